"""The face that chaos expansions and Kriging share: one can be used for the other without asking which it is."""

import numpy as np
import pytest

import structid as si
from structid.engine.device import jnp
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.regression import Regression

SPACE = si.ParameterSpace(a=si.Uniform(-1.0, 1.0), b=si.Normal(0.0, 1.0))


@pytest.mark.parametrize("settings", [si.PCE(degree=2), si.Kriging(), si.Kriging(shared=False)])
def test_both_kinds_have_one_face(settings):
    design = SPACE.sample(30, seed=1)
    points = SPACE.sample(7, seed=2).values
    outputs = np.column_stack([np.sin(design.values[:, 0]), design.values[:, 0] * design.values[:, 1] ** 2])
    fitted: Regression = settings.fit(design, outputs)
    assert fitted.word == type(fitted).__name__ and fitted.leave_one_out_error.shape == (2,)
    for theta in (points, jnp.asarray(points)):
        mean, deviation = fitted.predict_with_deviation(theta)
        np.testing.assert_allclose(mean, fitted.predict(theta), rtol=1e-12, atol=1e-12)
        assert (deviation is None) == (fitted.deviation(theta) is None) == isinstance(fitted, ChaosExpansion)
        if deviation is not None:
            np.testing.assert_array_equal(deviation, fitted.deviation(theta))
            np.testing.assert_array_equal(deviation, fitted.predict(theta, return_std=True)[1])
    plain, arrays = fitted.to_plain()
    maker = {kind.word: kind for kind in (ChaosExpansion, KrigingPredictor)}[fitted.word]
    np.testing.assert_array_equal(maker.from_plain(SPACE, plain, arrays).predict(points), fitted.predict(points))
