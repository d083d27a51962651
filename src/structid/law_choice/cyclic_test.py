"""A measured cyclic test: displacement and force, its scales, its half-cycles."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Int

from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.validation import check_arguments, real_array
from structid.data_files.loop_columns import read_loop_columns
from structid.ground_motion.excitation import DisplacementHistory
from structid.law_choice.cycles import Cycles, cumulative_displacement, cycle_ends, cycles_along
from structid.law_choice.specimen_test import Residuals, SensorValues, SpecimenTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.models.hysteretic.law_values import MODEL_PARAMETERS
from structid.observation import Observation
from structid.probability.space import ParameterSpace

REVERSAL = 0.02
"""Change of the displacement that counts as a reversal, relative to the largest displacement; below it are noise and creep."""
ELASTIC = 0.1
"""Part of the largest displacement up to which the first loading gives the initial stiffness."""
ONE_SIDED = 0.05
"""Smallest displacement of the weaker direction, relative to the largest, that counts as a second direction."""
FEW_TURNS = 6
"""Half-cycles below which a degradation can hardly be learnt."""
PRELOAD = 0.05
"""Force at the start, relative to the largest, that counts as a preload."""
JUMP = 0.2
"""Move between two samples, relative to the largest displacement, that counts as a jump."""
LONGEST, WEAKEST = 5.0, 1.0
"""Largest displacement [m] and smallest force [N] of a usual test."""
STIFFER = 1.5
"""Secant stiffness at the largest displacement, relative to the initial stiffness, that is not a specimen's."""
SLIPPING = 0.3
"""First slope, relative to the secant to the peaks, below which it says nothing of the specimen."""
USUAL = 0.99
"""Share of the moves that set the steps of a simulation; longer moves are divided, so that they do not set the steps of all."""
FEWEST = 20
"""Smallest number of samples of a test."""
SEARCHED = 600
"""Number of samples at which laws are searched; all turning points are among them."""
FIRST_PART = 0.7
"""Share of the half-cycles from which the others are predicted."""
KEPT_MODELS = 64
"""Number of models whose compiled loops are kept."""


