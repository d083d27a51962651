"""Modes that particles lose, particles that are not at rest, and what the evidence says of both."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.special
import scipy.stats

import structid as si
from structid.inference.diagnostics.verdict import uneven_shares
from structid.inference.sampling.smc.lost_modes import all_modes, lost_modes, thin_modes
from structid.inference.sampling.smc.particle_mixing import still_moving

normal = scipy.stats.norm.logpdf
SMALL = si.SMC(particles=400, steps=20, effective_share=0.6, correlation=0.3)
NARROW, WIDE, MASS = 0.15, 0.3, 2 / 3
"""Widths of two modes, and the mass of the narrow one."""


def boxed(density, dimension, half_width=10.0):
    names = tuple(f"x{i}" for i in range(dimension))
    box = (-half_width, half_width)
    space = si.ParameterSpace(**{n: si.Uniform(*box) for n in names})
    return si.LogDensity(density, names, space, dict.fromkeys(names, box))


def two_modes(dimension):
    """They integrate to one: log Z = 0."""

    def density(x):
        narrow = np.log(MASS) + normal(x, 3.0, NARROW).sum(axis=1)
        return np.logaddexp(narrow, np.log1p(-MASS) + normal(x, -3.0, WIDE).sum(axis=1))

    return boxed(density, dimension)


def funnel(dimension):
    """v ~ N(0, 3), x_i ~ N(0, e^(v/2))."""

    def density(x):
        v, others = x[:, 0], x[:, 1:]
        return normal(v, 0.0, 3.0) + normal(others, 0.0, np.exp(0.5 * v)[:, None]).sum(axis=1)

    return boxed(density, dimension, 30.0)


def test_a_narrow_mode_of_ten_dimensions_is_found_and_keeps_its_weight():
    result = si.sample(two_modes(10), SMALL, seed=2)
    evidence = result.log_evidence
    assert abs(evidence.value) < 4.0 * evidence.error + 0.02, str(evidence)
    share = (result.flat[:, 0] > 0).mean()
    assert abs(share - MASS) < 0.06
    assert "0.19 % of the prior or more" in str(evidence)


def test_without_scouts_it_is_lost():
    """All populations lose it alike: the case that the others must find."""
    evidence = si.sample(two_modes(10), replace(SMALL, scouts=0), seed=2).log_evidence
    assert evidence.value == pytest.approx(np.log(1.0 - MASS), abs=0.3)
    assert abs(evidence.value) > 5.0 * evidence.error
    assert "basin" not in str(evidence)


def test_derivatives_whose_squares_overflow_are_climbed():
    """Data without noise: the log density −r²/σ² − n ln σ² has no largest value, and slopes beyond 1e154."""

    def density(x):
        return -(x[:, 0] ** 2) * np.exp(-x[:, 1]) - 200.0 * x[:, 1]

    particles = np.random.default_rng(1).normal((0.5, -500.0), (0.1, 1.0), (50, 2))
    target = boxed(density, 2, 600.0)
    phi = target.bijection.inverse(particles)
    log_density = target.evaluate(phi)[0]
    assert np.ptp(log_density) > 1e200
    for mode in thin_modes(target, phi, log_density, phi[:2], 0.0):
        assert np.isfinite(mode.middle).all()
        assert np.isfinite(mode.factor).all()


def test_where_nothing_is_lost_the_scouts_change_nothing():
    target = boxed(lambda x: normal(x, 0.5, np.geomspace(0.05, 1.0, 5)).sum(axis=1), 5)
    looked, not_looked = (si.sample(target, replace(SMALL, scouts=count), seed=1) for count in (1, 0))
    np.testing.assert_array_equal(looked.history, not_looked.history)
    assert looked.log_evidence.value == not_looked.log_evidence.value


def test_a_mode_is_described_by_its_curvature():
    """The Gaussian law that touches a Gaussian mode is the mode."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(4, 4))
    covariance = 1e-3 * root @ root.T
    names = ("a", "b", "c", "d")
    space = si.ParameterSpace(**{n: si.Normal(0.0, 1.0) for n in names})

    def density(x):
        lost = scipy.stats.multivariate_normal(np.full(4, 1.0), covariance).logpdf(x) + np.log(0.3)
        return np.logaddexp(lost, np.log(0.7) + normal(x, -1.0, 0.05).sum(axis=1))

    target = si.LogDensity(density, names, space)
    to_coordinates = target.bijection.inverse
    known = to_coordinates(-1.0 + 0.05 * rng.normal(size=(500, 4)))
    scouts = to_coordinates(rng.normal(size=(300, 4)))
    (mode,) = lost_modes(target, known, target.evaluate(known)[0], scouts)
    theta, jacobian = target.bijection(mode.middle[None])
    np.testing.assert_allclose(theta[0], 1.0, atol=1e-3)
    scale = np.exp(jacobian[0] / 4)
    np.testing.assert_allclose(mode.factor @ mode.factor.T * scale**2, covariance, atol=1e-3 * np.abs(covariance).max())
    assert mode.log_mass == pytest.approx(np.log(0.3), abs=1e-3)


