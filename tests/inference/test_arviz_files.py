"""ArviZ reads our netCDF files, before its version 1 and after: cross-validation of the same draws, with our own numbers."""

import arviz
import numpy as np
import pytest

import structid as si
from structid.inference.model_comparison.comparison import leave_out

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def result():
    record = si.GroundMotion.synthetic(seed=8).trim(3.0, 4.0)
    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"))
    model = si.BoucWen(mass=12e3, alpha=0.05, beta=60.0, gamma=30.0, damping_ratio=0.03, free=space.names)
    values = model.simulate([[7.5e6]], record).values[0]
    noise = 0.05 * values.std() * np.random.default_rng(0).standard_normal(values.shape)
    posterior = si.Posterior(space, model, si.Observation(record, values + noise), si.IID())
    return si.sample(posterior, si.SMC(particles=400, ensembles=4, steps=80), seed=1)


def test_cross_validation_of_arviz_is_ours(result, tmp_path):
    """The file with all draws has a hundred thousand beside 300 log-likelihoods, of which ArviZ makes nothing."""
    assert result.draws.shape[:2] == (4, 400 * 80) or result.flat.shape[0] == 4 * 400 * 80
    data = arviz.from_netcdf(result.to_netcdf(tmp_path / "draws.nc", thinned=400))
    draws = data["posterior"]["stiffness"].values
    assert draws.shape[0] == 1 and draws.shape[1] <= 400
    np.testing.assert_array_equal(draws[0], result.thinned(400)[:, 0])
    np.testing.assert_allclose(
        data["sample_stats"]["lp"].values[0], result.target.log_density(result.thinned(400)), rtol=1e-9
    )
    assert data["log_likelihood"]["y"].shape[:2] == draws.shape == data["posterior_predictive"]["y"].shape[:2]
    found = arviz.loo(data)
    ours = leave_out(result.target, result.thinned(400), blocks=data["log_likelihood"]["y"].shape[2])
    elpd = float(getattr(found, "elpd", None) or found["elpd_loo"])
    assert elpd == pytest.approx(ours.value, abs=0.5) and not found.warning
    assert len(arviz.compare({"one": data, "two": data})) == 2
    values = arviz.loo_pit(data, y="y") if hasattr(arviz, "psislw") else arviz.loo_pit(data)["y"].values
    # Of the right model they are uniform: their mean is ½, to five errors of n independent ones.
    assert abs(np.mean(values) - 0.5) < 5.0 * np.sqrt(1.0 / 12.0 / np.size(values))


def test_too_few_draws_are_refused(result):
    with pytest.raises(si.InputError, match="2 draws or more"):
        result.to_datatree(thinned=1)
