"""Hysteretic laws: time per sample beside the Bouc-Wen-Baber-Noori model, and the law that real cyclic tests choose.

    python benchmarks/hysteretic_laws.py [--quick]

Times are medians over interleaved calls of the same batch of runs along one cyclic path. The tests are read from the folder
of data beside the checkout.
"""

from __future__ import annotations

import itertools
import time
from functools import partial

import common
import numpy as np

import structid as si
from structid.law_choice.cyclic_test import CyclicTest
from structid.mechanics.hysteretic_laws.law_list import LAWS

NAME = "hysteretic_laws"
RUNS = 2048
AMPLITUDES = np.repeat(np.linspace(0.1, 1.0, 10), 2) * 0.02  # m, two cycles each
SAMPLES = 55  # per half-cycle, as in a test of 2197 samples
PIECES = 10
TESTS = {
    "PG1, stone masonry": "FD_PG1_Almeida2012.csv",
    "T1-1, stone masonry": "FD_T11_Faella1992.csv",
    "CT01, stone masonry": "FD_CT01_Magenes2010.csv",
}
DATA = common.ROOT.parent / "shared" / "data" / "hysteresis"


def cyclic_path(quick: bool) -> si.DisplacementHistory:
    """A path of growing cycles."""
    turns = np.concatenate([[0.0], *([a, -a] for a in AMPLITUDES[: 2 if quick else None])])
    moves = [np.linspace(a, b, SAMPLES + 1)[1:] for a, b in itertools.pairwise(turns)]
    return si.DisplacementHistory(np.concatenate([[0.0], *moves]), 1.0)


def bouc_wen(free: tuple[str, ...]) -> si.BoucWen:
    """The spring of the Bouc-Wen-Baber-Noori model with strength and stiffness degradation."""
    return si.BoucWen(mass=1.0, gamma_ratio=0.5, free=free, channels=("restoring_force",))


def speed_rows(quick: bool) -> list[list[str]]:
    """Time per sample of every law, with all its parameters free."""
    path = cyclic_path(quick)
    test = CyclicTest(path.values, 60e3 * np.tanh(path.values / 3e-3), "path")
    space = si.ParameterSpace(
        stiffness=si.Uniform(10.0, 40.0, unit="kN/mm"),
        alpha=si.Uniform(0.0, 0.1),
        beta=si.Uniform(50.0, 200.0, unit="1/m"),
        delta_nu=si.Uniform(0.0, 1e-4, unit="kg/J"),
        delta_eta=si.Uniform(0.0, 1e-4, unit="kg/J"),
    )
    theta, model = space.sample(RUNS, seed=1).values, bouc_wen(space.names)
    calls = {
        "`BoucWen`, imposed in 10 pieces": partial(si.ImposedDisplacements(model, pieces=PIECES).simulate, theta, path),
        "`BoucWen`, 3 substeps": partial(model.simulate, theta, path),
    }
    for word, kind in LAWS.items():
        priors = test.priors(kind())
        law = si.Hysteretic(word, free=priors.names)
        calls[f"`{word}`"] = partial(law.simulate, priors.sample(RUNS, seed=1).values, path)
    for call in calls.values():
        call()
    timings = common.interleaved(calls, 1 if quick else 9)
    first = next(iter(timings.values())).median
    rows = []
    for name, timing in timings.items():
        nanoseconds = 1e9 * timing.median / (RUNS * len(path.values))
        common.record_result(NAME, quick=quick, law=name, nanoseconds=nanoseconds, ratio=first / timing.median)
        rows.append([name, f"{nanoseconds:.1f}", f"{first / timing.median:.1f}"])
    return rows


def read_test(name: str, file: str) -> CyclicTest:
    """Read a test of the data folder: mm and kN, after four lines of text."""
    table = np.genfromtxt(DATA / file, delimiter=",", skip_header=4, usecols=(0, 1))
    table = table[np.isfinite(table).all(axis=1)]
    return CyclicTest(1e-3 * table[:, 0], 1e3 * table[:, 1], name)


def choice_rows(quick: bool) -> list[list[str]]:
    """The chosen law of every test, what it explains and predicts, and the time."""
    rows = []
    for name, file in {} if quick or not DATA.is_dir() else TESTS.items():
        test, begin = read_test(name, file), time.perf_counter()
        choice = si.choose_model(test, seed=1)
        seconds = time.perf_counter() - begin
        best = min(c.prediction_error for c in choice.candidates)
        shown = [words for words, gain in choice.mechanisms.items() if gain > 5.0]
        values = {"unexplained": choice.least_squares, "prediction_error": choice.chosen.prediction_error}
        common.record_result(NAME, quick=quick, test=name, law=choice.chosen.law.word, seconds=seconds, **values)
        rows.append(
            [
                name,
                f"{len(test.force)}",
                f"`{choice.chosen.law.word}`",
                f"{choice.least_squares:.2%}",
                f"{choice.chosen.prediction_error:.1%}",
                f"{best:.1%}",
                ", ".join(shown),
                f"{seconds:.0f}",
            ]
        )
    return rows


def main() -> None:
    """Run the comparisons, and write the page."""
    quick = common.is_quick(__doc__ or "")
    text = f"""
# Hysteretic laws

`benchmarks/hysteretic_laws.py`. {common.machine()}.

Nanoseconds per sample and run, {
        RUNS
    } runs of a cyclic path on both cores, all parameters with a default prior free. The last column is how many
times faster the law is than the Bouc–Wen–Baber–Noori model under imposed displacements with ten pieces per sample.

{common.markdown_table(["law", "time per sample [ns]", "times faster"], speed_rows(quick))}

The law that a real test chooses among all, with independent or AR(1) errors. *Unexplained* is the residual variance of the force at
the law's least squares. The *prediction error* is the root mean square of the error on the last 30 % of the half-cycles, predicted
from the others, relative to the largest force; beside it the smallest of all laws.

{
        common.markdown_table(
            ["test", "samples", "law", "unexplained", "prediction error", "smallest", "mechanisms shown", "seconds"],
            choice_rows(quick),
        )
    }
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
