"""The sequential loop: design → surrogate → posterior → model runs in its region → … → certificate."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.calibration.adopted_runs import first_design, take_over
from structid.calibration.calibration_result import CalibrationResult, Round, hint_for_slow_rounds
from structid.calibration.cross_validation import cross_validate
from structid.calibration.exploration import Exploration
from structid.calibration.final_draws import FinalDraws, final_draws
from structid.calibration.initial_runs import make_first_runs, refuse_noise, warn_of_mistakes
from structid.calibration.next_runs import Batch, certificate_draws, next_batch
from structid.calibration.plan import FEWEST_IN_A_BATCH, Plan
from structid.calibration.requested_limits import earlier_limits
from structid.calibration.surrogate_fits import SurrogateFits, best_densities
from structid.campaign.executors import kept_open, run_map
from structid.campaign.store import CALIBRATION_FINISHED
from structid.certification.certificate import issue_certificate
from structid.certification.fresh_draws import DensityDifference, FreshDraws, StoredRuns
from structid.certification.model_runs import ModelRuns, ReportActivity, noise_doubts
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.journal import Journal
from structid.core.progress import Progress
from structid.core.streams import Purpose, derived_seed, stream
from structid.core.validation import check_arguments
from structid.engine.lanes.machine import engine
from structid.inference.error_model_choice import AUTO, ErrorModelChoice, choose_among
from structid.inference.error_models.base import ErrorModel
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import sample
from structid.inference.sampling.base import Block, Sampler
from structid.inference.sampling_result import SamplingResult
from structid.models.base import Model
from structid.observation import Observation
from structid.probability.space import ParameterSpace
from structid.surrogates.base import Surrogate, SurrogateSettings
from structid.surrogates.surrogate_list import DEFAULT, load_surrogate

SCHEMA = 14
"""Version of the stored rounds, and of the random streams that continue from them."""

LARGEST_OUTSIDE = 0.01
"""Largest fraction of the posterior outside the range of the runs for which a certificate is attempted."""

SURE = 0.035
"""Standard deviation of the log density due to the surrogate error below which a certificate is attempted [nat]. The spread of
the last round's log weights then does not matter, since its draws train this surrogate."""

Entry = dict[str, np.ndarray]
"""A stored round."""

_log = logging.getLogger(__name__)


