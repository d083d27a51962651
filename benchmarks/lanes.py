"""Cost of a run in compiled vector code for every hysteretic model, compared with JAX's scan and a hand-written kernel.

The hand-written Numba kernel has 16 runs in its innermost loop and covers only the plain model. Vector code, which is generated
from one general model, should come close to it. Histories are compared with JAX's. Run with ``python benchmarks/lanes.py
[--quick]``.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import common
import numpy as np

import structid as si
from structid.engine.device import over_runs
from structid.engine.lanes.machine import engine, lanes, processor

NAME = "lanes"
DURATION, PGA = 40.0, 1.8
BATCHES, SUBSTEPS = (50, 200, 2000), (1, 3)
NEAR_KERNEL = 1.5
"""Largest cost of the general model, relative to the hand-written kernel."""
FULL_LAW_LIMIT = 0.05
"""Largest time per run of the full hysteretic model, 200 at a time, with the default substeps [ms]."""

DEGRADING = {"delta_nu": common.DELTA_NU, "delta_eta": common.DELTA_ETA}
PINCHED = {"zeta0": 0.9, "p": 10.0, "q": 0.1, "psi0": 0.002, "delta_psi": 0.0005, "lambda_": 0.5}
LAWS: dict[str, dict[str, Any]] = {
    "plain": {},
    "exponent 2": {"exponent": 2.0},
    "exponent 1.5": {"exponent": 1.5},
    "degrading": DEGRADING,
    "pinching": PINCHED,
    "degrading and pinching": {"delta_a": 0.1} | DEGRADING | PINCHED,
}
FULL = "degrading and pinching"
STOREYS = (2, 4, 8)


# --- models ---------------------------------------------------------------------------------------------------------


def oscillator(law: str, substeps: int) -> si.BoucWen:
    """The study's oscillator with its four free parameters and one of the hysteretic models."""
    return si.BoucWen(
        mass=common.MASS,
        damping_ratio=common.DAMPING_RATIO,
        free=common.study_space().names,
        substeps=substeps,
        **LAWS[law],
    )


def frame(storeys: int, substeps: int) -> si.ShearFrame:
    """A frame of such springs, with the velocity of its top as output."""
    return si.ShearFrame(
        storeys=storeys,
        mass=common.MASS,
        damping_ratio=common.DAMPING_RATIO,
        free=common.study_space().names,
        channels=(f"velocity_{storeys}",),
        substeps=substeps,
    )


def models(substeps: int) -> dict[str, Any]:
    """Oscillators with every hysteretic model, and frames."""
    frames = {f"frame of {storeys} storeys": frame(storeys, substeps) for storeys in STOREYS}
    return {law: oscillator(law, substeps) for law in LAWS} | frames


# --- hand-written kernel --------------------------------------------------------------------------------------------


