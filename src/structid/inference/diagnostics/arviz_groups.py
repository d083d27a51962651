"""Groups of the ArviZ schema: draws and their statistics; for a posterior also its measurement and predictions."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.core.streams import Purpose, derived_seed, stream
from structid.core.units import factor, si_unit
from structid.inference.likelihood.posterior import Posterior

LIBRARY = {
    "inference_library": "structid",
    "inference_library_version": importlib.metadata.version("structid"),
    "creation_library": "structid",
}
"""Attributes of every group, named as in the ArviZ schema."""
EXCITATION_UNITS = {"ground_motion": "m/s**2", "force": "N", "displacement": "m", "rotation": "rad"}
"""SI unit of each kind of excitation; every signal of an excitation has its own kind."""


def groups_of_draws(
    draws: Float[np.ndarray, "chain draw parameter"],
    ensemble: Int[np.ndarray, " chain"],
    statistics: Mapping[str, np.ndarray],
    units: Mapping[str, str],
) -> dict[str, Any]:
    """Groups available for every sampler: the posterior and the statistics of its draws."""
    import xarray

    dims = ("chain", "draw")
    coordinates = {
        "chain": np.arange(len(draws)),
        "draw": np.arange(draws.shape[1]),
        "ensemble": ("chain", ensemble),
    }
    plain = {name: (dims, v) for name, v in statistics.items()}
    return {
        "posterior": xarray.Dataset(_with_units(draws, units), coords=coordinates, attrs=LIBRARY),
        "sample_stats": xarray.Dataset(plain, coords=coordinates, attrs=LIBRARY),
    }


def _with_units(draws: np.ndarray, units: Mapping[str, str]) -> dict[str, Any]:
    """Variables of draws (chain, draw, parameter) in SI, each with its SI unit, its declared unit, and their ratio.

    ``units`` is the netCDF convention's attribute, with which xarray labels the axes of plots.
    """
    return {
        name: (
            ("chain", "draw"),
            draws[:, :, i],
            {"unit": si_unit(unit), "units": si_unit(unit), "display_unit": unit, "display_factor": factor(unit)},
        )
        for i, (name, unit) in enumerate(units.items())
    }


def groups_of_measurement(
    posterior: Posterior, theta: Float[np.ndarray, "draw parameter"], seed: int, predictions: bool
) -> dict[str, Any]:
    """Groups that need a measurement: prior, predictions, observed data, excitation, pointwise log-likelihood."""
    import xarray

    prior = posterior.space.sample(len(theta), derived_seed(seed, Purpose.PRIOR_DRAWS)).values
    draws = {"chain": [0], "draw": np.arange(len(theta))}
    groups: dict[str, Any] = {
        "prior": xarray.Dataset(_with_units(prior[None], posterior.units), coords=draws, attrs=LIBRARY)
    }
    parts: dict[str, dict[str, Any]] = {}
    for index, observation in enumerate(posterior.observations):
        suffix = "" if len(posterior.observations) == 1 else f"_{index + 1}"
        dims = (f"time{suffix}", f"channel{suffix}")
        coords = {dims[0]: observation.time, dims[1]: list(observation.channels)}
        of_record = dims[0] if observation.sampling is None else f"record_{dims[0]}"

        def put(group: str, name: str, values: np.ndarray, dims: tuple[str, ...], coords: dict[str, Any]) -> None:
            parts.setdefault(group, {})[name] = xarray.DataArray(values, dims=dims, coords=coords)

        put("observed_data", f"y{suffix}", observation.values, dims, coords)
        driven = (of_record,) if observation.record.values.ndim == 1 else (of_record, f"signal{suffix}")
        put(
            "constant_data",
            f"excitation{suffix}",
            observation.record.values,
            driven,
            {of_record: observation.record.time},
        )
        if predictions:
            every = ("chain", "draw", *dims)
            put(
                "posterior_predictive",
                f"y{suffix}",
                _observable(posterior, theta, index, seed, Purpose.PREDICTION_ON_THE_RECORD)[None],
                every,
                coords | draws,
            )
            put(
                "prior_predictive",
                f"y{suffix}",
                _observable(posterior, prior, index, seed, Purpose.PREDICTION_FROM_THE_PRIOR)[None],
                every,
                coords | draws,
            )
            put(
                "log_likelihood",
                f"y{suffix}",
                posterior.pointwise_log_likelihood(theta, index)[None],
                every,
                coords | draws,
            )
    for group, variables in parts.items():
        if group != "log_likelihood":
            _declare_units(variables, posterior)
    attributes = {**LIBRARY, "excitation": [o.record.name for o in posterior.observations]}
    return groups | {group: xarray.Dataset(variables, attrs=attributes) for group, variables in parts.items()}


def _declare_units(variables: Mapping[str, Any], posterior: Posterior) -> None:
    """Add the SI unit to every variable that holds channels or excitations."""
    for index, observation in enumerate(posterior.observations):
        suffix = "" if len(posterior.observations) == 1 else f"_{index + 1}"
        driven = ", ".join(EXCITATION_UNITS.get(kind, "SI") for kind in observation.record.kind.split("+"))
        for name, unit in ((f"y{suffix}", ", ".join(observation.si_units)), (f"excitation{suffix}", driven)):
            if name in variables:
                variables[name].attrs["unit"] = unit


def _observable(posterior: Posterior, theta: np.ndarray, index: int, seed: int, purpose: Purpose) -> np.ndarray:
    rng = stream(seed, purpose, index)
    response = posterior.predict(theta, index)
    bound, step = posterior.likelihood.of[index], posterior.observations[index].step
    return np.asarray(response + bound.draw_errors(rng, response, posterior.unknowns(theta, index), step))