@check_arguments
@dataclass(frozen=True, eq=False)
class CyclicTest(SpecimenTest):
    """Displacement and force of a quasi-static cyclic test.

    Parameters
    ----------
    displacement : array, shape (time,)
        Measured displacement [m].
    force : array, shape (time,)
        Measured force [N], in the direction of the displacement.
    name : str
        Name of the test.

    Raises
    ------
    InputError
        If the arrays differ in length, have missing values, or do not move.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> u = 0.02 * np.sin(np.linspace(0.0, 12.0, 400)) * np.linspace(0.2, 1.0, 400)
    >>> test = si.CyclicTest(u, 2e6 * u, name="elastic")
    >>> print(test)
    CyclicTest elastic: 400 samples, 4 half-cycles, ±18.7 mm, ±37.4 kN, initial stiffness 2 kN/mm
    """

    quantity: ClassVar[str] = "the force"
    course: ClassVar[str] = "half-cycles"

    displacement: np.ndarray = field(repr=False)
    force: np.ndarray = field(repr=False)
    name: str = "cyclic test"

    def __post_init__(self) -> None:
        for name in ("displacement", "force"):
            object.__setattr__(self, name, real_array(f"CyclicTest.{name}", getattr(self, name)))
        u, f = self.displacement, self.force
        if u.ndim != 1 or u.shape != f.shape or len(u) < FEWEST:
            raise InputError(
                "CyclicTest", f"shapes {u.shape} and {f.shape}", f"two histories of {FEWEST} or more samples"
            )
        if missing := int(np.count_nonzero(~np.isfinite(u + f))):
            raise InputError("CyclicTest", f"{missing} of {u.size} samples are not finite", "finite numbers")
        for name, values in (("displacement", u), ("force", f)):
            if not np.ptp(values) > 0.0:
                raise InputError(f"CyclicTest.{name}", f"a constant {name}", "a history that moves")
        if np.corrcoef(u, f)[0, 1] < 0.0:
            raise InputError(
                "CyclicTest.force",
                "a force that is negative where the displacement is positive",
                "the force that acts on the specimen in the direction of the displacement",
                "Multiply one of the two columns by -1.",
            )

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        displacement_unit: str,
        force_unit: str,
        displacement_column: int | str = 0,
        force_column: int | str = 1,
        missing: Literal["refuse", "leave_out"] = "refuse",
        name: str | None = None,
    ) -> CyclicTest:
        """Read a test from a file.

        Parameters
        ----------
        path : path-like
            A table of columns, of any format that `GroundMotion.read` reads.
        displacement_unit, force_unit : str
            Units of the columns, for example ``"mm"`` and ``"kN"``.
        displacement_column, force_column : int or str
            Columns: numbers, counted from 0, or titles.
        missing : {"refuse", "leave_out"}
            Whether lines without a displacement or a force are refused or left out.
        name : str, optional
            Name of the test; by default the file's.

        Returns
        -------
        CyclicTest
            The test.

        Raises
        ------
        InputError
            If the file cannot be read, or its columns are not a test.
        """
        displacement, force = read_loop_columns(
            path, displacement_unit, force_unit, displacement_column, force_column, gaps=missing == "leave_out"
        )
        measured = np.isfinite(displacement + force)
        return cls(displacement[measured], force[measured], Path(path).stem if name is None else name)

    @cached_property
    def turns(self) -> Int[np.ndarray, " turn"]:
        """Samples at which the displacement turns."""
        return turning_points(self.displacement, REVERSAL * self.largest_displacement)

    @property
    def largest_displacement(self) -> float:
        """Largest absolute displacement [m]."""
        return float(np.abs(self.displacement).max())

    @property
    def largest_force(self) -> float:
        """Largest absolute force [N]."""
        return float(np.abs(self.force).max())

    @cached_property
    def first_slope(self) -> float:
        """Slope of the regression through the first loading, up to a tenth of the largest displacement [N/m]."""
        beyond = np.abs(self.displacement - self.displacement[0]) > ELASTIC * self.largest_displacement
        end = max(int(np.argmax(beyond)) + 1, 3)
        return float(np.polyfit(self.displacement[:end], self.force[:end], 1)[0])

    @property
    def initial_stiffness(self) -> float:
        """The first slope, or the secant to the peaks if a slip or a preload has made the first slope too small [N/m]."""
        secant = self.largest_force / self.largest_displacement
        return self.first_slope if self.first_slope > SLIPPING * secant else secant

    def until(self, share: float) -> int:
        """Return the number of samples of the first half-cycles.

        Parameters
        ----------
        share : float
            Share of all half-cycles.

        Returns
        -------
        int
            Number of samples.
        """
        ends = np.append(self.turns, len(self.force))
        return int(ends[max(1, round(share * len(ends))) - 1])

    def part(self, samples: slice | np.ndarray) -> CyclicTest:
        """Return a part of the test.

        Parameters
        ----------
        samples : slice or ndarray of int
            The samples of the part.

        Returns
        -------
        CyclicTest
            The part.
        """
        return CyclicTest(self.displacement[samples], self.force[samples], self.name)

    def along(self, displacement: Float[np.ndarray, " time"]) -> CyclicTest:
        """Return a path of other displacements for the same specimen; its force is unknown.

        Parameters
        ----------
        displacement : ndarray, shape (time,)
            Displacements [m].

        Returns
        -------
        CyclicTest
            The path, with the initial stiffness times the displacement as its force.
        """
        return CyclicTest(
            displacement, self.initial_stiffness * np.asarray(displacement), f"prediction for {self.name}"
        )

    @property
    def cycles(self) -> Cycles:
        """Energy, stiffness, strength and equivalent damping of every complete cycle."""
        return self.cycles_of(self.force)

    def cycles_of(self, force: Float[np.ndarray, " time"]) -> Cycles:
        """Return the measures of every complete cycle with the force of a model.

        Parameters
        ----------
        force : ndarray, shape (time,)
            Force along the test's displacement [N].

        Returns
        -------
        Cycles
            The measures.
        """
        return cycles_along(self.displacement, force, cycle_ends(self.displacement, self.turns, not self._direction))

    def thinned(self, samples: int) -> CyclicTest:
        """Return the test at fewer samples, all turning points among them.

        Parameters
        ----------
        samples : int
            Approximate number of samples.

        Returns
        -------
        CyclicTest
            The thinned test, or the test itself if it has no more samples.
        """
        if len(self.force) <= samples:
            return self
        way = cumulative_displacement(self.displacement)
        even = np.searchsorted(way, np.linspace(0.0, way[-1], samples))
        return self.part(np.unique(np.concatenate([even.clip(0, len(way) - 1), self.turns])))

    def divided(self, move: float) -> tuple[DisplacementHistory, Int[np.ndarray, " time"]]:
        """Return the path with points between distant samples, and the rows of the samples.

        Parameters
        ----------
        move : float
            Longest move, relative to the largest displacement; infinite for no division.

        Returns
        -------
        tuple
            The path, and the row of every sample.
        """
        if move not in self._divisions:
            self._divisions[move] = self._division(move)
        return self._divisions[move]

    @cached_property
    def _divisions(self) -> dict[float, tuple[DisplacementHistory, Int[np.ndarray, " time"]]]:
        """The paths of `divided`; a model compiles its loop for each once."""
        return {}

    def _division(self, move: float) -> tuple[DisplacementHistory, Int[np.ndarray, " time"]]:
        u = self.displacement
        pieces = np.maximum(1, np.ceil(np.abs(np.diff(u)) / (move * self.largest_displacement))).astype(int)
        rows = np.concatenate([[0], np.cumsum(pieces)])
        return DisplacementHistory(np.interp(np.arange(rows[-1] + 1), rows, u), 1.0, self.name), rows

    @property
    def questions(self) -> tuple[str, ...]:
        """Doubts about the measurement, and what it cannot show, in sentences."""
        return tuple(filter(None, (self._direction, self._count, self._preload, self._jump, self._size, self._swapped)))

    @property
    def _direction(self) -> str:
        ends = self.displacement.min(), self.displacement.max()
        if min(-ends[0], ends[1]) > ONE_SIDED * self.largest_displacement:
            return ""
        return "The displacement has one direction only: the test cannot show an asymmetric strength."

    @property
    def _count(self) -> str:
        if len(self.turns) >= FEW_TURNS:
            return ""
        return f"The test has {len(self.turns)} half-cycles: it can hardly show a loss of strength or stiffness with the cycles."

    @property
    def _preload(self) -> str:
        first = self.force[0] - self.initial_stiffness * self.displacement[0]
        if abs(first) <= PRELOAD * self.largest_force:
            return ""
        return f"The test begins with a force of {1e-3 * first:.3g} kN: a preload, or the zero of the load cell."

    @property
    def _jump(self) -> str:
        moves = np.abs(np.diff(self.displacement))
        if moves.max() <= JUMP * self.largest_displacement:
            return ""
        sample = int(moves.argmax()) + 1
        return f"The displacement jumps by {1e3 * moves.max():.3g} mm at sample {sample}: samples are missing, or a sensor slipped."

    @property
    def _size(self) -> str:
        if self.largest_displacement < LONGEST and self.largest_force > WEAKEST:
            return ""
        return (
            f"The largest displacement is {self.largest_displacement:.3g} m, and the largest force {self.largest_force:.3g} N: "
            "check the units, or whether the columns are exchanged."
        )

    @property
    def _swapped(self) -> str:
        """A specimen softens: its secant stiffness at the peak is not much above the initial stiffness."""
        peak = int(np.abs(self.displacement).argmax())
        secant = abs(self.force[peak] / self.displacement[peak])
        if secant < STIFFER * self.first_slope:
            return ""
        return (
            f"The secant stiffness at the largest displacement, {1e-6 * secant:.3g} kN/mm, is larger than the first slope, "
            f"{1e-6 * self.first_slope:.3g} kN/mm: the columns may be exchanged, or the rig slips."
        )

    @cached_property
    def _divided_at_jumps(self) -> tuple[DisplacementHistory, Int[np.ndarray, " time"]]:
        moves = np.abs(np.diff(self.displacement))
        return self.divided(float(np.quantile(moves, USUAL)) / self.largest_displacement)

    @property
    def path(self) -> DisplacementHistory:
        """The displacement as an excitation, with points between the most distant samples; its rate has no meaning."""
        return self._divided_at_jumps[0]

    @property
    def rows(self) -> Int[np.ndarray, " time"]:
        """Rows of the samples in `path`."""
        return self._divided_at_jumps[1]

    @property
    def observation(self) -> Observation:
        """The measured force as an observation along `path`, with missing values between the samples."""
        values = np.full(len(self.path.values), np.nan)
        values[self.rows] = self.force
        return Observation(self.path, values, ("restoring_force",))

    def priors(self, law: HystereticLaw, known: Collection[str] = ()) -> ParameterSpace:
        """Return the default priors of a law for this test, with the force offset.

        Parameters
        ----------
        law : HystereticLaw
            The law.
        known : collection of str
            Parameters without a prior, which keep the law's value.

        Returns
        -------
        ParameterSpace
            Priors of its parameters, in kN and mm.
        """
        described = law.parameters() | {"force_offset": MODEL_PARAMETERS["force_offset"]}
        priors = {name: p for name, p in described.items() if name not in known}
        return ParameterSpace({n: self.default_prior(p) for n, p in priors.items() if p.prior is not None})

    # --- as the choice of a law uses it; see `SpecimenTest` -----------------------------------------------------

    @cached_property
    def sensors(self) -> tuple[SensorValues, ...]:
        """The force; its gaps are counted along `path`."""
        return (SensorValues(self.force, np.diff(self.rows)),)

    @property
    def observations(self) -> tuple[Observation, ...]:
        """The observation of the force."""
        return (self.observation,)

    @property
    def content_hash(self) -> str:
        """Hash of displacement and force."""
        return digest([self.displacement, self.force])

    def model(self, law: HystereticLaw, free: Sequence[str]) -> Hysteretic:
        """Return the spring under imposed displacements.

        Parameters
        ----------
        law : HystereticLaw
            The law.
        free : sequence of str
            Its free parameters.

        Returns
        -------
        Hysteretic
            The model.
        """
        return _spring(law, tuple(free))

    def residuals(self, law: HystereticLaw, space: ParameterSpace, finer: int = 1) -> Residuals:
        """Return the errors of the force as a function of the parameters; see `SpecimenTest.residuals`."""
        model = self.model(law, space.names)
        # Only distant samples are divided: that takes fewer steps than as many for every sample.
        path, rows = self.divided(law.accurate_move / finer)
        return lambda theta: self.force - model.simulate(theta, path).values[:, rows, 0]

    @cached_property
    def searched(self) -> CyclicTest:
        """The test at fewer samples."""
        return self.thinned(SEARCHED)

    @cached_property
    def first(self) -> CyclicTest | None:
        """The first half-cycles."""
        end = self.until(FIRST_PART)
        return None if end == len(self.force) else self.part(slice(0, end))

    def __str__(self) -> str:
        return (
            f"CyclicTest {self.name}: {len(self.force)} samples, {len(self.turns)} half-cycles, "
            f"±{1e3 * self.largest_displacement:.1f} mm, ±{1e-3 * self.largest_force:.1f} kN, "
            f"initial stiffness {1e-6 * self.initial_stiffness:.3g} kN/mm"
        )


@lru_cache(maxsize=KEPT_MODELS)
def _spring(law: HystereticLaw, free: tuple[str, ...]) -> Hysteretic:
    """Return the spring under imposed displacements; fits to a test and to its parts share its compiled loops."""
    return Hysteretic(law, free=free, channels=("restoring_force",))


def turning_points(values: Float[np.ndarray, " time"], change: float) -> Int[np.ndarray, " turn"]:
    """Return the samples at which a history turns by more than a change."""
    turns: list[int] = []
    high = low = direction = 0
    for i, value in enumerate(values):
        high, low = (i if value > values[high] else high), (i if value < values[low] else low)
        if direction >= 0 and value < values[high] - change:
            turns.append(high)
            direction, low = -1, i
        elif direction <= 0 and value > values[low] + change:
            turns.append(low)
            direction, high = 1, i
    return np.array([i for i in turns if i > 0], dtype=int)
