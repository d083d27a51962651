"""From the words of a study file to records, model, space, campaign and posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from structid.calibration.sequential import Plan
from structid.channels import standard_unit
from structid.errors import InputError, suggestion
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.record import GroundMotion
from structid.histories import Histories
from structid.inference.likelihood.correlated import AR1, DampedCosine, Matern32
from structid.inference.likelihood.discrepancy import IID, Discrepancy
from structid.inference.likelihood.observation import Observation
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.delayed_acceptance import DelayedAcceptance
from structid.inference.sampling.ensemble import AIES
from structid.inference.sampling.gradient import NUTS
from structid.inference.sampling.sampler import Sampler
from structid.inference.sampling.tempered import SMC
from structid.journal import digest
from structid.models.bouc_wen import BoucWen
from structid.models.face import Model
from structid.models.hysteretic_parameters import PARAMETER_UNITS
from structid.models.shear_frame import STOREY_PARAMETERS, ShearFrame
from structid.optimize.region import region
from structid.probability import marginals
from structid.probability.expressions import parse_expression
from structid.probability.space import Design, ParameterSpace
from structid.probability.truncation import Marginal
from structid.streams import Purpose, stream
from structid.study.external import external_model
from structid.study.schema import (
    CalibrationSection,
    CampaignSection,
    ExternalSection,
    ObservationSection,
    PriorSection,
    RecordSection,
    SamplerSection,
    StudyErrors,
    StudyFile,
    VirtualSection,
)
from structid.study.surrogate import surrogate_settings
from structid.surrogates.kind import SurrogateKind
from structid.surrogates.registry import by_word
from structid.units import factor, to_si

_FAMILIES: dict[str, tuple[Callable[..., Marginal], tuple[str, ...]]] = {
    "uniform": (marginals.Uniform, ("low", "high")),
    "normal": (marginals.Normal, ("mean", "sd", "low", "high")),
    "lognormal": (marginals.LogNormal, ("mean", "sd", "log_mean", "log_sd", "low", "high")),
    "gamma": (marginals.Gamma, ("mean", "sd", "shape", "rate", "low", "high")),
    "beta": (marginals.Beta, ("mean", "sd", "a", "b", "low", "high")),
    "weibull": (marginals.Weibull, ("mean", "sd", "shape", "scale", "low", "high")),
    "gumbel": (marginals.Gumbel, ("mean", "sd", "location", "scale", "low", "high")),
}
SURROGATE_RUNS = 500
"""True runs of a study with a surrogate that does not say how many."""

AIES_DEFAULTS = {
    "walkers": 32, "steps": 3000, "ensembles": 4, "differential_evolution": 0.8, "discard": 0.3, "start_candidates": 10,
}  # fmt: skip
"""Settings of an ensemble that converge on the benchmark study."""

SURROGATE_WIDENING = 2.0
"""How much further than the prior the design of a surrogate reaches, in normal scores."""

_WITH_UNIT = ("mean", "sd", "low", "high", "scale", "location")
_PURE = ("shape", "rate", "log_mean", "log_sd", "a", "b")


@dataclass(frozen=True, eq=False)
class BuiltStudy:
    """Everything a study needs to run.

    Parameters
    ----------
    file : StudyFile
        What the file said.
    folder : Path
        Where its relative paths start.
    raw_record, record : GroundMotion
        The study's record as read, and after processing.
    space : ParameterSpace
        The model's unknown parameters.
    model : Model
        The model.
    campaign : Design or None
        Points of the true runs, if the study asks for them.
    campaign_records : tuple of GroundMotion
        What drives them, dealt out in turn.
    posterior : Posterior or None
        Of the model's parameters and the discrepancy's; None for a study without an observation.
    sampler : Sampler
        Its settings.
    truths : tuple
        For each observation the true model of a virtual experiment, or None.
    other_records : tuple of GroundMotion
        Records to predict for.
    plan : Plan or None
        How true runs are spent on a certified calibration, if the study asks for one.
    """

    file: StudyFile
    folder: Path
    raw_record: GroundMotion
    record: GroundMotion
    space: ParameterSpace
    model: Model
    campaign: Design | None
    campaign_records: tuple[GroundMotion, ...]
    posterior: Posterior | None
    sampler: Sampler
    truths: tuple[Model | None, ...]
    other_records: tuple[GroundMotion, ...]
    plan: Plan | None

    @property
    def content_hash(self) -> str:
        """Hash of everything the runs and the draws depend on."""
        return digest(self.identity)

    @property
    def identity(self) -> dict[str, Any]:
        """What the runs and the draws depend on, part by part, so that it can be said which has changed."""
        parts: dict[str, Any] = {
            "model": self.model.content_hash,
            "parameters": self.space.content_hash,
            "record": self.record.content_hash,
            "seed": self.file.seed,
        }
        if self.campaign is not None:
            parts["campaign records"] = [r.content_hash for r in self.campaign_records]
        if self.posterior is not None:
            parts["observation"] = digest([o.describe() for o in self.posterior.observations])
            parts["discrepancy"] = digest(self.posterior.discrepancy.describe())
            parts["sampler"] = digest(self.sampler.describe())
        if self.has_surrogate:
            said = self.file.surrogate.model_dump(exclude_unset=True, exclude={"trust", "limit"})
            parts["surrogate"] = digest(said)
        if self.plan is not None:
            parts["calibration"] = digest(self.plan.describe())
        return parts

    def working_in(self, folder: Path) -> BuiltStudy:
        """Return the study with a folder for the files that runs of its model leave.

        Parameters
        ----------
        folder : Path
            The folder.

        Returns
        -------
        BuiltStudy
            The same study.
        """
        model = self.model.working_in(folder)
        posterior = None if self.posterior is None else self.posterior.on(model)
        return self if model is self.model else replace(self, model=model, posterior=posterior)

    @property
    def surrogate_kind(self) -> SurrogateKind | None:
        """Kind of the surrogate, if one stands in for the model."""
        return by_word().get(self.file.surrogate.kind)

    @property
    def has_surrogate(self) -> bool:
        """Whether a surrogate stands in for the model."""
        return self.file.surrogate.kind != "none"

    @property
    def validation_runs(self) -> int:
        """True runs that validate the surrogate: as many on each record for one that knows only its own."""
        section = self.file.surrogate
        each = self.surrogate_kind is not None and self.surrogate_kind.own_records
        return section.validation * (len(self.campaign_records) if each else 1)

    @property
    def sampled(self) -> Posterior:
        """The posterior of a study that has an observation."""
        assert self.posterior is not None
        return self.posterior

    @property
    def search_methods(self) -> tuple[str, ...]:
        """The deterministic searches: both for a built-in model unless the file says otherwise, none for an external one."""
        methods = self.file.deterministic.methods
        if methods is None:
            return ("pattern_search", "interior_point") if self.model.traceable else ()
        if "interior_point" in methods and not self.model.traceable:
            raise InputError(
                "key 'deterministic.methods'", "'interior_point' for an external model, which has no derivatives",
                "['pattern_search'] or []", "Pattern search needs none, but hundreds of runs.",
            )  # fmt: skip
        return methods

    @property
    def search_bounds(self) -> dict[str, tuple[float, float]] | None:
        """Bounds of the deterministic searches in SI, None for the priors' supports."""
        space = self.space
        bounds = {}
        for name, (low, high) in self.file.deterministic.bounds.items():
            key = f"key 'deterministic.bounds.{name}'"
            if name not in space.names:
                raise InputError(key, "no such parameter", ", ".join(space.names), suggestion(name, space.names))
            bounds[name] = (to_si(low, space.units[name], key), to_si(high, space.units[name], key))
        return bounds or None

    @property
    def true_values(self) -> dict[str, float]:
        """True values of the sampled parameters in a virtual experiment, in SI, where the two models share a name."""
        truth = self.truths[0] if self.truths else None
        if truth is None:
            return {}
        values = {n: getattr(truth, n, None) for n in self.space.names}
        return {n: float(v) for n, v in values.items() if isinstance(v, (int, float))}


