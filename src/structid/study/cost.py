"""Expected cost of a study, from a few timed runs of its model and evaluations of its likelihood under each error model."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.calibration.plan import Plan
from structid.core.errors import InputError, Status
from structid.core.streams import Purpose, stream
from structid.inference.error_model_choice import CHOICE_SAMPLER, usual_error_models
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.smc.smc import SMC
from structid.study.building.built_study import BuiltStudy
from structid.study.stages.error_model_stage import sampler_under

USUAL_ROUNDS = 6
"""Number of rounds of a calibration in the benchmark study."""
CHEAP = 1e-3
"""Duration of a model run [s] below which no surrogate is needed."""
LONG = 0.3
"""Duration of a call [s] above which the call is timed only once, since other load then matters less."""
SLOW = 20.0
"""Duration of a batch [s] above which the batch is timed only once."""
SAMPLING = "Sampling"
"""Name of the part that samples the posterior."""
SEARCHED = {"pattern_search": (1500, 4), "interior_point": (2400, 200)}
"""Runs per starting point, and linearisations of all starting points together, of each search in the benchmark studies."""
OVERHEAD = 0.4e-6
"""Overhead of a sampler per move and parameter [s]."""
SURROGATE = {"fitting": 3.0, "exploring": 3.0, "choosing the error model": 4.0, "sampling": 15.0}
"""Durations of surrogate steps in the benchmark study [s]; the speed of a surrogate is known only after its fit."""
BENCHMARK_SAMPLES = 4001
"""Number of samples in the record of the benchmark study."""
RUNS_OF_LAW_CHOICE = 500_000
"""Number of runs of the bilinear spring that take as long as the choice among all laws, most of which are slower."""
SMALL_SETTINGS = ("particles", "ensembles", "steps", "effective_share", "correlation", "scouts")
SMALL_POPULATION = SMC(particles=200, ensembles=2, steps=150, effective_share=0.5, correlation=0.3, scouts=0)
"""Population that is offered where sampling takes long; a frame with twelve unknown parameters converged with it."""
LONG_SAMPLING = 600.0
"""Duration of the sampling [s] above which it is offered."""
PAGE = 14.0
"""Duration of the predictions, the figures and the page [s]."""


@dataclass(frozen=True)
class Part:
    """A part of a study and its cost."""

    what: str  # description
    seconds: float  # duration on this machine [s]
    runs: int = 0  # number of model runs; 0 for a part without model runs
    batch: int = 1  # number of runs computed together
    plan: Plan | None = None  # budget of a certified calibration

    def __str__(self) -> str:
        counted = ""
        if self.runs:
            together = f"in batches of {self.batch:,}" if self.batch > 1 else "one after another"
            counted = f"{self.runs:,} model runs {together}, {1e3 * self.seconds / self.runs:.3g} ms per run: "
        spent = "" if self.plan is None else f"\n{_rounds(self.plan)}"
        return f"{self.what}: {counted}about {duration(self.seconds)}{spent}"


@dataclass(frozen=True)
class StudyCost:
    """Expected cost of a study."""

    parts: tuple[Part, ...]  # parts of the study, in order
    batch: int  # number of runs computed together; 1 for an external model
    plan: Plan | None = None  # budget of a certified calibration
    otherwise: Part | None = None  # cost of sampling if the data choose drifting parameters
    longest: float | None = None  # total duration if a certified calibration uses its whole budget [s]
    smaller: float | None = None  # duration of the sampling with `SMALL_POPULATION`, if the given one takes long [s]
    # Whether a time_shift has a prior: the model then cannot run in compiled vector code
    clock_is_inferred: bool = False

    @property
    def seconds(self) -> float:
        """Total duration [s]."""
        return _sum(self.parts)

    @property
    def _each(self) -> float:
        """Duration per model run in a batch [s]."""
        return next((part.seconds / part.runs for part in self.parts if part.runs), float("inf"))

    def __str__(self) -> str:
        return "\n".join([*map(str, self.parts), self.conclusion])

    @property
    def conclusion(self) -> str:
        """The total duration and cheaper alternatives, as lines of text."""
        lines = [f"Total: about {duration(self.seconds)} on this machine{self._at_most}."]
        if self.otherwise is not None:
            lines.append(
                f"If the data choose drifting parameters, sampling takes about {duration(self.otherwise.seconds)} instead. For a "
                'first result, set kind = "iid" in [discrepancy].'
            )
        if self.smaller is not None:
            lines.append(
                f"With a small population, sampling takes about {duration(self.smaller)}; the verdict shows whether it is enough. "
                f"In [sampler]: {', '.join(f'{k} = {getattr(SMALL_POPULATION, k):g}' for k in SMALL_SETTINGS)}."
            )
        if self.clock_is_inferred:
            lines.append(
                "With a prior for time_shift, a run takes about ten times as long. For a first result, set it to a number."
            )
        if self.plan is not None and self._each < CHEAP:
            lines.append(
                f"A run takes only {1e3 * self._each:.2g} ms, so the model itself can be sampled without a certificate: set "
                'kind = "none" in [surrogate], and remove [calibration].'
            )
        if self.batch == 1:
            lines.append("With --executor, workers share these runs: divide the duration by the number of workers.")
        return "\n".join(lines)

    @property
    def _at_most(self) -> str:
        if self.longest is None or self.plan is None or duration(self.longest) == duration(self.seconds):
            return ""
        rounds = f"{USUAL_ROUNDS} rounds are enough for the surrogate"
        return f" if {rounds}, {duration(self.longest)} if it needs all {self.plan.rounds} rounds"


def _rounds(plan: Plan) -> str:
    """Describe how a plan distributes its runs, and whether it allows enough rounds."""
    start, batch = plan.sizes
    description = (
        f"{start} runs train the first surrogate, {plan.certificate} runs are for the certificate, and the others allow "
        f"{plan.rounds} rounds of {batch} runs."
    )
    if plan.rounds < USUAL_ROUNDS:
        enough = start + USUAL_ROUNDS * batch + plan.certificate
        description += (
            f" Most surrogates need {USUAL_ROUNDS} rounds: set calibration.true_runs = {enough} to allow them."
        )
    return description


def duration(seconds: float) -> str:
    """Format a duration in a suitable unit."""
    for size, unit in ((86400.0, "days"), (3600.0, "hours"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 2 else f"{1e3 * seconds:.0f} ms"


def estimate(study: BuiltStudy, show: Callable[[str], None] | None = None) -> StudyCost:
    """Time a few batches of all repeated computations of a study, and extrapolate."""
    batch = study.sampler.ensembles * study.sampler.walkers // 2 if study.model.batched else 1
    # The first batch may include a compilation or the start of a process.
    each = float(np.median(_seconds_per_run(study, batch, repeats=6 if batch > 1 else 4)[1:]))
    parts, under = [], _under_usual_error_models(study)
    for part in _parts(study, under, each, batch):
        parts.append(part)
        if show is not None:
            show(str(part))
    more, otherwise, smaller = 0.0, None, None
    if study.posterior is not None and study.has_surrogate:
        usual, longest = (_sum(_through_a_surrogate(study, rounds)) for rounds in _rounds_of(study))
        more = longest - usual  # additional duration if a calibration uses its whole budget [s]
    elif study.posterior is not None and not study.posterior.costs_runs:
        # The data may choose drifting parameters, if compiled vector code can sample them.
        drifting = next((of for of in under if of.error_model.inside and of.in_lanes), None)
        otherwise = None if drifting is None else _sampling(drifting, sampler_under(study, drifting))
        smaller = _with_a_small_population(study.sampler, study.posterior.dimension, parts)
    at_most = _sum(parts) + more if more else None
    return StudyCost(tuple(parts), batch, study.plan, otherwise, at_most, smaller, _clock_is_inferred(study))


def _with_a_small_population(sampler: Sampler, dimension: int, parts: Sequence[Part]) -> float | None:
    """Duration of a long sampling run of SMC with a small population; None if it is short [s]."""
    sampling = next((part.seconds for part in parts if part.what == SAMPLING), 0.0)
    if sampler.describe().get("kind") != "smc" or sampling < LONG_SAMPLING:
        return None
    smaller = sampling * SMALL_POPULATION.evaluations(dimension) / sampler.evaluations(dimension)
    return smaller if smaller < 0.5 * sampling else None


def _parts(study: BuiltStudy, under: Sequence[Posterior], each: float, batch: int) -> Iterator[Part]:
    """The parts of a study in order, given the duration per run in a batch."""
    if runs := _true_runs(study):
        yield Part("Campaign", runs * each, runs, batch, study.plan)
    if study.motion_test is not None:
        yield Part("Choosing the hysteretic law", RUNS_OF_LAW_CHOICE * each)
    if study.posterior is not None:
        yield from _sampling_parts(study, study.posterior, under, each, batch)
    for stage in study.planned_stages:
        runs = stage.model_runs
        yield Part(stage.what.capitalize(), runs * each, runs, batch)
    if study.posterior is not None:
        yield from _other_records(study, each)
        yield Part("Predictions, figures and page", PAGE)


def _sampling_parts(
    study: BuiltStudy, posterior: Posterior, under: Sequence[Posterior], each: float, batch: int
) -> Iterator[Part]:
    """The parts that produce draws of the posterior."""
    if study.has_surrogate:
        yield from _through_a_surrogate(study, _rounds_of(study)[0])
    elif posterior.costs_runs:
        evaluations = study.sampler.evaluations(posterior.dimension)
        yield Part(SAMPLING, evaluations * each, evaluations, batch)
    else:
        yield from _choice(under)
        yield from _searches(study)
        yield replace(_sampling(posterior, study.sampler), batch=batch)


def _clock_is_inferred(study: BuiltStudy) -> bool:
    """Whether the model itself is sampled with an unknown time shift."""
    posterior = study.posterior
    if posterior is None or not posterior.model.traceable or study.file.surrogate.kind != "none":
        return False
    return any(observation.time_shift is not None for observation in posterior.observations)


def _true_runs(study: BuiltStudy) -> int:
    """Number of model runs before sampling, plus the runs that accept or reject a surrogate's proposals."""
    runs = 0 if study.campaign is None else len(study.campaign)
    if study.plan is not None:
        runs = study.plan.true_runs * len({o.record.content_hash for o in study.sampled.observations})
    elif study.has_surrogate:
        runs += study.validation_runs
    if study.sampler.exact:
        runs += study.sampler.steps * study.sampler.ensembles * study.sampler.walkers
    return runs


