"""Draws that somebody else made, against the model: the right ones pass, wrong ones do not, bad input is told."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

import structid as si
from structid.core.errors import InputError

NAMES = ("a", "b", "c")
TRUTH, SDS = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.5, 0.2])
BOX = {name: (-10.0, 10.0) for name in NAMES}


def normal(mean=TRUTH, sd=SDS):
    return lambda theta: scipy.stats.norm.logpdf(theta, mean, sd).sum(axis=1)


def posterior():
    return si.LogDensity(normal(), NAMES, si.ParameterSpace(**{n: si.Uniform(*BOX[n]) for n in NAMES}), BOX)


def draws(mean=TRUTH, sd=SDS, count=4000, seed=1):
    return np.random.default_rng(seed).normal(mean, sd, (count, 3))


# --- what is right passes, in every form in which it may come ---------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_draws_with_their_density(seed):
    found = si.certify(posterior(), draws(seed=seed), lambda x: normal()(x) + 5.0, seed=seed)
    assert found.certified and found.variation.bound < 1e-6, str(found)
    assert found.true_runs == 31 + found.searched <= 31 + 2 * 5


def test_draws_with_the_values_of_their_density():
    some = draws()
    found = si.certify(posterior(), some, normal()(some))
    assert found.certified and len(found.draws) == 30


def test_draws_alone():
    """20 000 determine a density of some dozens of parameters to 5 %; what is certified is told."""
    found = si.certify(posterior(), draws(count=20_000, seed=1), seed=1)
    assert found.certified, str(found)
    assert str(found).startswith(
        f"CERTIFIED for a density that was fitted to the draws ({61 + found.searched} model runs"
    )


def forms(some):
    xarray = pytest.importorskip("xarray")
    chains = some.reshape(4, -1, 3)
    columns = dict(zip(NAMES, np.moveaxis(chains, -1, 0), strict=True))
    dataset = xarray.Dataset({n: (("chain", "draw"), v) for n, v in columns.items()})
    millis = xarray.Dataset(
        {
            n: (("chain", "draw"), 1e3 * v if n == "a" else v, {"unit": "mm"} if n == "a" else {})
            for n, v in columns.items()
        }
    )
    return {"chains": chains, "mapping": columns, "Dataset": dataset, "in millimetres": millis}


@pytest.mark.parametrize("form", ["chains", "mapping", "Dataset", "in millimetres"])
def test_forms_of_draws(form):
    some = draws()
    plain = si.certify(posterior(), some.reshape(4, -1, 3), normal())
    found = si.certify(posterior(), forms(some)[form], normal())
    np.testing.assert_allclose(found.draws, plain.draws, rtol=1e-5)  # a density was fitted to rounded numbers
    assert found.certified


def test_files(tmp_path):
    pytest.importorskip("xarray")
    some = draws()
    np.savetxt(tmp_path / "draws.csv", some, delimiter=",", header="a,b,c", comments="")
    assert si.certify(posterior(), tmp_path / "draws.csv", normal()).certified
    result = si.sample(posterior(), si.SMC(particles=200, steps=30, effective_share=0.5, correlation=0.3), seed=1)
    path = result.to_netcdf(tmp_path / "draws.nc", predictions=False)
    assert si.certify(posterior(), path, normal()).certified
    assert si.certify(posterior(), result).certified  # its own target is the density


# --- what is wrong does not -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mean", "sd"),
    [(TRUTH + 0.25 * SDS * [1, 0, 0], SDS), (TRUTH, SDS * [1, 0.8, 1]), (TRUTH, SDS * [1, 1, 1.2])],
    ids=["mean off by 0.25 sd", "sd 0.8", "sd 1.2"],
)
@pytest.mark.parametrize("told", ["function", "values", "nothing"])
def test_wrong_posteriors_are_refused(mean, sd, told):
    """A sample of each; `benchmarks/draws_by_values.py` counts over a hundred."""
    some = draws(mean, sd)
    density = {"function": normal(mean, sd), "values": normal(mean, sd)(some), "nothing": None}[told]
    found = si.certify(posterior(), some, density)
    assert not found.certified, str(found)


def test_draws_of_another_law_than_the_right_density():
    """The density is the true one, and the draws are not its draws: weights alone would let them pass."""
    found = si.certify(posterior(), draws(TRUTH + 0.46 * SDS * [0, 0, 1]), normal())
    assert not found.certified and found.only_the_draws
    assert "these are not draws of the given density" in str(found) and "mean of c" in str(found)


PARTS = {
    "half": lambda z: z[:, 0] > 0.0,
    "within one standard deviation": lambda z: np.abs(z[:, 0]) < 1.0,
    "without a tenth": lambda z: z[:, 0] > -1.28,
}


@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_the_posterior_with_its_right_values(part):
    """At the draws themselves all is right. Stein's identity says by the slopes there that they end where the density does not."""
    some = draws(count=6000)
    some = some[PARTS[part]((some - TRUTH) / SDS)]
    found = si.certify(posterior(), some, normal()(some))
    assert not found.certified and found.variation.bound < 1e-6
    assert any("Stein's identity" in doubt and " of a is" in doubt for doubt in found.doubts), str(found)