def build(file: StudyFile, folder: Path, solver_folder: Path | None = None) -> BuiltStudy:
    """Build a study.

    Parameters
    ----------
    file : StudyFile
        The checked file.
    folder : Path
        Where relative paths start.
    solver_folder : Path, optional
        Where those of an external solver start, if not there.

    Returns
    -------
    BuiltStudy
        Ready to run.

    Raises
    ------
    InputError
        If its parts do not fit together; `StudyErrors` if several are wrong by themselves.
    """
    try:
        return _built(file, folder, solver_folder)
    except InputError as first:
        # Each mistake that needs no other part to be seen is told with it, so that one correction does not lead to the next.
        told = list(dict.fromkeys([str(first), *_wrong_alone(file, folder)]))
        if len(told) == 1:
            raise
        raise StudyErrors(file.name, told) from None


def _wrong_alone(file: StudyFile, folder: Path) -> list[str]:
    """What is wrong with records, priors, discrepancy, sampler and plan, each by itself."""
    records = {
        "record": file.record,
        **{f"observation.{i}.record": o.record for i, o in enumerate(file.observation) if o.record is not None},
        **{f"prediction.records.{i}": r for i, r in enumerate(file.prediction.records)},
    }
    channels = tuple(dict.fromkeys(c for o in file.observation for c in o.channels))
    parts: list[Callable[[], object]] = [
        *(partial(load_record, section, folder, where) for where, section in records.items()),
        *(partial(_prior_of, file, name) for name in file.parameters),
        *([partial(_discrepancy, file, channels)] if channels else []),
        partial(_sampler, file.sampler),
        partial(_plan, file.calibration),
    ]
    told = []
    for part in parts:
        try:
            part()
        except InputError as error:
            told.append(str(error))
    return told


