"""Shared code of the benchmarks: interleaved timing, the machine, stored results, and the common study."""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# One thread for every other program. Only structid distributes a batch over the cores, as the tables state.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402

import structid as si  # noqa: E402
from structid.models.hysteretic.hysteretic_parameters import parameter_unit  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
EL_CENTRO = ROOT.parent / "shared" / "data" / "strong_motion" / "RSN6_IMPVALL.I_I-ELC180.AT2"
"""El Centro record of the published studies, stored next to the checkout."""
RESULTS = ROOT / "benchmarks" / "results"
QUICK = ROOT / "build" / "benchmarks"
"""Output folder of quick runs, which keeps their figures apart from the published ones."""


# --- command line and folders -----------------------------------------------------------------------------------


def is_quick(description: str) -> bool:
    """Read the command line: `--quick` is the only option."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="few repeats; does not write to docs/")
    return bool(parser.parse_args().quick)


def shorter_if_quick(record: si.GroundMotion, seconds: float) -> si.GroundMotion:
    """Return the record, shortened to its first seconds in a quick run, which only checks that the script works."""
    return record.trim(0.0, seconds) if "--quick" in sys.argv else record


def documents(quick: bool) -> Path:
    """Return the output folder of tables and figures: docs/, or the output folder of quick runs."""
    folder = QUICK if quick else ROOT / "docs"
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    return folder


# --- timing -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Timing:
    """Elapsed time and CPU time of every repeat of one callable, in seconds.

    The CPU time of all threads together distinguishes a slow callable from a busy machine.
    """

    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median elapsed time of the repeats [s]."""
        return statistics.median(self.seconds)

    @property
    def cpu_median(self) -> float:
        """Median CPU time of the repeats [s]."""
        return statistics.median(self.cpu_seconds)

    @property
    def spread(self) -> float:
        """Difference between the longest and the shortest repeat, divided by the median."""
        return (max(self.seconds) - min(self.seconds)) / self.median


def interleaved(callables: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Time several callables in turn, so that a disturbance of the machine affects all of them equally.

    Every second round runs in reverse order, so that the same callable is not always first. There is no warm-up call.
    """
    clocks = (time.perf_counter, time.process_time)
    seconds: dict[str, list[tuple[float, ...]]] = {name: [] for name in callables}
    for repeat in range(repeats):
        names = list(callables) if repeat % 2 == 0 else list(callables)[::-1]
        for name in names:
            gc.collect()
            began = [clock() for clock in clocks]
            callables[name]()
            seconds[name].append(tuple(clock() - start for clock, start in zip(clocks, began, strict=True)))
    return {name: Timing(*zip(*values, strict=True)) for name, values in seconds.items()}


def growth_exponent(sizes: Sequence[float], seconds: Sequence[float]) -> tuple[float, float]:
    """Return the least-squares slope of log time against log size, and the slope of the last interval."""
    x, y = np.log(np.asarray(sizes, dtype=float)), np.log(np.asarray(seconds, dtype=float))
    return float(np.polyfit(x, y, 1)[0]), float((y[-1] - y[-2]) / (x[-1] - x[-2]))


# --- the machine ------------------------------------------------------------------------------------------------


def machine(*packages: str) -> str:
    """Return one line with the processor, the number of cores, the load and the versions."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "?"
    names = ("structid", "jax", "numpy", "scipy", *packages)
    versions = ", ".join(f"{name} {_version(name)}" for name in names)
    return f"{_processor()}, {cores} cores (load {load}), Python {platform.python_version()}, {versions}"


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", path.read_text()) if path.exists() else None
    return found.group(1).strip() if found else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


# --- results ----------------------------------------------------------------------------------------------------


def record_result(name: str, *, quick: bool, **values: Any) -> None:
    """Append one JSON line to `benchmarks/results/<name>.jsonl`."""
    folder = QUICK if quick else RESULTS
    folder.mkdir(parents=True, exist_ok=True)
    row = {"when": time.strftime("%Y-%m-%dT%H:%M:%S%z"), **values}
    with (folder / f"{name}.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(row, default=float, ensure_ascii=False) + "\n")


def last_results(name: str, *keys: str, quick: bool) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Return the last line of `benchmarks/results/<name>.jsonl` for all values of some keys."""
    file = (QUICK if quick else RESULTS) / f"{name}.jsonl"
    lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    return {tuple(line[key] for key in keys): line for line in lines}


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a markdown table; the first column is left-aligned, the others right-aligned."""
    ruler = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (header, ruler, *rows))


def write_page(quick: bool, name: str, text: str) -> None:
    """Write a benchmark's page, ``benchmarks/tables/<name>.md`` in the output folder; `text` begins with the heading."""
    page = documents(quick) / "benchmarks" / "tables" / f"{name}.md"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text.strip() + "\n", encoding="utf-8")