def _rounds_of(study: BuiltStudy) -> tuple[int, int]:
    """Usual number of surrogate fits, and the number that the budget allows."""
    if study.plan is None:
        return 1, 1
    return min(study.plan.rounds, USUAL_ROUNDS) + 1, study.plan.rounds + 1


def _through_a_surrogate(study: BuiltStudy, rounds: int) -> list[Part]:
    """Cost of fitting and sampling surrogates in all rounds, scaled from the benchmark study."""
    longer = sum(len(o.record) * len(o.channels) for o in study.sampled.observations) / BENCHMARK_SAMPLES
    # If a surrogate is not good enough after the usual rounds, its posterior is wide, and every step takes longer.
    harder = max(1.0, rounds / (USUAL_ROUNDS + 1))
    parts = [Part("Fitting the surrogate", SURROGATE["fitting"] * rounds * longer)]
    if study.plan is not None:
        parts.append(Part("Exploring the surrogate's posterior", SURROGATE["exploring"] * rounds * longer))
    if study.error_model_is_open:
        what = "choosing the error model"
        parts.append(Part(what.capitalize(), SURROGATE[what] * longer * harder))
    return [*parts, Part("Sampling the surrogate", SURROGATE["sampling"] * longer * harder)]


def _other_records(study: BuiltStudy, each: float) -> list[Part]:
    """Runs of an external solver for other records, unless a NARX predicts them."""
    if study.model.batched or not study.other_records or (study.has_surrogate and "narx" in study.file.surrogate.kind):
        return []
    runs = (study.file.prediction.draws + 1) * len(study.other_records)
    return [Part("Predicting other records (prediction.draws)", runs * each, runs)]