def kernel_by_hand() -> Callable[..., np.ndarray] | None:
    """Compile RK4 of the plain model, with 16 runs in the innermost loop and blocks over the cores; None without Numba."""
    try:
        import numba
    except ImportError as error:
        print(f"skipped: Numba cannot be imported ({error})")
        return None
    width = 16

    @numba.njit(fastmath={"contract", "nsz", "arcp"}, error_model="numpy", inline="always")
    def rate(u, v, z, ground, p, j):
        return (
            v,
            -ground - p[0, j] * v - p[1, j] * u - p[2, j] * z,
            v - p[3, j] * abs(v) * z - p[4, j] * v * abs(z),
        )

    @numba.njit(fastmath={"contract", "nsz", "arcp"}, error_model="numpy", parallel=True)
    def velocities(ground, dt, substeps, parameters, found):
        h, runs = dt / substeps, parameters.shape[1]
        for block in numba.prange((runs + width - 1) // width):
            first, count = block * width, min(width, runs - block * width)
            u, v, z, p = np.zeros(width), np.zeros(width), np.zeros(width), np.zeros((5, width))
            p[:, :count] = parameters[:, first : first + count]
            found[0, first : first + count] = 0.0
            for i in range(ground.size - 1):
                slope = (ground[i + 1] - ground[i]) / substeps
                for s in range(substeps):
                    a0 = ground[i] + slope * s
                    a1, a2 = a0 + 0.5 * slope, a0 + slope
                    for j in range(width):
                        u1, v1, z1 = rate(u[j], v[j], z[j], a0, p, j)
                        u2, v2, z2 = rate(u[j] + h / 2 * u1, v[j] + h / 2 * v1, z[j] + h / 2 * z1, a1, p, j)
                        u3, v3, z3 = rate(u[j] + h / 2 * u2, v[j] + h / 2 * v2, z[j] + h / 2 * z2, a1, p, j)
                        u4, v4, z4 = rate(u[j] + h * u3, v[j] + h * v3, z[j] + h * z3, a2, p, j)
                        u[j] += h / 6 * (u1 + 2 * (u2 + u3) + u4)
                        v[j] += h / 6 * (v1 + 2 * (v2 + v3) + v4)
                        z[j] += h / 6 * (z1 + 2 * (z2 + z3) + z4)
                found[i + 1, first : first + count] = v[:count]

    def call(record: si.GroundMotion, substeps: int, theta: np.ndarray) -> np.ndarray:
        stiffness, beta, ratio, alpha = theta.T
        square = stiffness / common.MASS
        viscous = 2.0 * common.DAMPING_RATIO * np.sqrt(square)
        parameters = np.stack([viscous, alpha * square, (1.0 - alpha) * square, beta, ratio * beta])
        found = np.empty((len(record), len(theta)))
        velocities(record.values, record.dt, substeps, parameters, found)
        return found

    return call


# --- timed calls ----------------------------------------------------------------------------------------------------


def several_times(call: Callable[[], Any], times: int) -> None:
    """Call several times, and discard the results."""
    for _ in range(times):
        call()


def timed(batch: int, substeps: int, repeats: int, by_hand: Callable[..., np.ndarray] | None) -> list[list[str]]:
    """Milliseconds per run of every model, and the difference between vector code and JAX; a quick run times one batch."""
    record, space = common.study_record(DURATION, PGA), common.study_space()
    theta = space.sample(batch, seed=1).values
    rows = []
    for name, model in models(substeps).items():
        if batch == BATCHES[-1] and name not in LAWS:
            continue  # JAX takes minutes
        traced, jax_alone = model.traced(record), over_runs(model.response, (2, 0))
        in_lanes, expected = model.simulate(theta, record).values, jax_alone(theta, traced)[0]
        difference = np.abs(np.moveaxis(expected, 2, 0) - in_lanes).max() / np.abs(in_lanes).max()
        space = common.study_space(model.exponent)
        misfit = si.Posterior(space, model, si.Observation(record, in_lanes[0], model.channels), si.IID()).misfit
        misfit(theta)
        calls = {
            "lanes": lambda m=model: m.simulate(theta, record),
            "misfit": lambda m=misfit: m(theta),
            "JAX": lambda j=jax_alone, t=traced: j(theta, t),
        }
        if name == "plain" and by_hand is not None:
            apart = np.abs(by_hand(record, substeps, theta).T - in_lanes[..., 0]).max() / np.abs(in_lanes).max()
            difference = max(difference, apart)
            calls["by hand"] = lambda: by_hand(record, substeps, theta)
        # A call of a small batch takes less than a millisecond: several are timed together.
        together = BATCHES[-1] // batch if repeats > 1 else 1
        several = {who: partial(several_times, call, together) for who, call in calls.items()}
        each = {who: 1e3 * t.median / (batch * together) for who, t in common.interleaved(several, repeats).items()}
        rows.append([name, each, difference])
    return rows


# --- workers --------------------------------------------------------------------------------------------------------


def cpu_seconds(rows: np.ndarray) -> float:
    """CPU time of this process for some runs, all threads together: median of fifteen calls after compilation."""
    model, record = oscillator("degrading", 3), common.study_record(DURATION, PGA)
    model.simulate(rows, record)
    spent = []
    for _ in range(15):
        began = time.process_time()
        model.simulate(rows, record)
        spent.append(time.process_time() - began)
    return float(np.median(spent))


def worker_rows(runs: int) -> list[list[str]]:
    """CPU time of the same runs on one core, and in several kinds of workers."""
    from distributed import Client, LocalCluster

    parts = np.split(common.study_space().sample(runs, seed=2).values, 4)
    os.environ["JAX_NUM_CPU_DEVICES"] = "1"
    spent = {"one core": sum(map(cpu_seconds, parts))}
    del os.environ["JAX_NUM_CPU_DEVICES"]
    spent["all cores, one process"] = sum(map(cpu_seconds, parts))
    for start in ("fork", "spawn"):
        with ProcessPoolExecutor(2, multiprocessing.get_context(start)) as pool:
            spent[f"two processes, {start}"] = sum(pool.map(cpu_seconds, parts))
    # The workers must find the modules that this file imports.
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        spent["two Dask workers"] = sum(client.gather(client.map(cpu_seconds, parts)))
    alone = spent["one core"]
    return [
        [who, f"{cpu:.2f}", f"{cpu / alone:.2f}", "-" if who == "one core" else "1.1"] for who, cpu in spent.items()
    ]


# --- report ---------------------------------------------------------------------------------------------------------


def cells(name: str, each: dict[str, float], difference: float, batch: int, substeps: int) -> list[str]:
    """Return a row of the table."""
    verdict = "–"
    if "by hand" in each:
        ratio = each["lanes"] / each["by hand"]
        verdict = f"{ratio:.2f} × hand-written, limit {NEAR_KERNEL}: {'met' if ratio <= NEAR_KERNEL else 'MISSED'}"
    if name == FULL and batch == 200 and substeps == 3:
        verdict = f"limit {FULL_LAW_LIMIT} ms: {'met' if each['lanes'] <= FULL_LAW_LIMIT else 'MISSED'}"
    by_hand = f"{each['by hand']:.4f}" if "by hand" in each else "–"
    milliseconds = [f"{each[who]:.4f}" for who in ("lanes", "misfit", "JAX")]
    faster = f"{each['JAX'] / each['lanes']:.1f}"
    return [f"{name}, {batch}, {substeps}", *milliseconds, by_hand, faster, f"{difference:.0e}", verdict]


def main() -> None:
    quick = common.is_quick(__doc__)
    batches, substeps, repeats = ((50,), (1,), 1) if quick else (BATCHES, SUBSTEPS, 5)
    by_hand, table = kernel_by_hand(), []
    for count in substeps:
        for batch in batches:
            for name, each, difference in timed(batch, count, repeats, by_hand):
                table.append(cells(name, each, difference, batch, count))
                common.record_result(
                    NAME,
                    machine=common.machine("llvmlite", "numba"),
                    quick=quick,
                    law=name,
                    batch=batch,
                    substeps=count,
                    ms_per_run=each,
                    difference=difference,
                )
    workers = 400 if quick else 8000
    header = (
        "model, batch, substeps",
        "vector code",
        "vector code, misfit",
        "JAX",
        "hand-written",
        "speed-up over JAX",
        "difference",
        "limit",
    )
    text = f"""# Compiled vector code

Milliseconds of one run of {DURATION:g} s (4001 samples): medians of {repeats} interleaved repeats of 2000 runs, after compilation.
Vector code computes several runs at once on one core. Vector code and JAX return the history of one velocity; "misfit" returns
only the sum of squared residuals. The hand-written Numba kernel has 16 runs in its innermost loop and covers only the plain model.
The column "difference" gives the largest difference between the histories of vector code and JAX, divided by the largest value.
Engine {engine()}, {lanes()} runs per block, half as many for large states, {processor()}. {common.machine("llvmlite", "numba")}.

{common.markdown_table(header, table)}

CPU time of {workers} runs of the degrading oscillator with three substeps, in several kinds of workers:

{common.markdown_table(("workers", "CPU seconds", "relative to one core", "limit"), worker_rows(workers))}
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
