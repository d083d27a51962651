"""A misspelt argument is answered with the nearest name; what is printed well is shown well in a notebook."""

import numpy as np
import pytest

import structid as si
from structid.errors import InputError

RECORD = si.GroundMotion.synthetic(seed=3).trim(3.0, 5.0)


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
        (lambda: si.Observation(RECORD, np.zeros((len(RECORD), 0)), channels=()), "channels: none"),
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
        assert shown._repr_html_().startswith("<pre>") and "stiffness" in str(result.summary())
    table = result.summary().to_pandas()
    assert (
        list(table.index) == list(result.names) and table.loc["stiffness", "unit"] == result.target.units["stiffness"]
    )
    tree = result.to_datatree()
    for group in ("observed_data", "posterior_predictive"):
        assert tree[group]["y"].attrs["unit"] == "m/s" and tree[group].attrs["inference_library"] == "structid"
    assert "unit" not in tree["log_likelihood"]["y"].attrs
