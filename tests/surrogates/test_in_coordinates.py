"""Surrogates in coordinates: functions of the parameters on which the response depends more simply."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.surrogates.in_coordinates import InCoordinates, fitted_in_coordinates

PRIORS = dict(energy=si.Uniform(1.0, 10.0), strength=si.Uniform(0.5, 2.0))
COORDINATES = {"log_stiffness": "log(strength**2 / energy)", "log_strength": "log(strength)"}
SPACE = si.ParameterSpace(coordinates=COORDINATES, **PRIORS)
RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)


def outputs(theta):
    """Linear in the coordinates, and far from it in the parameters."""
    stiffness, strength = np.log(theta[:, 1] ** 2 / theta[:, 0]), np.log(theta[:, 1])
    return np.stack([stiffness + 0.3 * strength, np.sin(1.5 * stiffness)], axis=1)


@pytest.mark.parametrize("settings", [si.Kriging(), si.PCE(degree=6)])
def test_they_are_fitted_better(settings):
    design, unseen = SPACE.sample(60, seed=1), SPACE.sample(200, seed=2)
    within = fitted_in_coordinates(
        design, lambda d: settings.fit(d, outputs(d.values if d is design else design.values))
    )
    plain = settings.fit(si.Design(design.values, si.ParameterSpace(**PRIORS)), outputs(design.values))
    truth = outputs(unseen.values)
    errors = [np.abs(np.asarray(r.predict(unseen.values)) - truth).max() for r in (within, plain)]
    assert isinstance(within, InCoordinates) and errors[0] < 0.1 * errors[1]


def test_a_surrogate_in_them_saved_and_read_again(tmp_path):
    """As good in lanes as on the host, and to the last bit from a file; the space says what its coordinates are."""
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.3, free=("stiffness", "alpha"))
    space = si.ParameterSpace(
        coordinates={"log_stiffness": "log(stiffness)", "alpha_too": "alpha"},
        stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"),
        alpha=si.Uniform(0.02, 0.1),
    )
    runs = si.Campaign(model, RECORD, space.sample(40, seed=1)).run()
    for settings in (si.PODKriging(), si.PODPCE()):
        surrogate = settings.fit(runs)
        again = si.load_surrogate(surrogate.save(tmp_path / "one.h5"))
        points = space.sample(20, seed=2)
        np.testing.assert_array_equal(again.simulate(points, RECORD).values, surrogate.simulate(points, RECORD).values)
        assert again.space.coordinates == ("log_stiffness", "alpha_too")
        error = np.abs(surrogate.simulate(points, RECORD).values - model.simulate(points, RECORD).values).max()
        assert error < 1e-2 * np.abs(runs.values).max()
    measured = model.simulate([[7.5e6, 0.05]], RECORD).values[0]
    of = si.Posterior(
        space, si.PODKriging().fit(runs), si.Observation(RECORD, measured, ("velocity",)), refuse_unfit=False
    )
    assert of.in_lanes and np.isfinite(of.log_density(np.array([[7.4e6, 0.06, 1e-6]])))


@pytest.mark.parametrize(
    "settings",
    [
        si.PCNARX(degree=2, steps=2),
        si.KrigingNARX(degree=1, steps=2, refinements=1),
        si.PCNARX(training="per-experiment"),
    ],
)
def test_coefficients_of_a_narx_are_functions_of_them(tmp_path, settings):
    """Fitted in coordinates it is the one whose parameters are these; saved and in lanes it is the same."""
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.3, free=("stiffness", "alpha"))
    space = si.ParameterSpace(
        coordinates={"log_stiffness": "log(stiffness)", "alpha_too": "alpha"},
        stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"),
        alpha=si.Uniform(0.02, 0.1),
    )
    runs = si.Campaign(model, RECORD, space.sample(24, seed=1)).run()
    surrogate = settings.fit(runs)
    values = space.in_coordinates(runs.design.values)
    low, high = values.min(axis=0), values.max(axis=0)
    plain = si.ParameterSpace(log_stiffness=si.Uniform(low[0], high[0]), alpha_too=si.Uniform(low[1], high[1]))
    of_them = settings.fit(si.Runs.from_histories(si.Design(values, plain), runs.histories(), RECORD))
    points = space.sample(6, seed=2).values
    found = surrogate.simulate(points, RECORD).values
    there = of_them.simulate(np.asarray(space.in_coordinates(points)), RECORD).values
    np.testing.assert_allclose(found, there, rtol=1e-6, atol=1e-9 * np.abs(there).max())
    again = si.load_surrogate(surrogate.save(tmp_path / "one.h5"))
    np.testing.assert_array_equal(again.simulate(points, RECORD).values, found)


def test_a_warm_start_knows_them():
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.3, alpha=0.05, free=("stiffness",))
    space = si.ParameterSpace(coordinates={"log_stiffness": "log(stiffness)"}, stiffness=si.Uniform(6.5e6, 8.5e6))
    few, more = (si.Campaign(model, RECORD, space.sample(n, seed=n)).run() for n in (12, 24))
    assert si.PODKriging().fit(more, start=si.PODKriging().fit(few)).fitted.error < 0.05


def test_what_is_no_coordinate():
    with pytest.raises(InputError, match=r"coordinate 'k'.*'strenght' in.*Did you mean 'strength'"):
        si.ParameterSpace(coordinates={"k": "log(strenght)"}, **PRIORS)
    space = si.ParameterSpace(coordinates={"k": "strength / strength"}, **PRIORS)
    with pytest.raises(InputError, match=r"coordinate 'k'.*a finite coordinate that varies"):
        fitted_in_coordinates(space.sample(10, seed=1), lambda d: si.Kriging().fit(d, d.values[:, 0]))
    assert si.ParameterSpace.from_plain(SPACE.to_plain()).content_hash == SPACE.content_hash
    assert SPACE.content_hash != si.ParameterSpace(**PRIORS).content_hash
