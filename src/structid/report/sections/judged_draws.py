"""The certificate of draws that another program made."""

from __future__ import annotations

from pathlib import Path

from structid.figures import calibration as figures
from structid.figures.style import pretty, pretty_unit
from structid.report.certificate_material import CertificateMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.sections.certificate import what_was_asked, what_was_bounded


def _tables(material: CertificateMaterial) -> list[Table]:
    return [what_was_asked(material.certificate), what_was_bounded(material.certificate)]


def _drawings(material: CertificateMaterial) -> list[Drawing]:
    certificate = material.certificate

    def ratios(folder: Path) -> Picture:
        names = [
            pretty(name) + (f" [{pretty_unit(unit)}]" if unit else "")
            for name, unit in zip(certificate.names, material.units, strict=True)
        ]
        figures.ratios_over_parameters(
            certificate.draws / material.factors,
            certificate.log_ratios,
            names,
            certificate.limits.mean,
            save=folder / "ratios",
        )
        return Picture(
            "ratios",
            "Every point is a draw at which the model was run: how much more density the model gives it than the law of the draws, "
            "relative to the median, over each parameter. Where the two posteriors are the same, all lie on zero; the band is the "
            "largest standard deviation that a certificate allows. A slope says that a mean is off, a bow that a standard "
            "deviation is. Triangles lie beyond the edge, dotted lines are draws whose run failed.",
        )

    return [ratios]


SECTION = Section("certificate", "Where model and draws differ", _drawings, _tables)