def _built(file: StudyFile, folder: Path, solver_folder: Path | None) -> BuiltStudy:
    raw = _read_record(file.record, folder, "record")
    record = _process(raw, file.record, "record")
    if file.record.trim is not None:
        raw = raw.trim(*file.record.trim)  # the same instants as the processed one, to be drawn beside it
    space = _space(file)
    wanted = file.campaign.channels if file.campaign is not None else ()
    channels = tuple(dict.fromkeys((*(c for o in file.observation for c in o.channels), *wanted)))
    model = _model(file.model, space, file.derived, channels or ("velocity",), solver_folder or folder)
    observations, truths = [], []
    for index, section in enumerate(file.observation):
        where = "observation" if len(file.observation) == 1 else f"observation.{index}"
        own = record if section.record is None else load_record(section.record, folder, f"{where}.record")
        observation, truth = _observation(section, own, folder, where, file.seed, index)
        observations.append(observation)
        truths.append(truth)
    posterior = None
    if observations:
        measured = tuple(dict.fromkeys(c for o in observations for c in o.channels))
        law = _discrepancy(file, measured)
        posterior = Posterior(space, model, observations, law, model_error=file.surrogate.model_error)
    others = tuple(load_record(r, folder, f"prediction.records.{i}") for i, r in enumerate(file.prediction.records))
    driven_by = {r.content_hash: r for r in (record, *(o.record for o in observations)) if isinstance(r, GroundMotion)}
    design, campaign_records = _campaign(file, folder, space, tuple(driven_by.values()))
    study = BuiltStudy(
        file, folder, raw, record, space, model, design, campaign_records, posterior, _sampler(file.sampler), tuple(truths), others,
        _plan(file.calibration),
    )  # fmt: skip
    _check_before_anything_is_written(study)
    return study


_SAMPLERS: dict[str, type[Any]] = {
    "aies": AIES, "smc": SMC, "nuts": NUTS, "delayed_acceptance": DelayedAcceptance,
}  # fmt: skip
"""Samplers by the word for them."""


