"""Settings of NARX surrogates: of one measured system, and with coefficients that are functions of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from structid.errors import InputError, Status, check_choice
from structid.ground_motion.excitation import Excitation
from structid.models.face import Progress
from structid.probability.space import Design, ParameterSpace
from structid.runs import InMemory, Runs
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.face import check_enough, common_step
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.narx.experiments import Signals
from structid.surrogates.narx.fitting import NARXFit, check_terms_of_chaos, held_out_rows
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.narx.structure import structure_of
from structid.surrogates.narx.terms import Memory, Term, as_memories, as_terms


@dataclass(frozen=True)
class NARXSettings:
    """What PC-NARX and Kriging-NARX have in common.

    Parameters
    ----------
    terms : sequence of Term or str, or mapping of str to such, optional
        Candidate terms of every output, or of each by its channel; left out, terms with a hysteretic memory. Outputs are called
        ``y``, or ``y1``, ``y2``, … where there are several, inputs ``x``, or ``x1``, ``x2``, ….
    memories : sequence of Memory or str
        Memories that `terms` use.
    training : {"joint", "per-experiment"}
        All coefficients at once, on the one-step and then on the free-run error; or as in the thesis: coefficients of each
        experiment by ordinary least squares, which are then interpolated.
    selection : {"lars", "orthogonal"}, optional
        Choose among the terms by their free runs; all are kept when left out.
    most_terms : int, optional
        Most terms the selection keeps.
    degree : int
        Largest degree of the chaos expansions that the coefficients of the joint training are.
    horizons : sequence of int, optional
        Samples between restarts from the measured past in the training that goes before the one on free runs, one after another;
        left out, 16 and 128 where the free runs of the regression are lost, and none where they are not.
    steps : int
        Most steps of the training on the free-run error; 0 leaves it at the regression.
    held_out : float
        Share of the runs that choose when to stop and what the predicted standard deviation is.
    washout : float
        Time at the start of each run that does not count [s], where what went before is not known.
    limit : float
        Largest mean relative error with which it may stand in a posterior.
    outside : {"warn", "refuse", "allow"}
        What to do with parameters beyond the range of the design.
    seed : int
        Seed of the choice of held-out runs.
    """

    terms: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None = None
    memories: Sequence[Memory | str] = ()
    training: Literal["joint", "per-experiment"] = "joint"
    selection: Literal["lars", "orthogonal"] | None = None
    most_terms: int | None = None
    degree: int = 3
    horizons: Sequence[int] | None = None
    steps: int = 10
    held_out: float = 0.1
    washout: float = 0.0
    limit: float = 5e-2
    outside: Literal["warn", "refuse", "allow"] = "warn"
    seed: int = 0

    def __post_init__(self) -> None:
        check_choice("training", self.training, ("joint", "per-experiment"))
        if self.selection is not None:
            check_choice("selection", self.selection, ("lars", "orthogonal"))
        if not 0.0 <= self.held_out < 0.5:
            raise InputError("held_out", f"{self.held_out}", "a share, 0 or more and below 0.5")
        for name, least in (("degree", 0), ("steps", 0), ("most_terms", 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(name, f"{value!r}", f"a whole number, {least} or more")
        if not (isinstance(self.washout, (int, float)) and self.washout >= 0.0):
            raise InputError("washout", f"{self.washout!r}", "a time in seconds, 0 or more")
        if not all(isinstance(h, int) and h >= 1 for h in self.horizons or ()):
            raise InputError("horizons", f"{self.horizons!r}", "numbers of samples, 1 or more")
        # A term or a memory that cannot be read is refused here, not after the runs.
        for terms in self.terms.values() if isinstance(self.terms, Mapping) else [self.terms or ()]:
            as_terms(terms)
        as_memories(self.memories)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against runs that are yet to be made.

        Parameters
        ----------
        design : Design
            Their points.
        records : sequence of Excitation
            What will drive them.
        channels : sequence of str
            What they will return.

        Raises
        ------
        InputError
            If no surrogate can be fitted to them: too few for the degree, records of different steps, terms of other signals.
        """
        kind = type(self).__name__
        common_step(f"{kind}.fit", records)
        structure_of(self.terms, self.memories, Signals.of(records[0], channels))
        check_enough(f"{kind}.fit", len(design), f"{len(design)} runs")
        if self.training == "joint":
            fitted, _ = held_out_rows(len(design), self.held_out, self.seed)
            check_terms_of_chaos(kind, design.space, self.degree, len(fitted))

    @property
    def in_words(self) -> dict[str, Any]:
        """All of them, as JSON can say it."""
        said = asdict(replace(self, terms=None, memories=()))
        if isinstance(self.terms, Mapping):
            said["terms"] = {output: [str(t) for t in terms] for output, terms in self.terms.items()}
        elif self.terms is not None:
            said["terms"] = [str(t) for t in self.terms]
        said["memories"] = [str(m) for m in self.memories]
        return said


