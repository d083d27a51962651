"""A ground-motion record, with methods to read, simulate, process, characterise and draw it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structid.core.errors import InputError
from structid.core.units import STANDARD_GRAVITY, factor
from structid.core.validation import check_arguments
from structid.data_files.read_file import read_signal
from structid.figures import record as record_figures
from structid.ground_motion import processing, spectra
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.synthetic import stochastic_acceleration

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LONGEST_STEP = 0.5
"""Time step [s] from which times are probably not in seconds."""


@check_arguments
class GroundMotion(Excitation):
    """Ground acceleration with a constant time step. Records are immutable: every operation returns a new record.

    Parameters
    ----------
    values : array-like, shape (time,)
        Acceleration [m/s²].
    dt : float
        Time step [s].
    name : str
        Name of the record.
    interpolation, lead_in_periods
        As for `Excitation`.

    Examples
    --------
    >>> import structid as si
    >>> record = si.GroundMotion.synthetic(seed=7).lowpass(20.0).scale_to_pga(1.8)
    >>> round(record.pga, 6)
    1.8
    """

    kind = "ground_motion"
    unit = "m/s^2"
    display_unit = "m/s^2"

    @property
    def acceleration(self) -> np.ndarray:
        """Ground acceleration [m/s²], shape (time,)."""
        return self.values

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        dt: float | None = None,
        unit: str | None = None,
        column: int | str | None = None,
        name: str | None = None,
        component: str | int | None = None,
        time_column: int | str | None = None,
    ) -> GroundMotion:
        r"""Read a ground acceleration from a file of a strong-motion network, a logger or a program.

        The format is recognised by the content of the file. The page "From your files to a study" lists all formats.

        Parameters
        ----------
        path : path-like
            The file.
        dt : float, optional
            Time step [s] of a file that does not state it. For points digitised from a film, which have no constant step: the
            step of a linear interpolation.
        unit : str, optional
            Unit of the values, such as ``"g"`` or ``"gal"``. It must agree with a unit in the file.
        column : int or str, optional
            Column of the values in a table: its number, counted from 0, or its title.
        name : str, optional
            Name of the record; the file's name by default.
        component : str or int, optional
            Channel of a file with several channels: its direction, such as ``"EW"``, or its number from 1.
        time_column : int or str, optional
            Column of the times in a table; by default the one whose title names the time, or the first.

        Returns
        -------
        GroundMotion
            The record.

        Raises
        ------
        InputError
            If the file is damaged, holds something else, or leaves a choice. The message names the line, and the choice.

        Examples
        --------
        >>> import tempfile, pathlib
        >>> import structid as si
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "table.csv"
        >>> _ = file.write_text("time [s];floor [g]\n0,00;0,10\n0,01;-0,25\n0,02;0,05\n")
        >>> round(si.GroundMotion.read(file).pga, 4)
        2.4517
        """
        signal = read_signal(path, unit, dt, column, "m/s^2", (), time_column, component)
        if signal.dt >= LONGEST_STEP:
            raise InputError(
                f"{path}",
                f"a time step of {signal.dt:g} s",
                f"a record with a step below {LONGEST_STEP:g} s",
                "If the times are in milliseconds, write the unit into the title, as in 'time [ms]', or give dt and the column.",
            )
        return cls(signal.values[:, 0], signal.dt, Path(path).stem if name is None else name)

    @classmethod
    def synthetic(
        cls,
        seed: int,
        duration: float = 40.0,
        dt: float = 0.01,
        arias: float = 1.0,
        significant_duration: float = 10.0,
        middle: float = 8.0,
        frequency: float = 2.0,
        frequency_slope: float = -0.02,
        bandwidth: float = 0.4,
    ) -> GroundMotion:
        """Simulate a stochastic record (Rezaeian & Der Kiureghian 2010, doi 10.1002/eqe.997).

        White noise passes through a filter whose frequency changes with time. It is then multiplied by a gamma-type modulating
        function and high-pass filtered.

        Parameters
        ----------
        seed : int
            Seed; the same seed gives the same record.
        duration, dt : float
            Length and time step [s].
        arias : float
            Expected Arias intensity [m/s].
        significant_duration, middle : float
            Expected significant duration D5-95, and time of the middle of the strong shaking [s].
        frequency, frequency_slope : float
            Filter frequency at the middle of the strong shaking [Hz] and its rate of change [Hz/s].
        bandwidth : float
            Damping ratio of the filter.

        Returns
        -------
        GroundMotion
            The record.
        """
        if dt > 0:
            processing.check_samples("GroundMotion.synthetic(duration, dt)", duration / dt)
        samples = round(duration / dt) + 1 if dt > 0 else 0
        acceleration = stochastic_acceleration(
            seed, samples, dt, arias, significant_duration, middle, frequency, frequency_slope, bandwidth
        )
        return cls(acceleration, dt, f"synthetic, seed {seed}")

    # --- processing ---------------------------------------------------------------------------------------------

    def _with(self, acceleration: np.ndarray, **changes: Any) -> GroundMotion:
        return replace(self, values=acceleration, **changes)

    def baseline(self, kind: str | Sequence[float] | Sequence[tuple[float, float]] = "constant") -> GroundMotion:
        """Subtract the mean, the least-squares line, or the offset of an instrument before the shaking.

        Parameters
        ----------
        kind : {"constant", "linear"}, pair of float, or two pairs
            Subtract the mean (``"constant"``), the least-squares line (``"linear"``), the mean between two times [s] at rest, or
            the line through the means of two such stretches.

        Returns
        -------
        GroundMotion
            The corrected record.

        Raises
        ------
        InputError
            If there is no sample between the two times.
        """
        if isinstance(kind, str):
            return self._with(processing.remove_baseline(self.values, kind))
        return self._with(
            processing.remove_offset(self.values, self.time, processing.stretches(kind, "baseline"), "baseline")
        )

    def lowpass(self, edge: float, order: int | None = None, stop: float | None = None) -> GroundMotion:
        """Zero-phase Butterworth low-pass.

        Parameters
        ----------
        edge : float
            Passband edge [Hz]. The two passes together attenuate by 6 dB there.
        order : int, optional
            Order of one pass; by default the smallest that attenuates by 8 dB at `stop` (3 for 20 Hz at 0.01 s).
        stop : float, optional
            Stopband edge [Hz]; 1.25 × `edge` by default.

        Returns
        -------
        GroundMotion
            The filtered record.
        """
        order = processing.butterworth_order(edge, self.dt, stop) if order is None else order
        return self._with(processing.butterworth(self.values, self.dt, edge, "lowpass", order))

    def highpass(self, edge: float, order: int = 4) -> GroundMotion:
        """Zero-phase Butterworth high-pass.

        Parameters
        ----------
        edge : float
            Passband edge [Hz].
        order : int
            Order of one pass.

        Returns
        -------
        GroundMotion
            The filtered record.
        """
        return self._with(processing.butterworth(self.values, self.dt, edge, "highpass", order))

    def bandpass(self, low: float, high: float, order: int = 4) -> GroundMotion:
        """Zero-phase Butterworth band-pass.

        Parameters
        ----------
        low, high : float
            Passband edges [Hz].
        order : int
            Order of one pass.

        Returns
        -------
        GroundMotion
            The filtered record.
        """
        return self._with(processing.butterworth(self.values, self.dt, (low, high), "bandpass", order))

    def scale(self, by: float) -> GroundMotion:
        """Multiply by a factor.

        Parameters
        ----------
        by : float
            The factor.

        Returns
        -------
        GroundMotion
            The scaled record.
        """
        return self._with(self.values * by)

    def scale_to_pga(self, pga: float) -> GroundMotion:
        """Scale to a given peak ground acceleration.

        Parameters
        ----------
        pga : float
            Peak ground acceleration of the scaled record [m/s²].

        Returns
        -------
        GroundMotion
            The scaled record.

        Raises
        ------
        InputError
            If all values of the record are zero, or `pga` is not a positive number.
        """
        if not 0.0 < pga < np.inf:
            raise InputError(
                "scale_to_pga",
                f"{pga!r}",
                "a positive peak in m/s²",
                "For the opposite sign, use scale(-1.0).",
            )
        if self.pga == 0.0:
            raise InputError(
                "scale_to_pga", "all values of the record are zero", "a record that is not zero everywhere"
            )
        return self.scale(pga / self.pga)

    def resample(self, dt: float) -> GroundMotion:
        """Resample with an anti-aliasing filter.

        Parameters
        ----------
        dt : float
            The new time step [s].

        Returns
        -------
        GroundMotion
            The resampled record.
        """
        return self._with(processing.resample(self.values, self.dt, dt), dt=dt)

    def trim(self, start: float, end: float) -> GroundMotion:
        """Keep the samples from `start` to `end`, both included.

        Parameters
        ----------
        start, end : float
            First and last time [s].

        Returns
        -------
        GroundMotion
            The selected part of the record; its time starts at zero.

        Raises
        ------
        InputError
            If the interval is empty or not inside the record.
        """
        inside = 0.0 <= start < end <= self.duration + self.dt
        first, last = (round(start / self.dt), min(round(end / self.dt), len(self) - 1)) if inside else (0, 0)
        if last - first < 1:
            raise InputError("trim", f"{start:g} s to {end:g} s", f"an interval between 0 s and {self.duration:g} s")
        return self._with(self.values[first : last + 1])

    def pad(self, before: float = 0.0, after: float = 0.0) -> GroundMotion:
        """Add zeros before and after.

        Parameters
        ----------
        before, after : float
            Duration of the zeros [s].

        Returns
        -------
        GroundMotion
            The longer record.
        """
        if before < 0 or after < 0:
            raise InputError("pad", f"{before:g} s before, {after:g} s after", "times of 0 s or more")
        processing.check_samples("pad", len(self) + (before + after) / self.dt)
        return self._with(np.pad(self.values, (round(before / self.dt), round(after / self.dt))))

    # --- measures and spectra -----------------------------------------------------------------------------------

    @property
    def pga(self) -> float:
        """Peak ground acceleration [m/s²]."""
        return float(np.abs(self.values).max())

    @property
    def velocity(self) -> np.ndarray:
        """Ground velocity [m/s], integrated from rest, shape (time,)."""
        return processing.integrate(self.values, self.dt)

    @property
    def displacement(self) -> np.ndarray:
        """Ground displacement [m], integrated from rest, shape (time,)."""
        return processing.integrate(self.velocity, self.dt)

    @property
    def pgv(self) -> float:
        """Peak ground velocity [m/s]."""
        return float(np.abs(self.velocity).max())

    @property
    def pgd(self) -> float:
        """Peak ground displacement [m]."""
        return float(np.abs(self.displacement).max())

    @property
    def arias_intensity(self) -> float:
        """Arias intensity π/(2g) ∫ a² dt [m/s]."""
        return float(spectra.arias_history(self.values, self.dt)[-1])

    @property
    def significant_duration(self) -> float:
        """Time from 5 to 95 % of the Arias intensity [s]."""
        return spectra.significant_duration(self.values, self.dt)

    def fourier_amplitude(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the Fourier amplitude spectrum.

        Returns
        -------
        tuple of ndarray, shape (frequency,)
            Frequency [Hz] and amplitude [m/s].
        """
        return spectra.fourier_amplitude(self.values, self.dt)

    @property
    def dominant_frequency(self) -> float:
        """Frequency of the largest Fourier amplitude [Hz]."""
        frequency, amplitude = self.fourier_amplitude()
        return float(frequency[1:][np.argmax(amplitude[1:])])

    def response_spectrum(
        self, periods: np.ndarray | None = None, damping_ratio: float = 0.05
    ) -> spectra.ResponseSpectrum:
        """Compute the response spectrum of linear oscillators.

        Parameters
        ----------
        periods : ndarray, shape (period,), optional
            Periods [s]; by default 120 from 0.02 to 10 s.
        damping_ratio : float
            Fraction of critical damping.

        Returns
        -------
        ResponseSpectrum
            Period [s], displacement [m], pseudo-velocity [m/s], pseudo-acceleration [m/s²].
        """
        return spectra.response_spectrum(self.values, self.dt, periods, damping_ratio)

    # --- output -------------------------------------------------------------------------------------------------

    def __str__(self) -> str:
        return (
            f"GroundMotion '{self.name}': PGA {self.pga:.4g} m/s² ({self.pga / STANDARD_GRAVITY:.3g} g), dt {self.dt:g} s, "
            f"fs {1 / self.dt:g} Hz, {len(self)} samples, {self.duration:g} s, "
            f"dominant frequency {self.dominant_frequency:.3g} Hz"
        )

    def __repr__(self) -> str:
        return f"<{self}>"

    def to_csv(self, path: str | os.PathLike[str], unit: str = "m/s^2") -> Path:
        """Write time and acceleration as two columns that `read` can read.

        Parameters
        ----------
        path : path-like
            The file.
        unit : str
            Unit of the accelerations.

        Returns
        -------
        Path
            The file written.
        """
        table, header = np.column_stack([self.time, self.values / factor(unit)]), f"time [s],acceleration [{unit}]"
        np.savetxt(path, table, delimiter=",", comments="", fmt="%.12g", header=header)
        return Path(path)

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the record, its Fourier amplitude and its response spectrum.

        Parameters
        ----------
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        spectrum = self.response_spectrum()
        drawn = (self.time, self.values, *self.fourier_amplitude(), spectrum.period, spectrum.pseudo_acceleration)
        return record_figures.record(*drawn, title=self.name, save=save)

    def plot_filter(self, filtered: GroundMotion, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw this record and the filtered record in the time and frequency domains, to tune the filter.

        Parameters
        ----------
        filtered : GroundMotion
            The same record after filtering.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        before = (self.time, self.values, *self.fourier_amplitude())
        after = (filtered.time, filtered.values, *filtered.fourier_amplitude())
        return record_figures.filter_tuning(*before, *after, title=self.name, save=save)
