"""Bands of another record are as wide as they should have been on the measured one, in its strong and in its quiet part."""

import numpy as np
import pytest

import structid as si
from structid.inference.prediction.band_scale import LIMITS, BandScale
from structid.inference.prediction.prediction import predict

SAMPLER = si.SMC(particles=200, steps=20, effective_share=0.5, correlation=0.4)
DT = 0.01
TIME = DT * np.arange(4000)


def motion(seed):
    """Narrow-band, strong for ten seconds and a tenth as strong after them."""
    rng = np.random.default_rng(seed)
    envelope = np.where(TIME < 10.0, 1.0, 0.1)
    return envelope * np.sin(2.0 * np.pi * 1.5 * TIME + rng.uniform(0.0, 6.0))


def errors(rng, sd, count=()):
    """Of a correlation time of some tenths of a second."""
    white = rng.normal(size=(*count, len(TIME) + 60))
    kernel = np.hanning(40)
    smooth = np.apply_along_axis(np.convolve, -1, white, kernel / np.sqrt((kernel**2).sum()), "valid")
    return sd * smooth[..., : len(TIME)]


def inside(measured, draws):
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    return (measured > low) & (measured < high)


@pytest.mark.parametrize(("strong", "quiet"), [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0), (0.4, 0.4)])
def test_the_next_record_is_held_as_often_as_the_band_says(strong, quiet):
    """Where draws scatter `strong` and `quiet` times as much as the errors do in these parts."""
    held = []
    wrong = np.where(TIME < 10.0, strong, quiet)
    sd = np.where(TIME < 10.0, 0.1, 0.03)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        draws = (motion(seed) + wrong * errors(rng, sd, (200,)))[..., None]
        scale = BandScale.of((motion(seed) + errors(rng, sd))[:, None], draws, DT)
        other = (motion(seed + 100) + wrong * errors(rng, sd, (200,)))[..., None]
        found = inside((motion(seed + 100) + errors(rng, sd))[:, None], scale.applied(other, DT))[:, 0]
        held.append([found[TIME < 9.0].mean(), found[TIME > 11.0].mean()])
    print(np.mean(held, axis=0))
    assert ((np.mean(held, axis=0) > 0.85) & (np.mean(held, axis=0) < 0.96)).all()


def test_without_the_scale_it_is_not():
    rng = np.random.default_rng(1)
    draws = (motion(1) + 0.5 * errors(rng, 0.1, (200,)))[..., None]
    assert inside((motion(1) + errors(rng, 0.1))[:, None], draws).mean() < 0.7


def test_one_record_does_not_prove_everything():
    rng = np.random.default_rng(2)
    draws = (motion(2) + errors(rng, 1e-6, (100,)))[..., None]
    scale = BandScale.of((motion(2) + errors(rng, 0.1))[:, None], draws, DT)
    assert (scale.factors == LIMITS[1]).all()
    still = BandScale.of(np.zeros((100, 1)), np.zeros((10, 100, 1)), DT)
    assert (still.factors == 1.0).all()


