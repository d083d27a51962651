"""What a sampling has found: groups of ArviZ's schema, the mode, predictions, warnings."""

import numpy as np

import structid as si
from structid.inference.target import LogDensity


def test_result_speaks_the_arviz_schema(short_posterior, tmp_path):
    import xarray

    result = si.sample(short_posterior, si.AIES(walkers=12, steps=60, ensembles=2), seed=1)
    path = result.to_netcdf(tmp_path / "posterior.nc")
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        groups = {g.strip("/") for g in tree.groups} - {""}
        predictive = {"posterior_predictive", "prior_predictive", "log_likelihood"}
        assert groups == predictive | {"posterior", "prior", "sample_stats", "observed_data", "constant_data"}
        assert tree["posterior"]["stiffness"].dims == ("chain", "draw")
        assert tree["posterior"]["ensemble"].values.tolist() == [0] * 12 + [1] * 12
        np.testing.assert_array_equal(tree["posterior"]["alpha"].values, result.draws[:, :, 3])
        assert tree["posterior_predictive"]["y"].dims == ("chain", "draw", "time", "channel")
    np.testing.assert_array_equal(result.draws[13, :, 0], result.kept[:, 1, 1, 0])


def test_map_is_at_least_the_best_draw_and_predictions_have_bands(short_posterior, short_record):
    result = si.sample(
        short_posterior,
        si.AIES(walkers=12, steps=400, ensembles=2, differential_evolution=0.5, start_candidates=10),
        seed=1,
    )
    at_map = short_posterior.log_density(result.map_estimate[None])[0]
    assert at_map >= result.log_density[result.discarded :].max() - 1e-9
    prediction = result.predict(draws=100)
    assert prediction.response.shape == (len(prediction.response), 601, 1)
    inner, outer = prediction.band(), prediction.band(discrepancy=True)
    assert np.mean(outer[1] - outer[0]) > np.mean(inner[1] - inner[0])
    other = result.predict(short_record.scale(0.5), channels=("displacement", "restoring_force"), draws=50)
    assert other.channels == ("displacement", "restoring_force") and np.isfinite(other.peaks).all()
    # An observable the discrepancy covers: about nine tenths of the measurement lies in its 90 % band.
    y = short_posterior.observations[0].values
    assert np.mean((y > outer[0]) & (y < outer[1])) > 0.8


def test_a_posterior_on_a_bound_of_its_prior():
    """At zero, which physics mostly sets, the data show nothing of the parameter; elsewhere they would go further."""
    space = si.ParameterSpace(a=si.Uniform(0.0, 10.0), b=si.Uniform(1.0, 11.0), c=si.Uniform(0.0, 10.0))
    centre = np.array([0.0, 1.0, 5.0])
    density = LogDensity(
        lambda x: -20.0 * np.abs(x - centre).sum(axis=1),
        "abc",
        lambda n, rng: centre + rng.random((n, 3)),
        {name: marginal.support for name, marginal in space.marginals.items()},
    )
    density.space = space
    warnings = si.sample(density, si.AIES(walkers=40, ensembles=4, steps=8000), seed=1).verdict().warnings
    assert [w for w in warnings if "of a lies at the lower bound" in w and "favour zero" in w]
    assert [w for w in warnings if "of b lies at the lower bound" in w and w.endswith("favour values beyond it")]
    assert len(warnings) == 2  # and nothing of far tails