def write_section(page: Path, name: str, text: str) -> None:
    """Replace the text between `<!-- name:start -->` and `<!-- name:end -->` in a page that is written by hand."""
    start, end = f"<!-- {name}:start -->", f"<!-- {name}:end -->"
    written = page.read_text(encoding="utf-8") if page.exists() else f"{start}\n{end}\n"
    before, rest = written.split(start, 1)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(before + f"{start}\n{text.strip()}\n{end}" + rest.split(end, 1)[1], encoding="utf-8")


# --- the study --------------------------------------------------------------------------------------------------

MASS, STIFFNESS, DAMPING_RATIO, ALPHA, BETA, GAMMA = 12_000.0, 7.6e6, 0.03, 0.05, 63.0, 63.0
DELTA_NU, DELTA_ETA = 2.43, 6.5
STUDY_PGA = 1.8
NOISE = 0.02
"""Standard deviation of the white measurement noise, divided by the RMS of the response."""


def study_record(duration: float, pga: float) -> si.GroundMotion:
    """Return the synthetic record of the benchmarks, filtered with a 20 Hz low-pass and scaled."""
    return shorter_if_quick(si.GroundMotion.synthetic(seed=7, duration=duration).lowpass(20.0).scale_to_pga(pga), 8.0)


def degrading_oscillator(**settings: Any) -> si.BoucWen:
    """Return the oscillator that generates the data: exponent 1, with degradation, without pinching."""
    values = {
        "mass": MASS,
        "stiffness": STIFFNESS,
        "damping_ratio": DAMPING_RATIO,
        "alpha": ALPHA,
        "beta": BETA,
        "gamma_ratio": GAMMA / BETA,
        "delta_nu": DELTA_NU,
        "delta_eta": DELTA_ETA,
    }
    return si.BoucWen(**(values | settings))


def study_space(exponent: float = 1.0) -> si.ParameterSpace:
    """Return the priors of the study, with their moments before truncation and with β in m⁻ⁿ."""
    return si.ParameterSpace(
        stiffness=si.Normal(7.42, 0.742, low=4.27, high=11.85, unit="kN/mm"),
        beta=si.Uniform(55.0, 65.0, unit=parameter_unit("beta", {"exponent": exponent}, ()) or ""),
        gamma_ratio=si.Uniform(-1.0, 1.0),
        alpha=si.LogNormal(0.063, 0.01, high=1.0),
    )


def study_posterior(record: si.GroundMotion, substeps: int) -> si.Posterior:
    """Return the posterior of an oscillator without degradation, given the noisy velocity of a degrading oscillator."""
    velocity = degrading_oscillator(substeps=4).simulate(np.zeros((1, 0)), record).channel("velocity")[0]
    noise = np.random.default_rng(11).standard_normal(velocity.size)
    measured = velocity + NOISE * np.sqrt(np.mean(velocity**2)) * noise
    space = study_space()
    model = si.BoucWen(mass=MASS, damping_ratio=DAMPING_RATIO, free=space.names, substeps=substeps)
    return si.Posterior(space, model, si.Observation(record, measured), si.IID())