@check_arguments
def calibrate(
    model: Model,
    space: ParameterSpace,
    observations: Observation | Sequence[Observation],
    surrogate: SurrogateSettings | None = None,
    discrepancy: ErrorModel | str | None = None,
    *,
    true_runs: int = 500,
    plan: Plan | None = None,
    sampler: Sampler | None = None,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    adopt: bool = False,
    executor: Any = None,
    progress: ReportActivity | None = None,
) -> CalibrationResult:
    """Calibrate a model with a surrogate that is improved near the posterior until model runs certify it.

    A first design is run, and a surrogate is fitted to it. The surrogate's posterior is explored from the prior in tempering
    steps. The model is then run at draws of this posterior, at points where the surrogate is least certain, and at tempered
    draws. All these runs train the next surrogate. Since a NARX reproduces none of its runs exactly, a POD-Kriging surrogate
    replaces it for the records of the observations; see `CorrectedNARX`. When the importance weights of the plain draws are
    nearly equal, the surrogate's posterior is sampled until the draws have converged and a second sampler agrees with them. The
    next round then spends `Plan.certificate` model runs on a `Certificate`, at fresh draws, a third of them tempered. If the
    certificate is refused, these runs also train the next surrogate and assess it by cross-validation.

    Parameters
    ----------
    model : Model
        The true model: built in, or an external solver.
    space : ParameterSpace
        Its unknown parameters and their priors.
    observations : Observation or sequence of Observation
        The measurements.
    surrogate : PODKriging, PODPCE, PCNARX or KrigingNARX, optional
        Settings of the surrogate; by default `PODKriging`.
    discrepancy : Discrepancy or "auto", optional
        The error model; by default independent errors. ``"auto"`` lets the data choose
        one by its evidence as soon as the surrogate is good enough near the posterior; see `structid.choose_error_model`.
    true_runs : int
        Budget of model runs, including the certificate's runs. With several records, each point counts once.
    plan : Plan, optional
        All further settings of the budget. If given, its own budget replaces `true_runs`.
    sampler : Sampler, optional
        Sampler of the certified surrogate posterior; by default `SMC`, with more particles and moves if it has not
        converged. `DelayedAcceptance` draws from the model's own posterior, at the cost of further model runs.
    seed : int
        Seed.
    store : path-like, optional
        Folder for model runs, rounds and draws. An interrupted calibration, or one with a larger budget, continues from it.
    adopt : bool
        Keep the stored runs of another version of the model, which otherwise raises an error: for a corrected solver whose finished
        runs are valid. They become the first design. Failed runs are repeated, and rounds and draws are made anew.
    executor : optional
        Executor of an external model's runs; see `Campaign.run`.
    progress : callable, optional
        Called with the current activity, the amount done, and the total.

    Returns
    -------
    CalibrationResult
        Draws, certificate, rounds, model runs.

    Raises
    ------
    InputError
        If the budget is too small for a first design and a certificate.
    StoreMismatchError
        If `store` belongs to another calibration.

    Warns
    -----
    StructidWarning
        If the first runs are unlike the measurements: many times larger or smaller, mainly at another frequency, with the sign
        reversed, or shifted in time. A unit is then probably wrong.

    Notes
    -----
    The result of each round is logged; ``logging.basicConfig(level=logging.INFO)`` prints it.

    Examples
    --------
    >>> import structid as si
    >>> calibration = si.calibrate(model, space, measured, si.PODKriging(), true_runs=200, seed=1)  # doctest: +SKIP
    >>> print(calibration.certificate)  # doctest: +SKIP
    """
    settings = DEFAULT.made({}) if surrogate is None else surrogate
    error_model = _given_error_model(discrepancy)
    if error_model is not None and error_model.inside:
        raise InputError(
            "calibrate(discrepancy)",
            f"{error_model.describe()['kind']}, which varies the model's parameters in time",
            "errors that are added to the response: iid, ar1, matern32, damped_cosine",
            "A surrogate cannot include this drift. Sample the model itself: structid.sample, or a study without a surrogate.",
        )
    with kept_open(model, executor) as workers:
        loop = _Loop(
            Posterior(space, model, observations, error_model),
            error_model is None and discrepancy is not None,
            settings,
            Plan(true_runs=true_runs) if plan is None else plan,
            sampler,
            seed,
            None if store is None else Path(store),
            adopt,
            workers,
            progress,
        )
        return loop.run()


def _given_error_model(discrepancy: ErrorModel | str | None) -> ErrorModel | None:
    """Return the given error model; None if it is omitted or if the data choose it."""
    if isinstance(discrepancy, str) and discrepancy != AUTO:
        raise InputError(
            "calibrate(discrepancy)", f"'{discrepancy}'", f"an error model such as structid.AR1(), or '{AUTO}'"
        )
    return None if isinstance(discrepancy, str) else discrepancy


