"""What runs teach of somebody's draws: good ones with bad tails pass, others do not; modes that they lack are searched for."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.certification.external import hidden_modes
from structid.certification.external.fitted_density import FittedDensity
from structid.certification.external.kriged_density import (
    CORRELATIONS,
    KrigedDensity,
    in_parameters,
    normal_by,
    standardised_by,
)
from structid.probability.bijections import Bijection

NAMES = ("a", "b", "c")
SPACE = si.ParameterSpace(**{n: si.Normal(0.0, 3.0) for n in NAMES})
PRIOR = [(-np.inf, np.inf)] * 3
SEED = 0


def target(log_density):
    return si.LogDensity(log_density, NAMES, SPACE, dict(zip(NAMES, PRIOR, strict=True)))


def bent(x):
    """A normal density, bent."""
    y = np.column_stack([x[:, 0], x[:, 1] - 0.15 * x[:, 0] ** 2, x[:, 2]])
    return scipy.stats.norm.logpdf(y).sum(axis=1)


def of_bent(count, seed):
    y = np.random.default_rng(seed).standard_normal((count, 3))
    return np.column_stack([y[:, 0], y[:, 1] + 0.15 * y[:, 0] ** 2, y[:, 2]])


def rough(x):
    """The same with ripples of a tenth of a nat, as a fit of few runs has, and tails of half a nat too little at three widths."""
    return bent(x) + 0.25 * np.sin(2.0 * x[:, 0]) * np.cos(1.7 * x[:, 2]) - 0.002 * (x[:, 2] ** 2) ** 2


def of_rough(count, seed):
    """By rejection from the bent law."""
    some = of_bent(4 * count, seed)
    accepted = np.random.default_rng(seed + 100).uniform(size=len(some)) < np.exp(rough(some) - bent(some) - 0.25)
    return some[accepted][:count]


def test_good_draws_with_rough_weights_pass_when_the_runs_have_taught_enough():
    """Ripples that move no mean: weights alone would ask for a χ that is half as large."""
    rng = np.random.default_rng(SEED)
    known = 2.0 * rng.standard_normal((120, 3))
    found = si.certify(
        target(bent),
        of_rough(6000, SEED),
        rough,
        true_runs=60,
        known=(known, bent(known)),
        limits=si.Limits(0.15, 0.15),
        seed=SEED,
    )
    assert found.certified and found.correction is not None, str(found)
    assert np.abs(found.correction.mean).max() < 0.1 and found.true_runs <= 62 + 10 + 30
    assert "relative to a density fitted to the runs" in str(found)


def test_what_the_runs_teach_of_wrong_draws_is_how_wrong_they_are():
    moved = np.array([0.3, 0.0, 0.0])
    known = 2.0 * np.random.default_rng(SEED).standard_normal((80, 3))
    found = si.certify(
        target(bent), of_bent(6000, SEED) + moved, lambda x: bent(x - moved), known=(known, bent(known)), seed=SEED
    )
    assert not found.certified
    assert found.correction is not None
    assert found.correction.mean[0] == pytest.approx(-0.3, abs=0.05)
    assert found.true_runs <= 32 + 5  # it teaches no further: this law is not to be certified


def correlated(x):
    """Standard normal parameters, two of which have a correlation of 0.3."""
    return scipy.stats.multivariate_normal.logpdf(x, np.zeros(3), [[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0]])


def test_draws_that_ignore_a_correlation_are_refused():
    """The runs teach that all means and standard deviations are right, and what is wrong."""
    draws = np.random.default_rng(SEED).standard_normal((4000, 3))
    known = 2.0 * np.random.default_rng(SEED + 50).standard_normal((80, 3))
    found = si.certify(
        target(correlated),
        draws,
        lambda x: scipy.stats.norm.logpdf(x).sum(axis=1),
        known=(known, correlated(known)),
        seed=SEED,
    )
    assert not found.certified and found.correction is not None
    assert found.correction.correlation[0, 1] == pytest.approx(0.3, abs=0.05)
    assert np.abs(found.correction.sd - 1.0).max() < 0.05
    assert any("the correlation of a and b" in reason for reason in found.reasons), str(found)


def test_a_run_that_no_other_one_foretells_is_not_learnt_away():
    """A heavy spike among the draws, as narrow as a fiftieth of them: a Kriging goes through any run."""
    top = np.array([1.5, 0.3, -1.0])

    def spiked(x):
        return np.logaddexp(bent(x), scipy.stats.norm.logpdf(x, top, 0.02).sum(axis=1))

    known = np.concatenate([2.0 * np.random.default_rng(SEED).standard_normal((80, 3)), top[None]])
    found = si.certify(target(spiked), of_rough(6000, SEED), rough, known=(known, spiked(known)), seed=SEED)
    assert not found.certified and "exceeds the drawn density by" in str(found), str(found)


def test_what_lies_beyond_the_draws_is_told():
    """Draws of half the width: where most of the posterior is, no fresh draw comes."""
    known = 2.0 * np.random.default_rng(1).standard_normal((120, 3))
    narrow = 0.5 * np.random.default_rng(2).standard_normal((6000, 3))
    density = lambda x: scipy.stats.norm.logpdf(x, 0.0, 0.5).sum(axis=1)  # noqa: E731
    found = si.certify(target(bent), narrow, density, known=(known, bent(known)), seed=1)
    assert not found.certified and "of the posterior lies beyond the draws" in str(found), str(found)


def two_modes(x):
    here, there = scipy.stats.norm.logpdf(x, 1.5, 0.3).sum(axis=1), scipy.stats.norm.logpdf(x, -1.5, 0.3).sum(axis=1)
    return np.logaddexp(here, there)


@pytest.mark.slow
def test_a_mode_that_no_draw_has_visited_is_searched_for():
    """The prior's draws that a few known runs do not rule out are run; the runs that somebody has made there help."""
    rng = np.random.default_rng(SEED)
    some = rng.normal(1.5, 0.3, (6000, 3))
    known = SPACE.sample(60, SEED).values
    density = lambda x: scipy.stats.norm.logpdf(x, 1.5, 0.3).sum(axis=1)  # noqa: E731
    options = {"true_runs": 60, "known": (known, two_modes(known)), "seed": SEED}
    unseen = si.certify(target(two_modes), some, density, searches=0, **options)
    near = np.linalg.norm(known + 1.5, axis=1) < 1.3  # a known run within reach of it says so itself
    assert unseen.certified == (not near.any()), str(unseen)
    found = si.certify(target(two_modes), some, density, searches=20, **options)
    assert not found.certified and "exceeds the drawn density" in str(found), str(found)


