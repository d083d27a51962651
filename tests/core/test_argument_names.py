"""A misspelt argument is answered with the nearest name; what is printed well is shown well in a notebook."""

import inspect

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError

RECORD = si.GroundMotion.synthetic(seed=3).trim(3.0, 5.0)


MADE_BY_STRUCTID = (
    *(
        "Certificate",
        "Design",
        "HybridResult",
        "ParameterSpace",
        "ProgrammeResult",
        "Runs",
        "SamplingResult",
        "Specimen",
    ),
    *("Status", "Term"),
)
"""Classes of results, the space, whose arguments have the users' names, and what others implement."""
CALLED_WITH_NAMES = [
    *(si.GroundMotion.read, si.GroundMotion.synthetic, si.GroundMotion.lowpass, si.GroundMotion.trim),
    *(si.GroundMotion.scale_to_pga, si.GroundMotion.response_spectrum, si.Histories.plot, si.Histories.to_csv),
    *(si.BoucWen.simulate, si.Campaign.run, si.ParameterSpace.sample, si.SamplingResult.to_netcdf, si.PCNARX.fit),
    *(si.optimize.pattern_search, si.optimize.interior_point),
]


def public_callables():
    for name in dir(si):
        value = getattr(si, name)
        if name in MADE_BY_STRUCTID or not callable(value) or inspect.ismodule(value):
            continue
        if not (isinstance(value, type) and issubclass(value, BaseException)):
            yield value
    yield from CALLED_WITH_NAMES


@pytest.mark.parametrize("function", list(public_callables()), ids=lambda f: f.__qualname__)
def test_every_public_name_refuses_an_argument_that_it_does_not_have(function):
    with pytest.raises(InputError, match=r"\(nothing_of_the_kind\): this argument does not exist. Expected: \w+"):
        function(nothing_of_the_kind=1)


