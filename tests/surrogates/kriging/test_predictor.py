"""Kriging: interpolation, leave-one-out against refitting, exact gradients, honest standard deviations."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.probability.designs import Design
from structid.surrogates.kriging import universal_kriging
from structid.surrogates.kriging.hyperparameters import HyperparameterObjective
from structid.surrogates.kriging.kriging_system import KrigingData, KrigingFactors

SPACE = si.ParameterSpace(a=si.Uniform(-1.0, 1.0), b=si.Normal(0.0, 1.0))


def smooth(x):
    return np.column_stack([np.sin(2 * x[:, 0]) + 0.3 * x[:, 1] ** 2, np.cos(x[:, 0] * x[:, 1])])


@pytest.mark.parametrize("correlation", ["exponential", "matern32", "matern52", "gaussian"])
@pytest.mark.parametrize("trend", ["constant", "linear", "quadratic", si.PCE(degree=3)])
def test_it_interpolates_without_a_nugget(correlation, trend):
    design = SPACE.sample(40, seed=1)
    separable = trend in ("constant", "quadratic")  # both forms, half of the cases each
    settings = si.Kriging(correlation=correlation, trend=trend, separable=separable)
    predictor = settings.fit(design, smooth(design.values))
    mean, deviation = predictor.predict(design.values, return_std=True)
    np.testing.assert_allclose(mean, smooth(design.values), atol=2e-5)
    assert (deviation < 2e-3).all()


@pytest.mark.parametrize(("lost", "learns"), [(universal_kriging.LOST, True), (np.inf, False)])
def test_a_search_leaves_lengths_at_which_nothing_is_learnt(monkeypatch, lost, learns):
    """As those of a few runs may be: the others say nothing of any point, and no small step changes that."""
    monkeypatch.setattr(universal_kriging, "LOST", lost)
    design, settings = SPACE.sample(40, seed=1), si.Kriging(separable=False)
    start = settings.fit(design[:10], smooth(design.values[:10]))
    short = replace(start.groups[0], log_lengths=np.full(2, np.log(1e-4)))
    found = settings.fit(design, smooth(design.values), start=replace(start, groups=(short,)))
    left = np.sum(found.groups[0].leave_one_out_residuals ** 2) / np.sum(np.var(smooth(design.values), axis=0) * 40)
    assert left < 0.02 if learns else left > 0.5


@pytest.mark.parametrize("nugget", [0.0, 1e-3])
def test_leave_one_out_equals_refitting(nugget):
    """Dubrule's formula against brute force, the hyper-parameters kept."""
    design = SPACE.sample(25, seed=2)
    predictor = si.Kriging(trend="linear", nugget=nugget, separable=False).fit(design, smooth(design.values))
    group = predictor.groups[0]
    data = KrigingData(group.points, group.trend.evaluate(design.values), smooth(design.values))
    objective = HyperparameterObjective(data, group.family, group.separable, nugget, "ml")
    for i in (0, 7, 24):
        keep = np.arange(25) != i
        factors = KrigingFactors.of(
            data.some(keep), objective.on(data.some(keep)).matrix(group.log_lengths), group.factors.nugget
        )
        every = objective.matrix(group.log_lengths)
        mean = data.trend[i] @ factors.coefficients + every[i, keep] @ factors.weights
        np.testing.assert_allclose(
            data.outputs[i] - mean, group.leave_one_out_residuals[i], rtol=1e-4, atol=1e-7 if nugget == 0 else 1e-10
        )


@pytest.mark.parametrize("estimation", ["ml", "cv"])
@pytest.mark.parametrize("separable", [False, True])
@pytest.mark.parametrize("nugget", [1e-6, "estimate"])
def test_gradients_are_exact(estimation, separable, nugget):
    x = SPACE.sample(60, seed=3).values
    data = KrigingData(x, np.ones((60, 1)), smooth(x))
    objective = HyperparameterObjective(data, "matern52", separable, nugget, estimation)
    place = np.array([0.3, 0.6] + [-9.0] * (nugget == "estimate"))
    _, slope = objective(place)
    for j, direction in enumerate(np.eye(len(place))):
        difference = (objective(place + 1e-4 * direction)[0] - objective(place - 1e-4 * direction)[0]) / 2e-4
        np.testing.assert_allclose(slope[j], difference, rtol=1e-4)


def test_the_standard_deviation_is_honest():
    """Functions drawn from the very process: 95 % of the errors lie within 1.96 predicted standard deviations, to 4 sds."""
    rng = np.random.default_rng(4)
    points = SPACE.sample(340, seed=4).values
    shape = np.abs((points[:, None] - points[None]) / np.array([0.5, 1.0]))
    h = np.sqrt(5) * np.sqrt((shape**2).sum(axis=2))
    covariance = (1 + h + h**2 / 3) * np.exp(-h)
    draws = np.linalg.cholesky(covariance + 1e-10 * np.eye(340)) @ rng.normal(size=(340, 12))
    design = Design(points[:40], SPACE)
    predictor = si.Kriging(separable=False, shared=True).fit(design, draws[:40])
    mean, deviation = predictor.predict(points[40:], return_std=True)
    inside = np.abs(mean - draws[40:]) < 1.96 * deviation
    per_draw = inside.mean(axis=0)
    margin = 4 * per_draw.std(ddof=1) / np.sqrt(12)
    print(f"coverage {inside.mean():.3f} +- {margin / 4:.3f}")
    assert abs(inside.mean() - 0.95) < margin
    # A deviation half as large must fail the same test.
    assert abs((np.abs(mean - draws[40:]) < 0.98 * deviation).mean() - 0.95) > margin


