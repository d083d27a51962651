"""Responses of a specimen with a mass to ground motions or forces, from which its hysteretic law is chosen."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.errors import ConvergenceError, InputError
from structid.core.hashing import digest
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import DisplacementHistory, Excitation
from structid.inference.error_models.independent import IID
from structid.inference.likelihood.joint_likelihood import JointLikelihood
from structid.inference.likelihood.observation_likelihood import ObservationLikelihood
from structid.law_choice.cyclic_test import FIRST_PART
from structid.law_choice.specimen_test import Residuals, SensorValues, SpecimenTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.linear import Linear
from structid.models.finer_steps import in_finer_steps
from structid.models.hysteretic.hysteretic import Hysteretic
from structid.models.hysteretic.hysteretic_parameters import DEFAULT_SUBSTEPS
from structid.models.hysteretic.law_values import MODEL_PARAMETERS, PARAMETER_UNITS
from structid.observation import Observation
from structid.probability.marginals import Uniform
from structid.probability.space import ParameterSpace
from structid.probability.truncation import Marginal

FREQUENCIES = np.geomspace(0.05, 50.0, 240)
"""Natural frequencies of the linear springs that are compared with the responses [Hz]."""
DAMPING_RATIOS = (0.02, 0.1, 0.3)
"""Their damping ratios; the energy that a hysteretic law dissipates is not known yet."""
SOFTENING = 1.5
"""Initial stiffness of a specimen that yields, relative to the linear spring that fits its responses best."""
SEARCH_STEP = 0.3
"""Largest step of a search, in radians of the initial stiffness: Runge-Kutta's relative error is below 1e-4 in a period."""
FEWEST_SAMPLES = 50
"""Smallest number of samples of a record that is divided."""


