"""Response histories of many runs, and the status of each run."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structid.core.channels import ChannelUnit, standard_unit
from structid.core.errors import InputError, Status, check_choice
from structid.core.units import factor
from structid.core.validation import check_arguments

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@check_arguments
@dataclass(frozen=True)
class Histories:
    """Response histories of several runs on one excitation.

    Parameters
    ----------
    values : ndarray, shape (run, time, channel)
        Responses in SI; NaN after the failure of a run.
    dt : float
        Time step [s].
    channels : sequence of str
        Names of the channels.
    status : ndarray of int, shape (run,), optional
        `Status` of each run; by default all runs are done.
    failure_time : ndarray, shape (run,), optional
        Time at which a run failed [s]; NaN for a run without failure.
    excitation : str, optional
        Name of the record.
    reasons : sequence of str, optional
        Reason why each run failed; empty for a run without failure.
    units : dict of str to ChannelUnit, optional
        Units of the channels; by default the units of the standard channel names.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> model = si.BoucWen(mass=12e3, stiffness=7.4e6, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0)
    >>> histories = model.simulate(np.empty((1, 0)), si.GroundMotion.synthetic(seed=7))
    >>> histories.channels
    ('velocity',)
    """

    values: np.ndarray
    dt: float
    channels: tuple[str, ...]
    status: np.ndarray = field(default=None)  # type: ignore[arg-type]
    failure_time: np.ndarray = field(default=None)  # type: ignore[arg-type]
    excitation: str = ""
    reasons: tuple[str, ...] = ()
    units: dict[str, ChannelUnit] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = np.asarray(self.values, dtype=np.float64)
        if values.ndim != 3 or values.shape[2] != len(self.channels):
            raise InputError("Histories.values", f"shape {values.shape}", f"(run, time, {len(self.channels)} channels)")
        runs = values.shape[0]
        status = np.zeros(runs, dtype=np.int8) if self.status is None else np.asarray(self.status, dtype=np.int8)
        times = np.full(runs, np.nan) if self.failure_time is None else np.asarray(self.failure_time, dtype=np.float64)
        for name, value in (
            ("values", values),
            ("status", status),
            ("failure_time", times),
            ("channels", tuple(self.channels)),
            ("reasons", tuple(self.reasons) or ("",) * runs),
            ("units", {c: self.units.get(c, standard_unit(c)) for c in self.channels}),
        ):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        runs, samples, _ = self.values.shape
        on = f" on {self.excitation}" if self.excitation else ""
        return f"Histories of {runs} runs, {int(self.done.sum())} done, {samples} samples of {', '.join(self.channels)}{on}"

    def __len__(self) -> int:
        return int(self.values.shape[0])

    @property
    def time(self) -> np.ndarray:
        """Times of the samples [s], shape (time,)."""
        return np.arange(self.values.shape[1]) * self.dt

    @property
    def done(self) -> np.ndarray:
        """Mask of the runs that reached the end, shape (run,)."""
        return np.asarray(self.status == Status.DONE)

    def channel(self, name: str) -> np.ndarray:
        """Return one channel of every run.

        Parameters
        ----------
        name : str
            The channel.

        Returns
        -------
        ndarray, shape (run, time)
            Its values in SI.

        Raises
        ------
        InputError
            If there is no such channel.
        """
        return self.values[:, :, self.channels.index(check_choice("channel", name, self.channels))]

    def to_csv(self, path: str | os.PathLike[str], run: int = 0, display: bool = False) -> Path:
        """Write one run as comma-separated columns: time, then every channel.

        Parameters
        ----------
        path : path-like
            The file.
        run : int
            Index of the run.
        display : bool
            Write display units (mm, kN) instead of SI.

        Returns
        -------
        Path
            The file written.
        """
        units = [self.units[c].display if display else self.units[c].si for c in self.channels]
        columns = self.values[run] / np.array([factor(u) for u in units])
        header = ",".join(["time [s]", *(f"{c} [{u}]" for c, u in zip(self.channels, units, strict=True))])
        np.savetxt(
            path,
            np.column_stack([self.time, columns]),
            delimiter=",",
            header=header,
            comments="",
            fmt="%.12g",
        )
        return Path(path)

    def to_xarray(self) -> xarray.Dataset:
        """Return the histories as an xarray Dataset with dimensions run, time, channel.

        Returns
        -------
        xarray.Dataset
            Variables ``values``, ``status``, ``failure_time`` and ``reason``.
        """
        import xarray

        return xarray.Dataset(
            {
                "values": (("run", "time", "channel"), self.values),
                "status": ("run", self.status),
                "failure_time": ("run", self.failure_time),
                "reason": ("run", np.array(self.reasons, dtype=object)),
            },
            coords={"time": self.time, "channel": list(self.channels)},
            attrs={"dt": self.dt, "excitation": self.excitation},
        )

    def plot(self, run: int = 0, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw every channel of one run against time.

        Parameters
        ----------
        run : int
            Index of the run.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from structid.figures import response

        units = [self.units[c].display for c in self.channels]
        columns = [self.channel(c)[run] / factor(u) for c, u in zip(self.channels, units, strict=True)]
        return response.histories(self.time, columns, self.channels, units, title=self.excitation, save=save)
