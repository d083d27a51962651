"""Accuracy, claims of convergence and number of model runs of four programs on six posteriors.

Run with ``python benchmarks/leaderboard.py [--quick]``. The other programs are the dependency group ``peers``; missing ones are
omitted. Every run has a separate process and a line in ``results/leaderboard.jsonl``, and is not repeated if the line exists. Draws
of the other programs are kept in ``build/leaderboard``: delete a line to certify its draws again.
"""

from __future__ import annotations

import json
import pickle
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from typing import Any

import common
import numpy as np
from leaderboard_cases import CASES, Case
from leaderboard_methods import METHODS, Outcome, installed, quiet

import structid as si

NAME = "leaderboard"
SEEDS = range(1, 11)
LONGEST = 480.0
"""Time after which a run is stopped [s]."""
KEPT = common.ROOT / "build" / "leaderboard"
"""Folder of the other programs' draws and of the references."""
REFERENCE = si.SMC(particles=1000, steps=100, effective_share=0.5, correlation=0.2)
LEVELS = (0.05, 0.5, 0.95)
FALSE = 0.25
"""Error of a mean in standard deviations, or relative error of a standard deviation, above which a claim is false."""
HEADS = [
    "posterior",
    "program",
    "seeds",
    "model runs",
    "rounds",
    "seconds",
    "error of a mean [sd]",
    "error of an sd",
    "error of a quantile [sd]",
    "claims",
    "false claims",
    "result of `certify`",
]


def reference_draws(case: Case, name: str, quick: bool) -> np.ndarray:
    """Draws from the model itself, shape (draw, parameter); stored draws are used again."""
    path = KEPT / f"{name}.npy"
    if quick:
        return si.sample(case.target, si.SMC(particles=100, steps=20), seed=99).flat
    if not path.is_file():
        KEPT.mkdir(parents=True, exist_ok=True)
        np.save(path, si.sample(case.target, REFERENCE, seed=99).flat)
    return np.load(path)


def compared(outcome: Outcome, reference: np.ndarray) -> dict[str, float]:
    """Largest errors over the parameters."""
    sd = reference.std(axis=0)
    quantiles = np.quantile(outcome.draws, LEVELS, axis=0) - np.quantile(reference, LEVELS, axis=0)
    return {
        "mean": float(np.max(np.abs(outcome.draws.mean(axis=0) - reference.mean(axis=0)) / sd)),
        "sd": float(np.max(np.abs(outcome.draws.std(axis=0) / sd - 1.0))),
        "quantile": float(np.max(np.abs(quantiles) / sd)),
    }


def by_certify(case: Case, outcome: Outcome, seed: int) -> str:
    """Result of `si.certify` with the limits of `FALSE`, from 60 model runs at a program's draws and up to 40 others."""
    if outcome.log_density is None:
        return ""
    try:
        limits = si.Limits(mean=FALSE, sd=FALSE, correlation=2.0 * FALSE)
        found = si.certify(
            case.target, outcome.draws, outcome.log_density, true_runs=60, known=outcome.known, limits=limits, seed=seed
        )
    except si.InputError:
        return "refused as input"
    return "certified" if found.certified else "refused"


def one(case_word: str, method: str, seed: int, quick: bool) -> None:
    """Run one case in this process, and print its line."""
    quiet()
    case = CASES[case_word]()
    outcome, seconds = kept(case, f"{case_word}-{method}-{seed}", method, seed)
    errors = compared(outcome, reference_draws(case, case_word, quick))
    row = {
        "case": case_word,
        "label": case.name,
        "method": method,
        "seed": seed,
        "runs": outcome.runs,
        "rounds": outcome.rounds,
        "seconds": seconds,
        "claims": outcome.claims,
        **errors,
        "certify": by_certify(case, outcome, seed),
    }
    print("ROW " + json.dumps(row))


def kept(case: Case, name: str, method: str, seed: int) -> tuple[Outcome, float]:
    """Outcome of a program and its seconds; stored outcomes of other programs are used again."""
    path = KEPT / f"{name}.pickle"
    if path.is_file():
        outcome, seconds = pickle.loads(path.read_bytes())
        return outcome, seconds
    began = time.perf_counter()
    outcome = METHODS[method](case, seed)
    seconds = time.perf_counter() - began
    if method != "structid":
        import cloudpickle  # pickles functions, too

        KEPT.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cloudpickle.dumps((outcome, seconds)))
    return outcome, seconds


def run_apart(case_word: str, method: str, seed: int, quick: bool) -> dict[str, Any]:
    """Run one case in a separate process; a failure or a time-out also gives a row."""
    command = [
        sys.executable,
        "-W",
        "ignore",
        __file__,
        "--one",
        case_word,
        method,
        str(seed),
        *(["--quick"] if quick else []),
    ]
    failed = {"case": case_word, "method": method, "seed": seed}
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return {**failed, "failed": f"stopped after {LONGEST:.0f} s"}
    lines = [line for line in told.stdout.splitlines() if line.startswith("ROW ")]
    if not lines:
        return {**failed, "failed": (told.stderr.strip().splitlines() or ["no output"])[-1][:200]}
    return dict(json.loads(lines[-1][4:]))


