"""The overview of a calibration: a description in one sentence, and tables of the posterior and of the run."""

from __future__ import annotations

import numpy as np

from structid.core.units import factor, label
from structid.figures.style import pretty, pretty_unit
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Rows
from structid.report.tables import moments, number, versions_table
from structid.surrogates.base import Surrogate


def posterior_table(material: PosteriorMaterial) -> Rows:
    """Mean, sd, 5 and 95 % quantiles, MAP and truth of every parameter."""
    summary = material.summary
    factors = dict(zip(material.posterior.names, material.posterior.factors, strict=True))
    robust, spread = "robust_sd" in summary.columns, material.result.robust
    doubt = {} if spread is None else dict(zip(material.posterior.names, spread.error, strict=True))
    elsewhere = "sd_elsewhere" in summary.columns
    further = [*(["robust sd"] if robust else []), *(["record-to-record sd"] if elsewhere else [])]
    heads = ["parameter", "mean", "sd", *further, "5 %", "95 %", "MAP"]
    if material.true_values:
        heads.append("truth")
    rows = []
    for i, (name, unit) in enumerate(zip(summary.names, summary.units, strict=True)):
        c = {k: float(v[i]) for k, v in summary.columns.items()}
        shown = [number(c[k], c["sd"]) for k in ("mean", "q05", "q95", "map")]
        row = [
            label(pretty(name), pretty_unit(unit)),
            shown[0],
            f"{c['sd']:.2g}",
            *([f"{c['robust_sd']:.2g}" + (f" ± {doubt[name]:.0%}" if doubt[name] else "")] if robust else []),
            *([f"{c['sd_elsewhere']:.2g}"] if elsewhere else []),
            *shown[1:],
        ]
        if material.true_values:
            truth = material.true_values.get(name)
            row.append("–" if truth is None else number(truth / factors[name]))
        rows.append(row)
    return heads, rows


def derived_table(material: PosteriorMaterial) -> Rows | None:
    """Mean, sd, 5 and 95 % quantiles and truth of derived quantities and of the standard deviations of the errors."""
    draws, weights = material.weighted_draws
    model, truth = material.true_posterior.model, material.truths[0]
    quantities = model.derived_quantities(np.asarray(material.true_posterior.model_parameters(draws)))
    true = {} if truth is None else truth.derived_quantities(np.zeros((1, 0)))
    # σ = √σ² has the unit of the measurement.
    variances = dict(zip(material.posterior.names, draws.T, strict=True))
    errors = {
        pretty(name).replace("²", ""): (np.sqrt(variances[name]), unit)
        for name, unit in material.posterior.sd_units.items()
    }
    rows = []
    for name, (values, unit) in (dict(quantities) | errors).items():
        if not np.isfinite(values).all():
            continue
        mean, sd, low, high = map(float, moments(values / factor(unit), weights))
        row = [label(name, unit), number(mean, sd), f"{sd:.2g}", number(low, sd), number(high, sd)]
        if true:
            row.append(number(float(true[name].values[0]) / factor(unit)) if name in true else "–")
        rows.append(row)
    heads = ["derived quantity", "mean", "sd", "5 %", "95 %", *(["truth"] if true else [])]
    return (heads, rows) if rows else None


def run_table(material: PosteriorMaterial, timings: dict[str, float]) -> Rows:
    """Settings, versions and timings of the run."""
    result, sampler = material.result, material.result.sampler
    steps, ensembles, walkers = result.history.shape[:3]
    rows = [
        ["model", str(material.posterior.model)],
        ["sampler", f"{sampler.in_words}, seed {result.seed}"],
        ["model runs in sampling", f"{steps * ensembles * walkers:,}" if result.cost is None else str(result.cost)],
    ]
    heads, versions = versions_table(timings)
    return heads, rows + versions


def sentence(material: PosteriorMaterial) -> str:
    """Describe the calibration in one sentence."""
    posterior, surrogate = material.posterior, material.results.get(Surrogate)
    through = "" if surrogate is None else f", with a {surrogate.kind_in_words},"
    records = ", ".join(o.record.name for o in posterior.observations)
    channels = ", ".join(dict.fromkeys(c for o in posterior.observations for c in o.channels))
    return (
        f"{len(posterior.model_space.names)} parameters of a {material.true_posterior.model.kind_in_words}{through} calibrated "
        f"to the measured {channels} for {records} ({sum(int(o.is_measured.sum()) for o in posterior.observations):,} values)."
    )
