"""The sequential loop: certified where the surrogate can be, refused where it cannot, the same after a kill."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest
from leaderboard_cases import two_modes

import structid as si
from structid.calibration import next_runs as batch
from structid.calibration.exploration import Exploration
from structid.calibration.final_draws import _made_up as made_up_of
from structid.calibration.next_runs import beyond_the_runs, far_apart, next_batch
from structid.calibration.requested_limits import earlier_limits
from structid.calibration.run_weights import FITTED_SHARE, LEAST, nearness
from structid.certification.limits import Limits
from structid.core.errors import InputError, StoreMismatchError

EXPLORER = si.SMC(particles=80, ensembles=4, steps=8, effective_share=0.5, correlation=0.5)
PLAN = si.Plan(true_runs=200, exploration_sampler=EXPLORER)
SAMPLER = replace(EXPLORER, particles=200, steps=30)
SMALL_BUDGET = replace(PLAN, true_runs=80)
"""Some rounds: what is to be refused uses all of its budget, and each round is compiled anew."""
HALF_BUDGET = replace(SMALL_BUDGET, true_runs=110, start=40)
"""For surrogates that see half of their runs."""


@pytest.fixture(scope="module")
def space():
    return si.ParameterSpace(
        stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )


@pytest.fixture(scope="module")
def model(space):
    return si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names)


@pytest.fixture(scope="module")
def measured(model):
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
    y = model.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    return si.Observation(record, y + 0.05 * y.std() * np.random.default_rng(1).normal(size=y.shape))


@pytest.fixture(scope="module")
def reference(space, model, measured):
    return si.sample(si.Posterior(space, model, measured), replace(SAMPLER, particles=400), seed=9)


@pytest.fixture(scope="module")
def calibrated(space, model, measured, tmp_path_factory):
    store = tmp_path_factory.mktemp("calibration")
    return si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=1, store=store), store


def test_it_is_certified_and_equals_the_model_s_own_posterior(calibrated, reference):
    result, _ = calibrated
    assert result.certificate.certified, str(result)
    assert (np.abs(result.mean - reference.mean) < 0.12 * reference.sd).all()
    np.testing.assert_allclose(result.sd, reference.sd, rtol=0.12)
    assert result.certificate.true_runs == len(result.runs) == result.training_runs + PLAN.certificate
    assert result.sampling.verdict().failed_simulations == 0
    told = str(result)
    assert "CERTIFIED" in told and "round 1: surrogate of 10 runs" in told and "stiffness" in told


def test_the_rounds_get_better(calibrated):
    result, _ = calibrated
    exponents = [r.exponent for r in result.rounds]
    assert exponents[0] < 1.0 and exponents[-1] == 1.0
    assert result.rounds[-1].deviation < 0.1 * result.rounds[0].deviation
    assert result.rounds[-1].spread < 0.1 and result.rounds[-1].certificate is result.certificate


def test_a_finished_one_is_read_and_another_is_refused(calibrated, space, model, measured):
    result, store = calibrated
    again = si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=1, store=store)
    np.testing.assert_array_equal(again.sampling.history, result.sampling.history)
    assert again.certificate.variation == result.certificate.variation
    with pytest.raises(StoreMismatchError):
        si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=2, store=store)


def test_a_killed_one_goes_on_to_the_same_bits(calibrated, space, model, measured, tmp_path):
    result, _ = calibrated

    class Killed(Exception):
        pass

    def stop(what, done, total):
        # In the second round, when its points have been chosen but not run.
        stop.seen = stop.seen | {what} if what == "exploring its posterior" else stop.seen
        stop.rounds += what == "model runs"
        if stop.rounds == 2:
            raise Killed

    stop.seen, stop.rounds = set(), 0
    with pytest.raises(Killed):
        si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=1, store=tmp_path, progress=stop)
    again = si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=1, store=tmp_path)
    np.testing.assert_array_equal(again.sampling.history, result.sampling.history)
    np.testing.assert_array_equal(again.runs.design.values, result.runs.design.values)


def test_without_a_store_nothing_is_run_twice(space, model, measured):
    """An external model that counts its calls."""
    calls = []

    def respond(parameters, record):
        calls.append(1)
        theta = np.array([[parameters["stiffness"], parameters["gamma_ratio"]]])
        return model.simulate(theta, record).values[0, :, 0]

    external = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    result = si.calibrate(external, space, measured, plan=PLAN, sampler=SAMPLER, seed=1)
    # Once more at the best run of the first design, and at the first draw of the certificate: is it a function?
    assert len(calls) == len(result.runs) + 2 == result.certificate.true_runs
    assert result.certificate.certified


def test_runs_that_fail_in_the_first_design_are_made_up_for(space, model, measured):
    """A solver that stops for a third of the prior: ten runs must finish before there is a surrogate."""

    def respond(parameters, record):
        if parameters["gamma_ratio"] < -0.3:
            raise RuntimeError("no equilibrium")
        theta = np.array([[parameters["stiffness"], parameters["gamma_ratio"]]])
        return model.simulate(theta, record).values[0, :, 0]

    external = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    result = si.calibrate(external, space, measured, plan=PLAN, sampler=SAMPLER, seed=1)
    assert result.certificate.certified and result.rounds[0].training > 10, str(result)
    assert 10 <= result.runs[np.arange(result.rounds[0].training)].done.sum() <= 12


@pytest.mark.slow
def test_two_records_of_two_lengths_with_correlated_errors(space, model):
    """The right model and law: certified, every point run on both records, the truth within four sds."""
    truth, law = np.array([[7.2e6, 0.4]]), si.AR1(white=0.0)
    observations = []
    for seed, end in ((3, 5.5), (4, 5.0)):
        record = si.GroundMotion.synthetic(seed=seed).lowpass(20.0).trim(3.0, end).scale_to_pga(2.0)
        y = model.simulate(truth, record).values[0]
        noise = si.AR1(variance=float((0.05 * y.std()) ** 2), white=0.0, correlation_time=0.05)
        error = noise.draw(np.random.default_rng(seed), (1, len(y), 1), {}, ("velocity",), record.dt)[0]
        observations.append(si.Observation(record, y + error))
    result = si.calibrate(model, space, observations, si.PODPCE(), law, plan=SMALL_BUDGET, sampler=SAMPLER, seed=1)
    assert result.certificate.certified, str(result)
    assert len(result.runs) == 2 * result.certificate.true_runs
    assert (np.abs(result.mean[:2] - truth[0]) < 4.0 * result.sd[:2]).all(), str(result)
    for name in ("correlation_time_1", "correlation_time_2"):
        k = result.names.index(name)
        assert abs(result.mean[k] - 0.05) < 4.0 * result.sd[k]


# --- what a certificate asks of the draws, and of those who ask for it ---------------------------------------------------


@pytest.mark.slow
def test_draws_that_have_not_converged_are_not_certified(space, model, measured):
    """The surrogate is right, and 80 particles are too few however long they move."""
    few = replace(EXPLORER, particles=20, steps=1)
    result = si.calibrate(model, space, measured, plan=SMALL_BUDGET, sampler=few, seed=1)
    certificate = result.certificate
    assert not certificate.certified and not result.trusted and certificate.only_the_draws, str(result)
    assert certificate.variation.bound < 0.1 and "effective sample size" in str(certificate)
    assert "surrogate and model agree" in str(result.rounds[-1])


def test_relaxed_limits_are_a_further_look(calibrated, space, model, measured, tmp_path):
    assert [earlier_limits(tmp_path, limits) for limits in (Limits(), Limits(mean=0.2), Limits())] == [0, 1, 0]
    assert earlier_limits(None, Limits(mean=0.2)) == 0
    result, store = calibrated
    relaxed = replace(PLAN, limits=Limits(mean=0.2))
    again = si.calibrate(model, space, measured, plan=relaxed, sampler=SAMPLER, seed=1, store=store)
    assert again.certificate.look == result.certificate.look + 1
    assert again.certificate.variation.bound > result.certificate.variation.bound
    same = si.calibrate(model, space, measured, plan=PLAN, sampler=SAMPLER, seed=1, store=store)
    assert same.certificate.look == result.certificate.look


def test_how_many_runs_a_first_design_and_a_round_have(space, model, measured):
    posterior = si.Posterior(space, model, measured)
    assert si.Plan().sized(posterior, si.PODKriging()).sizes == (10, 10)
    assert si.Plan(start=20, batch=7).sized(posterior, si.PODKriging()).sizes == (20, 7)
    # As many as a chaos expansion of degree 5 in two parameters asks for: 21 terms.
    start, _ = si.Plan().sized(posterior, si.PCNARX(degree=5)).sizes
    assert start > 42
    names = ("stiffness", "gamma_ratio", "alpha", "beta", "delta_nu", "delta_eta", "damping_ratio")
    seven = si.ParameterSpace(**{name: si.Uniform(0.1, 0.5) for name in names})
    wide = si.Posterior(seven, si.BoucWen(mass=12_000.0, free=names), measured)
    assert si.Plan().sized(wide, si.PODKriging()).sizes == (16, 22)
    with pytest.raises(InputError, match="46 or more: 16 for the first design"):
        si.Plan(true_runs=45).sized(
            si.Posterior(seven, si.BoucWen(mass=12_000.0, free=names), measured), si.PODKriging()
        )


# --- surrogates that must be refused --------------------------------------------------------------------------------


SMOOTH = {"too smooth": 3.0, "a little too smooth": 0.5}
"""Nuggets that keep a Kriging from its runs."""


@dataclass(frozen=True)
class Bad:
    """Settings of a surrogate that is wrong on purpose."""

    how: str

    warm_start: ClassVar[bool] = False
    weighted: ClassVar[bool] = False

    def check(self, design, records, channels):
        """Take anything."""

    def fit(self, runs, progress=None):
        """Fit as it should not be done."""
        good = si.PODKriging()
        if self.how == "biased":
            from structid.campaign.runs import StoredInMemory

            return good.fit(replace(runs, stored=StoredInMemory(1.02 * runs.values)))
        if self.how in SMOOTH:
            smooth = si.Kriging(correlation="gaussian", nugget=SMOOTH[self.how], trend="constant")
            return si.PODKriging(kriging=smooth).fit(runs)
        half = runs.design.values[:, 1] < 0.0
        return good.fit(runs[half])


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "how", ["too smooth", pytest.param("biased", marks=SLOW), pytest.param("half the prior", marks=SLOW)]
)
def test_bad_surrogates_are_refused(how, space, model, measured):
    plan = HALF_BUDGET if how == "half the prior" else SMALL_BUDGET
    result = si.calibrate(model, space, measured, surrogate=Bad(how), plan=plan, sampler=SAMPLER, seed=1)
    assert result.certificate.verdict == "not to be trusted", str(result)
    assert result.certificate.reasons and "NOT TO BE TRUSTED" in str(result) and not result.reweighted


@SLOW
def test_a_surrogate_that_weights_can_mend(space, model, measured, reference):
    """Not certified; what is reported is re-weighted, and then it is the model's own posterior."""
    bad = Bad("a little too smooth")
    many = si.Plan(true_runs=400, start=30, batch=20, certificate=150, exploration_sampler=EXPLORER)
    result = si.calibrate(model, space, measured, surrogate=bad, plan=many, sampler=SAMPLER, seed=1)
    assert result.certificate.verdict == "usable with re-weighting" and result.reweighted, str(result)
    sizes = [drawn.summary().columns["ess_bulk"] for drawn in (reference, result.sampling)]
    off, plain = (np.abs(found.mean - reference.mean) / reference.sd for found in (result, result.sampling))
    effective = len(result.certificate.draws) / (1.0 + result.certificate.variation.estimate**2)
    assert (off < 4.0 * np.sqrt(1.0 / effective + 1.0 / sizes[0])).all()
    # gamma_ratio, which the weights move most: without them it fails such a test of the many draws.
    assert off[1] < plain[1] and plain[1] > 4.0 * np.sqrt(1.0 / sizes[1][1] + 1.0 / sizes[0][1])