SPACE = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"))
MODEL = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.06, beta=60.0, gamma=60.0, free=SPACE.names)
MEASURED = si.Observation(RECORD, RECORD.values, channels=("velocity",))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: si.calibrate(SPACE, MODEL, MEASURED),
            r"calibrate\(model\): a ParameterSpace\. Expected: a model such as",
        ),
        (
            lambda: si.calibrate(MODEL, SPACE, MEASURED, "pod_kriging"),
            r"calibrate\(surrogate\): the string 'pod_kriging'",
        ),
        (
            lambda: si.Posterior(SPACE, MODEL, RECORD.values),
            r"Posterior\(observations\): an array\. Expected: a structid.Obs",
        ),
        (
            lambda: si.Observation(RECORD.values, RECORD),
            r"Observation\(record\): an array\. Expected: a structid\.GroundMotion",
        ),
        (lambda: MODEL.simulate({"stiffness": 7e6}, RECORD), r"parameters: values by name.*columns stiffness"),
        (
            lambda: si.ParameterSpace(a=scipy.stats.norm(1.0, 2.0)),
            r"ParameterSpace\(a\): SciPy's norm.*structid\.Uniform",
        ),
        (lambda: si.Posterior(SPACE, MODEL, [MEASURED, 3.0]), r"Posterior\(observations\): a float"),
        (lambda: si.Posterior(SPACE, MODEL, MEASURED, "ar1"), r"Posterior\(discrepancy\): the string 'ar1'.*AR1"),
        (lambda: si.sample(si.AIES(), MODEL), r"sample\(target\): an AIES\. Expected: a structid.Posterior"),
    ],
)
def test_a_value_of_another_kind(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_what_is_left_out_is_told():
    with pytest.raises(InputError, match=r"GroundMotion: missing dt\. Expected: GroundMotion\(values, dt, …\)"):
        si.GroundMotion(RECORD.values)
    with pytest.raises(InputError, match=r"Posterior: missing model and observations"):
        si.Posterior(SPACE)


def test_what_is_given_is_shown_in_a_line():
    assert str(MEASURED).startswith(f"Observation: {len(RECORD)} samples of velocity, at most ")
    assert str(si.Posterior(SPACE, MODEL, MEASURED)) == "Posterior of stiffness, sigma2"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: RECORD.scale_to_pga("0.2 g"), r"scale_to_pga\(pga\): the string '0.2 g'. Expected: a number.*help\("),
        (lambda: si.sample(None, seed="a"), r"sample\(seed\): the string 'a'"),
        (lambda: si.Uniform("1 kN", 2.0), r"Uniform\(low\): the string '1 kN'"),
        (lambda: RECORD.lowpass(edge="20"), r"lowpass\(edge\): the string '20'"),
    ],
)
def test_a_text_in_the_place_of_a_number(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: si.AIES(walker=30), r"AIES\(walker\).*Did you mean 'walkers'"),
        (lambda: si.SMC(particels=30), r"SMC\(particels\).*Did you mean 'particles'"),
        (lambda: si.NUTS(chain=3), r"NUTS\(chain\).*Did you mean 'chains'"),
        (lambda: si.BoucWen(mas=3.0), r"BoucWen\(mas\).*Did you mean 'mass'"),
        (lambda: si.ShearFrame(storey=3), r"ShearFrame\(storey\).*Did you mean 'storeys'"),
        (lambda: si.IID(varianc=3.0), r"IID\(varianc\).*Did you mean 'variance'"),
        (lambda: si.Observation(RECORD, RECORD.values, chanels=("velocity",)), r"Did you mean 'channels'"),
        (lambda: si.Observation(RECORD, np.zeros((len(RECORD), 0)), channels=()), "channels: no channels"),
        (lambda: si.NARX().fit(np.zeros(100), np.zeros(100)), r"NARX.fit\(excitations\).*ForceHistory"),
        (lambda: si.AIES(differential_evolution=1.8), "differential_evolution: 1.8"),
    ],
)
def test_one_sentence_instead_of_a_traceback(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_draws_that_no_machine_can_hold():
    target = si.LogDensity(lambda x: -(x[:, 0] ** 2), ("x",), si.ParameterSpace(x=si.Normal(0.0, 1.0)))
    with pytest.raises(InputError, match=r"10000000 walkers, whose draws take [\d,]+ GB"):
        si.sample(target, si.AIES(walkers=10**7))


def test_results_in_a_notebook_and_as_tables(short_posterior):
    result = si.sample(short_posterior, si.SMC(particles=40, ensembles=2, steps=5, effective_share=0.5), seed=1)
    for shown in (result.summary(), result.verdict(), short_posterior.space):
        assert shown._repr_html_().startswith("<pre ") and "stiffness" in str(result.summary())
    table = result.summary().to_pandas()
    assert (
        list(table.index) == list(result.names) and table.loc["stiffness", "unit"] == result.target.units["stiffness"]
    )
    tree = result.to_datatree()
    for group in ("observed_data", "posterior_predictive"):
        assert tree[group]["y"].attrs["unit"] == "m/s" and tree[group].attrs["inference_library"] == "structid"
    assert "unit" not in tree["log_likelihood"]["y"].attrs
    assert all(group.attrs["inference_library"] == "structid" for group in tree.subtree)
    for group in ("prior", "posterior"):
        said = {"unit": "N/m", "units": "N/m", "display_unit": "kN/mm", "display_factor": 1e6}
        assert tree[group]["stiffness"].attrs == said
    assert tree["constant_data"]["excitation"].attrs["unit"] == "m/s**2"
    assert tree["posterior"].sizes == {"chain": 2, "draw": 200}  # particles of an ensemble, one after the other
    first = result.kept[:, 0, 0, 0]  # the moves of one particle
    np.testing.assert_array_equal(tree["posterior"]["stiffness"].values[0, : len(first)], first)
    assert str(result).startswith(str(result.verdict())) and str(result.summary()) in str(result)


def test_too_many_arguments_without_names_are_refused():
    with pytest.raises(
        InputError, match=r"ParameterSpace: 2 arguments without a name.*at most 1.*correlation, derived"
    ):
        si.ParameterSpace({"a": si.Normal(0.0, 1.0)}, {})
    with pytest.raises(InputError, match=r"IID: 9 arguments without a name"):
        si.IID(*range(9))
