"""A posterior that is a narrow ridge along a product of parameters, whose law along it is known."""

import numpy as np
import pytest

import structid as si

PRIORS = dict(a=si.Uniform(1.0, 3.0), b=si.Uniform(2e6, 5e6))
RECORD = si.GroundMotion.synthetic(seed=3, duration=8.0).scale_to_pga(1.0)
TRUTH = 7e6


def posterior(**settings):
    """The response depends on k = a b alone."""
    space = si.ParameterSpace(**PRIORS, derived={"stiffness": "a * b"}, **settings)
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=1.0, beta=1.0, gamma_ratio=0.0, free=("stiffness",))
    exact = (
        si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=1.0, beta=1.0, gamma_ratio=0.0, stiffness=TRUTH)
        .simulate(np.zeros((1, 0)), RECORD)
        .values[0]
    )
    noise = 1e-3 * exact.std() * np.random.default_rng(1).normal(size=exact.shape)
    return si.Posterior(space, model, si.Observation(RECORD, exact + noise))


@pytest.mark.parametrize("sampler", [si.SMC(particles=200, steps=60), si.AIES(steps=1500)])
def test_along_it_the_law_is_the_known_one(sampler):
    """Of uniform a and b with a b = k, a has a density of 1/a between 7/5 and 3: moved in logarithms, all of it is found."""
    found = si.sample(posterior(coordinates={"log_k": "log(a * b)", "log_a": "log(a)"}), sampler, seed=1)
    assert found.verdict().converged
    low, high = TRUTH / 5e6, 3.0
    mean = (high - low) / np.log(high / low)
    second = 0.5 * (high**2 - low**2) / np.log(high / low)
    sd = np.sqrt(second - mean**2)
    size = found.verdict().parameters["a"].bulk_size
    assert abs(found.mean[0] - mean) < 4.0 * sd / np.sqrt(size)
    assert found.sd[0] == pytest.approx(sd, rel=4.0 / np.sqrt(size))
    products = found.flat[:, 0] * found.flat[:, 1]
    assert products.std() < 1e-3 * TRUTH and abs(products.mean() - TRUTH) < 5.0 * products.std()


@pytest.mark.slow
def test_bent_by_the_bounds_it_is_not_found_and_that_is_told():
    """The same moves through the logistic map of the bounds."""
    found = si.sample(posterior(), si.SMC(particles=200, steps=60), seed=1)
    assert not found.verdict().converged