@SLOW
def test_a_mode_that_the_surrogate_has_lost(measured):
    """Displacement by a², so that a and −a are alike: a surrogate of the positive half finds one mode, and is refused."""
    record = measured.record

    def respond(parameters, excitation):
        return parameters["a"] ** 2 * excitation.values + parameters["b"] * np.cos(excitation.time)

    space = si.ParameterSpace(a=si.Uniform(-1.5, 1.5), b=si.Uniform(-1.0, 1.0))
    model = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    rng = np.random.default_rng(2)
    y = respond({"a": 1.0, "b": 0.2}, record) + 0.3 * rng.normal(size=len(record))

    class Half(Bad):
        def fit(self, runs, progress=None):
            """Fit to the positive half."""
            return si.PODKriging(outside="allow").fit(runs[runs.design.values[:, 0] > 0.0])

    observation = si.Observation(record, y)
    refused = si.calibrate(model, space, observation, surrogate=Half("half"), plan=HALF_BUDGET, sampler=SAMPLER, seed=3)
    assert not refused.certificate.usable, str(refused)
    whole = si.calibrate(model, space, observation, plan=PLAN, sampler=SAMPLER, seed=3)
    assert whole.certificate.certified, str(whole)
    assert 0.35 < (whole.sampling.flat[:, 0] > 0).mean() < 0.65