def _sampler(section: SamplerSection) -> Sampler:
    kind = _SAMPLERS[section.kind]
    known = [f.name for f in fields(kind) if f.name in SamplerSection.model_fields]
    given = {k: v for k, v in section.model_dump(exclude={"kind"}).items() if v is not None}
    for key in given:
        if key not in known:
            raise InputError(
                f"key 'sampler.{key}'", f"a key that {section.kind} does not know", ", ".join(sorted(known))
            )
    if kind is AIES:
        given = {**AIES_DEFAULTS, **given}
        given.setdefault("settling_steps", min(500, int(given["discard"] * given["steps"])))
    try:
        sampler: Sampler = kind(**given)
    except InputError as error:
        key = error.where.replace(f"{kind.__name__}.", "sampler.")
        raise InputError(f"key '{key}'", error.came, error.allowed, error.cure) from None
    return sampler


def _plan(section: CalibrationSection | None) -> Plan | None:
    if section is None:
        return None
    try:
        return Plan(**section.model_dump())
    except InputError as error:
        raise InputError(f"table 'calibration': {error.where}", error.came, error.allowed, error.cure) from None


def _check_before_anything_is_written(study: BuiltStudy) -> None:
    """What the sampler and the searches would refuse, said before a folder is taken."""
    if study.posterior is None and study.campaign is None:
        raise InputError(
            "the file",
            "neither an [observation] nor a [campaign]",
            "one of them, or both",
            "Say what to calibrate, or what to run.",
        )
    unused = study.file.surrogate.model_fields_set - {"kind"}
    if unused and not study.has_surrogate:
        raise InputError(
            f"key 'surrogate.{min(unused)}'",
            "it is given with kind = 'none'",
            "a kind of surrogate, or no key beside kind",
        )
    if study.sampler.exact and not study.has_surrogate:
        raise InputError(
            "key 'sampler.kind'",
            "'delayed_acceptance' without a [surrogate]",
            "a kind of surrogate that makes proposals",
        )
    if study.plan is not None:
        _check_calibration(study, study.plan)
    if study.campaign is not None and study.has_surrogate:
        _check_surrogate(study, study.campaign, study.campaign_records)
    if study.posterior is None:
        return
    dimension = study.posterior.dimension
    if study.sampler.needs_derivatives:
        if not (study.has_surrogate or study.model.traceable):
            raise InputError(
                "key 'sampler.kind'", "'nuts' for an external model, which has no derivatives",
                "'aies' or 'smc', or a [surrogate]",
            )  # fmt: skip
    elif study.sampler.interacting and study.sampler.walkers < 2 * dimension:
        raise InputError(
            "key 'sampler.walkers'", f"{study.sampler.walkers} for {dimension} parameters", f"{2 * dimension} or more"
        )
    if study.search_methods:
        region(study.posterior.misfit, study.search_bounds, study.file.deterministic.constraints)


def _check_calibration(study: BuiltStudy, plan: Plan) -> None:
    """What a certified calibration has no use for, or cannot do without."""
    said = study.file.surrogate.model_fields_set & {"validation", "limit", "trust", "model_error"}
    own = "one of the two: a calibration does its own runs"
    judged = "no such key: the certificate judges the surrogate"
    refusals = (
        (not study.has_surrogate, "table 'calibration'", "no kind of [surrogate]", "a surrogate such as 'pod_kriging'"),
        (study.posterior is None, "table 'calibration'", "no [observation]", "a measurement to calibrate against"),
        (study.file.campaign is not None, "table 'campaign'", "a campaign beside [calibration]", own),
        (bool(said), f"key 'surrogate.{min(said, default='')}'", "it is given beside [calibration]", judged),
    )
    for wrong, where, came, allowed in refusals:
        if wrong:
            raise InputError(where, came, allowed)
    assert study.posterior is not None
    records = tuple({o.record.content_hash: o.record for o in study.posterior.observations}.values())
    points = np.repeat(study.space.sample(plan.start, 0, "sobol").values, len(records), axis=0)
    _check_surrogate(study, Design(points, study.space), records)


def _check_surrogate(study: BuiltStudy, design: Design, records: Sequence[Excitation]) -> None:
    """What fitting would refuse, said before hours of true runs."""
    settings = surrogate_settings(study.file.surrogate)
    try:
        settings.check(design, records, study.model.channels)
    except InputError as error:
        where = f"tables 'surrogate' and 'campaign': {error.where}"
        raise InputError(where, error.came, error.allowed, error.cure) from None


