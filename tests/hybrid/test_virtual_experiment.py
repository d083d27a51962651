"""A whole hybrid test as a model: campaigns, surrogates and posteriors apply to it as to any other."""

import numpy as np
import pytest

import structid as si
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame

pytestmark = pytest.mark.quick
UPPER, LOWER = si.cut_frame(two_floor_frame(hysteretic=True), 1)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.6e6, 0.4e6), beta=si.Uniform(50.0, 75.0))
TRUTH = np.array([[7.5e6, 63.0]])


@pytest.mark.slow
def test_a_posterior_by_a_surrogate_of_a_campaign():
    """What a hybrid system does under a record, taken for measured, gives back the specimen that it was done with."""
    storey = si.BoucWen(mass=12e3, alpha=0.05, gamma_ratio=1.0, delta_nu=2.43, delta_eta=6.5, free=SPACE.names)
    whole = si.VirtualHybridTest(UPPER, LOWER, storey, dt=0.01, channels=("displacement_1", "displacement_2"))
    record = si.GroundMotion(pulse(np.arange(0.0, 1.505, 0.01)), 0.01, name="pulse")
    runs = si.Campaign(whole, record, SPACE.sample(60, seed=1, method="sobol", widen=1.5)).run()
    assert runs.done.all()
    surrogate = si.PODKriging().fit(runs)
    others = SPACE.sample(20, seed=2)
    assert surrogate.validate(si.Campaign(whole, record, others).run()).mean < 1e-3
    answer = whole.simulate(TRUTH, record).values[0]
    noise = 0.02 * answer.std(axis=0) * np.random.default_rng(1).standard_normal(answer.shape)
    observation = si.Observation(record, answer + noise, whole.channels)
    plan = si.Plan(exploration_sampler=si.SMC(particles=100, steps=10, effective_share=0.5, correlation=0.5))
    sampler = si.SMC(particles=200, steps=30, effective_share=0.5, correlation=0.5)
    certified = si.calibrate(whole, SPACE, observation, plan=plan, sampler=sampler, seed=1)
    exact = si.sample(si.Posterior(SPACE, whole, observation), si.SMC(particles=100, steps=30), seed=3)
    assert certified.certificate.certified and exact.verdict().converged, f"{certified}\n{exact.verdict()}"
    assert (np.abs(exact.mean[:2] - TRUTH[0]) < 4.0 * exact.sd[:2]).all()
    # 0.1 sd of the certificate, and the Monte-Carlo error of four hundred draws and more.
    assert (np.abs(certified.mean - exact.mean)[:2] < 0.3 * exact.sd[:2]).all()
