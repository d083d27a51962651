"""Residuals of the best prediction, whitened by the error model."""

from __future__ import annotations

import functools

import numpy as np

from structid.figures import response as figures
from structid.inference.diagnostics.residuals import UNEVEN, WhitenedResidual
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, nothing


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    return [
        functools.partial(_residual, residual, material.suffix(residual.observation))
        for residual in material.result.residuals
    ]


def _residual(residual: WhitenedResidual, suffix: str) -> Picture:
    name = f"residuals_{residual.channel}{suffix}"
    figure = figures.residuals(
        np.arange(len(residual.autocorrelation)) * residual.dt,
        residual.autocorrelation,
        residual.bound,
        *residual.spectrum,
        residual.values,
    )
    return Picture(
        name,
        f"Whitened residuals of {residual.channel} for {residual.record} at the MAP estimate. If the model and the error model are "
        "right, these residuals are independent standard normals: no autocorrelation, a flat spectrum, quantiles on the line. "
        f"{_judged(residual)}.",
        figure,
    )


def _judged(residual: WhitenedResidual) -> str:
    """Sentence on what the residual implies for the error model."""
    if residual.correlated:
        return (
            "The residuals are correlated: the error model does not describe them, and the posterior standard deviations "
            "are too small"
        )
    if residual.heavy_tailed or residual.uneven:
        what = "have heavier tails than" if residual.heavy_tailed else "grow with the response, against"
        return f"The residuals {what} the error model: the posterior standard deviations may be wrong"
    frequency, power = residual.peak
    if power > UNEVEN:
        return (
            f"The residuals are hardly correlated, but around {frequency:.2g} Hz they have {power:.2g} times the power of white "
            "noise: the error model describes the errors only roughly"
        )
    return "The residuals give no evidence against the error model"


SECTION = Section("residuals", "Residuals", _drawings, nothing)
