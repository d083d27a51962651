"""Deterministic calibration, compared with the Bayesian calibration."""

from __future__ import annotations

import functools

import numpy as np

from structid.core.units import factor, label
from structid.figures import loops as figures
from structid.figures.style import pretty, pretty_unit
from structid.optimize.minima import OptimizeResult, Searches
from structid.report.material.material import PosteriorMaterial, simulated_loops
from structid.report.section import NEAREST, Drawing, Picture, Rows, Section, Table
from structid.report.tables import percent

FURTHER, NOTICED = 2.0, 0.02
"""Thresholds above which the page explains why the MAP fits worse than least squares: ratio of the two residuals, and residual
of the MAP as a fraction of the measured variance."""


def _searches(material: PosteriorMaterial) -> Searches:
    return material.results.get(Searches) or Searches()


def _at_zero(value: float) -> str:
    """Format a parameter; a value within rounding error of zero is shown as zero."""
    return "0" if abs(value) < 1e-12 else f"{value:.5g}"


def _minima(material: PosteriorMaterial) -> Rows:
    """Deterministic minima, and the Bayesian MAP and mean, in display units."""
    names = material.posterior.model_space.names
    factors, units = material.posterior.model_space.factors, material.posterior.model_space.units
    columns = (label(pretty(n), pretty_unit(units[n])) for n in names)
    heads = ["method", *columns, "unexplained variance", "starts", "at a bound"]
    rows = []
    for method, search in _searches(material).items():
        for minimum in search.minima[:4]:
            rows.append(
                [
                    method,
                    *(_at_zero(v) for v in minimum.theta / factors),
                    f"{minimum.value / search.scale:.3%}",
                    f"{minimum.starts} of {len(search.values)}",
                    ", ".join(pretty(n) for n in minimum.on_boundary) or "–",
                ]
            )
    size = len(names)
    estimates = {"posterior MAP": material.result.map_estimate, "posterior mean": material.result.mean}
    for (kind, theta), share in zip(estimates.items(), _unexplained(material), strict=True):
        rows.append([kind, *(f"{v:.5g}" for v in theta[:size] / factors), f"{share:.3%}", "–", "–"])
    return heads, rows


def _unexplained(material: PosteriorMaterial) -> tuple[float, float]:
    """Residual variance of the MAP and of the mean, as fractions of the measured variance; simulated once per page."""
    key = "what MAP and mean leave"
    if key not in material.shared:
        misfit, size = material.posterior.misfit, material.posterior.model_space.dimension
        both = (material.result.map_estimate, material.result.mean)
        material.shared[key] = tuple(float(misfit(theta[None, :size])[0] / misfit.scale) for theta in both)
    fractions: tuple[float, float] = material.shared[key]
    return fractions


def _words(material: PosteriorMaterial) -> list[str]:
    """Explain why the MAP fits worse than least squares, if it does."""
    if not _searches(material):
        return []
    least = min(search.best.value / search.scale for search in _searches(material).values())
    of_map, _ = _unexplained(material)
    if of_map < max(FURTHER * least, NOTICED):
        return []
    return [
        f"Least squares leave {percent(least)} of the measured variance unexplained, the MAP {percent(of_map)}. Least squares "
        "minimise the residual, without priors or an error model. With correlated errors, a slowly varying deviation reduces the "
        "likelihood only a little. The posterior then accepts a larger residual as error. A difference as large as this one "
        "suggests that the model lacks some behaviour of the structure."
    ]


def _tables(material: PosteriorMaterial) -> list[Table]:
    return [Table("Minima", _minima(material))] if _searches(material) else []


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    loops_are_known = bool(material.true_posterior.model.loop_channels)
    return [functools.partial(_identified, material)] if _searches(material) and loops_are_known else []


def _loop(material: PosteriorMaterial, search: OptimizeResult) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [mm] and force [kN] of the first spring at the best minimum."""
    posterior = material.true_posterior
    parameters = np.asarray(posterior.model_parameters(material.completed(search.best.theta)[None]))
    loops = simulated_loops(posterior.model, parameters, material.observations[0].record)
    loop = next(iter(loops.values()))[0]
    return loop[:, 0] * 1e3, loop[:, 1] * 1e-3


def _identified(material: PosteriorMaterial) -> Picture:
    observation = material.observations[0]
    channel = observation.channels[0]
    unit = observation.channel_unit(channel).display
    spring = next(iter(material.true_posterior.model.loop_channels))
    truth = material.true_loops[0].get(spring)
    predictions = {
        name: material.posterior.predict(material.completed(s.best.theta)[None])[0, :, 0] / factor(unit)
        for name, s in _searches(material).items()
    }
    figure = figures.identified(
        observation.time,
        observation.values[:, 0] / factor(unit),
        predictions,
        None if truth is None else (truth[:, 0] * 1e3, truth[:, 1] * 1e-3),
        {name: _loop(material, search) for name, search in _searches(material).items()},
        channel,
        unit,
    )
    of = f" of {spring}" if spring else ""
    caption = f"Deterministic calibration: loops{of} and {channel} for {observation.record.name}."
    return Picture("identified", caption, figure)


SECTION = Section(
    "deterministic",
    "Deterministic calibration for comparison",
    _drawings,
    _tables,
    _words,
    under_doubt=NEAREST,
    of_draws=False,
)
