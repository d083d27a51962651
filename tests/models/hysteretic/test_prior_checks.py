"""Priors and values that a hysteretic model cannot have are refused, wherever they come from; the tail of a normal prior is not."""

import re

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.models.hysteretic.prior_checks import unstable_share

RECORD = si.GroundMotion.synthetic(seed=3).trim(3.0, 5.0)
KNOWN = dict(mass=12_000.0, damping_ratio=0.03, stiffness=7.6e6, alpha=0.05, beta=60.0, gamma_ratio=0.5)
MEASURED = si.Observation(RECORD, np.sin(RECORD.time))


def posterior(**priors):
    space = si.ParameterSpace(**priors)
    known = {name: value for name, value in KNOWN.items() if name not in priors}
    return si.Posterior(space, si.BoucWen(**known, free=space.names), MEASURED)


@pytest.mark.parametrize(
    ("prior", "words"),
    [
        (dict(stiffness=si.Normal(7.0, 1.0, unit="kg")), "unit of the prior of 'stiffness'.*kg"),
        (dict(mass=si.Normal(12.0, 1.0, unit="kN")), "unit of the prior of 'mass'.*kN"),
        (dict(stiffness=si.Uniform(-1e6, 8e6)), "stiffness.*11% of the prior lies outside 0 and above"),
        (dict(alpha=si.Uniform(0.0, 2.0)), "alpha.*50% of the prior lies outside 0 to 1"),
        (dict(damping_ratio=si.Normal(0.0, 0.02)), "damping_ratio.*50% of the prior lies outside"),
        (dict(beta=si.Uniform(-60.0, 60.0)), "beta.*50% of the prior lies outside"),
        (dict(beta=si.Uniform(40.0, 60.0, unit="kg")), "unit of the prior of 'beta'.*kg"),
    ],
)
def test_priors_that_are_not_physical(prior, words):
    with pytest.raises(InputError, match=words):
        posterior(**prior)


@pytest.mark.parametrize(
    ("exponent", "unit", "factor"), [(1.0, "1/mm", 1e3), (2.0, "1/mm^2", 1e6), (1.5, "1/m^1.5", 1.0)]
)
def test_shapes_are_in_a_power_of_length_that_goes_with_the_exponent(exponent, unit, factor):
    space = si.ParameterSpace(beta=si.Uniform(0.05, 0.07, unit=unit))
    model = si.BoucWen(**{k: v for k, v in KNOWN.items() if k != "beta"}, exponent=exponent, free=("beta",))
    assert si.Posterior(space, model, MEASURED).factors[0] == pytest.approx(factor)
    wrong = si.ParameterSpace(beta=si.Uniform(0.05, 0.07, unit="1/m^3"))
    wanted = "'1/m'" if exponent == 1.0 else f"1/m^{exponent:g}"
    with pytest.raises(InputError, match=rf"unit of the prior of 'beta'.*{re.escape(wanted)}"):
        si.Posterior(wrong, model, MEASURED)


def test_shapes_of_an_unknown_exponent_are_plain_numbers():
    """1/mm would make them 1000 times as large, or a million times."""
    shapes = dict(exponent=si.Uniform(1.0, 2.0))
    assert posterior(beta=si.Uniform(40.0, 60.0), **shapes).dimension == 3
    with pytest.raises(InputError, match=r"unit of the prior of 'beta'.*unknown or varies"):
        posterior(beta=si.Uniform(0.04, 0.06, unit="1/mm"), **shapes)
    own = dict(KNOWN, exponent=(1.0, 2.0), beta=60.0)
    frame = si.ShearFrame(storeys=2, **{**own, "beta": None}, free=("beta_1", "beta_2"), channels=("displacement_2",))
    space = si.ParameterSpace(beta_1=si.Uniform(40.0, 60.0, unit="1/m"), beta_2=si.Uniform(40.0, 60.0, unit="1/m^2"))
    assert (
        si.Posterior(space, frame, si.Observation(RECORD, np.sin(RECORD.time), channels=("displacement_2",))).dimension
        == 3
    )


def test_the_tail_of_a_normal_prior_is_nobodys_mistake():
    assert posterior(stiffness=si.Normal(7.4, 2.0, unit="kN/mm")).dimension == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("alpha", 1.2),
        ("alpha", -0.1),
        ("damping_ratio", -0.03),
        ("mass", -1.0),
        ("stiffness", -1.0),
        ("beta", -3.0),
        ("delta_nu", -0.01),
        ("amplitude", 0.0),
        ("zeta0", -0.1),
    ],
)
def test_values_that_are_not_physical(name, value):
    with pytest.raises(InputError, match=f"{name}.*{value:g}".replace("-", ".")):
        si.BoucWen(**KNOWN | {name: value})
    with pytest.raises(InputError, match=f"{name}.*{value:g}".replace("-", ".")):
        si.ShearFrame(storeys=2, **KNOWN | {name: value})


def test_the_same_measurement_twice():
    space = si.ParameterSpace(stiffness=si.Normal(7.4e6, 1e5))
    model = si.BoucWen(**{n: v for n, v in KNOWN.items() if n != "stiffness"}, free=("stiffness",))
    with pytest.raises(InputError, match="observation 2: it repeats the measurement of observation 1"):
        si.Posterior(space, model, [MEASURED, si.Observation(RECORD, np.sin(RECORD.time))])
    assert si.Posterior(space, model, [MEASURED, si.Observation(RECORD, np.cos(RECORD.time))]).dimension == 3


def test_where_gamma_exceeds_beta_the_response_need_not_stay_bounded():
    one, two = dict(storeys=2, **KNOWN), dict(storeys=2, **KNOWN | {"gamma_ratio": (0.5, -2.0)})
    space = si.ParameterSpace(gamma_ratio_2=si.Uniform(-1.0, 3.0), mass=si.Normal(12e3, 1.0))
    assert unstable_share(space, si.ShearFrame(**one, free=("gamma_ratio_2",))) == pytest.approx(0.5, abs=0.01)
    none = si.ParameterSpace(alpha=si.Uniform(0.0, 1.0))
    assert unstable_share(none, si.ShearFrame(**one)) == 0.0 and unstable_share(none, si.ShearFrame(**two)) == 1.0
    gamma = {n: v for n, v in KNOWN.items() if n not in ("gamma_ratio", "beta")} | {"gamma": 61.0}
    betas = si.ParameterSpace(beta=si.Uniform(41.0, 81.0))
    assert unstable_share(betas, si.BoucWen(**gamma, free=("beta",))) == pytest.approx(0.5, abs=0.01)
    with pytest.warns(si.StructidWarning, match="50% of the prior .gamma. exceeds beta"):
        posterior(gamma_ratio=si.Uniform(-1.0, 3.0))


def test_an_acceleration_is_that_of_a_sensor():
    with pytest.raises(InputError, match=r"'acceleration'.*A sensor on the structure measures 'absolute_acceleration'"):
        si.BoucWen(**KNOWN, channels=("acceleration",))
    frame = dict(KNOWN, storeys=2, channels=("acceleration_2",))
    with pytest.raises(InputError, match="A sensor on the structure measures 'absolute_acceleration_2'"):
        si.ShearFrame(**frame)


def test_a_share_in_per_cent_is_told():
    with pytest.raises(InputError, match=r"damping_ratio: 3\. Expected: 0 to 1\. For 3 %, give 0\.03"):
        si.BoucWen(**KNOWN | {"damping_ratio": 3.0})