def test_an_estimated_nugget_finds_the_noise():
    design = SPACE.sample(120, seed=5)
    noise = 0.1 * np.random.default_rng(5).normal(size=(120, 1))
    predictor = si.Kriging(nugget="estimate", separable=False).fit(design, smooth(design.values)[:, :1] + noise)
    group = predictor.groups[0]
    np.testing.assert_allclose(group.factors.nugget * group.factors.likelihood_variance, 0.01, rtol=0.35)


def test_the_form_is_chosen_by_leaving_out():
    """A product of kinks along the axes is what a separable correlation knows."""
    space = si.ParameterSpace(**{n: si.Uniform(-1.0, 1.0) for n in "abcd"})
    design = space.sample(100, seed=6)
    values = np.abs(design.values).sum(axis=1)
    chosen = si.Kriging().fit(design, values).groups[0]
    errors = {s: si.Kriging(separable=s).fit(design, values).leave_one_out_error[0] for s in (False, True)}
    assert chosen.separable and errors[True] < 0.5 * errors[False]


@pytest.mark.parametrize("nugget", [1e-8, "estimate"])
def test_a_fit_that_begins_with_the_lengths_of_another_ends_where_a_search_does(nugget):
    """On another design, standardised by other moments: the lengths are carried over in SI."""
    few, more = SPACE.sample(30, seed=6), SPACE.sample(70, seed=7, widen=1.5)
    settings = si.Kriging(nugget=nugget, separable=False)
    told = {"cold": [], "warm": []}
    cold = settings.fit(more, smooth(more.values), lambda *done: told["cold"].append(done))
    begun = settings.fit(few, smooth(few.values))
    warm = settings.fit(more, smooth(more.values), lambda *done: told["warm"].append(done), begun)
    group = cold.groups[0]
    data = KrigingData(group.points, group.trend.evaluate(more.values), smooth(more.values))
    objective = HyperparameterObjective(data, group.family, group.separable, nugget, "ml")

    def value(predictor):
        other = predictor.groups[0]
        own = [np.log(other.factors.nugget)] * (nugget == "estimate")
        return objective(np.append(np.log(other.lengths / group.scale), own))[0]

    assert abs(value(warm) - value(cold)) < 0.1 < value(begun) - value(cold)
    assert told["warm"] == [(1, 1)]  # without a global search


def test_outputs_of_their_own_and_together():
    design, other = SPACE.sample(60, seed=7), SPACE.sample(200, seed=8).values
    values = np.column_stack([smooth(design.values), 10 * np.exp(design.values[:, 0])])
    true = np.column_stack([smooth(other), 10 * np.exp(other[:, 0])])
    own = si.Kriging(shared=False, separable=False).fit(design, values)
    together = si.Kriging(shared=True, separable=False).fit(design, values)
    assert len(own.groups) == 3 and len(together.groups) == 1
    for predictor in (own, together):
        error = np.mean((predictor.predict(other) - true) ** 2, axis=0) / true.var(axis=0)
        assert (error < 3e-2).all()
        assert predictor.leave_one_out_error.shape == (3,)


def test_predict_in_jax_is_predict_in_numpy():
    from structid.engine.device import jnp

    design = SPACE.sample(30, seed=9)
    predictor = si.Kriging().fit(design, smooth(design.values))
    theta = SPACE.sample(7, seed=10).values
    for ours, theirs in zip(
        predictor.predict(theta, return_std=True), predictor.predict(jnp.asarray(theta), return_std=True), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_what_a_fit_refuses():
    design = SPACE.sample(20, seed=1)
    twice = Design(np.vstack([design.values, design.values[3]]), SPACE)
    with pytest.raises(InputError, match=r"1 points are repeated, such as rows 3 and 20.*nugget"):
        si.Kriging().fit(twice, smooth(twice.values))
    si.Kriging(nugget=1e-4).fit(twice, smooth(twice.values))
    with pytest.raises(InputError, match="20 runs for a trend of 28 terms"):
        si.Kriging(trend="quadratic").fit(
            Design(
                np.random.default_rng(0).normal(size=(20, 6)),
                si.ParameterSpace(**{n: si.Normal(0, 1) for n in "abcdef"}),
            ),
            np.arange(20.0),
        )
    with pytest.raises(InputError, match="nugget"):
        si.Kriging(nugget=-1.0)


@pytest.mark.parametrize("noise", [0.05, 1e-3, 1e-4])
@pytest.mark.parametrize("nugget", [0.0, "estimate"])
def test_with_noisy_runs_it_is_never_sure_of_what_is_wrong(noise, nugget):
    """y = sin 5a + b + noise of 300 runs: errors beyond three deviations are rare, and no deviation is zero.

    Of normal errors 0.3 % are; the deviations of one fit are wrong together, so that up to 5 % are let pass.
    """
    space = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Uniform(0.0, 1.0))
    design = space.sample(300, seed=1)
    true = lambda x: np.sin(5.0 * x[:, 0]) + x[:, 1]  # noqa: E731
    values = true(design.values) + noise * np.random.default_rng(0).standard_normal(300)
    points = space.sample(500, seed=2).values
    mean, deviation = si.Kriging(nugget=nugget).fit(design, values).predict(points, return_std=True)
    error = np.abs(mean[:, 0] - true(points))
    assert (deviation > 0.0).all()
    assert np.mean(error > 3.0 * deviation[:, 0]) < 0.05
    assert deviation.mean() < 2.0 * noise  # and it says no more than the noise