def _campaign(
    file: StudyFile, folder: Path, space: ParameterSpace, driven_by: tuple[GroundMotion, ...]
) -> tuple[Design | None, tuple[GroundMotion, ...]]:
    """Draw the design of true runs, and read the records that drive them: the study's, and for a surrogate the observations'."""
    section, kind = file.campaign, file.surrogate.kind
    if file.calibration is not None or (section is None and kind == "none"):
        return None, ()
    section = section or CampaignSection(runs=SURROGATE_RUNS)
    seed = file.seed if section.seed is None else section.seed
    further = [load_record(r, folder, f"campaign.records.{i}") for i, r in enumerate(section.records)]
    # A design that a surrogate is fitted to reaches further into the tails than the prior.
    widen = section.widen or (1.0 if kind == "none" else SURROGATE_WIDENING)
    design = space.sample(section.runs, seed, section.method, widen)
    records = (*(driven_by[:1] if kind == "none" else driven_by), *further)
    if kind != "none" and by_word()[kind].own_records:  # every point on each of them
        design = Design(np.repeat(design.values, len(records), axis=0), space)
    return design, records


# --- records --------------------------------------------------------------------------------------------------------


def load_record(section: RecordSection, folder: Path, where: str) -> GroundMotion:
    """Read or make a record and process it.

    Parameters
    ----------
    section : RecordSection
        What the file says.
    folder : Path
        Where relative paths start.
    where : str
        The key, for messages.

    Returns
    -------
    GroundMotion
        The processed record.
    """
    return _process(_read_record(section, folder, where), section, where)


def _read_record(section: RecordSection, folder: Path, where: str) -> GroundMotion:
    if (section.file is None) == (section.synthetic is None):
        came = "neither file nor synthetic" if section.file is None else "both file and synthetic"
        raise InputError(f"key '{where}'", came, "exactly one of the two")
    if section.synthetic is not None:
        record = GroundMotion.synthetic(**section.synthetic.model_dump())
    else:
        assert section.file is not None
        record = GroundMotion.read(folder / section.file, section.dt, section.unit, section.column)
    return replace(record, name=section.name) if section.name else record


def _process(record: GroundMotion, section: RecordSection, where: str) -> GroundMotion:
    if section.baseline is not None:
        record = record.baseline(section.baseline)
    order = section.filter_order
    if section.highpass is not None and section.lowpass is not None:
        record = record.bandpass(section.highpass, section.lowpass, order or 4)
    elif section.highpass is not None:
        record = record.highpass(section.highpass, order or 4)
    elif section.lowpass is not None:
        record = record.lowpass(section.lowpass, order)
    if section.resample is not None:
        record = record.resample(section.resample)
    if section.trim is not None:
        record = record.trim(*section.trim)
    if section.pga is not None and section.scale is not None:
        raise InputError(f"key '{where}'", "both pga and scale", "one of the two")
    if section.pga is not None:
        return record.scale_to_pga(section.pga)
    return record if section.scale is None else record.scale(section.scale)


# --- parameters -----------------------------------------------------------------------------------------------------


def _prior(section: PriorSection, where: str, si_unit: str | None) -> Marginal:
    """Build a prior; `si_unit` is what it must measure, None for a parameter the model does not know."""
    make, allowed = _FAMILIES[section.distribution]
    unit = (si_unit or "") if section.unit is None else section.unit
    if si_unit is not None:
        to_si(f"1 {unit}", si_unit, f"key '{where}.unit'")
    values: dict[str, Any] = {}
    for name in (*_WITH_UNIT, *_PURE):
        value = getattr(section, name)
        if value is None:
            continue
        if name not in allowed:
            raise InputError(
                f"key '{where}.{name}'", f"it is given for a {section.distribution} distribution", ", ".join(allowed)
            )
        values[name] = to_si(value, unit, f"key '{where}.{name}'") / factor(unit) if name in _WITH_UNIT else value
    try:
        return make(**values, unit=unit)
    except TypeError:
        missing = [n for n in allowed[:2] if n not in values]
        raise InputError(f"key '{where}'", f"{', '.join(missing)} missing", f"{', '.join(allowed[:2])}") from None
    except InputError as error:
        raise InputError(f"key '{where}': {error.where}", error.came, error.allowed, error.cure) from None


