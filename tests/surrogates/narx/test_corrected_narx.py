"""A NARX for any record, and a POD-Kriging that responds to the records whose runs are known."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.surrogates.surrogate_list import load_surrogate
from structid.surrogates.surrogate_validation import relative_errors

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.42, 0.5, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-0.5, 1.0)
)
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names)
RECORD, OTHER = (si.GroundMotion.synthetic(seed=seed).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(3.0) for seed in (8, 9))
NARX = si.PCNARX(degree=1, steps=4)
SETTINGS = si.CorrectedNARX(NARX)


@pytest.fixture(scope="module")
def runs():
    return si.Campaign(MODEL, RECORD, SPACE.sample(40, seed=1, method="sobol", widen=1.4)).run()


@pytest.fixture(scope="module")
def unseen():
    return SPACE.sample(30, seed=2, method="random")


@pytest.fixture(scope="module")
def fitted(runs):
    return SETTINGS.fit(runs)


def mean_error(surrogate, design, record=RECORD):
    return relative_errors(MODEL.simulate(design, record).values, surrogate.simulate(design, record).values).mean()


def test_it_comes_through_its_runs(fitted, runs):
    # Its components leave out 1e-8 of the variance.
    assert mean_error(fitted, runs.design) < 1e-8 < 1e-2 * mean_error(fitted.narx, runs.design)


def test_on_the_records_of_its_runs_it_is_better_than_the_narx_alone(fitted, unseen):
    alone = mean_error(fitted.narx, unseen)
    together = mean_error(fitted, unseen)
    assert together < 0.3 * alone
    assert 0.1 < fitted.fitted.error / together < 20.0  # left out in turn, the ends of a wide design err most


def test_to_another_record_the_narx_responds_alone(fitted, unseen):
    theirs, spread = fitted.narx.predict(unseen, OTHER, return_std=True)
    ours, own = fitted.predict(unseen, OTHER, return_std=True)
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-12)
    np.testing.assert_allclose(own, spread, rtol=1e-12)
    theta = fitted.parameters(unseen)
    draws = [s.sampled(theta, OTHER, np.random.default_rng(1)) for s in (fitted, fitted.narx)]
    np.testing.assert_allclose(*draws, rtol=1e-12)
    variances = [
        s.error_variance(theta, s.traced(OTHER), ours.values.transpose(1, 2, 0)) for s in (fitted, fitted.narx)
    ]
    np.testing.assert_allclose(*variances, rtol=1e-12)


def test_its_standard_deviation_is_that_of_the_kriging(fitted, unseen):
    found, spread = fitted.predict(unseen, RECORD, return_std=True)
    error = (found.values - MODEL.simulate(unseen, RECORD).values) / spread
    assert 0.3 < np.sqrt(np.mean(error**2)) < 2.0
    theta = np.tile(fitted.parameters(unseen)[:1], (2000, 1))
    drawn = fitted.sampled(theta, RECORD, np.random.default_rng(1))
    np.testing.assert_allclose(drawn.mean(axis=0), found.values[0], atol=5.0 * spread[0].max() / np.sqrt(2000.0))
    # What the components leave out is not drawn.
    assert drawn.std(axis=0).max() == pytest.approx(spread[0].max(), rel=0.1)


def test_what_it_says_of_a_run_that_is_left_out(fitted, runs):
    """By the formula; and by a fit to the others, with the correlation lengths of that fit."""
    predicted = fitted.left_out(runs.design.values, RECORD)
    others = runs[np.arange(len(runs)) != 5]
    refitted = SETTINGS.fit(others).simulate(runs.design[5:6], RECORD).values[0]
    scale = np.sqrt(np.mean((predicted - runs.values) ** 2))
    assert np.sqrt(np.mean((predicted[5] - refitted) ** 2)) < 2.0 * scale


def test_on_the_records_of_its_runs_it_is_the_kriging(fitted, runs, unseen):
    pod = si.PODKriging().fit(runs)
    theta = fitted.parameters(unseen)
    np.testing.assert_allclose(
        fitted.simulate(unseen, RECORD).values, pod.simulate(unseen, RECORD).values, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(
        fitted.sampled(theta, RECORD, np.random.default_rng(1)), pod.sampled(theta, RECORD, np.random.default_rng(1))
    )
    measured = si.Observation(RECORD, MODEL.simulate([[7.2e6, 0.3]], RECORD).values[0, :, 0])
    errors = si.IID(variance=1e-4)
    points = SPACE.sample(20, seed=4).values
    ours, theirs = (si.Posterior(SPACE, s, measured, errors).log_density(points) for s in (fitted, pod))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_a_surrogate_of_the_same_runs_lends_its_narx(fitted, runs):
    form = replace(SETTINGS, kriging=si.PODKriging(kriging=si.Kriging(correlation="gaussian")))
    assert form.fit(runs, start=fitted).narx is fitted.narx
    assert form.fit(runs[:35], start=fitted).narx is not fitted.narx


def test_it_is_read_again(fitted, runs, unseen, tmp_path):
    again = load_surrogate(fitted.save(tmp_path / "surrogate.h5"))
    for record in (RECORD, OTHER):
        np.testing.assert_array_equal(again.simulate(unseen, record).values, fitted.simulate(unseen, record).values)
    assert again.content_hash == fitted.content_hash and str(again) == str(fitted)
    assert SETTINGS.fit(runs).content_hash == fitted.content_hash
    assert again.structure_in_words == fitted.structure_in_words and RECORD.name in again.structure_in_words[-1][1]


def test_a_file_of_the_sum_that_an_earlier_version_wrote_is_refused(fitted):
    plain, arrays = fitted.to_plain()
    with pytest.raises(InputError, match=r"a sum of a NARX and a Kriging.* Fit the surrogate to its runs again"):
        type(fitted).from_plain(
            fitted.fitted, {"narx": plain["narx"], "rest": plain["kriging"], "whole": False}, arrays
        )


def test_an_excitation_with_a_lead_in():
    """Periods that are run first and dropped: the Kriging knows the last one."""
    signal = si.ForceHistory(
        2e4 * np.sin(np.arange(300) * 2.0 * np.pi / 100.0), 0.02, interpolation="periodic", lead_in_periods=2
    )
    runs = si.Campaign(MODEL, signal, SPACE.sample(30, seed=1, method="sobol", widen=1.4)).run()
    fitted = SETTINGS.fit(runs)
    found = fitted.simulate(runs.design, signal).values
    assert relative_errors(runs.values, found).mean() < 1e-8
    np.testing.assert_allclose(
        fitted.response(runs.design.values, fitted.traced(signal))[0].transpose(2, 0, 1), found, rtol=1e-9
    )


def test_an_earlier_name_works_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"CorrectedNARX\(rest=…\) is now called"):
        assert si.CorrectedNARX(NARX, rest=si.PODKriging(left_out_energy=1e-7)).kriging.left_out_energy == 1e-7


@pytest.mark.parametrize("other", [si.PODKriging(), si.NARX(), "pc_narx"])
def test_something_that_is_no_narx_of_parameters(other):
    with pytest.raises(InputError, match="a PCNARX or a KrigingNARX"):
        si.CorrectedNARX(other)
