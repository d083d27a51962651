"""The sequential loop: design → surrogate → posterior → true runs where the posterior is → … → certificate."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.calibration.batch import Batch, certificate_draws, next_batch
from structid.calibration.calibration_result import CalibrationResult, Round
from structid.calibration.exploration import Exploration
from structid.calibration.forms import best_near_the_posterior
from structid.calibration.nearness import nearness
from structid.calibration.plan import Plan
from structid.campaign.executors import kept_open, run_map
from structid.campaign.runner import Campaign
from structid.campaign.store import CALIBRATION_RUNS
from structid.errors import InputError, Status, names_checked
from structid.hashing import digest
from structid.inference.assessment.certificate import Certificate, judged
from structid.inference.assessment.fresh_draws import FreshDraws, StoredRuns
from structid.inference.law_choice import AUTO, LawChoice, choose_among
from structid.inference.likelihood.discrepancy import ErrorLaw
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.sampler import Block, Sampler
from structid.inference.sampling.tempered import SMC
from structid.inference.sampling_result import SamplingResult
from structid.journal import Journal
from structid.mechanics.lanes.machine import engine
from structid.models.face import Model, Progress
from structid.observation import Observation
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.runs import Runs
from structid.streams import Purpose, derived_seed, stream
from structid.surrogates.face import Surrogate, SurrogateSettings
from structid.surrogates.registry import DEFAULT, load_surrogate

SCHEMA = 6
"""Version of the rounds on disk, and of the random streams that continue from them."""

DISCREPANCY_DRAWS = 32
"""Draws of the discrepancy's parameters among which each stored run takes the one that suits it best."""

USUAL_SAMPLER = SMC(particles=500, steps=50, effective_share=0.5, correlation=0.5)
"""Draws from the surrogate's posterior at the end, where no sampler is named."""

LONGER = (1, 4, 16)
"""How many times as many moves it takes at last if it has not converged: along a narrow ridge particles move slowly."""

LAWS_FOLDER = "laws"
"""Draws under each of the laws that may be chosen."""

LARGEST_OUTSIDE = 0.01
"""Share of the posterior beyond the range of the runs, where a surrogate responds as at the edge, before a certificate."""

FEWEST_IN_A_BATCH = 4
"""A batch of fewer runs before the last certificate is not worth a round."""

Entry = dict[str, np.ndarray]
"""A round on disk."""