def _prior_of(file: StudyFile, name: str) -> Marginal:
    base = name.rpartition("_")[0] if name.rpartition("_")[2].isdigit() else name
    return _prior(file.parameters[name], f"parameters.{name}", _parameter_unit(base, file))


def _space(file: StudyFile) -> ParameterSpace:
    priors = {name: _prior_of(file, name) for name in file.parameters}
    correlation = {}
    for pair, value in file.correlation.items():
        names = [n.strip() for n in pair.split(",")]
        if len(names) != 2:
            raise InputError(f"key 'correlation.{pair}'", f"'{pair}'", 'two names, such as "stiffness, alpha" = 0.4')
        correlation[names[0], names[1]] = value
    return ParameterSpace(correlation or None, file.derived, **priors)


def _parameter_unit(name: str, file: StudyFile) -> str | None:
    """SI unit of a parameter; β and γ are in m⁻ⁿ, which is known only where n is."""
    if name not in ("beta", "gamma"):
        return PARAMETER_UNITS.get(name)
    exponent = getattr(file.model, "exponent", None)
    if any(n.startswith("exponent") for n in (*file.parameters, *file.derived)) or isinstance(exponent, tuple):
        return ""  # a plain number in SI
    return "1/m" if exponent in (None, 1.0) else f"1/m^{exponent:g}"


# --- model ----------------------------------------------------------------------------------------------------------


def _model(
    section: Any, space: ParameterSpace, derived: dict[str, str], channels: tuple[str, ...], folder: Path
) -> Model:
    """Build the model with every parameter it knows and the space has as free."""
    if isinstance(section, ExternalSection):
        return external_model(section, space, folder)
    given = {k: v for k, v in section.model_dump(exclude={"type"}).items() if v is not None}
    known = set(PARAMETER_UNITS) if section.type == "bouc_wen" else _frame_parameters(section.storeys)
    free = tuple(n for n in space.all_names if n in known)
    ingredients = {n for name, text in derived.items() for n in parse_expression(text, f"derived.{name}")[1]}
    for name in space.all_names:
        if name in given:
            raise InputError(
                f"key 'parameters.{name}'" if name in space.names else f"key 'derived.{name}'",
                "it has a value in [model] as well",
                "one of the two",
                "Remove one of them.",
            )
        # A name the model lacks must at least be an ingredient of a derived one.
        if name not in known and name not in ingredients:
            raise InputError(
                f"key 'parameters.{name}'" if name in space.names else f"key 'derived.{name}'",
                f"the model {section.type} has no parameter '{name}'",
                ", ".join(n for n in PARAMETER_UNITS if n in known)
                + (" (and stiffness_2, …)" if section.type == "shear_frame" else ""),
                suggestion(name, known),
            )
    return _construct(section.type, given, free, channels)


def _construct(kind: str, given: dict[str, Any], free: tuple[str, ...], channels: tuple[str, ...]) -> Model:
    if kind == "bouc_wen":
        return BoucWen(free=free, channels=channels, **given)
    return ShearFrame(free=free, channels=channels, **given)


def _frame_parameters(storeys: int) -> set[str]:
    numbered = {f"{n}_{j}" for n in STOREY_PARAMETERS for j in range(1, storeys + 1)}
    return {"damping_ratio", *STOREY_PARAMETERS, *numbered}


# --- observations ---------------------------------------------------------------------------------------------------


