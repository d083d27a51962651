"""Accuracy of NARX models for three displacements of the masonry façade, in single runs and over the prior range.

Run with ``python benchmarks/facade_narx.py [--quick]``. El Centro is read from ``../shared/data``.
"""

from __future__ import annotations

import time
import warnings

import common
import numpy as np
from facade import BOX, COORDINATES, MONITORED, el_centro, wall

import structid as si
from structid.surrogates.narx.structure.candidate_terms import prony_terms

NAME = "facade_narx"
LIMIT, STANDS_UNTIL = 0.13, 2.36
"""Runs that exceed this drift [m] before this time [s] are omitted, as in the thesis."""
THESIS = (0.128, 0.179, 0.787)
TRAINING = 800


def past(signal: str, first: int, last: int) -> list[str]:
    return [f"{signal}(t-{k})" if k else f"{signal}(t)" for k in range(first, last + 1)]


def polynomial_and_cross() -> dict[str, list[str]]:
    """Terms with lags, powers and absolute values of the drift, and cross-channel terms."""
    terms = {
        MONITORED[0]: [
            "1",
            *past("x", 0, 2),
            *past("y1", 1, 4),
            "y1(t-1)*|y1(t-1)|",
            "y1(t-1)^3",
            "y1(t-2)*|y1(t-1)|",
            "|y1(t-1)|",
            "y1(t-1)^2",
            "y2(t-1)",
            "y3(t-1)",
            "y2(t-1)*y1(t-1)",
            "y3(t-1)*y1(t-1)",
        ]
    }
    for own, other in ((2, 3), (3, 2)):
        terms[MONITORED[own - 1]] = [
            "1",
            *past("x", 0, 1),
            *past(f"y{own}", 1, 4),
            *past("y1", 1, 2),
            "|y1(t-1)|",
            "|y1(t-2)|",
            "y1(t-1)^2",
            "y1(t-1)*|y1(t-1)|",
            "y1(t-2)^2",
            f"y{other}(t-1)",
        ]
    return terms


def with_prony() -> dict[str, list[str]]:
    """Polynomial and cross-channel terms, with additional terms from Prony's series."""
    terms = polynomial_and_cross()
    for number, channel in enumerate(MONITORED, start=1):
        y = f"y{number}"
        terms[channel] += [
            "x(t)^2",
            "exp(x(t))",
            "x(t)*cos(2*pi*t)",
            "x(t)*sin(2*pi*t)",
            f"x(t)*exp({y}(t-1))*|{y}(t-1)|",
            f"x(t-1)*exp({y}(t-1))*|{y}(t-2)|",
            f"{y}(t-1)*exp(-t)*sin(2*pi*t)",
        ]
    return terms


def prony_alone() -> dict[str, list[str]]:
    """Terms of the thesis (eqs. 5.7 to 5.12), separately for every channel."""
    return {
        channel: [str(t) for t in prony_terms(10, 5, outputs=(f"y{number}",))]
        for number, channel in enumerate(MONITORED, start=1)
    }


def standing(count: int) -> si.Runs:
    """Runs over the prior range that do not exceed the drift limit early."""
    design = si.ParameterSpace(**BOX, coordinates=COORDINATES).sample(count, 1)
    found = wall(*MONITORED, "drift").simulate(design, el_centro())
    keep = ~(si.first_passage(found, "drift", LIMIT) < STANDS_UNTIL)
    histories = si.Histories(found.values[keep][:, :, :3], found.dt, MONITORED)
    return si.Runs.from_histories(design[np.flatnonzero(keep)], histories, el_centro())