def test_particles_that_never_moved_are_one_point(space, model, measured):
    posterior = si.Posterior(space, model, measured)
    phi = posterior.bijection.inverse(posterior.space.sample(4, seed=1).values)
    twice = {"phi": np.repeat(phi, 5, axis=0)[None, None]}
    chosen = Exploration(posterior, None, [twice]).distinct(0, 10, np.random.default_rng(1))
    assert len(chosen) == len(np.unique(chosen, axis=0)) == 4


def test_a_surrogate_that_is_sure_of_nothing_yet_is_taught_on_the_way(space, model, measured):
    """Whatever the exponent, its own error is larger than it can tell posteriors apart: half of the points are the prior's."""
    posterior = si.Posterior(space, model, measured)
    phi = posterior.bijection.inverse(posterior.space.sample(60, seed=1).values)
    density = np.zeros((1, 1, len(phi)))
    blocks = [{"phi": phi[None, None], "exponent": np.array([e]), "log_density": density} for e in (0.0, 1e-4, 1.0)]

    class Unsure(Exploration):
        def variance(self, block=-1):
            """Infinite, as where responses have no density."""
            return np.inf

    explored = Unsure(posterior, None, blocks)
    assert not explored.sure and explored.nearest(0.0) == 0
    batch = next_batch(explored, posterior.model_space.sample(5, seed=2).values, 10, np.random.default_rng(1))
    assert len(batch.fresh) == 0 and 5 <= len(batch.others) <= 10


