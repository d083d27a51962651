"""NARX of one measured system, with constant coefficients identified from measured inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.campaign.runs import Runs, StoredInMemory
from structid.core.errors import InputError, Status
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.narx.narx_fit import NARXFit
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.settings import NARXSettings
from structid.surrogates.surrogate_kind import SurrogateKind


@check_arguments
@dataclass(frozen=True)
class NARX(NARXSettings):
    """Settings of a NARX of one system, with constant coefficients identified from measured inputs and outputs.

    Parameters
    ----------
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        See `NARXSettings`. There are no parameters, so the degree has no effect.

    Examples
    --------
    >>> import structid as si
    >>> settings = si.NARX(terms=["y(t-1)", "y(t-2)", "x(t)", "x(t-1)"])
    >>> surrogate = settings.fit(runs)  # doctest: +SKIP
    """

    def fit(
        self,
        excitations: Excitation | Sequence[Excitation],
        responses: np.ndarray | Sequence[np.ndarray],
        channels: Sequence[str] = ("displacement",),
        progress: Progress | None = None,
    ) -> ParametricNARX:
        """Fit a NARX to one or several experiments.

        Parameters
        ----------
        excitations : Excitation or sequence of Excitation
            Excitations of the system; combine several simultaneous inputs in a `CombinedExcitation`.
        responses : array-like or sequence of array-like, shape (time,) or (time, channel)
            Measured responses in SI, one for each excitation.
        channels : sequence of str
            Names of the channels.
        progress : callable, optional
            Callback whose arguments are the finished percentage of the fit, and 100.

        Returns
        -------
        ParametricNARX
            A model without free parameters; ``simulate(np.zeros((1, 0)), record)`` runs it.
        """
        if isinstance(excitations, Excitation):
            excitations, responses = [excitations], [responses]  # type: ignore[list-item]
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        records = tuple(excitations)
        for record in records:
            if not isinstance(record, Excitation):
                raise InputError(
                    "NARX.fit(excitations)",
                    f"a {type(record).__name__}",
                    "a ForceHistory, a GroundMotion or another excitation, which has a time step",
                    "Use, for example, structid.ForceHistory(values, dt).",
                )
        measured = [np.asarray(r, dtype=np.float64) for r in responses]
        if not records or len(records) != len(measured):
            raise InputError("NARX.fit", f"{len(measured)} responses to {len(records)} excitations", "one for each")
        samples = max(map(len, records))
        values = np.full((len(records), samples, len(channels)), np.nan)
        for row, (record, response) in enumerate(zip(records, measured, strict=True)):
            if response.shape not in ((len(record),) * (len(channels) == 1), (len(record), len(channels))):
                raise InputError(
                    "NARX.fit",
                    f"a response of shape {response.shape}",
                    f"shape ({len(record)}, {len(channels)}), to match its excitation",
                )
            if not np.isfinite(response).all():
                came = f"a response with {np.count_nonzero(~np.isfinite(response))} values that are not finite"
                raise InputError("NARX.fit", came, "finite numbers", "Cut or repair the measurement first.")
            values[row, : len(record)] = response.reshape(len(record), -1)
        nothing = Design(np.zeros((len(records), 0)), ParameterSpace())
        status = np.full(len(records), Status.DONE)
        runs = Runs(nothing, records, channels, StoredInMemory(values), status, np.arange(len(records)))
        return NARXFit(self, runs, progress, fewest=1).pc_narx(PCE(degree=0))


KIND = SurrogateKind(NARX, ParametricNARX)