def test_one_of_two_exchangeable_modes_is_missed():
    """The gradient is right at all draws. A run with both parameters exchanged finds the other mode."""

    def either(theta):
        one, other = (-0.5 * ((a - 1.0) / 0.2) ** 2 - 0.5 * ((b + 1.0) / 0.3) ** 2 for a, b in (theta.T, theta.T[::-1]))
        return np.logaddexp(one, other)

    box = dict.fromkeys(("a", "b"), (-10.0, 10.0))
    target = si.LogDensity(either, ("a", "b"), si.ParameterSpace(**{n: si.Uniform(*box[n]) for n in box}), box)
    some = np.random.default_rng(1).normal([1.0, -1.0], [0.2, 0.3], (4000, 2))
    found = si.certify(target, some, either(some))
    assert not found.certified and any("misses a part" in reason for reason in found.reasons)


def test_values_that_cannot_tell():
    """On a narrow bent ridge slopes are too steep to average to nothing: then half of it would pass, and nothing is certified."""
    bounds = {"a": (-10.0, 10.0), "b": (-30.0, 60.0)}
    target = si.LogDensity(
        ridge, ("a", "b"), si.ParameterSpace(**{k: si.Uniform(*v) for k, v in bounds.items()}), bounds
    )
    some = on_the_ridge(count=2000)
    found = si.certify(target, some, ridge(some))
    assert not found.certified and "cannot decide" in str(found) and found.only_the_draws


def chains(tau, count, steps, seed):
    """Of the normal density itself, with the autocorrelation time τ: first-order autoregressive, begun long before."""
    rho, rng = (tau - 1.0) / (tau + 1.0), np.random.default_rng(seed)
    noise = np.sqrt(1.0 - rho**2) * rng.standard_normal((count, steps + 20 * tau, 3))
    return TRUTH + SDS * scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=1)[:, 20 * tau :]


@pytest.mark.slow
@pytest.mark.parametrize("told", ["function", "values"])
def test_chains_of_the_right_law_that_are_too_short(told):
    """Walkers of two autocorrelation times: their law is the posterior itself, and averages over them are far from its own."""
    short, enough = (chains(50, 32, steps, seed=1) for steps in (100, 1600))
    densities = [normal() if told == "function" else normal()(x.reshape(-1, 3)) for x in (short, enough)]
    refused, found = (si.certify(posterior(), x, q) for x, q in zip((short, enough), densities, strict=True))
    assert not refused.certified and refused.variation.bound < 1e-6 and "there are too few draws" in str(refused)
    assert found.certified, str(found)
    assert 0.02 < found.monte_carlo.mean.max() < 0.1 and f"{found.monte_carlo.size:.0f} independent" in found.statement
    # The statement is about the draws: what it says holds of their averages, and not of their law alone.
    assert np.all(np.abs((found.monte_carlo.mean + found.mean_bound) - found.mean_within) < 1e-12)
    assert np.all(np.abs(enough.mean(axis=(0, 1)) - TRUTH) / SDS <= found.mean_within)


def test_walkers_that_take_turns_are_no_independent_draws():
    """What emcee gives with `flat=True`: step by step, every walker of the ensemble."""
    some = chains(50, 32, 100, seed=1)
    apart, flat = (si.certify(posterior(), x, normal()) for x in (some, some.swapaxes(0, 1).reshape(-1, 3)))
    assert flat.monte_carlo.size == pytest.approx(apart.monte_carlo.size, rel=1e-12) and not flat.certified