def _observation(
    section: ObservationSection, record: GroundMotion, folder: Path, where: str, seed: int, index: int
) -> tuple[Observation, Model | None]:
    if (section.file is None) == (section.virtual is None):
        came = "neither file nor virtual" if section.file is None else "both file and virtual"
        raise InputError(f"key '{where}'", came, "exactly one of the two")
    unit = standard_unit(section.channels[0]).si
    nuisances: dict[str, Any] = {
        name: _prior(prior, f"{where}.{name}", {"gain": "", "offset": unit, "time_shift": "s"}[name])
        for name in ("gain", "offset", "time_shift")
        if (prior := getattr(section, name)) is not None
    }
    if section.virtual is not None:
        truth, values = _virtual_experiment(section.virtual, record, section.channels, seed, index)
        return Observation(record, values, section.channels, name=where, **nuisances), truth
    assert section.file is not None
    if len(section.channels) != 1:
        raise InputError(
            f"key '{where}.channels'",
            f"{list(section.channels)} from one file",
            "one channel for each file",
            "Give each channel its own [[observation]].",
        )
    if section.unit is None:
        raise InputError(
            f"key '{where}.unit'", "it is missing", f"the unit of the numbers in the file, such as '{unit}'"
        )
    to_si(f"1 {section.unit}", unit, f"key '{where}.unit'")
    path = folder / section.file
    return Observation.read(
        record, path, section.unit, section.channels[0], section.column, section.dt, **nuisances
    ), None


def _virtual_experiment(
    section: VirtualSection, record: GroundMotion, channels: tuple[str, ...], seed: int, index: int
) -> tuple[Model, np.ndarray]:
    """Simulate the true model and add white noise of a fraction of each channel's RMS."""
    given = {k: v for k, v in section.model.model_dump(exclude={"type"}).items() if v is not None}
    truth = _construct(section.model.type, given, (), channels)
    run: Histories = truth.simulate(np.zeros((1, 0)), record)
    if not run.done[0]:
        raise InputError(
            "key 'observation.virtual'", f"the true model diverges at {run.failure_time[0]:g} s", "a stable model"
        )
    values = run.values[0]
    own = (seed, index) if section.seed is None else (section.seed, 0)
    rng = stream(own[0], Purpose.VIRTUAL_NOISE, own[1])
    rms = np.sqrt((values**2).mean(axis=0))
    return truth, values + section.noise * rms * rng.standard_normal(values.shape)


_LAWS: dict[str, tuple[type[Discrepancy], tuple[str, ...]]] = {
    "iid": (IID, ("variance", "per_channel")),
    "ar1": (AR1, ("variance", "white", "correlation_time")),
    "matern32": (Matern32, ("variance", "white", "correlation_time")),
    "damped_cosine": (DampedCosine, ("variance", "white", "frequency", "damping")),
}
"""Laws of the discrepancy, and the keys each of them knows."""


def _discrepancy(file: StudyFile, channels: tuple[str, ...]) -> Discrepancy:
    section = file.discrepancy
    law, known = _LAWS[section.kind]
    given = section.model_fields_set - {"kind"}
    for key in given:
        if key not in known:
            raise InputError(f"key 'discrepancy.{key}'", f"a key that {section.kind} does not know", ", ".join(known))
    units = {standard_unit(c).si for c in channels}
    for key in ("variance", "white"):
        if getattr(section, key) is not None and len(units) > 1:
            raise InputError(
                f"key 'discrepancy.{key}'",
                f"one variance for channels in {', '.join(sorted(units))}",
                "nothing, so that each channel has its own unknown variance",
            )
    unit = f"({units.pop()})^2"
    unit_of = {"variance": unit, "white": unit, "correlation_time": "s", "frequency": "Hz", "damping": ""}
    values = {key: _known_or_prior(getattr(section, key), key, unit_of[key]) for key in given if key in unit_of}
    if "per_channel" in given:
        values["per_channel"] = section.per_channel
    try:
        return law(**values)
    except InputError as error:
        raise InputError(f"table 'discrepancy': {error.where}", error.came, error.allowed, error.cure) from None


def _known_or_prior(value: float | str | PriorSection | None, key: str, unit: str) -> Any:
    where = f"discrepancy.{key}"
    if value is None:
        return None
    return _prior(value, where, unit) if isinstance(value, PriorSection) else to_si(value, unit, f"key '{where}'")
