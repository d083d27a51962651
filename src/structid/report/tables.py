"""Tables of a report: rows of text, numbers with as many digits as they deserve.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import importlib.metadata
import platform
from typing import Any

import numpy as np

from structid.calibration.calibration_result import CalibrationResult
from structid.channels import standard_unit
from structid.figures.style import pretty, pretty_unit
from structid.inference.assessment.diagnostics import EFFECTIVE_SIZE_LIMIT, R_HAT_LIMIT
from structid.report.content import ReportContent
from structid.runs import Runs
from structid.surrogates.face import Surrogate
from structid.units import factor, label

Table = tuple[list[str], list[list[str]]]
"""Heads and rows."""


def number(value: float, error: float | None = None) -> str:
    """A number with two digits of its uncertainty, or four significant digits.

    Parameters
    ----------
    value : float
        The number.
    error : float, optional
        Its uncertainty.

    Returns
    -------
    str
        Such as ``"5.350"`` for 5.34972 ± 0.012.
    """
    if not np.isfinite(value):
        return "–"
    if error is None or not np.isfinite(error) or error <= 0:
        return f"{value:.4g}"
    digits = int(np.clip(1 - np.floor(np.log10(error)), 0, 12))
    magnitude = max(abs(value), error)
    return f"{value:.{digits}f}" if 1e-4 <= magnitude < 1e6 else f"{value:.4g}"


def _at_zero(value: float) -> str:
    """A parameter that lies on a bound at zero but for rounding is shown as zero."""
    return "0" if abs(value) < 1e-12 else f"{value:.5g}"


def posterior_table(content: ReportContent) -> Table:
    """Mean, sd, 5-95 %, MAP and truth of every parameter, as the thesis's tables have them.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list
        Heads and rows, in display units.
    """
    summary = content.summary
    factors = content.posterior.factors
    robust = "robust_sd" in summary.columns
    heads = ["parameter", "mean", "sd", *(["robust sd"] if robust else []), "5 %", "95 %", "MAP"]
    if content.true_values:
        heads.append("truth")
    rows = []
    for i, (name, unit) in enumerate(zip(summary.names, summary.units, strict=True)):
        c = {k: float(v[i]) for k, v in summary.columns.items()}
        shown = [number(c[k], c["sd"]) for k in ("mean", "q05", "q95", "map")]
        row = [
            label(pretty(name), pretty_unit(unit)),
            shown[0],
            f"{c['sd']:.2g}",
            *([f"{c['robust_sd']:.2g}"] if robust else []),
            *shown[1:],
        ]
        if content.true_values:
            truth = content.true_values.get(name)
            row.append("–" if truth is None else number(truth / factors[i]))
        rows.append(row)
    return heads, rows


def convergence_table(content: ReportContent) -> Table:
    """R-hat, effective sample sizes and autocorrelation time of every parameter.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    verdict = content.result.verdict()
    heads = [
        "parameter",
        f"R-hat (below {R_HAT_LIMIT})",
        f"ESS bulk ({EFFECTIVE_SIZE_LIMIT} or more)",
        "ESS tail (the same)",
        "τ [steps]",
        f"kept steps / τ ({verdict.needed_length:g} or more)",
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


def deterministic_table(content: ReportContent) -> Table:
    """Deterministic minima beside the Bayesian MAP and mean.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list
        Heads and rows, in display units.
    """
    names = content.posterior.model_space.names
    factors, units = content.posterior.model_space.factors, content.posterior.model_space.units
    heads = ["method", *(label(pretty(n), pretty_unit(units[n])) for n in names), "unexplained", "starts", "at a bound"]
    rows = []
    for method, search in content.searches.items():
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
    misfit = content.posterior.misfit
    for kind, theta in (("posterior MAP", content.result.map_estimate), ("posterior mean", content.result.mean)):
        share = float(misfit(theta[None, :size])[0]) / misfit.scale
        rows.append([kind, *(f"{v:.5g}" for v in theta[:size] / factors), f"{share:.3%}", "–", "–"])
    return heads, rows


def prior_table(content: ReportContent) -> Table:
    """Priors as the study gave them.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    rows = [[pretty(name), str(marginal)] for name, marginal in content.posterior.space.marginals.items()]
    return ["parameter", "prior (native parameters)"], rows


def identifiability_table(content: ReportContent) -> Table | None:
    """Combinations of parameters by what the data say of them.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list or None
        Heads and rows.
    """
    info = content.information
    if info is None:
        return None
    rows = [[str(i + 1), f"{v:.3g}", info.combination(i)] for i, v in enumerate(info.eigenvalues)]
    return ["combination", "information / prior's", "in prior standard deviations"], rows


def run_table(content: ReportContent, timings: dict[str, float]) -> Table:
    """Settings, versions and timings.

    Parameters
    ----------
    content : ReportContent
        The content.
    timings : dict of str to float
        Seconds of every stage.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    result, sampler = content.result, content.result.sampler
    steps, ensembles, walkers = result.history.shape[:3]
    rows = [
        ["model", str(content.posterior.model)],
        ["sampler", f"{sampler.in_words}, seed {result.seed}"],
        ["model runs in sampling", f"{steps * ensembles * walkers:,}" if result.cost is None else str(result.cost)],
    ]
    heads, versions = versions_table(timings)
    return heads, rows + versions


def versions_table(timings: dict[str, float]) -> Table:
    """Times, versions and machine.

    Parameters
    ----------
    timings : dict of str to float
        Seconds of every stage.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    rows = [
        *([f"time: {stage}", f"{seconds:.1f} s"] for stage, seconds in timings.items()),
        [
            "versions",
            ", ".join(f"{n} {importlib.metadata.version(n)}" for n in ("structid", "jax", "numpyro", "numpy", "scipy")),
        ],
        ["machine", f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"],
    ]
    return ["what", "value"], rows


def runs_table(runs: Runs) -> Table:
    """How the runs of a campaign ended, what they cost, and why some failed.

    Parameters
    ----------
    runs : Runs
        The campaign's.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    rows = [[status.words, f"{count}", ""] for status, count in runs.counts.items() if count]
    seconds = runs.seconds[np.isfinite(runs.seconds) & (runs.seconds > 0)]
    if seconds.size:
        rows.append(["wall time of a run", f"{np.median(seconds):.3g} s", f"median; {seconds.max():.3g} s at most"])
    again = int((runs.attempts > 1).sum())
    if again:
        rows.append(["tried more than once", f"{again}", ""])
    rows += [["reason", f"{count}", reason] for reason, count in runs.failures[:20]]
    return ["what", "runs", ""], rows


def others_table(content: ReportContent) -> Table | None:
    """Peak responses predicted for other records.

    Parameters
    ----------
    content : ReportContent
        The content.

    Returns
    -------
    tuple of list or None
        Heads and rows, in display units.
    """
    rows: list[list[Any]] = []
    for other in content.others:
        for c, channel in enumerate(other.prediction.channels):
            unit = standard_unit(channel).display
            peaks = other.prediction.peaks[:, c] / factor(unit)
            low, median, high = np.quantile(peaks, [0.05, 0.5, 0.95])
            spread = high - low
            rows.append(
                [other.name, label(channel, pretty_unit(unit)), *(number(v, spread) for v in (low, median, high))]
            )
    return (["record", "largest", "5 %", "median", "95 %"], rows) if rows else None


def _in_words(setting: Any) -> str:
    if isinstance(setting, dict):
        return ", ".join(f"{pretty(k)} {_in_words(v)}" for k, v in setting.items() if v is not None)
    return ", ".join(map(str, setting)) if isinstance(setting, (list, tuple)) else str(setting)


def validation_table(surrogate: Surrogate) -> Table:
    """Errors of a surrogate over the runs it was validated on, a row a channel.

    Parameters
    ----------
    surrogate : Surrogate
        Validated.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    validation = surrogate.validation
    assert validation is not None
    heads = ["channel", "mean error", "median", "95 %", "worst", "diverged", "peak off by", "within 1.96 sd"]
    rows = [
        [
            pretty(channel),
            *(f"{errors[k]:.2g}" for k in ("mean", "median", "q95", "worst")),
            f"{validation.diverged} of {len(validation.errors)}",
            f"{validation.peak_error:.2%}",
            f"{validation.coverage:.1%}",
        ]
        for channel, errors in validation.per_channel.items()
    ]
    return heads, rows


def calibration_tables(calibration: CalibrationResult | None) -> list[tuple[str, Table]]:
    """Certificate and rounds of a calibration.

    Parameters
    ----------
    calibration : CalibrationResult or None
        The calibration, if there was one.

    Returns
    -------
    list of tuple
        Captions and tables.
    """
    if calibration is None:
        return []
    c, limits = calibration.certificate, calibration.certificate.limits
    count = len(c.draws)
    asked = [
        ["tail index k̂ of the weights", f"{c.k_hat:.2f}", f"below {limits.largest_k_hat(count):.2f}"],
        [
            "effective draws",
            f"{c.effective_sample_size:.0f} of {count}",
            f"{limits.effective_share * count:.0f} or more",
        ],
        ["spread of log weights", f"{c.spread:.3f}", f"{limits.spread:g} or less"],
        [
            f"density missed at {c.within_reach} true runs within {limits.reach:g} nats of the best",
            f"{max(c.excess, 0.0):.2f} nats",
            f"{limits.excess:g} nats or less",
        ],
    ]
    shifts = [[pretty(n), f"{s:+.3f} ± {e:.3f}"] for n, s, e in zip(c.names, c.shift, c.shift_error, strict=True)]
    rounds = [
        [
            str(r.number + 1), str(r.training), f"{r.error:.1e}", f"{r.effective_sample_size:.0f} of {r.fresh}", f"{r.spread:.2g}",
            r.certificate.verdict if r.certificate is not None else "",
        ]
        for r in calibration.rounds
    ]  # fmt: skip
    heads = ["round", "training runs", "surrogate's error, all runs", "effective", "spread of log w", "certificate"]
    return [
        ("What was asked for", (["", "found", "limit"], asked)),
        ("How far the model's runs move each mean, in standard deviations", (["", "shift"], shifts)),
        ("Rounds", (heads, rounds)),
    ]


def surrogate_table(surrogate: Surrogate) -> Table:
    """What a surrogate is and what it was fitted to.

    Parameters
    ----------
    surrogate : Surrogate
        Fitted.

    Returns
    -------
    tuple of list
        Heads and rows.
    """
    fit = surrogate.fitted
    rows = [
        ["kind", fit.kind],
        ["fitted to", f"{fit.runs} runs, {fit.left_out} failed ones left out, in {fit.seconds:.1f} s"],
        ["mean error estimated while fitting", f"{fit.error:.2g}"],
    ]
    judged = "estimated while fitting"
    if surrogate.validation is not None:
        validation, judged = surrogate.validation, "on the validation runs"
        rows += [
            ["mean error on the validation runs", f"{validation.mean:.2g}"],
            ["validation runs outside its range", f"{validation.outside} of {len(validation.errors)}"],
        ]
    rows.append(["may be sampled up to a mean error of", f"{fit.limit:g} ({judged})"])
    rows += [[name, value] for name, value in surrogate.structure_in_words]
    shown = {k: v for k, v in fit.settings.items() if k not in ("limit", "outside") and v not in (None, [])}
    rows += [[pretty(k), _in_words(v)] for k, v in shown.items()]
    return ["", ""], rows
