"""The certificate of a calibration: limits, error bounds, shifts of the means by re-weighting, rounds."""

from __future__ import annotations

from structid.calibration.calibration_result import Round
from structid.certification.certificate import Certificate, number_in_words
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
        "surrogate error, all runs",
        "exponent of likelihood",
        "sd of log density [nat]",
        "fresh draws",
        "sd of log weights",
        "certificate",
    ]
    return [
        what_was_asked(certificate),
        what_was_bounded(certificate),
        *_second_sampler(material.calibration.representation),
        Table("Rounds", (heads, [_round(r) for r in material.calibration.rounds])),
    ]


def what_was_asked(certificate: Certificate) -> Table:
    """Table of the quantities that a certificate limits."""
    return Table("Limits", (["", "value", "limit"], _asked(certificate)))


def what_was_bounded(certificate: Certificate) -> Table:
    """Table of the error bounds for the moments of each parameter."""
    by_chance = [] if certificate.monte_carlo is None else ["part of the draws [sd]"]
    heads = ["", "mean within [sd]", *by_chance, "sd within", "correlations within", "estimated shift of mean [sd]"]
    return Table(
        "Error bounds for each parameter, with "
        f"{100.0 * certificate.limits.confidence:.0f} % confidence, and the shift of the mean when the draws are weighted",
        (heads, _bounds(certificate)),
    )


def _second_sampler(found: Representation | None) -> list[Table]:
    """Tables of the agreement between the draws and a second sampler."""
    if found is None:
        return []
    moments = zip(found.names, found.mean_gap, found.mean_error, found.sd_gap, found.sd_error, strict=True)
    rows = [
        [pretty(name), f"{mean:+.3f} ± {error:.3f}", f"{100.0 * sd:+.1f} ± {100.0 * error_of_sd:.1f} %"]
        for name, mean, error, sd, error_of_sd in moments
    ]
    tables = [
        Table(
            "Comparison of the draws with a second sampler, which searches for modes and starts evenly in all of them",
            (["", "difference of means [sd]", "difference of sds"], rows),
        )
    ]
    if len(found.modes) > 1:
        shares = zip(found.shares, found.shares_again, strict=True)
        rows = [
            [str(mode), f"{first_share:.2f}", f"{again:.2f}"]
            for mode, (first_share, again) in enumerate(shares, start=1)
        ]
        tables.append(Table("Probabilities of the modes", (["mode", "draws", "second sampler"], rows)))
    return tables


def _asked(certificate: Certificate) -> list[list[str]]:
    """Rows of the quantities that a certificate limits."""
    limits, variation = certificate.limits, certificate.variation
    of_weights = [
        f"coefficient of variation χ of the weights, with {100 * variation.confidence:.3g} % confidence "
        f"(attempt {certificate.look})",
        f"{variation.estimate:.2g}, at most {variation.bound:.2g}",
        "bounds every error",
    ]
    of_moments = [
        "largest error of a mean [sd], of a standard deviation, of a correlation",
        f"{number_in_words(certificate.mean_bound.max())}, {number_in_words(certificate.sd_bound.max())}, "
        f"{number_in_words(certificate.correlation_bound.max())}",
        f"{limits.mean:g}, {limits.sd:g}, {limits.correlation:g} or less",
    ]
    excluded = [
        [
            "fraction of the posterior that may lie where the given density is zero",
            f"{certificate.missing:.2%}",
            "included in the bounds",
        ]
    ]
    rows = [of_weights, of_moments, *(excluded if certificate.missing else [])]
    if not certificate.within_reach:
        return rows
    return [
        *rows,
        [
            f"largest underestimate of the log density at the {certificate.within_reach} model runs within {limits.reach:g} "
            "nats of the best run",
            f"{max(certificate.excess, 0.0):.2f} nats",
            f"{limits.excess:g} nats or less",
        ],
        [
            "log density of the best model run minus that of the best draw",
            f"{max(certificate.above, 0.0):.2f} nats",
            f"{limits.above:g} nats or less",
        ],
    ]


def _bounds(certificate: Certificate) -> list[list[str]]:
    """Rows of the error bounds for the moments and the correlations of each parameter."""
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
        "same draws, cross-validated" if r.again else str(r.fresh),
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
            "Each point is a draw from a surrogate's posterior at which the model was run. The ordinate is the log density of the "
            "model minus that of the surrogate, relative to the median of the round. If the two posteriors are equal, all points "
            "lie at zero. Points whose standard deviation is that of the band or less meet the limit for means. In rounds without "
            "points, the surrogate was not yet accurate enough to draw from its posterior.",
            figure,
        )

    return [rounds]


SECTION = Section("calibration", "Certificate", _drawings, _tables)