def test_a_search_that_finds_nothing_takes_no_certificate_away():
    found = si.certify(target(bent), of_bent(6000, SEED), bent, searches=10, seed=SEED)
    assert found.certified and found.true_runs <= 31 + 2 * 10


@pytest.mark.parametrize("near", [0.0, 1e9])
def test_a_search_that_has_come_near_to_something_goes_on(monkeypatch, near):
    monkeypatch.setattr(hidden_modes, "NEAR", near)
    monkeypatch.setattr(hidden_modes, "HOPELESS", -np.inf)
    found = si.certify(target(bent), of_bent(6000, 1), bent, searches=3, seed=1)
    assert found.searched == (6 if near else 3)


@pytest.mark.parametrize("word", ["searches", "teaching"])
def test_numbers_of_runs(word):
    with pytest.raises(si.InputError, match=rf"certify\({word}\).*0 or more"):
        si.certify(target(bent), of_bent(500, 1), bent, **{word: -1})


@pytest.mark.parametrize(
    "known", [(np.zeros((5, 2)), np.zeros(5)), (np.zeros((5, 3)), np.zeros(4)), (np.zeros(5), np.zeros(5))]
)
def test_known_runs_of_another_shape(known):
    with pytest.raises(si.InputError, match=r"certify\(known\).*as the posterior computes them"):
        si.certify(target(bent), of_bent(500, 1), bent, known=known)


@pytest.mark.parametrize("constant", [0.5, -7.0])
def test_known_log_densities_without_a_constant(constant):
    """Such as log-likelihoods, or what another program has normalised."""
    known = 2.0 * np.random.default_rng(1).standard_normal((40, 3))
    with pytest.raises(
        si.InputError,
        match=r"certify\(known\): a log density of .* at the best of 40 points, where the posterior gives",
    ):
        si.certify(target(bent), of_bent(500, 1), bent, known=(known, bent(known) + constant))


# --- the Kriging of a log density --------------------------------------------------------------------------------------


@pytest.mark.parametrize("correlation", CORRELATIONS)
def test_errors_fall_with_the_runs(correlation):
    """Of a log density that no trend holds."""
    other = of_bent(400, 9)
    errors = []
    for count in (40, 160):
        phi = of_bent(count, 5)
        kriged = KrigedDensity.fitted(standardised_by(phi), correlation, phi, rough(phi))
        errors.append(np.sqrt(np.mean((kriged.at(other)[0] - rough(other)) ** 2)))
        np.testing.assert_allclose(kriged.at(phi)[0], rough(phi), atol=1e-3)
    assert errors[1] < 0.5 * errors[0]


def test_charts():
    """All three give the same density back; near a bound that of the parameters is best."""
    bijection = Bijection(np.array([[0.0, 1.0], [-np.inf, np.inf], [-np.inf, np.inf]]))
    rng = np.random.default_rng(2)
    theta = np.column_stack([rng.beta(1.0, 0.6, 90), rng.standard_normal((90, 2))])
    phi = bijection.inverse(theta)
    values = -2.0 * theta[:, 0] ** 2 - 0.5 * (theta[:, 1:] ** 2).sum(axis=1) + bijection(phi)[1]
    fitted = FittedDensity.of(phi, rng)
    charts = {"parameters": in_parameters(bijection, theta), "φ": standardised_by(phi), "normal": normal_by(fitted)}
    errors = {w: KrigedDensity.fitted(c, "gaussian", phi, values).error(np.ones(90)) for w, c in charts.items()}
    assert min(errors, key=errors.get) == "parameters" and errors["parameters"] < 0.1 * errors["φ"], errors
    chosen = KrigedDensity.best([(c, "gaussian") for c in charts.values()], phi, values, np.ones(90))
    assert chosen.chart is charts["parameters"]


def test_left_out_runs_are_not_known():
    phi = of_bent(80, 3)
    values = bent(phi)
    values[5] += 3.0  # a run that is wrong
    whole = KrigedDensity.fitted(standardised_by(phi), "matern52", phi, values)
    left = whole.without(np.array([5]))
    assert len(left.phi) == 79
    assert abs(whole.at(phi[5:6])[0][0] - values[5]) < 0.05 and abs(left.at(phi[5:6])[0][0] - values[5]) > 1.0
    sure = left.believing(phi[5:6], left.at(phi[5:6])[0])
    assert sure.at(phi[5:6])[1][0] < 0.7 * left.at(phi[5:6])[1][0]