@dataclass(frozen=True)
class PCNARX(NARXSettings):
    """Settings of a PC-NARX: a NARX whose coefficients are polynomial chaos expansions (thesis eq. 2.55).

    Parameters
    ----------
    pce : PCE
        For ``training="per-experiment"``: how the coefficients are expanded.
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`.
    """

    pce: PCE = field(default_factory=lambda: PCE(degree=tuple(range(1, 7)), hyperbolic_norm=1.0))

    def fit(self, runs: Runs, progress: Progress | None = None, weights: np.ndarray | None = None) -> ParametricNARX:
        """Fit to runs on one record or several.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how far the fit is, in hundredths.
        weights : ndarray, shape (run,), optional
            How much the error of each run counts in the joint training; the same for all when left out.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return NARXFit(self, runs, progress, weights=weights).pc_narx(self.pce)


@dataclass(frozen=True)
class KrigingNARX(NARXSettings):
    """Settings of a Kriging-NARX: a NARX whose coefficients are Kriging predictors (thesis eq. 2.72, with σ for its σ²).

    With ``training="joint"`` the coefficients of each run are refined on its own free run, drawn towards those of the joint
    training as far as the run does not determine them; what they differ by is interpolated. Alone, least squares leaves
    collinear coefficients to wander, and no interpolation follows.

    Parameters
    ----------
    kriging : Kriging
        How the coefficients are interpolated.
    refinements : int
        Steps of the refinement.
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`.
    """

    kriging: Kriging = field(default_factory=lambda: Kriging(nugget="estimate", separable=False))
    refinements: int = 2

    def fit(self, runs: Runs, progress: Progress | None = None, weights: np.ndarray | None = None) -> ParametricNARX:
        """Fit to runs on one record or several; see `PCNARX.fit`.

        Parameters
        ----------
        runs : Runs
            Of the model it is to stand for; failed ones are left out.
        progress : callable, optional
            Told how far the fit is, in hundredths.
        weights : ndarray, shape (run,), optional
            How much the error of each run counts in the joint training; the same for all when left out.

        Returns
        -------
        ParametricNARX
            A model for these parameters and any record.
        """
        return NARXFit(self, runs, progress, weights=weights).kriging_narx(self.kriging, self.refinements)


@dataclass(frozen=True)
class NARX(NARXSettings):
    """Settings of a NARX of one system: constant coefficients, identified from measured inputs and outputs.

    Parameters
    ----------
    terms, memories, training, selection, most_terms, degree, horizons, steps, held_out, washout, limit, outside, seed
        As for `NARXSettings`; there are no parameters, so the degree does not matter.
    """

    def fit(
        self,
        excitations: Excitation | Sequence[Excitation],
        responses: np.ndarray | Sequence[np.ndarray],
        channels: Sequence[str] = ("displacement",),
        progress: Progress | None = None,
    ) -> ParametricNARX:
        """Fit to one experiment or several.

        Parameters
        ----------
        excitations : Excitation or sequence of Excitation
            What drove the system; several inputs at once are a `CombinedExcitation`.
        responses : array-like or sequence of array-like, shape (time,) or (time, channel)
            What was measured, in SI, one for each excitation.
        channels : sequence of str
            Names of the channels.
        progress : callable, optional
            Told how far the fit is, in hundredths.

        Returns
        -------
        ParametricNARX
            A model without free parameters; ``simulate(np.zeros((1, 0)), record)`` runs it.
        """
        if isinstance(excitations, Excitation):
            excitations, responses = [excitations], [responses]  # type: ignore[list-item]
        channels = (channels,) if isinstance(channels, str) else tuple(channels)
        records = tuple(excitations)
        measured = [np.asarray(r, dtype=np.float64) for r in responses]
        if not records or len(records) != len(measured):
            raise InputError("NARX.fit", f"{len(measured)} responses to {len(records)} excitations", "one to each")
        samples = max(map(len, records))
        values = np.full((len(records), samples, len(channels)), np.nan)
        for row, (record, response) in enumerate(zip(records, measured, strict=True)):
            if response.shape not in ((len(record),) * (len(channels) == 1), (len(record), len(channels))):
                raise InputError(
                    "NARX.fit",
                    f"a response of shape {response.shape}",
                    f"({len(record)}, {len(channels)}) as its excitation",
                )
            if not np.isfinite(response).all():
                came = f"a response with {np.count_nonzero(~np.isfinite(response))} values that are not finite"
                raise InputError(
                    "NARX.fit", came, "finite numbers", "Cut or repair the measurement before handing it over."
                )
            values[row, : len(record)] = response.reshape(len(record), -1)
        nothing = Design(np.zeros((len(records), 0)), ParameterSpace())
        status = np.full(len(records), Status.DONE)
        runs = Runs(nothing, records, channels, InMemory(values), status, np.arange(len(records)))
        return NARXFit(self, runs, progress, fewest=1).pc_narx(PCE(degree=0))