@pytest.mark.parametrize("told", ["values", "nothing"])
def test_without_a_function_the_search_begins_anywhere(told):
    """Runs close to one another make a Kriging sure of everything. A wide second mode is found by runs of the prior."""

    def two(x):
        return np.logaddexp(normal()(x), normal(TRUTH - 4.0, 2.5 * np.ones(3))(x) + 3.0)

    target = si.LogDensity(two, NAMES, si.ParameterSpace(**{n: si.Uniform(*BOX[n]) for n in NAMES}), BOX)
    some = draws(sd=0.1 * SDS, count=20_000)
    found = si.certify(target, some, {"values": normal(sd=0.1 * SDS)(some), "nothing": None}[told])
    assert found.searched >= 3 and not found.certified
    assert "no second sampler has searched" in str(found)


def test_a_known_point_above_the_draws():
    """A mode that no draw visits, and somebody has been there."""

    def two(x):
        return np.logaddexp(normal()(x), normal(TRUTH + 5.0, 0.1 * SDS)(x))

    target = si.LogDensity(two, NAMES, si.ParameterSpace(**{n: si.Uniform(*BOX[n]) for n in NAMES}), BOX)
    there = (TRUTH + 5.0)[None]
    unseen = si.certify(target, draws(), normal())
    assert unseen.certified and "a mode that no model run of any round has reached" in str(unseen)
    found = si.certify(target, draws(), normal(), known=(there, two(there)))
    assert found.verdict == "not to be trusted" and "nats above every draw" in str(found)


def test_a_law_that_was_cut_off():
    """Where q has no density, none of its draws comes; draws of the wider density do, and the model finds something there."""
    some = draws()
    some = some[some[:, 0] > TRUTH[0]]

    def cut(x):
        return np.where(x[:, 0] > TRUTH[0], normal()(x), -np.inf)

    found = si.certify(posterior(), some, cut)
    assert not found.certified and "ends where the posterior is still high" in str(found), str(found)
    assert not found.only_the_draws  # the model has been asked, and contradicts


def within(depth, density):
    """The same density, and none where it is so far below that of the truth."""
    return lambda x: np.where(np.sum(((x - TRUTH) / SDS) ** 2, axis=1) < 2.0 * depth, density(x), -np.inf)


@pytest.mark.parametrize(("depth", "good"), [(4.0, False), (7.0, True), (9.5, True)])
def test_what_a_density_excludes_all_around_is_in_the_bounds(depth, good):
    """Of a normal density, exactly P(χ²₃ > 2h) is missing, and its variance is P(χ²₅ < 2h)/P(χ²₃ < 2h) of what it was."""
    some = draws(count=20_000)
    some = some[np.isfinite(within(depth, normal())(some))]
    edge = TRUTH + SDS * np.sqrt(2.0 * depth + 0.1) * np.eye(3)
    found = si.certify(posterior(), some, within(depth, normal()), known=(edge, normal()(edge)))
    assert found.certified == good, str(found)
    assert found.missing == pytest.approx(scipy.stats.chi2.sf(2.0 * depth, 3), rel=0.2)
    variance = scipy.stats.chi2.cdf(2.0 * depth, 5) / scipy.stats.chi2.cdf(2.0 * depth, 3)
    assert (found.sd_bound >= 1.0 - np.sqrt(variance)).all()
    assert not good or "may lie where the given density is zero" in str(found)


def test_a_mode_that_a_density_excludes():
    """It is too low to be missed as the end of the draws, but a valley lies between: it holds a fifth of the probability."""
    low, wide = TRUTH + 6.0, 5.0 * SDS

    def two(x):
        return np.logaddexp(normal()(x), normal(low, wide)(x) - 1.4)

    target = si.LogDensity(two, NAMES, si.ParameterSpace(**{n: si.Uniform(*BOX[n]) for n in NAMES}), BOX)
    found = si.certify(target, draws(), within(30.0, normal()), known=(low[None], two(low[None])))
    assert not found.certified and "a valley of the posterior separates the draws" in str(found), str(found)
    # Of a density that is nowhere zero the same run is simply one that it understates.
    assert "the drawn density misses a part" in str(
        si.certify(target, draws(), normal(), known=(low[None], two(low[None])))
    )


def ridge(x):
    """Rosenbrock's: a ~ N(1, 0.7²), and b = a² to 0.07."""
    return -((1.0 - x[:, 0]) ** 2) - 100.0 * (x[:, 1] - x[:, 0] ** 2) ** 2