def test_a_mode_that_a_surrogate_has_made_up(calibrated, space, model, measured):
    """Draws at which it does not know its own density are no draws for a certificate; runs go there first."""
    result, _ = calibrated
    posterior = result.posterior.on(result.surrogate)
    phi = posterior.bijection.inverse(result.sampling.thinned(100))
    density = posterior.log_density(result.sampling.thinned(100))[None, None]
    blocks = [{"phi": phi[None, None], "exponent": np.array([e]), "log_density": density} for e in (0.0, 1.0)]
    explored = Exploration(posterior, result.surrogate, blocks)
    assert explored.sure and len(made_up_of(posterior, result.surrogate, result.sampling)) == 0
    elsewhere = result.sampling.history.copy()
    elsewhere[..., :2] = space.sample(elsewhere[..., 0].size, seed=3).values.reshape(*elsewhere.shape[:-1], 2)
    made_up = made_up_of(posterior, result.surrogate, replace(result.sampling, history=elsewhere))
    assert len(made_up) > 10 and np.median(explored.variance_at(made_up)) > 1.0
    known = result.runs.design.values
    chosen = next_batch(explored, known, 10, np.random.default_rng(1), made_up).others
    assert (chosen[: batch.MOST_SCOUTS, None] == made_up[:, :2]).all(axis=2).any(axis=1).all()


# --- pieces ---------------------------------------------------------------------------------------------------------


@pytest.mark.quick
def test_points_far_apart():
    candidates = np.array([[0.0], [0.1], [1.0], [0.5]])
    np.testing.assert_array_equal(far_apart(candidates, np.array([[0.0]]), 2), [2, 3])
    # A weight outweighs distance.
    np.testing.assert_array_equal(far_apart(candidates, np.array([[0.0]]), 1, np.array([1.0, 100.0, 1.0, 1.0])), [1])


def test_where_the_posterior_reaches_beyond_the_runs():
    """A run in each such direction, and none where the runs reach further already."""
    known = np.array([[0.0, 0.0], [1.0, 1.0]])
    particles = np.array([[-0.1, 0.2], [0.5, 1.2]])  # beyond them to the left, and upwards
    candidates = np.array([[0.5, 1.5], [-0.3, 0.4], [1.8, 0.5], [0.6, -0.9]])
    assert beyond_the_runs(candidates, particles, known).tolist() == [0, 1]
    assert beyond_the_runs(candidates, 0.5 * particles + 0.1, known).size == 0
    corner = np.array([[-0.3, 1.5], [0.2, 0.2]])
    assert beyond_the_runs(corner, particles, known).tolist() == [0]  # one run for both


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(true_runs=38), "40 or more: 10 for the first design and 30 for a certificate"),
        (dict(start=3), "start.*10 or more"),
        (dict(certificate=600), "exploration_sampler|true_runs"),
    ],
)
def test_plans_that_make_no_sense(settings, words):
    with pytest.raises(InputError, match=words):
        si.Plan(**settings)


