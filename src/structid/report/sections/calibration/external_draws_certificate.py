"""The certificate of external draws."""

from __future__ import annotations

import numpy as np

from structid.certification.certificate import Certificate
from structid.figures import calibration as figures
from structid.figures.style import pretty, pretty_unit
from structid.report.material.certificate_material import CertificateMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.sections.calibration.certificate_section import what_was_asked, what_was_bounded


def _tables(material: CertificateMaterial) -> list[Table]:
    certificate = material.certificate
    return [what_was_asked(certificate), what_was_bounded(certificate), *_correction(certificate)]


def _correction(certificate: Certificate) -> list[Table]:
    """Table of the differences between the density fitted to the model runs and the density of the draws."""
    density = certificate.correction
    if density is None:
        return []
    moments = zip(certificate.names, density.mean, density.mean_error, density.sd, density.correlation, strict=True)
    rows = [
        [
            pretty(name),
            f"{mean:+.3f} ± {error:.3f}",
            f"{100.0 * (sd - 1.0):+.1f} %",
            _furthest(correlations, certificate.names),
        ]
        for name, mean, error, sd, correlations in moments
    ]
    title = (
        "The density fitted to the model runs, relative to the density of the draws. Their total variation "
        f"distance is {100.0 * density.distance:.1f} %, and the bounds above allow for it"
    )
    heads = ["", "difference of means [sd]", "difference of sds", "largest difference of a correlation"]
    return [Table(title, (heads, rows))]


def _furthest(correlations: np.ndarray, names: tuple[str, ...]) -> str:
    """Largest difference of a correlation of one parameter, and the other parameter of that correlation."""
    other = int(np.argmax(np.abs(correlations)))
    return f"{correlations[other]:+.2f} with {pretty(names[other])}" if len(names) > 1 else ""


def _drawings(material: CertificateMaterial) -> list[Drawing]:
    certificate = material.certificate

    def ratios() -> Picture:
        names = [
            pretty(name) + (f" [{pretty_unit(unit)}]" if unit else "")
            for name, unit in zip(material.names, material.units, strict=True)
        ]
        figure = figures.ratios_over_parameters(
            certificate.draws / material.factors,
            certificate.log_ratios,
            names,
            certificate.limits.mean,
        )
        return Picture(
            "ratios",
            "Each point is a draw at which the model was run. The ordinate is the log density of the model minus the log density "
            "of the draws, relative to the median. If the two posteriors are equal, all points lie at zero. Points whose standard "
            "deviation is that of the band or less meet the limit for means. A slope indicates a wrong mean, a curvature a wrong "
            "standard deviation. Triangles mark points beyond the axis limits. Dotted lines mark draws whose run failed.",
            figure,
        )

    return [ratios]


SECTION = Section("certificate", "Difference between model and draws", _drawings, _tables)
