"""The certificate of a calibration: what was asked for, how far true runs move the means, the rounds."""

from __future__ import annotations

from pathlib import Path

from structid.calibration.calibration_result import Round
from structid.figures import calibration as figures
from structid.figures.style import pretty
from structid.inference.assessment.certificate import Certificate
from structid.report.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, Table


def _tables(material: PosteriorMaterial) -> list[Table]:
    if material.calibration is None:
        return []
    certificate = material.calibration.certificate
    heads = [
        "round",
        "training runs",
        "surrogate's error, all runs",
        "effective",
        "spread of log w",
        "by a certificate",
    ]
    shifts = [
        [pretty(name), f"{shift:+.3f} ± {error:.3f}"]
        for name, shift, error in zip(certificate.names, certificate.shift, certificate.shift_error, strict=True)
    ]
    return [
        Table("What was asked for", (["", "found", "limit"], _asked(certificate))),
        Table("How far the model's runs move each mean, in standard deviations", (["", "shift"], shifts)),
        Table("Rounds", (heads, [_round(r) for r in material.calibration.rounds])),
    ]


def _asked(certificate: Certificate) -> list[list[str]]:
    """Figures of a certificate beside their limits."""
    limits, count = certificate.limits, len(certificate.draws)
    return [
        ["tail index k̂ of the weights", f"{certificate.k_hat:.2f}", f"below {limits.largest_k_hat(count):.2f}"],
        [
            "effective draws",
            f"{certificate.effective_sample_size:.0f} of {count}",
            f"{limits.effective_share * count:.0f} or more",
        ],
        ["spread of log weights", f"{certificate.spread:.3f}", f"{limits.spread:g} or less"],
        [
            f"density missed at {certificate.within_reach} true runs within {limits.reach:g} nats of the best",
            f"{max(certificate.excess, 0.0):.2f} nats",
            f"{limits.excess:g} nats or less",
        ],
    ]


def _round(r: Round) -> list[str]:
    verdict = "" if r.certificate is None else r.certificate.agreement
    effective = f"{r.effective_sample_size:.0f} of {r.fresh}"
    return [str(r.number + 1), str(r.training), f"{r.error:.1e}", effective, f"{r.spread:.2g}", verdict]


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    calibration = material.calibration
    if calibration is None:
        return []

    def rounds(folder: Path) -> Picture:
        figures.rounds(
            [r.training for r in calibration.rounds],
            [r.log_weights for r in calibration.rounds],
            calibration.certificate.limits.spread,
            save=folder / "rounds",
        )
        return Picture(
            "rounds",
            "Every point is a draw of a surrogate's posterior at which the model itself was run: how much more density the "
            "model gives it than the surrogate, relative to the median of its round. Where the two posteriors are the same, "
            "all lie on zero; the band is one standard deviation of what a certificate allows.",
        )

    return [rounds]


SECTION = Section("calibration", "Certificate", _drawings, _tables)