def on_the_ridge(count=8000, seed=1):
    rng = np.random.default_rng(seed)
    a = rng.normal(1.0, np.sqrt(0.5), count)
    return np.column_stack([a, rng.normal(a**2, np.sqrt(0.005))])


@pytest.mark.parametrize(("end", "good"), [(1.4, False), (3.2, True), (np.inf, True)])
def test_a_bent_ridge_whose_end_is_missing(end, good):
    """A wider density that is not bent, too, would look for the rest beside the ridge; without its 0.1 % beyond 3.2 it passes."""
    bounds = {"a": (-10.0, 10.0), "b": (-30.0, 60.0)}
    space = si.ParameterSpace(**{name: si.Uniform(*pair) for name, pair in bounds.items()})
    some = on_the_ridge()
    some = some[some[:, 0] < end]

    def ended(x):
        return np.where(x[:, 0] < end, ridge(x), -np.inf)

    limits = si.Limits(mean=0.25, sd=0.25, correlation=0.5)
    found = si.certify(si.LogDensity(ridge, ("a", "b"), space, bounds), some, ended, limits=limits, seed=1)
    assert found.certified == good, str(found)


def test_a_law_whose_density_falls_too_fast():
    """Exponents that no computer has: what is left of q where the wider density goes is zero, and the model is not there either."""
    narrow = draws(sd=0.02 * SDS)
    found = si.certify(posterior(), narrow, normal(sd=0.02 * SDS))
    assert not found.certified and not np.isnan(found.variation.estimate)


def test_looks_are_counted():
    bounds = [si.certify(posterior(), draws(), normal(TRUTH + 0.02 * SDS), look=k).variation.bound for k in (1, 2)]
    assert bounds[1] > bounds[0]


# --- the user's own model ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
    oscillator = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=("stiffness", "gamma_ratio"))
    y = oscillator.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    return oscillator, si.Observation(record, y + 0.05 * y.std() * np.random.default_rng(1).normal(size=y.shape))


@pytest.fixture(scope="module")
def space():
    return si.ParameterSpace(
        stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )


@pytest.fixture(scope="module")
def sampled(measured, space):
    oscillator, observation = measured
    return si.sample(si.Posterior(space, oscillator, observation), si.SMC(particles=200, steps=30), seed=2)


def external(oscillator, noise=0.0, still=False):
    rng, calls = np.random.default_rng(0), []

    def respond(parameters, record):
        calls.append(1)
        theta = np.array([[parameters["stiffness"], parameters["gamma_ratio"]]])
        y = oscillator.simulate(theta, record).values[0, :, 0]
        return np.full_like(y, 0.1) if still else y + noise * rng.standard_normal(y.shape)

    model = si.CallableModel(respond, free=("stiffness", "gamma_ratio"), channels=("velocity",), isolated=False)
    return model, calls


def test_an_external_solver_is_run_once_a_point_and_resumed(measured, space, sampled, tmp_path):
    oscillator, observation = measured
    model, calls = external(oscillator)
    target = si.Posterior(space, model, observation)
    found = si.certify(target, sampled, store=tmp_path)
    assert found.certified and len(calls) == found.true_runs == 31 + found.searched, str(found)
    again = si.certify(target, sampled, store=tmp_path)
    assert again.variation == found.variation and len(calls) == found.true_runs


def test_a_solver_with_noise_is_noticed(measured, space, sampled):
    oscillator, observation = measured
    model, _ = external(oscillator, noise=0.01)
    found = si.certify(si.Posterior(space, model, observation), sampled)
    assert not found.certified and "the model is not deterministic" in str(found)


def test_a_solver_that_does_not_move(measured, space, sampled):
    oscillator, observation = measured
    model, _ = external(oscillator, still=True)
    with pytest.raises(InputError, match="constant in time, in all 30 runs"):
        si.certify(si.Posterior(space, model, observation), sampled)
    with pytest.raises(InputError, match="constant in time, in all 10 runs"):
        si.calibrate(model, space, observation)


