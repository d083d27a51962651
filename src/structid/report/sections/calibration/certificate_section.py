"""The certificate of a calibration: limits, bounds, shifts by model runs, rounds."""

from __future__ import annotations

from structid.calibration.calibration_result import Round
from structid.certification.certificate import Certificate
from structid.figures import calibration as figures
from structid.figures.style import pretty
from structid.inference.diagnostics.second_sampler import Representation
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, Table


def _tables(material: PosteriorMaterial) -> list[Table]:
    if material.calibration is None:
        return []
    certificate = material.calibration.certificate
    heads = [
        "round",
        "training runs",
        "surrogate's error, all runs",
        "sure up to",
        "log density unsure by [nat]",
        "fresh draws",
        "spread of log w",
        "by a certificate",
    ]
    return [
        what_was_asked(certificate),
        what_was_bounded(certificate),
        *_second_explorer(material.calibration.representation),
        Table("Rounds", (heads, [_round(r) for r in material.calibration.rounds])),
    ]


def what_was_asked(certificate: Certificate) -> Table:
    """Figures of a certificate with their limits."""
    return Table("What was asked for", (["", "found", "limit"], _asked(certificate)))


def what_was_bounded(certificate: Certificate) -> Table:
    """Bounds of every parameter's moments."""
    by_chance = [] if certificate.monte_carlo is None else ["of this by the number of draws [sd]"]
    heads = ["", "mean within [sd]", *by_chance, "sd within", "correlations within", "mean moves by [sd]"]
    return Table(
        "How far the figures of each parameter may be off, with "
        f"{100.0 * certificate.limits.confidence:.0f} % confidence, and how far the draws of the certificate say they are",
        (heads, _bounds(certificate)),
    )


def _second_explorer(found: Representation | None) -> list[Table]:
    """Agreement of a second sampler with the draws."""
    if found is None:
        return []
    moments = zip(found.names, found.mean_gap, found.mean_error, found.sd_gap, found.sd_error, strict=True)
    rows = [
        [pretty(name), f"{mean:+.3f} ± {error:.3f}", f"{100.0 * sd:+.1f} ± {100.0 * error_of_sd:.1f} %"]
        for name, mean, error, sd, error_of_sd in moments
    ]
    tables = [
        Table(
            "A second explorer of the surrogate's posterior: it searches for modes and begins at all of them evenly",
            (["", "its mean lies at [sd]", "its sd is larger by"], rows),
        )
    ]
    if len(found.modes) > 1:
        shares = zip(found.shares, found.shares_again, strict=True)
        rows = [
            [str(mode), f"{first_share:.2f}", f"{again:.2f}"]
            for mode, (first_share, again) in enumerate(shares, start=1)
        ]
        tables.append(Table("Shares of the modes", (["mode", "of the draws", "of the second explorer's"], rows)))
    return tables


def _asked(certificate: Certificate) -> list[list[str]]:
    """Figures of a certificate with their limits."""
    limits, variation = certificate.limits, certificate.variation
    of_weights = [
        f"variation χ of the weights, bounded with {100 * variation.confidence:.3g} % confidence (look {certificate.look})",
        f"{variation.estimate:.2g}, at most {variation.bound:.2g}",
        f"{limits.mean:.2g} or less",
    ]
    excluded = [
        [
            "share of the posterior that may lie where the given density is zero",
            f"{certificate.missing:.2%}",
            "in the bounds",
        ]
    ]
    rows = [of_weights, *(excluded if certificate.missing else [])]
    if not certificate.within_reach:
        return rows
    return [
        *rows,
        [
            f"density missed at {certificate.within_reach} model runs within {limits.reach:g} nats of the best",
            f"{max(certificate.excess, 0.0):.2f} nats",
            f"{limits.excess:g} nats or less",
        ],
        [
            "density of the best model run above every draw",
            f"{max(certificate.above, 0.0):.2f} nats",
            f"{limits.above:g} nats or less",
        ],
    ]


def _bounds(certificate: Certificate) -> list[list[str]]:
    """Bounds of every parameter's moments, and of its correlations with the others."""
    chance = certificate.monte_carlo
    by_chance = [[] for _ in certificate.names] if chance is None else [[f"{mean:.2g}"] for mean in chance.mean]
    figures = (
        certificate.mean_within,
        by_chance,
        certificate.sd_within,
        certificate.correlation_within.max(axis=1),
        certificate.shift,
        certificate.shift_error,
    )
    return [
        [pretty(name), f"{mean:.2g}", *by, f"{100.0 * sd:.2g} %", f"{correlation:.2g}", f"{shift:+.3f} ± {error:.3f}"]
        for name, mean, by, sd, correlation, shift, error in zip(certificate.names, *figures, strict=True)
    ]


def _round(r: Round) -> list[str]:
    verdict = "" if r.certificate is None else r.certificate.agreement
    return [
        str(r.number + 1),
        str(r.training),
        f"{r.error:.1e}",
        f"{r.exponent:.2g}",
        f"{r.deviation:.2g}",
        "the same, left out in turn" if r.again else str(r.fresh),
        f"{r.spread:.2g}" if r.fresh else "",
        verdict,
    ]


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    calibration = material.calibration
    if calibration is None:
        return []

    def rounds() -> Picture:
        figure = figures.rounds(
            [r.training for r in calibration.rounds],
            [r.log_weights for r in calibration.rounds],
            calibration.certificate.limits.mean,
        )
        return Picture(
            "rounds",
            "Every point is a draw of a surrogate's posterior at which the model itself was run: how much more density the "
            "model gives it than the surrogate, relative to the median of its round. Where the two posteriors are the same, "
            "all lie on zero; the band is the largest standard deviation that a certificate allows. Rounds without points came "
            "before the surrogate was sure of its posterior.",
            figure,
        )

    return [rounds]


SECTION = Section("calibration", "Certificate", _drawings, _tables)
