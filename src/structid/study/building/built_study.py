"""A study that is ready to run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from structid.calibration.plan import Plan
from structid.core.by_type import ByType
from structid.core.errors import InputError, suggestion
from structid.core.hashing import digest
from structid.core.units import to_si
from structid.ground_motion.record import GroundMotion
from structid.inference.error_model_choice import AUTO
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Sampler
from structid.law_choice.motion_test import MotionTest
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.models.base import Model
from structid.models.hysteretic.loop_lines import LoopLines
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.study.building.named_kind import kind_named
from structid.study.schema.study_file import StudyFile
from structid.surrogates import surrogate_list as registry
from structid.surrogates.surrogate_kind import SurrogateKind


@dataclass(frozen=True, eq=False)
class BuiltStudy:
    """A study that is ready to run."""

    file: StudyFile  # content of the file
    folder: Path  # base of relative paths
    raw_record: GroundMotion  # record of the study before processing
    record: GroundMotion  # record of the study after processing
    space: ParameterSpace  # unknown parameters of the model
    model: Model
    campaign: Design | None  # points of the model runs, if the study has a campaign
    campaign_records: tuple[GroundMotion, ...]  # excitations, assigned to these runs in turn
    # Posterior of the parameters of the model and the error model; None for a study without an observation
    posterior: Posterior | None
    sampler: Sampler  # settings of the sampler
    truths: tuple[Model | None, ...]  # true model of a virtual experiment for each observation, or None
    other_records: tuple[GroundMotion, ...]  # records to predict
    plan: Plan | None  # budget of a certified calibration, if there is one
    loop: LoopLines | None = None  # lines through a measured loop, from which priors are derived
    # Test from which the hysteretic law is chosen, and the laws among which; None if the file names the law
    motion_test: MotionTest | None = None
    laws: tuple[HystereticLaw, ...] = ()
    planned_stages: ByType = ByType()  # noqa: RUF009 (never changed)  # `PlannedStage` of each stage with its own table

    @property
    def content_hash(self) -> str:
        """Hash of all inputs on which runs and draws depend."""
        return digest(self.identity)

    @property
    def identity(self) -> dict[str, Any]:
        """All inputs on which runs and draws depend, by part, so that a message can name a changed part."""
        parts: dict[str, Any] = {
            "model": self.model.content_hash,
            "parameters": self.space.content_hash,
            "record": self.record.content_hash,
            "seed": self.file.seed,
        }
        if self.motion_test is not None:
            parts["choice of the law"] = [self.motion_test.content_hash, *(law.word for law in self.laws)]
        if self.campaign is not None:
            parts["campaign records"] = [r.content_hash for r in self.campaign_records]
        if self.posterior is not None:
            parts["observation"] = digest([o.describe() for o in self.posterior.observations])
            parts["discrepancy"] = AUTO if self.error_model_is_open else digest(self.posterior.error_model.describe())
            parts["sampler"] = digest(self.sampler.describe())
        if self.has_surrogate:
            settings_of_surrogate = self.file.surrogate.model_dump(exclude_unset=True, exclude={"trust", "limit"})
            parts["surrogate"] = digest(settings_of_surrogate)
        if self.plan is not None:
            parts["calibration"] = digest(self.plan.describe())
        return parts | {name: digest(value) for stage in self.planned_stages for name, value in stage.identity.items()}

    def working_in(self, folder: Path) -> BuiltStudy:
        """Return the study with a folder for the files of its model runs."""
        model = self.model.working_in(folder)
        posterior = None if self.posterior is None else self.posterior.on(model)
        return self if model is self.model else replace(self, model=model, posterior=posterior)

    def with_law(self, law: HystereticLaw) -> BuiltStudy:
        """Return the study with a hysteretic law in place of the open one, and its default priors."""
        test, posterior = self.motion_test, self.sampled
        assert test is not None
        space = test.priors(law)
        model = test.model(law, space.names).recording(*posterior.model.channels)
        of_law = Posterior(space, model, posterior.observations, posterior.error_model, map=posterior.map)
        return replace(self, space=space, model=model, posterior=of_law)

    @property
    def error_model_is_open(self) -> bool:
        """Whether the data choose the error model."""
        return self.file.discrepancy.kind == AUTO

    @property
    def surrogate_kind(self) -> SurrogateKind | None:
        """Kind of the surrogate; None without a surrogate."""
        return kind_named(self.file.surrogate.kind, registry.KINDS) if self.has_surrogate else None

    @property
    def has_surrogate(self) -> bool:
        """Whether a surrogate replaces the model."""
        return self.file.surrogate.kind != "none"

    @property
    def validation_runs(self) -> int:
        """Number of model runs that validate the surrogate; one set of runs per record if it is valid only for these records."""
        section = self.file.surrogate
        each = self.surrogate_kind is not None and self.surrogate_kind.own_records
        return section.validation * (len(self.campaign_records) if each else 1)

    @property
    def sampled(self) -> Posterior:
        """The posterior of a study with an observation."""
        assert self.posterior is not None
        return self.posterior

    @property
    def search_methods(self) -> tuple[str, ...]:
        """Methods of deterministic search; by default, all methods for a built-in model, and none for an external model."""
        methods = self.file.deterministic.methods
        if methods is None:
            return ("pattern_search", "interior_point") if self.model.traceable else ()
        if "interior_point" in methods and not self.model.traceable:
            raise InputError(
                "key 'deterministic.methods'",
                "'interior_point' for an external model, which has no derivatives",
                "['pattern_search'] or []",
                "Use pattern search, which needs no derivatives but hundreds of runs, or no search.",
            )
        return methods

    @property
    def search_bounds(self) -> dict[str, tuple[float, float]] | None:
        """Bounds of the deterministic searches in SI; None for the supports of the priors."""
        space = self.space
        bounds = {}
        for name, (low, high) in self.file.deterministic.bounds.items():
            key = f"key 'deterministic.bounds.{name}'"
            if name not in space.names:
                raise InputError(key, "unknown parameter", ", ".join(space.names), suggestion(name, space.names))
            bounds[name] = (to_si(low, space.units[name], key), to_si(high, space.units[name], key))
        return bounds or None

    @property
    def true_values(self) -> dict[str, float]:
        """True values of a virtual experiment in SI, for the sampled parameters that the true model also has."""
        truth = self.truths[0] if self.truths else None
        if truth is None:
            return {}
        of_law = getattr(truth, "law", None)  # a hysteretic law has the parameters of its model's spring
        values = {n: getattr(truth, n, getattr(of_law, n, None)) for n in self.space.names}
        return {n: float(v) for n, v in values.items() if isinstance(v, (int, float))}
