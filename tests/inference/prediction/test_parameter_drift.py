"""Parameters that drift are found where they do, and only there; what is found is what predictions of other records need."""

import numpy as np
import pytest
import scipy

import structid as si
from structid.inference.prediction.error_growth import error_growth, running_power
from structid.inference.prediction.parameter_drift import _gain, _projections, parameter_drift
from structid.models.drifting_model import DriftingModel

SPACE = si.ParameterSpace(
    stiffness=si.Normal(0.474, 0.06, low=0.2, high=0.8, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
LAW = dict(mass=12_000.0, damping_ratio=0.03, beta=25.0, alpha=0.1)
MODEL = si.BoucWen(**LAW, free=SPACE.names)
TRUTH = np.array([0.474e6, 0.3])


def motion(seed):
    return si.GroundMotion.synthetic(seed=seed).lowpass(20.0).trim(0.0, 20.0).scale_to_pga(1.8)


def posterior(record, clean, seed, law=None):
    noise = 0.02 * clean.std() * np.random.default_rng(seed).normal(size=clean.shape)
    return si.Posterior(SPACE, MODEL, si.Observation(record, clean + noise), law)


def fit(of):
    """Without sampling: the best of a search, and the variance that it leaves."""
    best = si.optimize.pattern_search(of.misfit, starts=2, seed=1).best
    variance = best.value / len(of.observations[0].values)
    return np.concatenate([best.theta, [variance]])


@pytest.mark.parametrize("seed", range(4))
def test_nothing_drifts_where_the_model_is_right(seed):
    record = motion(seed)
    of = posterior(record, MODEL.simulate(TRUTH[None], record).values[0, :, 0], seed)
    drift = parameter_drift(of, np.concatenate([TRUTH, [np.var(of.observations[0].values) * 0.02**2]]))
    assert not drift.found and drift.gain < 0.0
    assert drift.sentence(TRUTH) == "" and np.array_equal(drift.widened(np.ones(3)), np.ones(3))


@pytest.mark.parametrize("seed", range(5))
def test_outliers_are_no_drift(seed):
    """Their whitened residuals seem to drift with seeds 2, 3 and 4, by 6 and 7 nats; their influence does not."""
    record, rng = motion(3), np.random.default_rng(seed)
    clean = MODEL.simulate(TRUTH[None], record).values[0, :, 0]
    sd = 0.02 * clean.std()
    noise = sd * rng.normal(size=clean.shape) * np.where(rng.random(clean.shape) < 0.01, 20.0, 1.0)
    errors = si.Contaminated(variance=sd**2, outlier_share=0.01, outlier_scale=20.0)
    of = si.Posterior(SPACE, MODEL, si.Observation(record, clean + noise), errors)
    assert not parameter_drift(of, TRUTH).found
    assert error_growth(of, TRUTH).share[0] < 0.05


def test_a_drift_is_found_as_large_as_it_is():
    """The root mean square over records: of six values at the knots, one record alone tells the sd to a factor of two."""
    sizes, drift_of_stiffness = [], 0.02e6
    for seed in range(6):
        record = motion(seed)
        drifting = DriftingModel(MODEL, SPACE, 6, 4.0)
        at = np.random.default_rng(seed).normal(size=6)
        theta = np.concatenate([TRUTH, [drift_of_stiffness, 0.0], at - at.mean(), np.zeros(6)])
        of = posterior(record, drifting.simulate(theta[None], record).values[0, :, 0], seed)
        drift = parameter_drift(of, fit(of))
        assert drift.found, seed
        sizes.append(drift.sd[0])
    ratio = np.sqrt(np.mean(np.square(sizes))) / drift_of_stiffness
    assert 0.5 < ratio < 2.0, sizes
    assert "stiffness by 0.0" in drift.sentence(TRUTH) and "kN/mm (" in drift.sentence(TRUTH)
    assert drift.widened(np.array([1.0, 1.0, 1.0]))[0] == pytest.approx(np.hypot(1.0, drift.sd[0]))


def test_the_gain_is_that_of_the_whole_gaussian():
    record = motion(1)
    of = posterior(record, MODEL.simulate(TRUTH[None], record).values[0, :, 0], 1, si.AR1(white=0.0))
    theta, steps = np.concatenate([TRUTH, [1e-6, 0.1]]), 0.01 * np.array([0.06e6, 0.5])
    gram, projection = _projections(of, theta, steps, 0, 5)
    spread = np.repeat([0.01e6, 0.1], 6)
    # e has the same projections on the columns of any V with this Gram matrix.
    factor = scipy.linalg.sqrtm(gram).real
    e = np.linalg.solve(factor, projection)
    covariance = np.eye(12) + factor @ np.diag(spread**2) @ factor.T
    normal = scipy.stats.multivariate_normal
    expected = normal(np.zeros(12), covariance).logpdf(e) - normal(np.zeros(12), np.eye(12)).logpdf(e)
    assert _gain(gram, projection, spread) == pytest.approx(expected, rel=1e-4)  # sqrtm of a nearly singular matrix


def test_errors_that_grow_with_the_motion_are_told_from_those_that_do_not():
    record, rng = motion(2), np.random.default_rng(3)
    clean = MODEL.simulate(TRUTH[None], record).values[0, :, 0]
    envelope = np.sqrt(running_power(clean[:, None], record.dt)[:, 0])
    shares = {}
    for name, size in (("constant", np.full(len(clean), envelope.mean())), ("growing", envelope)):
        measured = clean + 0.1 * size * rng.normal(size=clean.shape)
        of = si.Posterior(SPACE, MODEL, si.Observation(record, measured))
        growth = error_growth(of, np.concatenate([TRUTH, [1e-6]]))
        shares[name] = growth.share[0]
    assert shares["constant"] < 0.1 and shares["growing"] > 0.9
    # Twice the motion, twice the errors: σ²(t) averages to the measured record's where the motion is that of it.
    one, two = (growth.scale(size * clean[None, :, None], record.dt) for size in (1.0, 2.0))
    assert np.mean(one**2) == pytest.approx(1.0, rel=0.02)
    assert np.mean(two**2) == pytest.approx(1.0 - growth.share[0] + 4.0 * growth.share[0], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("law", [si.IID(), si.DampedCosine()], ids=["iid", "damped cosine"])
def test_the_peak_of_another_record_is_inside_its_band(law):
    """A structure degrades, the model does not: without the drift an iid posterior holds 12 % of the peaks."""
    truth = si.BoucWen(**LAW, stiffness=TRUTH[0], gamma_ratio=TRUTH[1], delta_nu=0.05, delta_eta=0.15)
    sampler = si.SMC(particles=200, ensembles=2, steps=40, effective_share=0.5, correlation=0.4)

    def response(record):
        return truth.simulate(np.zeros((1, 0)), record).values[0, :, 0]

    inside, strong = [], []
    for seed in range(6):
        result = si.sample(posterior(motion(seed), response(motion(seed)), seed, law), sampler, seed=seed)
        assert result.verdict().converged and result.verdict().wrong_model
        prediction, clean = result.predict(motion(seed + 1), draws=300), response(motion(seed + 1))
        low, high = np.quantile(prediction.peaks[:, 0], [0.05, 0.95])
        inside.append(low <= np.abs(clean).max() <= high)
        low, high = (edge[:, 0] for edge in prediction.band(0.9, discrepancy=True))
        power = running_power(clean[:, None], motion(0).dt)[:, 0]
        covered = (clean >= low) & (clean <= high)
        strong.append(covered[power > 0.1 * power.max()].mean())
    assert sum(inside) >= 5 and np.mean(strong) > 0.8
