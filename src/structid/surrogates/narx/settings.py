"""Settings common to all NARX surrogates.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from structid.core.errors import InputError, check_choice
from structid.core.keys import Seconds
from structid.core.streams import Purpose, stream
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.surrogates.fit import OutsideRule, check_enough, common_step
from structid.surrogates.in_coordinates import coordinate_design
from structid.surrogates.narx.structure.experiments import NARXSignals
from structid.surrogates.narx.structure.narx_structure import structure_of
from structid.surrogates.narx.structure.terms import Memory, Term, as_memories, as_terms


@dataclass(frozen=True)
class NARXSettings:
    """Settings common to PC-NARX and Kriging-NARX."""

    # Candidate terms of every output, or of each output by its channel; by default terms with a hysteretic memory. The
    # output is ``y``, or several outputs ``y1``, ``y2``, …; the input is ``x``, or several inputs ``x1``, ``x2``, …
    terms: Sequence[Term | str] | Mapping[str, Sequence[Term | str]] | None = None
    memories: Sequence[Memory | str] = ()  # memories used by `terms`
    # ``"joint"``: fit all coefficients at once, to the one-step error and then to the free-run error. ``"per-experiment"``,
    # as in the thesis: fit the coefficients of each experiment by ordinary least squares, and then interpolate them
    training: Literal["joint", "per-experiment"] = "joint"
    # Method that selects terms by their free runs; by default all terms are kept
    selection: Literal["lars", "orthogonal"] | None = None
    most_terms: int | None = None  # largest number of terms that the selection keeps
    degree: int = 3  # largest degree of the coefficients' chaos expansions in the joint training
    # Samples between restarts from the measured past, one number for each stage of training before the stage on free
    # runs. Default: 16 and then 128 if the free runs of the regression diverge, and otherwise no such stages
    horizons: Sequence[int] | None = None
    steps: int = 10  # largest number of training steps on the free-run error; 0 keeps the regression
    # Fraction of held-out runs, which determine the end of the training and the predicted standard deviation
    held_out: float = 0.1
    # Time at the start of each run that is not used [s], since the preceding signals are unknown
    washout: float = 0.0
    limit: float = 5e-2  # largest mean relative error accepted in a posterior
    outside: OutsideRule = "warn"  # treatment of points outside the range of the design
    seed: int = 0  # seed for the choice of held-out runs

    warm_start: ClassVar[bool] = False
    weighted: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_choice("training", self.training, ("joint", "per-experiment"))
        if self.selection is not None:
            check_choice("selection", self.selection, ("lars", "orthogonal"))
        if not 0.0 <= self.held_out < 0.5:
            raise InputError("held_out", f"{self.held_out}", "a fraction of at least 0 and below 0.5")
        for name, least in (("degree", 0), ("steps", 0), ("most_terms", 1)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(name, f"{value!r}", f"a whole number of {least} or more")
        if not (isinstance(self.washout, (int, float)) and self.washout >= 0.0):
            raise InputError("washout", f"{self.washout!r}", "a time of 0 s or more")
        if not all(isinstance(h, int) and h >= 1 for h in self.horizons or ()):
            raise InputError("horizons", f"{self.horizons!r}", "whole numbers of samples, each 1 or more")
        # Invalid terms and memories are refused here, before the model runs.
        for terms in self.terms.values() if isinstance(self.terms, Mapping) else [self.terms or ()]:
            as_terms(terms)
        as_memories(self.memories)

    def check(self, design: Design, records: Sequence[Excitation], channels: Sequence[str]) -> None:
        """Check the settings against planned runs."""
        kind = type(self).__name__
        common_step(f"{kind}.fit", records)
        structure_of(self.terms, self.memories, NARXSignals.of(records[0], channels))
        check_enough(f"{kind}.fit", len(design), f"{len(design)} runs")
        if self.training == "joint":
            fitted, _ = held_out_rows(len(design), self.held_out, self.seed)
            check_terms_of_chaos(kind, coordinate_design(design).space, self.degree, len(fitted))

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""
        settings = asdict(replace(self, terms=None, memories=()))
        if isinstance(self.terms, Mapping):
            settings["terms"] = {output: [str(t) for t in terms] for output, terms in self.terms.items()}
        elif self.terms is not None:
            settings["terms"] = [str(t) for t in self.terms]
        settings["memories"] = [str(m) for m in self.memories]
        return settings


def held_out_rows(runs: int, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Select training runs and held-out runs at random."""
    count = round(share * runs)
    order = stream(seed, Purpose.HELD_OUT_RUNS).permutation(runs)
    return np.sort(order[count:]), np.sort(order[:count])


def check_terms_of_chaos(kind: str, space: ParameterSpace, degree: int, runs: int) -> None:
    """Check that there are enough runs for coefficients that are chaos expansions of a given degree."""
    terms = math.comb(space.dimension + degree, degree)
    if terms > max(runs // 2, 1):
        raise InputError(
            f"{kind}.fit",
            f"{runs} runs (without held-out runs) for coefficients of {terms} chaos terms (degree {degree})",
            f"at least {2 * terms} runs",
            "Lower the degree.",
        )


NARX_KEYS = {
    "terms": tuple[str, ...] | dict[str, tuple[str, ...]],
    "memories": tuple[str, ...],
    "training": Literal["joint", "per-experiment"],
    "selection": Literal["lars", "orthogonal"],
    "most_terms": int,
    "degree": int | tuple[int, ...],
    "horizons": tuple[int, ...],
    "steps": int,
    "held_out": float,
    "washout": Annotated[Seconds, Field(ge=0)],
}
"""Study-file keys common to all NARX surrogates, and their types; see `NARXSettings`."""

JOINT_KEYS = ("degree", "horizons", "steps")
"""Keys used only by the joint training."""