def test_a_bent_posterior_has_no_lost_mode():
    """Straight ways to its middle lead through valleys, and every search ends where particles are."""
    target = boxed(lambda x: normal(x[:, 0], 0.0, 2.0) + normal(x[:, 1], x[:, 0] ** 2 - 3.0, 0.3), 2)
    result = si.sample(target, SMALL, seed=3)
    phi = target.bijection.inverse(result.flat)
    scouts = target.initial(2000, np.random.default_rng(1))
    assert lost_modes(target, phi, target.evaluate(phi)[0], scouts) == []


@pytest.mark.parametrize("seed", range(5))
def test_scouts_are_chosen_where_the_density_is_higher_than_its_trend(seed):
    """The basin of a mode a third as wide is a part in ten thousand of the prior: few of 10 000 plain scouts come there, if any."""

    def parts(x):
        return [normal(x, at, width).sum(axis=1) for at, width in ((3.0, 0.1), (-3.0, 0.3))]

    target = boxed(lambda x: np.logaddexp(*parts(x)), 10)
    rng = np.random.default_rng(seed)
    phi = target.bijection.inverse(rng.normal(-3.0, 0.3, (500, 10)))
    found = all_modes(target, phi, target.evaluate(phi)[0], phi[:0], target.initial(100_000, rng), 10_000)
    middles = target.bijection(np.stack([mode.middle for mode in found]))[0]
    np.testing.assert_allclose(middles, np.repeat([[-3.0], [3.0]], 10, axis=1), atol=0.1)


def test_chosen_scouts_find_no_mode_that_is_not_there():
    """Nor may points at which there is no density take part in the trend."""

    def density(x):
        bent = normal(x[:, 0], 0.0, 2.0) + normal(x[:, 1], x[:, 0] ** 2 - 3.0, 0.3) + normal(x[:, 2:]).sum(axis=1)
        return np.where(x[:, 2] > 8.0, -np.inf, bent)

    target = boxed(density, 5)
    phi = target.bijection.inverse(si.sample(target, SMALL, seed=3).flat)
    many = target.initial(25_000, np.random.default_rng(1))
    assert len(all_modes(target, phi, target.evaluate(phi)[0], phi[:0], many, 2_500)) == 1


def test_a_run_that_begins_again_is_killed_and_goes_on_to_the_same_bits(tmp_path):
    target, sampler = two_modes(10), replace(SMALL, particles=200, steps=5)
    whole = si.sample(target, sampler, seed=2, store=tmp_path / "whole.h5")
    assert (whole.flat[:, 0] > 0).any() and (whole.flat[:, 0] < 0).any()

    class Killed(Exception):
        pass

    killed = 0
    for last in range(3, 200, 4):
        calls = []

        def stop(done, total, calls=calls, last=last):
            calls.append(done)
            if len(calls) == 3:
                raise Killed

        try:
            again = si.sample(target, sampler, seed=2, store=tmp_path / "cut.h5", progress=stop)
            break
        except Killed:
            killed += 1
    assert killed > 3
    np.testing.assert_array_equal(again.history, whole.history)
    assert again.log_evidence.value == whole.log_evidence.value
    longer = si.sample(target, replace(sampler, steps=60), seed=2, store=tmp_path / "cut.h5")
    np.testing.assert_array_equal(longer.history[:5], whole.history)


@pytest.mark.slow
def test_particles_that_have_not_reached_the_neck_of_a_funnel_say_so():
    result = si.sample(funnel(10), replace(SMALL, steps=60), seed=1)
    assert not result.verdict().converged
    assert "not in equilibrium" in str(result.verdict()) and "missing from the draws and the evidence" in str(
        result.verdict()
    )
    assert "without regions that the particles have not reached" in str(result.log_evidence)
    assert result.log_evidence.value < -0.3


def spike(dimension, width, share):
    """A normal density inside a uniform one on the whole range; no valley divides them. It integrates to one."""

    def density(x):
        narrow = np.log(share) + normal(x, 0.3, width).sum(axis=1)
        return np.logaddexp(narrow, np.log1p(-share) - dimension * np.log(2.0))

    return boxed(density, dimension, 1.0)