def done(quick: bool) -> dict[tuple[str, str, int], dict[str, Any]]:
    """Rows that are already stored."""
    path = (common.QUICK if quick else common.RESULTS) / f"{NAME}.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    return {(r["case"], r["method"], r["seed"]): r for r in rows if "case" in r and r["version"] == si.__version__}


def runs(quick: bool) -> list[dict[str, Any]]:
    """All rows, ordered by seed."""
    wanted = [
        (case, method, seed)
        for seed in ([1] if quick else SEEDS)
        for case in (["rosenbrock"] if quick else CASES)
        for method in (["structid"] if quick else METHODS)
        if installed(method)
    ]
    known = {} if quick else done(quick)
    for key in wanted:
        if key not in known:
            known[key] = run_apart(*key, quick)
            common.record_result(NAME, quick=quick, version=si.__version__, machine=common.machine(), **known[key])
            print(known[key], flush=True)
    return [known[key] for key in known if key in set(wanted) or not quick]


def false(row: dict[str, Any]) -> bool:
    """Whether a claim is false."""
    return bool(row["claims"]) and (row["mean"] > FALSE or row["sd"] > FALSE)


def rows(found: list[dict[str, Any]]) -> list[list[str]]:
    """Table of medians over the seeds, with the largest value in brackets."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in found:
        groups[row["case"], row["method"]].append(row)
    table = []
    for case in CASES:
        for method in METHODS:
            group = groups.get((case, method), [])
            good = [r for r in group if "failed" not in r]
            if not group:
                continue
            if not good:
                table.append([CASES[case]().name, method, str(len(group)), *["–"] * 6, "failed", "", ""])
                continue
            table.append(
                [
                    good[0]["label"],
                    method,
                    str(len(group)),
                    spread(good, "runs", "{:,.0f}"),
                    spread(good, "rounds", "{:,.0f}"),
                    spread(good, "seconds", "{:.0f}"),
                    spread(good, "mean", "{:.2f}"),
                    spread(good, "sd", "{:.0%}"),
                    spread(good, "quantile", "{:.2f}"),
                    f"{sum(r['claims'] for r in good)} of {len(group)}",
                    str(sum(map(false, good))),
                    by_certify_of(good),
                ]
            )
    return table


def by_certify_of(group: list[dict[str, Any]]) -> str:
    """Numbers of certified samples, of wrong certificates and of accurate samples."""
    judged = [r for r in group if r["certify"]]
    if not judged:
        return ""
    passed = [r for r in judged if r["certify"] == "certified"]
    wrong = sum(r["mean"] > FALSE or r["sd"] > FALSE for r in passed)
    right = sum(r["mean"] <= FALSE and r["sd"] <= FALSE for r in judged)
    return f"{len(passed)} of {len(judged)} certified, {wrong} wrongly; {right} accurate"


def spread(group: list[dict[str, Any]], key: str, form: str) -> str:
    """Median, and the largest value in brackets."""
    values = [r[key] for r in group]
    middle, largest = form.format(statistics.median(values)), form.format(max(values))
    return middle if middle == largest else f"{middle} ({largest})"


def main() -> None:
    if "--one" in sys.argv:
        place = sys.argv.index("--one")
        case, method, seed = sys.argv[place + 1 : place + 4]
        one(case, method, int(seed), "--quick" in sys.argv)
        return
    quick = common.is_quick(__doc__.splitlines()[0])
    table = rows(runs(quick))
    text = f"""## Every program on every posterior

`benchmarks/leaderboard.py`. {common.machine("pyvbmc", "gpry", "emcee")}.

Every program runs with its defaults in a separate process. The table gives medians over the seeds, and the largest value in
brackets. PyVBMC, GPry and emcee receive the log density with the error variance integrated out, and start from quantiles of the
priors. structid receives model and measurement, and the variance is one of its parameters. Errors are the largest over the
parameters, relative to tempered SMC on the model itself. A claim ("converged", "certified") is false if the error of a mean
exceeds {FALSE} posterior standard deviations, or the error of a standard deviation exceeds {FALSE:.0%}. The last column gives the
result of `si.certify` with the same limits on the draws of another program. It uses 60 runs at the draws, one at the best known
point, up to 10 to search for missing modes, and up to 30 to learn where the draws are wrong. A program fails if it stops with an
error or takes more than {LONGEST / 60.0:.0f} minutes.

Seconds are per run. The other programs shared the two cores with other jobs; structid ran alone.

`certify` cannot detect a mode that neither the program nor any of these runs has visited. Its statement includes this limitation.

{common.markdown_table(HEADS, table)}
"""
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=table)
    common.write_section(common.documents(quick) / "benchmarks" / "leaderboard.md", NAME, text)
    print(text)


if __name__ == "__main__":
    main()