def run_by_run(runs: si.Runs, count: int) -> list[list[str]]:
    """Errors of free runs with coefficients fitted to each single run, as in the thesis."""
    rows = [["thesis, 59 terms, LARS, 200 runs", *(f"{e:.3f}" for e in THESIS), "", ""]]
    candidates = (
        ("only Prony terms (5.7 to 5.12), LARS", prony_alone(), {"selection": "lars"}),
        ("polynomial and cross-channel terms", polynomial_and_cross(), {}),
        ("Prony, polynomial and cross-channel terms", with_prony(), {}),
    )
    record = el_centro()
    for label, terms, settings in candidates:
        errors, began = [], time.perf_counter()
        for values in runs[:count].values:
            fitted = si.NARX(terms=terms, held_out=0.0, **settings).fit(record, values, MONITORED)
            again = fitted.simulate(np.zeros((1, 0)), record).values[0]
            spread = ((values - values.mean(axis=0)) ** 2).sum(axis=0)
            errors.append(((values - again) ** 2).sum(axis=0) / spread)
        found, seconds = np.array(errors), time.perf_counter() - began
        diverged = ~np.isfinite(found).all(axis=1)
        mean, worst = found[~diverged].mean(axis=0), found[~diverged].max(axis=0)
        cells = [f"{m:.2g} (largest {w:.2g})" for m, w in zip(mean, worst, strict=True)]
        rows.append([f"{label}, {count} runs", *cells, f"{diverged.sum()}", f"{seconds / count:.1f}"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def over_the_box(runs: si.Runs, training: int, most: int | None) -> list[list[str]]:
    """Errors of one PC-NARX for the prior range, on validation runs."""
    rows = []
    fit, unseen = runs[:training], runs[training:]
    cases = (
        ("in the parameters, degree 2", None, polynomial_and_cross(), 2),
        ("in transformed coordinates, degree 2", COORDINATES, polynomial_and_cross(), 2),
        ("in transformed coordinates, degree 3", COORDINATES, polynomial_and_cross(), 3),
        ("with Prony terms, in transformed coordinates, degree 2", COORDINATES, with_prony(), 2),
    )
    for label, coordinates, terms, degree in cases[:most]:
        space = si.ParameterSpace(**BOX, coordinates=coordinates)
        own = [
            si.Runs.from_histories(si.Design(r.design.values, space), r.histories(), el_centro()) for r in (fit, unseen)
        ]
        began = time.perf_counter()
        surrogate = si.PCNARX(terms=terms, degree=degree, limit=10.0).fit(own[0])
        seconds = time.perf_counter() - began
        found = surrogate.validate(own[1])
        cells = [f"{e['median']:.2g} (95 % {e['q95']:.2g})" for e in found.per_channel.values()]
        rows.append([f"PC-NARX {label}", *cells, f"{found.diverged} of {len(unseen)}", f"{seconds:.0f}"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    warnings.simplefilter("ignore")
    runs = standing(80 if quick else 1400)
    each = run_by_run(runs, 1 if quick else 25)
    box = over_the_box(runs, 50 if quick else TRAINING, 1 if quick else None)
    heads = ["fitted to single runs", "ux top left", "uy top left", "uy top right", "diverged", "seconds per run"]
    text = f"""# The masonry façade by NARX

`benchmarks/facade_narx.py`. {common.machine()}.

El Centro, 2.5 s, 251 samples. The runs cover the prior ranges of the thesis. Runs whose drift exceeds 130 mm before 2.36 s are
omitted, as in the thesis. The error of a free run is Σ(y − ŷ)²/Σ(y − ȳ)². The limits are the thesis's 0.128, 0.179 and 0.787; the
stretch goal is 0.02 for every channel.

{common.markdown_table(heads, each)}

One surrogate for these ranges, fitted to {len(runs[: 50 if quick else TRAINING])} runs: median and 95 % quantile in other runs:

{common.markdown_table(["surrogate", "ux top left", "uy top left", "uy top right", "diverged", "fit [s]"], box)}

Joints that open and close cause the vertical displacements, which a recursion with few lags reproduces only in part. Terms that
depend on time alone (cos 2πt, exp(−t) sin 2πt) fit only one record. They improve single runs, but more runs diverge over the
ranges. For calibration on one record, response-space surrogates ([the masonry façade](facade.md)) are better: their mean error is
0.023 with 900 runs.
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=each, box=box)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
