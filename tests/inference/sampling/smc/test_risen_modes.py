"""Narrow modes that particles reach only while they move at β = 1: the particles restart around them, whenever a run is stopped."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.inference.sampling.smc import smc

normal = scipy.stats.norm.logpdf
DIMENSION, WIDTH, SHARE = 6, 0.1, 0.5
SAMPLER = si.SMC()
SEED = 2


class Spike:
    """Half of the mass in a tenth of the width of the other half, and a count of the points at which it is computed."""

    def __init__(self):
        self.points = 0
        self.centre = np.clip(np.random.default_rng([DIMENSION, SEED]).normal(size=DIMENSION), -3.0, 3.0)

    def __call__(self, x):
        self.points += len(x)
        wide = np.log1p(-SHARE) + normal(x).sum(axis=1)
        return np.logaddexp(wide, np.log(SHARE) + normal(x, self.centre, WIDTH).sum(axis=1))


def target(density):
    names = tuple(f"x{i}" for i in range(DIMENSION))
    space = si.ParameterSpace(**{name: si.Uniform(-5.0, 5.0) for name in names})
    return si.LogDensity(density, names, space, dict.fromkeys(names, (-5.0, 5.0)))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    density = Spike()
    return density, si.sample(target(density), SAMPLER, seed=SEED, store=tmp_path_factory.mktemp("risen") / "whole.h5")


def test_particles_restart_around_a_mode_that_has_risen(whole, monkeypatch):
    density, result = whole
    near = np.linalg.norm(result.flat - density.centre, axis=1) < 6.0 * WIDTH
    assert near.mean() == pytest.approx(SHARE, abs=0.05) and result.log_evidence.at_rest
    assert abs(result.log_evidence.value) < 4.0 * result.log_evidence.error < 0.1
    monkeypatch.setattr(smc, "RISEN", np.inf)
    without = si.sample(target(Spike()), SAMPLER, seed=SEED)
    assert (np.linalg.norm(without.flat - density.centre, axis=1) < 6.0 * WIDTH).mean() < 0.1
    assert without.log_evidence.value < -0.5


def test_a_killed_run_goes_on_to_the_same_bits_and_a_finished_one_costs_nothing(whole, tmp_path):
    result, killed = whole[1], 0

    class Killed(Exception):
        pass

    for _ in range(200):
        calls = []

        def stop(done, total, calls=calls):
            calls.append(done)
            if len(calls) == 3:
                raise Killed

        try:
            again = si.sample(target(Spike()), SAMPLER, seed=SEED, store=tmp_path / "cut.h5", progress=stop)
            break
        except Killed:
            killed += 1
    assert killed > 3
    np.testing.assert_array_equal(again.history, result.history)
    assert again.log_evidence.value == result.log_evidence.value
    idle = Spike()
    si.sample(target(idle), SAMPLER, seed=SEED, store=tmp_path / "cut.h5")
    assert idle.points == 0
