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
    return [what_was_asked(certificate), what_was_bounded(certificate), *_what_was_taught(certificate)]


def _what_was_taught(certificate: Certificate) -> list[Table]:
    """Difference of the draws' density from the one learnt from model runs."""
    taught = certificate.correction
    if taught is None:
        return []
    moments = zip(certificate.names, taught.mean, taught.mean_error, taught.sd, taught.correlation, strict=True)
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
        "The density fitted to the runs, beside that of the draws: they differ in "
        f"{100.0 * taught.distance:.1f} % of the probability. The bounds above reckon with it"
    )
    return [Table(title, (["", "its mean lies at [sd]", "its sd is larger by", "correlation that differs most"], rows))]


def _furthest(correlations: np.ndarray, names: tuple[str, ...]) -> str:
    """Largest difference of a correlation with another parameter, and that parameter."""
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
            "Every point is a draw at which the model was run: how much more density the model gives it than the density of "
            "the draws, relative to the median, over each parameter. Where the two posteriors are the same, all lie on "
            "zero; the band is the largest standard deviation that a certificate allows. A slope means that a mean is "
            "off, a bow that a standard deviation is. Triangles lie beyond the edge, dotted lines are draws whose run failed.",
            figure,
        )

    return [ratios]


SECTION = Section("certificate", "Where model and draws differ", _drawings, _tables)
