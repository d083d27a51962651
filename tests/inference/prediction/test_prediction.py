"""Predictions know each observation and each channel."""

import numpy as np
import pytest

import structid as si


def test_prediction_knows_each_observation_and_each_channel(short_record, study_space):
    from structid.inference.prediction.prediction import predict

    other = si.GroundMotion.synthetic(seed=9).lowpass(20.0).trim(4.0, 8.0).scale_to_pga(1.5)
    channels = ("displacement", "velocity")
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names, channels=channels)
    values = [model.simulate(np.array([[7e6, 60.0, 0.3, 0.05]]), r).values[0] for r in (short_record, other)]
    observations = [si.Observation(r, v, channels) for r, v in zip((short_record, other), values, strict=True)]
    posterior = si.Posterior(study_space, model, observations)
    theta = np.tile([7e6, 60.0, 0.3, 0.05, 1e-8, 1e-2, 1e-8, 1e-4], (50, 1))
    one = predict(posterior, theta, short_record, ("velocity",), scaled=False)
    assert (one.observable - one.response).std() == pytest.approx(0.1, rel=0.02)
    second = predict(posterior, theta, other, scaled=False)
    assert second.channels == channels
    assert (second.observable - second.response)[:, :, 1].std() == pytest.approx(0.01, rel=0.02)
    peak = np.median(second.peaks[:, 1]) * 1e3
    assert f"peak velocity {peak:.3g} mm/s (90 %: " in str(second) and "50 draws of the response to" in repr(second)
    extra = predict(posterior, theta, other, ("velocity", "restoring_force"))
    np.testing.assert_array_equal(extra.observable[:, :, 1], extra.response[:, :, 1])