@pytest.mark.parametrize("steepness", [0.1, 30.0, 1e5])
def test_half_of_the_runs_count_however_steep_the_posterior_is(steepness):
    log_density = -steepness * np.random.default_rng(1).gamma(2.0, size=300)
    weights = nearness(np.append(log_density, -np.inf))
    assert weights[:-1].max() == 1.0 and weights[-1] == LEAST
    assert (np.diff(weights[:-1][np.argsort(log_density)]) >= 0).all()
    effective = weights.sum() ** 2 / np.sum(weights**2)
    if steepness > 1.0:
        assert effective == pytest.approx(FITTED_SHARE * len(weights), rel=1e-6)
    else:  # draws of the posterior: it is not sharpened
        assert effective > 0.9 * len(weights)


def test_where_every_run_failed_none_is_preferred():
    np.testing.assert_array_equal(nearness(np.full(9, -np.inf)), 1.0)


@dataclass(frozen=True)
class Weighed(si.PCNARX):
    """Remembers how much its runs counted."""

    seen: list = field(default_factory=list, repr=False, compare=False)

    def fit(self, runs, progress=None, weights=None):
        self.seen.append((runs.design.values, weights))
        return super().fit(runs, progress, weights)


@SLOW
def test_a_narx_is_fitted_to_the_runs_near_the_posterior(space, model, measured, reference):
    settings = Weighed(degree=1, steps=0)
    found = si.calibrate(model, space, [measured], settings, plan=PLAN, sampler=EXPLORER, seed=1)
    # Once in each round, whatever the number of forms to choose among.
    assert settings.seen[0][1] is None and len(settings.seen) == len(found.rounds) > 1
    assert found.certificate.certified
    truth = si.Posterior(space, model, measured)
    for points, weights in settings.seen[1:]:
        theta = np.column_stack([points, np.full(len(points), reference.mean[-1])])
        order = np.argsort(truth.log_density(theta))
        assert weights[order[-5:]].min() > 10.0 * weights[order[:5]].max()
        assert weights.sum() ** 2 / np.sum(weights**2) == pytest.approx(0.5 * len(weights), rel=1e-6)


# --- what lies beyond all runs -----------------------------------------------------------------------------------------


def mean_of_two_modes():
    """Of a with a² + 0.2 a = 1.2 ± 0.15, a ~ N(0.5, 1): the other parameters are independent of it."""
    a = np.linspace(-3.0, 3.0, 20_001)
    density = np.exp(-0.5 * (a - 0.5) ** 2 - 0.5 * ((a**2 + 0.2 * a - 1.2) / 0.15) ** 2)
    return density @ a / density.sum()


@pytest.mark.parametrize("scouts", [0, 2])
def test_a_mode_beyond_the_range_of_the_first_design(monkeypatch, scouts):
    """The first design of this seed ends at a = −0.79, and the second mode lies at −1.2: without scouts nobody goes there.

    Nor does the posterior of a surrogate that responds beyond as at the edge.
    """
    case = two_modes()
    monkeypatch.setattr(batch, "MOST_SCOUTS", scouts)
    as_at_the_edge = si.PODKriging(reach=0.0)
    result = si.calibrate(case.model, case.space, case.observation, as_at_the_edge, case.law, seed=4)
    right = abs(result.sampling.mean[0] - mean_of_two_modes()) < 0.1 * result.sampling.sd[0]
    assert result.certificate.certified and right == (scouts > 0)


def test_another_record_is_predicted_by_the_model_itself(calibrated, model):
    result, _ = calibrated
    other = result.posterior.observations[0].record.scale(0.5)
    with pytest.raises(InputError, match="not fitted to"):
        result.sampling.predict(other, draws=5)
    found = result.predict(other, draws=5)
    expected = model.simulate(result.sampling.thinned(5)[:, :2], other).values
    np.testing.assert_allclose(found.response, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert result.predict(draws=5).excitation == result.posterior.observations[0].record.name


def test_the_earlier_name_of_the_exploration_sampler_gives_a_warning():
    with pytest.warns(DeprecationWarning, match=r"Plan\(explorer=…\) is now called Plan\(exploration_sampler=…\)"):
        plan = si.Plan(explorer=EXPLORER)
    with pytest.warns(DeprecationWarning, match=r"Plan\.explorer is now called Plan\.exploration_sampler"):
        assert plan.explorer is plan.exploration_sampler