class _Loop:
    """One calibration, round by round."""

    def __init__(
        self,
        posterior: Posterior,
        error_model_is_open: bool,
        settings: SurrogateSettings,
        plan: Plan,
        sampler: Sampler | None,
        seed: int,
        folder: Path | None,
        adopt: bool,
        executor: Any,
        progress: ReportActivity | None,
    ) -> None:
        self.posterior, self.settings, self.sampler = posterior, settings, sampler
        self.seed, self.folder, self.executor, self.progress = seed, folder, executor, progress
        self.space, self.error_model_is_open = posterior.model_space, error_model_is_open
        self.plan = plan.sized(posterior, settings)
        first = first_design(folder, self._planned(self.plan.sizes[0]))
        self.true = ModelRuns(posterior, first, folder, executor, progress)
        if adopt:
            take_over(self.true)
        self.true.refuse_another()
        settings.check(self.true.design, self.true.records, posterior.model.channels)
        self.journal = None if folder is None else Journal(folder / "rounds.journal", self._identity)
        self.looked = earlier_limits(folder, plan.limits)
        self.rounds: list[Round] = []
        self.twice = 0
        self.noise: tuple[str, ...] = ()
        self.last: Batch | None = None
        self.before: Surrogate | None = None
        self.surrogate: Surrogate | None = None
        self.choice: ErrorModelChoice | None = None
        self._hinted = False
        self.settled = not error_model_is_open
        self.final: tuple[int, FinalDraws] | None = None

    @property
    def _identity(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "engine": engine(),
            "posterior": self.posterior.content_hash,
            **({"law": AUTO} if self.error_model_is_open else {}),
            "surrogate": digest(type(self.settings).__name__, repr(self.settings)),
            "plan": digest(self.plan.describe()),
            "seed": self.seed,
        }

    def run(self) -> CalibrationResult:
        """Run the calibration, which continues from the stored rounds."""
        make_first_runs(self.true, self.settings, self._planned, self._left)
        self.twice += refuse_noise(self.true)
        warn_of_mistakes(self.true)
        stored = [] if self.journal is None else list(self.journal)
        while True:
            number, training = len(self.rounds), len(self.true)
            surrogate = self._surrogate(number)
            if number < len(stored):
                entry = stored[number]
                if entry["chosen"]:
                    self._choose_error_model(number, surrogate)  # again, in the same round; its draws are stored
                    self.settled = bool(entry["settled"])
            else:
                entry = self._next(number, surrogate)
                if self.journal is not None:
                    self.journal.append(entry)
            self.last = Batch.of(entry)
            if not entry["again"]:
                self.true.make(self.last.points(self.space.dimension))
            self.rounds.append(self._judged(entry, surrogate, self.last, training))
            _log.info("%s", self.rounds[-1])
            self._report_once(hint_for_slow_rounds(self.rounds, self.posterior))
            certificate = self.rounds[-1].certificate
            spent = self._left(len(self.true)) < 0 and not self._to_be_judged_again
            if certificate is not None and (certificate.certified or spent):
                return self._result(number, surrogate)

    def _report_once(self, hint: str) -> None:
        """Report the first lack of progress."""
        if hint and not self._hinted:
            _log.info("%s", hint)
            self._hinted = True

    def _planned(self, count: int) -> np.ndarray:
        """Return `count` points of the first design, in SI."""
        return self.space.sample(count, self.seed, "sobol", self.plan.widen).values

    # --- a round ------------------------------------------------------------------------------------------------

    def _surrogate(self, number: int) -> Surrogate:
        path = None if self.folder is None else self.folder / f"surrogate_{number}.h5"
        if path is not None and path.is_file():
            surrogate = load_surrogate(path)
        else:
            surrogate, _ = self._fits(self._progress_of("fitting the surrogate")).fit(
                np.arange(len(self.true)), self.surrogate
            )
            if path is not None:
                surrogate.save(path)
        surrogate.trust()  # the certificate assesses it
        self.before, self.surrogate = self.surrogate, surrogate
        return surrogate

    def _fits(self, progress: Progress) -> SurrogateFits:
        """The current data for surrogate fits."""
        return SurrogateFits(self.settings, self.posterior, self.true, self.last, progress)

    def _next(self, number: int, surrogate: Surrogate) -> Entry:
        """Explore the surrogate's posterior, and choose the round's points: a batch, or the draws of a certificate."""
        training = len(self.true)
        last_chance = not self._room(training)
        explored = self._explored(number, surrogate)
        promising = self._promising(explored)
        due = last_chance or promising
        # A choice made because the budget was spent, by a possibly poor surrogate, is repeated with a larger budget.
        chosen = not self.settled and (promising or (last_chance and self.choice is None))
        self.settled = self.settled or (chosen and promising)
        if chosen and not self._choose_error_model(number, surrogate):
            due, explored = last_chance, self._explored(number, surrogate)
        made_up = None
        if due or self._to_be_judged_again:
            final = self._final_draws(number, surrogate, training, explored.sure)
            made_up, fit = final.made_up, explored.outside <= LARGEST_OUTSIDE and not final.failures
            due = due and (fit or last_chance)
        again = self._to_be_judged_again and (fit or self._left(training) < 0)
        rng, difference = stream(self.seed, Purpose.CALIBRATION_BATCH, number), DensityDifference()
        if again:
            batch, difference = self._again(final.sampling, surrogate)
        elif due:
            batch = certificate_draws(explored, final.sampling, self.plan.certificate, rng)
        else:
            batch = next_batch(explored, self.true.points, min(self.plan.sizes[1], self._left(training)), rng, made_up)
        sure = float(explored.exponents[explored.trusted]), explored.deviation
        flags = {"final": due or again, "again": again, "chosen": chosen, "settled": self.settled, "sure": sure}
        return batch.to_entry() | difference.to_entry() | {name: np.array(value) for name, value in flags.items()}

    @property
    def _to_be_judged_again(self) -> bool:
        """Whether the last round's certificate was refused, so that its draws can assess the next surrogate."""
        return bool(self.rounds) and self.rounds[-1].to_be_judged_again

    def _again(self, drawn: SamplingResult, surrogate: Surrogate) -> tuple[Batch, DensityDifference]:
        """Cross-validate the surrogate with the last certificate's draws."""
        assert self.last is not None
        everything, first = np.arange(len(self.true)), len(self.true) - len(self.last.fresh)
        fits = self._fits(self._progress_of("fitting surrogates without some runs"))
        # All runs choose the form. The search begins at a surrogate that was also fitted without these draws.
        _, form = fits.fit(everything, self.before)

        def without(places: np.ndarray) -> Posterior:
            left, _ = fits.fit(np.delete(everything, first + places), self.before, (form,))
            left.trust()
            return self.posterior.on(left)

        return cross_validate(self.last, drawn, self.posterior.on(surrogate), without)

    def _explored(self, number: int, surrogate: Surrogate) -> Exploration:
        blocks: list[Block] = []
        progress = self._progress_of("exploring its posterior")
        under, seed = self.posterior.on(surrogate), derived_seed(self.seed, Purpose.CALIBRATION_EXPLORING, number)
        self.plan.exploration_sampler.run(under, seed, None, [], lambda _index, block: blocks.append(block), progress)
        return Exploration(under, surrogate, blocks)

    def _final_draws(self, number: int, surrogate: Surrogate, training: int, sure: bool) -> FinalDraws:
        """Return the draws for this round's certificate, computed once or read from the store."""
        if self.final is None or self.final[0] != number:
            folder = None if self.folder is None else self.folder / f"draws_{number}"
            sampler = None if self.sampler is not None and self.sampler.exact else self.sampler
            seed = derived_seed(self.seed, Purpose.CALIBRATION_SAMPLING)
            points, report = self.true.points[:training], self._progress_of("sampling")
            under = self.posterior.on(surrogate)
            self.final = number, final_draws(under, surrogate, sure, points, sampler, seed, folder, report)
        return self.final[1]

    def _promising(self, explored: Exploration) -> bool:
        """Whether a certificate is likely, judged by the plain draws of the last round or by the surrogate error."""
        if not self.rounds or self.rounds[-1].certificate is not None or not self.rounds[-1].fresh:
            return False
        return self.rounds[-1].promising or bool(explored.sure and explored.deviation <= SURE)

    def _room(self, training: int) -> bool:
        """Whether the budget allows another batch before the certificate."""
        return self._left(training) >= FEWEST_IN_A_BATCH

    def _left(self, training: int) -> int:
        """Number of model runs left besides a certificate, which also repeats one run of an external solver."""
        of_a_certificate = self.plan.certificate + (not self.posterior.model.traceable)
        return self.plan.true_runs - training - self.twice - of_a_certificate

    def _choose_error_model(self, number: int, surrogate: Surrogate) -> bool:
        """Let the data choose the error model, with responses of the surrogate; return whether it is unchanged."""
        folder, before = None if self.folder is None else self.folder / f"laws_{number}", self.posterior.error_model
        seed = derived_seed(self.seed, Purpose.LAW_CHOICE)
        report = self._progress_of("choosing the error model")
        self.choice = choose_among(self.posterior.on(surrogate), seed=seed, progress=report, store=folder)
        self.posterior = self.posterior.on(error_model=self.choice.posterior.error_model)
        return self.posterior.error_model.describe() == before.describe()

    def _judged(self, entry: Entry, surrogate: Surrogate, batch: Batch, training: int) -> Round:
        """Assess a round by its model runs at the fresh draws, with a certificate if it is due."""
        number, again, count = len(self.rounds), bool(entry["again"]), len(batch.fresh)
        exponent, deviation = map(float, entry["sure"])
        first = training - count if again else training
        fresh = slice(first, first + count)
        log_true = self.posterior.given(self.true.responses(fresh)).log_density(batch.fresh) if count else np.empty(0)
        drawn = FreshDraws(
            batch.fresh,
            self.posterior.compared(batch.fresh),
            log_true,
            batch.log_surrogate,
            batch.shares,
            self.posterior.compared(batch.population),
            batch.highest,
            self.true.collapsed(fresh),
            DensityDifference.of(entry),
        )
        certificate = None
        if entry["final"]:
            look = 1 + self.looked + sum(r.certificate is not None for r in self.rounds)
            density, theta = best_densities(self.posterior, self.true, batch)
            stored = StoredRuns(density, self.posterior.on(surrogate).log_density(theta))
            doubts = self._final_draws(number, surrogate, training, exponent == 1.0).failures
            noise = self._noise(first, batch, log_true, again)
            spent = len(self.true) + self.twice
            certificate = issue_certificate(
                drawn, stored, self.posterior.compared_names, spent, look, self.plan.limits, doubts, noise
            )
        return Round(
            number,
            training,
            surrogate.fitted.error,
            len(batch.fresh),
            len(batch.others),
            exponent,
            deviation,
            drawn.spread,
            drawn.failed,
            certificate,
            drawn.log_ratios,
            batch.shares,
            again,
        )

    def _noise(self, first: int, batch: Batch, log_true: np.ndarray, again: bool) -> tuple[str, ...]:
        """Repeat the run at a certificate's first draw, and report an external solver that is not deterministic."""
        if not (self.posterior.model.traceable or again):
            self.twice += 1
            once_more = self.posterior.given(self.true.once_more(first)).log_density(batch.fresh[:1])
            self.noise = noise_doubts(log_true[0], once_more[0]) or self.noise
        return self.noise

    # --- the end ------------------------------------------------------------------------------------------------

    def _result(self, number: int, surrogate: Surrogate) -> CalibrationResult:
        last = self.rounds[-1]
        assert last.certificate is not None
        final = self._final_draws(number, surrogate, last.training, last.exponent == 1.0)
        sampler, drawn = self.sampler, replace(final.sampling, certified=last.certificate.certified)
        if sampler is not None and sampler.exact:  # draws of the model's own posterior, for any verdict
            chains = None if self.folder is None else self.folder / f"exact_{number}.h5"
            seed, progress = derived_seed(self.seed, Purpose.CALIBRATION_SAMPLING), self._progress_of("exact sampling")
            with run_map(self.posterior.model, self.executor) as map_of_runs:
                target = self.posterior.mapped_by(map_of_runs)
                drawn = sample(target, sampler.proposing_by(surrogate), seed, chains, progress=progress)
        if self.folder is not None:
            (self.folder / CALIBRATION_FINISHED).touch()
        return CalibrationResult(
            drawn,
            last.certificate,
            tuple(self.rounds),
            self.posterior,
            surrogate,
            self.true.runs,
            self.choice,
            final.representation,
        )

    def _progress_of(self, what: str) -> Progress:
        def report(done: int, total: int) -> None:
            if self.progress is not None:
                self.progress(what, done, total)

        return report