@pytest.mark.parametrize(("dimension", "width"), [(3, 0.06), (6, 0.1)])
def test_a_spike_inside_the_bulk_has_its_share_and_its_evidence(dimension, width):
    result = si.sample(spike(dimension, width, 0.5), SMALL, seed=1)
    evidence = result.log_evidence
    assert abs(evidence.value) < 4.0 * evidence.error + 0.02, str(evidence)
    inside = np.sum(((result.flat - 0.3) / width) ** 2, axis=1) < scipy.stats.chi2.ppf(0.99, dimension)
    assert inside.mean() == pytest.approx(0.5, abs=0.06)


def test_particles_do_not_restart_for_a_mode_that_has_its_share():
    rng = np.random.default_rng(4)
    target, particles = spike(3, 0.06, 0.5), np.concatenate(
        [rng.normal(0.3, 0.06, (500, 3)), rng.uniform(-1.0, 1.0, (500, 3))]
    )  # fmt: skip
    phi = target.bijection.inverse(particles)
    scouts = target.initial(200, rng)
    few = np.concatenate([phi[:10], phi[500:]])
    (mode,) = thin_modes(target, few, target.evaluate(few)[0], scouts, 0.0)
    np.testing.assert_allclose(target.bijection(mode.middle[None])[0], 0.3, atol=0.01)
    assert thin_modes(target, phi, target.evaluate(phi)[0], scouts, 0.0) == []


@pytest.mark.parametrize("seed", range(5))
def test_particles_at_rest_are_not_said_to_move(seed):
    """Autoregressive walks: at rest from the start, and drifting by a fiftieth of their spread."""
    rng = np.random.default_rng(seed)
    walks = [rng.normal(size=(4, 1000, 3))]
    for _ in range(99):
        walks.append(0.9 * walks[-1] + np.sqrt(1 - 0.81) * rng.normal(size=(4, 1000, 3)))
    draws = np.stack(walks)
    assert still_moving(draws) == {}
    draws[..., 1] -= np.linspace(0.0, 0.25, 100)[:, None, None]
    assert list(still_moving(draws)) == [1] and still_moving(draws)[1] < 0


def test_a_share_of_dense_draws_that_grows_is_said_to_move():
    """Particles enter a narrow spike one after another, and stay: 4 % in the end, too few to move the mean rank far."""
    rng = np.random.default_rng(5)
    log_density = rng.normal(size=(100, 4, 1000))
    entered = rng.uniform(0.0, 2500.0, size=(4, 1000))
    log_density[np.arange(100)[:, None, None] > entered] += 10.0
    draws = rng.normal(size=(100, 4, 1000, 1))
    assert set(still_moving(draws, log_density)) >= {3}
    assert set(still_moving(draws, log_density)).isdisjoint({0})


def test_ensembles_with_other_shares_of_dense_draws_have_not_converged():
    rng = np.random.default_rng(6)
    log_density = rng.normal(size=(100, 4, 500))
    assert uneven_shares(log_density) == []
    log_density[:, 2, :20] += 10.0
    assert "narrow region" in uneven_shares(log_density)[0]


@pytest.mark.slow
def test_evidence_of_two_modes_over_ten_seeds():
    scores = []
    for seed in range(10):
        evidence = si.sample(two_modes(10), replace(SMALL, steps=1), seed=seed).log_evidence
        scores.append(evidence.value / evidence.error)
    print(np.round(scores, 1))
    assert np.abs(scores).max() <= 3.5


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [3, 5])
def test_evidence_beside_nested_sampling(dimension):
    """dynesty's evidence of two modes, and ours, both of the same integral, which is known."""
    dynesty = pytest.importorskip("dynesty")
    target = two_modes(dimension)
    evidence = si.sample(target, si.SMC(steps=5), seed=1).log_evidence
    nested = dynesty.NestedSampler(
        lambda x: float(target.log_density(x[None])[0] + dimension * np.log(20.0)),
        lambda u: 20.0 * u - 10.0,
        dimension,
        nlive=120,
        sample="rwalk",
        rstate=np.random.default_rng(1),
    )
    nested.run_nested(print_progress=False)
    other, error = float(nested.results.logz[-1]), float(nested.results.logzerr[-1])
    print(evidence, other, error)
    assert abs(evidence.value - other) < 3.5 * np.hypot(evidence.error, error)
    assert evidence.error < error
    assert abs(evidence.value) < 3.5 * evidence.error