def _sum(parts: Iterable[Part]) -> float:
    return sum(part.seconds for part in parts)


def _under_usual_error_models(study: BuiltStudy) -> list[Posterior]:
    """The posterior under each error model, if the data choose the error model and the model itself is sampled."""
    posterior = study.posterior
    if posterior is None or not study.error_model_is_open or study.has_surrogate or posterior.costs_runs:
        return []
    return [study.sampled.on(error_model=error_model) for error_model in usual_error_models(study.model)]


def _choice(under: Sequence[Posterior]) -> list[Part]:
    """Cost of choosing the error model, with one sampling run per error model."""
    if not under:
        return []
    tried = [of for of in under if of.in_lanes or not of.error_model.inside]
    return [Part("Choosing the error model", sum(_sampling(of, CHOICE_SAMPLER).seconds for of in tried))]


def _sampling(posterior: Posterior, sampler: Sampler) -> Part:
    """Cost of sampling a posterior, including the initial and the discarded draws."""
    evaluations = sampler.evaluations(posterior.dimension)
    together = sampler.ensembles * sampler.walkers
    phi = posterior.initial(
        together if sampler.needs_derivatives else max(together // 2, 64), stream(0, Purpose.TIMED_DRAWS)
    )
    each = _shortest(
        _gradient(posterior, phi) if sampler.needs_derivatives else lambda: posterior.evaluate_parts(phi)
    ) / len(phi)
    return Part(SAMPLING, evaluations * (each + OVERHEAD * posterior.dimension), evaluations)


def _gradient(posterior: Posterior, phi: np.ndarray) -> Callable[[], object]:
    """Function that evaluates the gradient of the log density, for timing."""
    import jax

    density, data = posterior.traceable()
    gradient = jax.jit(jax.grad(lambda points: density(points, data).sum()))
    return lambda: jax.block_until_ready(gradient(phi))


def _searches(study: BuiltStudy) -> Iterator[Part]:
    """Cost of each deterministic search: its model runs, and its linearisations at all starting points."""
    misfit, starts = study.sampled.misfit, study.file.deterministic.starts
    theta = study.space.sample(starts, seed=study.file.seed).columns(misfit.names)
    for method in study.search_methods:
        runs, linearised = SEARCHED[method]
        seconds = runs * _shortest(lambda: misfit(theta))
        if misfit.differentiable:
            seconds += linearised * _shortest(lambda: misfit.linearised(theta))
        yield Part(method.replace("_", " ").capitalize(), seconds)


def _shortest(call: Callable[[], object], repeats: int = 3) -> float:
    """Shortest of several timings of a call, after a warm-up call that may compile; a long call is timed once [s]."""
    call()
    seconds: list[float] = []
    while len(seconds) < repeats and sum(seconds) < LONG:
        began = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def _seconds_per_run(study: BuiltStudy, batch: int, repeats: int) -> list[float]:
    """Seconds per run in a batch of prior draws, for each repetition; the first may include a compilation."""
    theta = study.model.parameters(study.space.sample(batch, seed=study.file.seed))
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        histories = study.model.simulate(theta, study.record)
        seconds.append((time.perf_counter() - began) / batch)
        if all(Status(status).run_failed for status in histories.status):
            raise InputError(
                "model",
                f"its trial run {Status(histories.status[0]).words}: {histories.reasons[0]}",
                "a model that runs at prior draws",
                "Correct the model, its files or the priors.",
            )
        if seconds[0] * batch > SLOW:
            return seconds * 2
    return seconds