Tell = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and the total."""


@names_checked
def calibrate(
    model: Model,
    space: ParameterSpace,
    observations: Observation | Sequence[Observation],
    surrogate: SurrogateSettings | None = None,
    discrepancy: ErrorLaw | str | None = None,
    *,
    true_runs: int = 500,
    plan: Plan | None = None,
    sampler: Sampler | None = None,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    executor: Any = None,
    progress: Tell | None = None,
) -> CalibrationResult:
    """Calibrate a model with a surrogate that is improved where the posterior is, until true runs certify it.

    A first design is run, and a surrogate is fitted to it. The surrogate's posterior is explored from the prior in tempered
    stages. The model is then run at draws of this posterior, at points where the surrogate is least sure, and at tempered draws.
    All these runs train the next surrogate. A NARX, which reproduces none of its runs exactly, gives more weight to those near
    the posterior. When the importance weights of the plain draws are nearly equal, the next round spends `Plan.certificate` fresh
    draws, and a fifth as many tempered ones, on a `Certificate`. If that fails, they too train the next surrogate.

    Parameters
    ----------
    model : Model
        The true model: built in, or an external solver.
    space : ParameterSpace
        Its unknown parameters and their priors.
    observations : Observation or sequence of Observation
        What was measured.
    surrogate : PODKriging, PODPCE, PCNARX or KrigingNARX, optional
        Settings of the surrogate; `PODKriging` when left out.
    discrepancy : Discrepancy or "auto", optional
        The law of the difference between model and measurement; independent errors when left out. ``"auto"`` lets the data choose
        one by its evidence as soon as the surrogate is good enough near the posterior; see `structid.choose_law`.
    true_runs : int
        Budget of true runs, including those of the certificate. With several records, each point counts once.
    plan : Plan, optional
        Everything else about how they are spent. If given, its own budget replaces `true_runs`.
    sampler : Sampler, optional
        Draws from the surrogate's posterior at the end; `SMC` when left out, which moves up to 16 times longer if it has not
        converged. `DelayedAcceptance` draws from the model's own posterior, at the cost of further true runs.
    seed : int
        Seed.
    store : path-like, optional
        A folder for true runs, rounds and draws. A killed calibration continues from it, and so does one with a larger budget.
    executor : optional
        Where an external model's runs are done; see `Campaign.run`.
    progress : callable, optional
        Called with what is being done, how much of it is done, and the total.

    Returns
    -------
    CalibrationResult
        Draws, certificate, rounds, true runs.

    Raises
    ------
    InputError
        If the budget is too small for a first design and a certificate.
    StoreMismatchError
        If `store` belongs to another calibration.
    """
    settings = DEFAULT.made({}) if surrogate is None else surrogate
    law = _law(discrepancy)
    if law is not None and law.inside:
        raise InputError(
            "calibrate(discrepancy)",
            f"{law.describe()['kind']}, whose errors are inside the model",
            "errors that are added to the response: iid, ar1, matern32, damped_cosine",
            "A surrogate stands for the model as it is. Sample the model itself: structid.sample, or a study without a surrogate.",
        )
    with kept_open(model, executor) as workers:
        loop = _Loop(
            Posterior(space, model, observations, law),
            law is None and discrepancy is not None,
            settings,
            Plan(true_runs=true_runs) if plan is None else plan,
            sampler,
            seed,
            None if store is None else Path(store),
            workers,
            progress,
        )
        return loop.run()


def _law(discrepancy: ErrorLaw | str | None) -> ErrorLaw | None:
    """The law that is given; None where it is left out, or to be chosen."""
    if isinstance(discrepancy, str) and discrepancy != AUTO:
        raise InputError("calibrate(discrepancy)", f"'{discrepancy}'", f"a law such as structid.AR1(), or '{AUTO}'")
    return None if isinstance(discrepancy, str) else discrepancy


class _Loop:
    """One calibration, round by round."""

    def __init__(
        self,
        posterior: Posterior,
        law_is_open: bool,
        settings: SurrogateSettings,
        plan: Plan,
        sampler: Sampler | None,
        seed: int,
        folder: Path | None,
        executor: Any,
        progress: Tell | None,
    ) -> None:
        self.posterior, self.settings, self.plan, self.sampler = posterior, settings, plan, sampler
        self.seed, self.folder, self.executor, self.progress = seed, folder, executor, progress
        self.space, self.law_is_open = posterior.model_space, law_is_open
        self.records = tuple({o.record.content_hash: o.record for o in posterior.observations}.values())
        self.points = self.space.sample(plan.start, seed, "sobol", plan.widen).values
        settings.check(self._design(), self.records, posterior.model.channels)
        self.journal = None if folder is None else Journal(folder / "rounds.journal", self._identity)
        self.rounds: list[Round] = []
        self.last: Batch | None = None
        self.surrogate: Surrogate | None = None
        self.choice: LawChoice | None = None

    @property
    def _identity(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "engine": engine(),
            "posterior": self.posterior.content_hash,
            **({"law": AUTO} if self.law_is_open else {}),
            "surrogate": digest(type(self.settings).__name__, repr(self.settings)),
            "plan": digest(self.plan.describe()),
            "seed": self.seed,
        }

    def run(self) -> CalibrationResult:
        """Go through the rounds that are stored, and on from there."""
        runs = self._true_runs()
        stored = [] if self.journal is None else list(self.journal)
        while True:
            number, training = len(self.rounds), len(self.points)
            surrogate = self._surrogate(number, runs)
            if number < len(stored):
                entry = stored[number]
                self._law_as_stored(entry, surrogate)
            else:
                entry = self._next(number, surrogate)
                if self.journal is not None:
                    self.journal.append(entry)
            batch = Batch.of(entry)
            under = self.posterior.on(surrogate)
            self.points = np.concatenate([self.points, batch.points(self.space.dimension)])
            self.last = batch
            runs = self._true_runs(runs)
            self.rounds.append(self._judged(entry, surrogate, batch, under, runs, training))
            certificate = self.rounds[-1].certificate
            if certificate is not None and (certificate.certified or not self._affordable(len(self.points))):
                return self._result(surrogate, under, certificate, runs)

    # --- true runs ----------------------------------------------------------------------------------------------

    def _design(self) -> Design:
        """Every point on every record, one after another."""
        return Design(np.repeat(self.points, len(self.records), axis=0), self.space)

    def _true_runs(self, done: Runs | None = None) -> Runs:
        """Run the model at every point where it has not been run."""
        told = self._told("true runs")
        model, cycle = self.posterior.model, "cycle" if len(self.records) > 1 else None
        if self.folder is not None:
            campaign = Campaign(model, self.records, self._design(), self.folder / CALIBRATION_RUNS, cycle)
        else:
            campaign = Campaign(model, self.records, self._design()[0 if done is None else len(done) :], None, cycle)
        runs = campaign.run(self.executor, progress=lambda ended, total, _failed: told(ended, total))
        return runs if self.folder is not None or done is None else done + runs

    def _responses(self, runs: Runs, points: slice) -> list[np.ndarray]:
        """Responses of some points to each observation's record, (run, time, channel); NaN where a run failed."""
        count = len(self.records)
        rows = np.arange(len(self.points))[points]
        hashes = [r.content_hash for r in self.records]
        responses = []
        for observation in self.posterior.observations:
            some = runs[rows * count + hashes.index(observation.record.content_hash)]
            values = some.values[:, : len(observation.record)]
            responses.append(np.where(some.done[:, None, None], values, np.nan))
        return responses

    def _collapsed(self, runs: Runs, points: slice) -> np.ndarray:
        """Points at which the structure failed on some record: the model finds them impossible, and has not failed itself."""
        status = runs.status.reshape(len(self.points), len(self.records))[points]
        return np.asarray((status == Status.STRUCTURE_FAILED).any(axis=1))

    # --- a round ------------------------------------------------------------------------------------------------

    def _surrogate(self, number: int, runs: Runs) -> Surrogate:
        path = None if self.folder is None else self.folder / f"surrogate_{number}.h5"
        if path is not None and path.is_file():
            surrogate = load_surrogate(path)
        else:
            surrogate = self._fit(runs, self._told("fitting the surrogate"))
            if path is not None:
                surrogate.save(path)
        surrogate.trust()  # the certificate judges it
        self.surrogate = surrogate
        return surrogate

    def _fit(self, runs: Runs, told: Progress) -> Surrogate:
        """Fit to all runs. If the kind can, start from the last round's surrogate and weight runs by nearness to the posterior."""
        further: dict[str, Any] = {}
        if self.settings.warm_start and self.surrogate is not None:
            further["start"] = self.surrogate
        if self.settings.weighted and self.last is not None:
            near = nearness(self._best_densities(self.last, runs)[0])
            further["weights"] = np.repeat(near, len(self.records))
        forms = getattr(self.settings, "forms", (self.settings,))
        if len(forms) == 1 or self.last is None:
            fit: Callable[..., Surrogate] = forms[0].fit
            return fit(runs, told, **further)
        density, theta = self._best_densities(self.last, runs)
        found: list[Any] = [form.fit(runs, told, **further) for form in forms]
        return best_near_the_posterior(found, self.posterior, theta, density)

    def _next(self, number: int, surrogate: Surrogate) -> Entry:
        """Explore the surrogate's posterior, and choose the round's points: a batch, or the draws of a certificate."""
        training = len(self.points)
        due = self._is_time_for_a_certificate(training)
        chosen = due and self.law_is_open and self.choice is None
        if chosen:
            due = self._choose_law(surrogate) or not self._room(training)
        explored = self._explored(number, surrogate)
        due = due and (explored.outside <= LARGEST_OUTSIDE or not self._room(training))
        rng = stream(self.seed, Purpose.CALIBRATION_BATCH, number)
        if due:
            batch = certificate_draws(explored, self.plan.certificate, rng)
        else:
            batch = next_batch(explored, self.points, min(self.plan.batch, self._left(training)), rng)
        sure = float(explored.exponents[explored.trusted]), float(np.sqrt(explored.variance()))
        said = {"final": np.array(due), "chosen": np.array(chosen), "sure": np.array(sure)}
        return batch.to_entry() | said

    def _explored(self, number: int, surrogate: Surrogate) -> Exploration:
        blocks: list[Block] = []
        told = self._told("exploring its posterior")
        under, seed = self.posterior.on(surrogate), derived_seed(self.seed, Purpose.CALIBRATION_EXPLORING, number)
        self.plan.explorer.run(under, seed, None, [], lambda _index, block: blocks.append(block), told)
        return Exploration(under, surrogate, blocks)

    def _is_time_for_a_certificate(self, training: int) -> bool:
        """When the last batch says so, or when the budget leaves no room for another batch before it."""
        return (bool(self.rounds) and self.rounds[-1].promising) or not self._room(training)

    def _room(self, training: int) -> bool:
        """Whether the budget leaves room for another batch before the certificate."""
        return self._left(training) >= FEWEST_IN_A_BATCH

    def _left(self, training: int) -> int:
        """Runs of the budget that no certificate needs."""
        return self.plan.true_runs - training - self.plan.certificate

    def _choose_law(self, surrogate: Surrogate) -> bool:
        """Let the data choose the law, by a surrogate that is good where the posterior is; say whether it stays as it was."""
        folder = None if self.folder is None else self.folder / LAWS_FOLDER
        seed = derived_seed(self.seed, Purpose.LAW_CHOICE)
        told = self._told("choosing the law of the errors")
        self.choice = choose_among(self.posterior.on(surrogate), seed=seed, progress=told, store=folder)
        self.posterior = self.posterior.on(law=self.choice.posterior.law)
        return self.choice.chosen == 0

    def _law_as_stored(self, entry: Entry, surrogate: Surrogate) -> None:
        """Choose the law again in the round in which it was chosen; its draws are stored."""
        if entry["chosen"] and self.choice is None:
            self._choose_law(surrogate)

    def _affordable(self, spent: int) -> bool:
        return self._left(spent) >= 0

    def _judged(
        self, entry: Entry, surrogate: Surrogate, batch: Batch, under: Posterior, runs: Runs, training: int
    ) -> Round:
        """What true runs at the fresh draws say of a round, and its certificate if it is time for one."""
        fresh = slice(training, training + len(batch.fresh))
        given = self.posterior.given(self._responses(runs, fresh)) if len(batch.fresh) else None
        log_true = np.empty(0) if given is None else given.log_density(batch.fresh)
        drawn = FreshDraws(
            batch.fresh, log_true, batch.log_surrogate, batch.shares, batch.population, batch.highest,
            self._collapsed(runs, fresh),
        )  # fmt: skip
        certificate = None
        if entry["final"]:
            look = 1 + sum(r.certificate is not None for r in self.rounds)
            stored = self._stored(batch, under, runs)
            certificate = judged(drawn, stored, self.posterior.names, len(self.points), look, self.plan.limits)
        exponent, deviation = map(float, entry["sure"])
        return Round(
            len(self.rounds), training, surrogate.fitted.error, len(batch.fresh), len(batch.others), exponent, deviation,
            drawn.spread, drawn.failed, certificate, drawn.log_ratios, batch.shares,
        )  # fmt: skip

    def _stored(self, batch: Batch, under: Posterior, runs: Runs) -> StoredRuns:
        density, theta = self._best_densities(batch, runs)
        return StoredRuns(density, under.log_density(theta))

    def _best_densities(self, batch: Batch, runs: Runs) -> tuple[np.ndarray, np.ndarray]:
        """Densities at all true runs, each with the discrepancy parameters that suit it best, chosen among some draws."""
        dimension = self.space.dimension
        own = batch.of_the_errors(dimension, DISCREPANCY_DRAWS)
        given = self.posterior.given(self._responses(runs, slice(None)))
        best = np.full(len(self.points), -np.inf)
        theta = np.concatenate([self.points, np.tile(own[0], (len(self.points), 1))], axis=1)
        for some in own:
            trial = np.concatenate([self.points, np.tile(some, (len(self.points), 1))], axis=1)
            density = given.log_density(trial)
            better = density > best
            best, theta[better] = np.where(better, density, best), trial[better]
        return best, theta

    # --- the end ------------------------------------------------------------------------------------------------

    def _result(
        self, surrogate: Surrogate, under: Posterior, certificate: Certificate | None, runs: Runs
    ) -> CalibrationResult:
        assert certificate is not None
        chains = None if self.folder is None else self.folder / f"chains_{len(self.rounds) - 1}.h5"
        seed, sampler = derived_seed(self.seed, Purpose.CALIBRATION_SAMPLING), self.sampler
        if sampler is not None and sampler.exact:  # draws of the model's own posterior, whatever the certificate says
            sampler = sampler.proposing_by(surrogate)
            with run_map(self.posterior.model, self.executor) as map_of_runs:
                target = self.posterior.mapped_by(map_of_runs)
                drawn = sample(target, sampler, seed, chains, progress=self._told("exact sampling"))
        else:
            drawn = replace(self._drawn(under, seed, chains), certified=certificate.certified)
        return CalibrationResult(drawn, certificate, tuple(self.rounds), self.posterior, surrogate, runs, self.choice)

    def _drawn(self, under: Posterior, seed: int, chains: Path | None) -> SamplingResult:
        """Draws of the surrogate's posterior; by the usual sampler until they converge, each time from where it was."""
        told = self._told("sampling")
        if self.sampler is not None:
            return sample(under, self.sampler, seed, chains, progress=told)
        with tempfile.TemporaryDirectory() as scratch:
            for times in LONGER:
                longer = replace(USUAL_SAMPLER, steps=times * USUAL_SAMPLER.steps)
                drawn = sample(under, longer, seed, chains or Path(scratch) / "chains.h5", progress=told)
                if drawn.verdict().converged:
                    break
        return drawn

    def _told(self, what: str) -> Progress:
        def tell(done: int, total: int) -> None:
            if self.progress is not None:
                self.progress(what, done, total)

        return tell
