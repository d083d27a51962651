"""Convergence of the sampler."""

from __future__ import annotations

import functools

from structid.figures import posterior as figures
from structid.figures.style import pretty
from structid.inference.diagnostics.verdict import EFFECTIVE_SIZE_LIMIT, R_HAT_LIMIT
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Rows, Section, Table


def _diagnostics(material: PosteriorMaterial) -> Rows:
    """R-hat, effective sample sizes (ESS) and autocorrelation time of each parameter."""
    verdict = material.result.verdict()
    heads = [
        "parameter",
        f"R-hat (below {R_HAT_LIMIT})",
        f"bulk ESS (at least {EFFECTIVE_SIZE_LIMIT})",
        f"tail ESS (at least {EFFECTIVE_SIZE_LIMIT})",
        "autocorrelation time τ [steps]",
        f"kept steps / τ (at least {verdict.needed_length:g})",
    ]
    rows = [
        [
            pretty(name),
            f"{d.r_hat:.4f}",
            f"{d.bulk_size:.0f}",
            f"{d.tail_size:.0f}",
            f"{d.autocorrelation_time:.1f}",
            f"{verdict.kept_steps / d.autocorrelation_time:.0f}",
        ]
        for name, d in verdict.parameters.items()
    ]
    return heads, rows


def _tables(material: PosteriorMaterial) -> list[Table]:
    return [Table("Convergence diagnostics (ESS: effective sample size)", _diagnostics(material))]


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    return [functools.partial(_traces, material), functools.partial(_acceptance, material)]


def _traces(material: PosteriorMaterial) -> Picture:
    result, space = material.result, material.posterior.space
    units = list(space.units.values())
    figure = figures.traces(space.names, units, result.history / space.factors, result.discarded)
    return Picture("traces", "Walkers and ensemble means.", figure)


def _acceptance(material: PosteriorMaterial) -> Picture:
    figure = figures.acceptance(material.result.verdict().acceptance)
    return Picture("acceptance", "Acceptance rate of each walker; dotted: median.", figure)


SECTION = Section("convergence", "Convergence", _drawings, _tables)