@pytest.mark.slow
def test_a_calibration_notices_a_solver_with_noise(measured, space, tmp_path):
    """Too little to be seen in the first design or in the weights, and enough to be no function; all runs are counted and kept."""
    oscillator, observation = measured
    explorer = si.SMC(particles=80, ensembles=4, steps=8, effective_share=0.5, correlation=0.5)
    plan = si.Plan(true_runs=110, exploration_sampler=explorer)
    for noise, certified in ((0.0, True), (1e-6, False)):
        model, calls = external(oscillator, noise=noise)
        found = si.calibrate(model, space, observation, plan=plan, seed=1, store=tmp_path / str(certified))
        assert found.certificate.certified == certified, str(found)
        assert ("the model is not deterministic" in str(found)) != certified
        assert len(calls) == found.certificate.true_runs <= 110
        again = si.calibrate(model, space, observation, plan=plan, seed=1, store=tmp_path / str(certified))
        assert len(calls) == found.certificate.true_runs and again.certificate.doubts == found.certificate.doubts


# --- bad input ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "density", "words"),
    [
        ({"a": draws()[:, 0], "b": draws()[:, 1], "d": draws()[:, 2]}, None, "draws of a, b, d.*Add draws of c"),
        (draws()[:, :2], None, r"shape \(4000, 2\).*a column in SI for each of a, b, c"),
        (draws()[:50], None, "50 draws.*100 or more for 3 parameters"),
        (1e3 * draws(), None, "outside the support of the priors.*Check that they are in SI"),
        (draws() * [1.0, np.nan, 1.0], None, "4000 values that are not finite"),
        (draws() * [1.0, 0.0, 1.0], None, "draws with a constant b"),
        (draws(), lambda x: -0.5 * (x[:, 0] - 4.0) ** 2, "does not match the draws"),
        (draws(), normal()(draws())[::-1], "does not match the draws"),
        (draws(), normal()(draws())[:30], r"shape \(30,\).*each of 4000 draws"),
        (draws(), lambda x: x, r"an array of shape \(4000, 3\).*a log density for each point"),
        (draws(), lambda x: np.where(x[:, 0] > TRUTH[0], normal()(x), -np.inf), "not finite at .* of 4000 draws"),
        ("nowhere.nc", None, "no file nowhere.nc"),
    ],
)
def test_what_bad_input_gets(given, density, words):
    with pytest.raises(InputError, match=words):
        si.certify(posterior(), given, density)


def test_too_few_true_runs():
    with pytest.raises(InputError, match="15 or more, 30 or more recommended"):
        si.certify(posterior(), draws(), normal(), true_runs=5)


@pytest.mark.parametrize(("walkers", "steps"), [(16, 1600), (200, 100)])
def test_steps_before_walkers_are_refused(walkers, steps):
    """As emcee keeps them: slopes would take the walkers' order for that of time. More chains than draws are none for that."""
    chain = chains(5, walkers, steps, seed=1)
    assert si.certify(posterior(), chain, normal()(chain.reshape(-1, 3)).reshape(walkers, steps)).certified
    with pytest.raises(InputError, match=rf"{steps} chains of {walkers} draws.*swapaxes\(0, 1\)"):
        si.certify(posterior(), chain.swapaxes(0, 1), normal())


@pytest.mark.parametrize("told", ["function", "values", "nothing"])
def test_draws_in_another_unit_are_asked_for(told):
    """Priors without bounds have draws of any size in their support; runs of the model alone would speak of thousands of nats."""
    space = si.ParameterSpace(**{n: si.Normal(m, 10.0 * s) for n, m, s in zip(NAMES, 1e3 * TRUTH, SDS, strict=True)})
    target = si.LogDensity(normal(1e3 * TRUTH), NAMES, space)
    some = draws(count=6000)
    density = {"function": normal(), "values": normal()(some), "nothing": None}[told]
    found = si.certify(target, some, density)
    assert not found.certified and "standard deviations from the prior median" in found.reasons[0], str(found)
    assert "check that they are in SI" in str(found) and "of b" in found.reasons[0]
    right = si.certify(target, some + 999.0 * TRUTH, normal(1e3 * TRUTH))
    assert right.certified, str(right)


def test_errors_far_smaller_than_their_prior_are_no_wrong_unit(measured, space):
    """Noise of 0.01 % of the peak: its variance is nine standard deviations from the middle of the prior, by logits."""
    model, observation = measured
    clean = model.simulate(np.array([[7.2e6, 0.4]]), observation.record).values[0, :, 0]
    noise = 1e-4 * np.abs(clean).max() * np.random.default_rng(1).normal(size=clean.shape)
    posterior = si.Posterior(space, model, si.Observation(observation.record, clean + noise))
    result = si.sample(posterior, si.SMC(particles=400, steps=40), seed=1)
    found = si.certify(posterior, result, seed=1)
    assert found.certified, str(found)