def test_a_right_model_is_left_nearly_as_it_is():
    """And a prediction of the measured record is not touched."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
    other = si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
    space = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.7e6, unit="N/m"), alpha=si.Uniform(0.0, 0.2))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.2, free=space.names)
    clean = model.simulate(np.array([[7.3e6, 0.05]]), record).values[0, :, 0]
    noise = 0.05 * clean.std() * np.random.default_rng(1).normal(size=clean.shape)
    posterior = si.Posterior(space, model, si.Observation(record, clean + noise), si.IID())
    result = si.sample(posterior, si.SMC(particles=200, steps=20, effective_share=0.5, correlation=0.4), seed=1)
    low, high = result.predict(other).band(0.9, discrepancy=True)
    width = np.median(high - low) / (2.0 * 1.645 * noise.std())
    assert width == pytest.approx(1.0, abs=0.12)
    low, high = result.predict().band(0.9, discrepancy=True)
    held = ((clean + noise > low[:, 0]) & (clean + noise < high[:, 0])).mean()
    assert held == pytest.approx(0.9, abs=0.03)


def test_a_model_whose_peaks_are_too_low_is_corrected():
    """The measured motion is 1.3 times what the linear model can do, on this record and on the next."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(0.5)
    other = si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(0.5)
    space = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.3e6, unit="N/m"))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=1.0, beta=60.0, gamma_ratio=0.2, free=space.names)
    clean = [1.3 * model.simulate(np.array([[7.4e6]]), r).values[0, :, 0] for r in (record, other)]
    noise = 0.01 * clean[0].std() * np.random.default_rng(1).normal(size=clean[0].shape)
    posterior = si.Posterior(space, model, si.Observation(record, clean[0] + noise), si.IID())
    result = si.sample(posterior, SAMPLER, seed=1)
    prediction = result.predict(other)
    assert prediction.peak_ratio[0] == pytest.approx(1.3, abs=0.08)
    low, high = np.quantile(prediction.peaks, [0.05, 0.95])
    linear = np.abs(clean[1]).max() / 1.3
    assert low < linear < np.abs(clean[1]).max() < high
    assert result.predict().peak_ratio is None


@pytest.mark.parametrize("kind", ["outliers", "proportional"])
def test_noise_of_an_instrument_is_no_peak_of_the_response(kind):
    """The model is right: an outlier of twice the peak, or errors of a fifth of the response, do not raise peaks elsewhere."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(0.5)
    space = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.3e6, unit="N/m"))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=1.0, beta=60.0, gamma_ratio=0.2, free=space.names)
    clean = model.simulate(np.array([[7.4e6]]), record).values[0, :, 0]
    normal = np.random.default_rng(1).normal(size=clean.shape)
    if kind == "outliers":
        measured = clean + 0.02 * clean.std() * normal
        measured[[300, 500, 700]] = 2.0 * np.abs(clean).max()
        errors = si.Contaminated(variance=(0.02 * clean.std()) ** 2, outlier_share=0.003, outlier_scale=100.0)
    else:
        measured = clean * (1.0 + 0.2 * normal)
        errors = si.Proportional(variance=(0.002 * clean.std()) ** 2, share=0.2)
    assert np.abs(measured).max() > 1.15 * np.abs(clean).max()
    result = si.sample(si.Posterior(space, model, si.Observation(record, measured), errors), SAMPLER, seed=1)
    prediction = result.predict(si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(0.5))
    assert prediction.peak_ratio[0] == pytest.approx(1.0, abs=0.08)


def test_outliers_do_not_narrow_the_spread_of_the_parameters():
    """With 1 % outliers, normal errors are too large and their band is narrowed; the response keeps its own spread."""
    rng = np.random.default_rng(7)
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
    other = si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
    space = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.7e6, unit="N/m"))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.1, beta=60.0, gamma_ratio=0.2, free=space.names)
    clean = model.simulate(np.array([[7.4e6]]), record).values[0, :, 0]
    noise = 0.01 * clean.std() * rng.normal(size=len(clean))
    noise[rng.random(len(noise)) < 0.01] += 3.0 * clean.std()
    posterior = si.Posterior(space, model, si.Observation(record, clean + noise))
    theta = np.stack([rng.normal(7.4e6, 0.05e6, 200), rng.uniform(0.9, 1.1, 200) * noise.var()], axis=1)
    scaled, plain = (predict(posterior, theta, other, scaled=scaled) for scaled in (True, False))
    np.testing.assert_allclose(scaled.response, plain.response, atol=1e-12)
    assert scaled.observable.std(axis=0).mean() < 0.7 * plain.observable.std(axis=0).mean()
    assert (scaled.observable.std(axis=0) > 0.99 * plain.response.std(axis=0)).all()