@check_arguments
@dataclass(frozen=True, eq=False)
class MotionTest(SpecimenTest):
    """Measured responses of a specimen with one mass to ground motions or forces.

    Parameters
    ----------
    measured : Observation or sequence of Observation
        The measured responses.
    mass : float, optional
        Mass [kg], unless `own_priors` has a prior for it.
    damping_ratio, damping : float, optional
        Viscous damping, beside the energy that the law dissipates; see `Hysteretic`. The default is no viscous damping.
    own_priors : mapping of str to Marginal
        Priors that replace the default ones, of parameters of any law, and priors of mass and damping.
    values : mapping of str to float
        Known values of parameters of the laws in SI.
    substeps : int, optional
        Integration steps per sample.
    name : str
        Name of the test.

    Raises
    ------
    InputError
        If there is no mass, a name is unknown, or an excitation is an imposed displacement.

    Examples
    --------
    >>> import structid as si
    >>> test = si.MotionTest(measured, mass=12e3, damping_ratio=0.02)  # doctest: +SKIP
    >>> choice = si.choose_model(test)  # doctest: +SKIP
    """

    quantity: ClassVar[str] = "the responses"
    course: ClassVar[str] = "motion"

    measured: Observation | Sequence[Observation]
    mass: float | None = None
    damping_ratio: float | None = None
    damping: float | None = None
    own_priors: Mapping[str, Marginal] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    substeps: int | None = None
    name: str = "test under a motion"

    def __post_init__(self) -> None:
        if not self._given:
            raise InputError("MotionTest.measured", "no observation", "one Observation or more")
        for observation in self._given:
            if observation.record.kind == DisplacementHistory.kind:
                raise InputError(
                    "MotionTest.measured",
                    "an imposed displacement",
                    "responses to a GroundMotion or a ForceHistory",
                    "Use CyclicTest for the force of a cyclic test.",
                )
        if self.mass is None and "mass" not in self.own_priors:
            raise InputError("MotionTest.mass", "no mass", "a mass in kg, or a prior of the mass in own_priors")
        for where, names in (("own_priors", self.own_priors), ("values", self.values)):
            for name in names:
                if name not in PARAMETER_UNITS:
                    raise InputError(
                        f"MotionTest.{where}", f"no law has a parameter '{name}'", ", ".join(PARAMETER_UNITS)
                    )
        if both := sorted(set(self.own_priors) & set(self.values)):
            raise InputError("MotionTest", f"a value and a prior of '{both[0]}'", "only one of the two", "Remove one.")

    @property
    def _given(self) -> tuple[Observation, ...]:
        return (self.measured,) if isinstance(self.measured, Observation) else tuple(self.measured)

    def __str__(self) -> str:
        measured = ", ".join(observation.channels[0].replace("_", " ") for observation in self.observations)
        return (
            f"MotionTest {self.name}: {measured}; the best linear spring has {self._natural_frequency:.3g} Hz, "
            f"{1e3 * self.largest_displacement:.3g} mm, {1e-3 * self.largest_force:.3g} kN"
        )

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        """The measurements, one for each sensor."""
        return tuple(
            replace(
                observation,
                channels=(channel,),
                values=observation.values[:, [column]],
                sd=None if observation.sd is None else np.asarray(observation.sd)[:, [column]],
                units={c: unit for c, unit in observation.units.items() if c == channel},
                dt=observation.step,
                start=observation.begin,
            )
            for observation in self._given
            for column, channel in enumerate(observation.channels)
        )

    @cached_property
    def sensors(self) -> tuple[SensorValues, ...]:
        """Measured values of every sensor, over their standard deviations if these are known."""
        return tuple(
            SensorValues(observation.weighted(observation.values)[known, 0], np.diff(np.flatnonzero(known)))
            for observation in self.observations
            for known in [observation.is_measured[:, 0]]
        )

    @property
    def content_hash(self) -> str:
        """Hash of the measurements and of all that is known of the specimen."""
        known = {name: getattr(self, name) for name in ("mass", "damping_ratio", "damping", "substeps")}
        described = {name: prior.describe() for name, prior in self.own_priors.items()}
        return digest(
            [observation.describe() for observation in self.observations], known, dict(self.values), described
        )

    def model(self, law: HystereticLaw, free: Sequence[str]) -> Hysteretic:
        """Return the oscillator with a law.

        Parameters
        ----------
        law : HystereticLaw
            The law.
        free : sequence of str
            Free parameters of the law and of the oscillator.

        Returns
        -------
        Hysteretic
            The model.
        """
        key = law, tuple(free)
        if key not in self._models:
            self._models[key] = self._oscillator(law, free)
        return self._models[key]

    @cached_property
    def _models(self) -> dict[tuple[HystereticLaw, tuple[str, ...]], Hysteretic]:
        """The models of `model`: fits to this test share their compiled loops."""
        return {}

    def _oscillator(self, law: HystereticLaw, free: Sequence[str]) -> Hysteretic:
        parameters = law.parameters()
        known = {n: v for n, v in self.values.items() if n in parameters and n not in free}
        return Hysteretic(
            law.with_values(known),
            mass=self.mass,
            damping_ratio=self.damping_ratio,
            damping=self.damping,
            force_offset=0.0 if "force_offset" in free else self.values.get("force_offset", 0.0),
            free=tuple(free),
            channels=tuple(dict.fromkeys(o.channels[0] for o in self.observations)),
            substeps=DEFAULT_SUBSTEPS if self.substeps is None else self.substeps,
        )

    def priors(self, law: HystereticLaw, known: Collection[str] = ()) -> ParameterSpace:
        """Return the priors of a law for this test: its own, or default priors from the scales of the responses.

        Parameters
        ----------
        law : HystereticLaw
            The law.
        known : collection of str
            Parameters without a prior, which keep the law's value.

        Returns
        -------
        ParameterSpace
            Priors of the law's parameters, in kN and mm, and own priors of mass and damping.
        """
        return ParameterSpace(
            {
                name: self.own_priors[name] if name in self.own_priors else self.default_prior(described)
                for name, described in (law.parameters() | MODEL_PARAMETERS).items()
                if name not in known
                and name not in self.values
                and (name in self.own_priors or self._has_default(name, law))
            }
        )

    def _has_default(self, name: str, law: HystereticLaw) -> bool:
        """Whether a parameter has a default prior; a force offset has one if a force is measured."""
        if name in MODEL_PARAMETERS:
            return name == "force_offset" and any("restoring_force" in o.channels for o in self.observations)
        return law.parameters()[name].prior is not None

    # --- scales -------------------------------------------------------------------------------------------------

    def _median(self, name: str) -> float:
        """Value of a parameter of the oscillator, or the median of its prior."""
        if (prior := self.own_priors.get(name)) is not None:
            return float(prior.quantile(np.array(0.5)))
        return float(getattr(self, name))

    @cached_property
    def _linear_fit(self) -> tuple[float, float]:
        """Stiffness [N/m] of the linear spring that fits the responses best, and its largest displacement [m]."""
        stiffness = self._median("mass") * (2.0 * np.pi * self._followed_frequencies) ** 2
        ends = {"stiffness": Uniform(stiffness[0], stiffness[-1]), "damping_ratio": Uniform(0.0, 0.5)}
        linear = replace(self, mass=self._median("mass"), damping_ratio=None, damping=None, own_priors=ends, values={})
        space = linear.unknowns(Linear())
        grid = np.stack(np.meshgrid(stiffness, DAMPING_RATIOS, indexing="ij"), axis=-1).reshape(-1, 2)
        theta = np.tile(space.quantile(np.full((1, space.dimension), 0.5)), (len(grid), 1))
        theta[:, [space.names.index(name) for name in ends]] = grid
        residuals = linear.residuals(Linear(), space)(theta)
        errors = np.array([self.unexplained(r) for r in residuals])
        if not np.isfinite(errors).any():
            raise ConvergenceError("No linear spring can follow the motion: every run fails. Check record and mass.")
        best = grid[int(np.nanargmin(errors))]
        oscillator = linear.model(Linear(), tuple(ends)).recording("displacement")
        records = {o.record.content_hash: o.record for o in self.observations}
        moved = max(np.abs(oscillator.simulate(best[None], record).values).max() for record in records.values())
        return float(best[0]), float(moved)

    @property
    def _followed_frequencies(self) -> Float[np.ndarray, " frequency"]:
        """Frequencies that the steps of every record follow."""
        longest = max(observation.record.dt for observation in self.observations)
        return FREQUENCIES[0.2 / longest > FREQUENCIES]

    @property
    def questions(self) -> tuple[str, ...]:
        """Doubts about the measurement, in sentences."""
        frequency = self._natural_frequency
        if FREQUENCIES[1] < frequency < self._followed_frequencies[-2]:
            return ()
        return (
            f"The linear spring that fits the responses best has {frequency:.3g} Hz, at the end of the range that was tried. Are "
            "the units of mass, record and measurement right, and do record and measurement begin together?",
        )

    @property
    def _natural_frequency(self) -> float:
        """Natural frequency of the best linear spring [Hz]."""
        return float(np.sqrt(self._linear_fit[0] / self._median("mass"))) / (2.0 * np.pi)

    @property
    def initial_stiffness(self) -> float:
        """Scale of the initial stiffness [N/m]."""
        return SOFTENING * self._linear_fit[0]

    @cached_property
    def largest_displacement(self) -> float:
        """Largest measured displacement, or that of the best linear spring [m]."""
        return self._largest("displacement") or self._linear_fit[1]

    @cached_property
    def largest_force(self) -> float:
        """Largest measured force, mass times the largest absolute acceleration, or the force of the best linear spring [N]."""
        accelerated = self._median("mass") * self._largest("absolute_acceleration")
        return self._largest("restoring_force") or accelerated or self._linear_fit[0] * self._linear_fit[1]

    def _largest(self, channel: str) -> float:
        """Largest measured value of a channel; zero if it is not measured, or through an unknown gain or offset."""
        plain = [o for o in self.observations if o.channels == (channel,) and not o.nuisances()]
        return max((float(o.peaks[0]) for o in plain), default=0.0)

    # --- residuals and parts ------------------------------------------------------------------------------------

    def residuals(self, law: HystereticLaw, space: ParameterSpace, finer: int = 1) -> Residuals:
        """Return the errors of all sensors as a function of the parameters; see `SpecimenTest.residuals`."""
        of_law = law.parameters() | MODEL_PARAMETERS
        own = ParameterSpace({name: prior for name, prior in space.marginals.items() if name in of_law})
        model = in_finer_steps(self.model(law, own.names), finer)
        likelihood = JointLikelihood(own, model, self.observations, IID())
        columns = [likelihood.space.names.index(name) for name in space.names]

        def residuals(theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, "run value"]:
            whole = np.ones((len(theta), likelihood.space.dimension))
            whole[:, columns] = theta
            each: dict[int, np.ndarray] = {}
            for numbers in likelihood.of_one_run:
                bound = likelihood.of[numbers[0]]
                response = model.simulate(bound.parameters(whole), bound.observation.record).values.transpose(1, 2, 0)
                for number in numbers:
                    each[number] = self._errors(likelihood.of[number], response, whole)
            return np.concatenate([each[number] for number in sorted(each)], axis=1)

        return residuals

    @staticmethod
    def _errors(
        bound: ObservationLikelihood, response: np.ndarray, whole: np.ndarray
    ) -> Float[np.ndarray, "run value"]:
        """Errors of one sensor at its measured values."""
        observation = bound.observation
        values = bound.weighted(observation.values[:, :, None])
        errors: np.ndarray = np.asarray(bound.residual_of_all(response, whole, values))[
            observation.is_measured[:, 0], 0
        ]
        return errors.T

    @cached_property
    def searched(self) -> MotionTest:
        """The first part, which has most of the motion, in longer steps."""
        part = self.first or self
        omega = np.sqrt(self.initial_stiffness / self._median("mass"))
        step = max(observation.record.dt for observation in self.observations)
        steps = int(np.ceil(omega * step / SEARCH_STEP))
        return self._part(part.measured, min(steps, self.substeps or DEFAULT_SUBSTEPS))

    def _part(self, measured: Observation | Sequence[Observation], substeps: int | None) -> _PartOfMotion:
        given = {f.name: getattr(self, f.name) for f in fields(MotionTest)}
        return _PartOfMotion(**given | {"measured": measured, "substeps": substeps}, whole=self)

    @cached_property
    def first(self) -> MotionTest | None:
        """The first part, with 70 % of the sum of squares of the responses to each record."""
        records = {o.record.content_hash: o.record for o in self.observations}
        if not all(_divisible(record) for record in records.values()):
            return None
        ends = {key: self._end(record) for key, record in records.items()}
        parts = []
        for observation in self.observations:
            record, end = observation.record, ends[observation.record.content_hash]
            samples = observation.time <= record.time[end - 1] + 1e-9 * record.dt
            parts.append(
                replace(
                    observation,
                    record=replace(record, values=record.values[:end]),
                    values=observation.values[samples],
                    sd=None if observation.sd is None else np.asarray(observation.sd)[samples],
                )
            )
        return self._part(tuple(parts), self.substeps)

    def _end(self, record: Excitation) -> int:
        """Number of samples with 70 % of the sum of squares."""
        shares = np.zeros(len(record))
        for observation in self.observations:
            if observation.record.content_hash == record.content_hash:
                squares = np.nancumsum(observation.values[:, 0] ** 2) / np.nansum(observation.values[:, 0] ** 2)
                shares += np.interp(record.time, observation.time, squares)
        return int(
            np.clip(np.searchsorted(shares, FIRST_PART * shares[-1]), FEWEST_SAMPLES, len(record) - FEWEST_SAMPLES)
        )


@dataclass(frozen=True, eq=False)
class _PartOfMotion(MotionTest):
    """A part of a test, with the scales, and therefore the priors, of the whole test; it is not divided again."""

    whole: MotionTest = field(kw_only=True, repr=False)

    @property
    def _linear_fit(self) -> tuple[float, float]:
        return self.whole._linear_fit

    @property
    def largest_displacement(self) -> float:
        return self.whole.largest_displacement

    @property
    def largest_force(self) -> float:
        return self.whole.largest_force

    @property
    def first(self) -> None:
        return None


def _divisible(record: Excitation) -> bool:
    """Whether a record has a first part that can be simulated alone."""
    return record.interpolation != "periodic" and len(record.signals) == 1 and len(record) >= 2 * FEWEST_SAMPLES
