"""Cost of the masonry façade, its drifts over the prior range, and the accuracy of its surrogates.

Run with ``python benchmarks/facade.py [--quick]``. El Centro is read from ``../shared/data``. If OpenSeesPy is installed, it
runs the same blocks with joints whose normal and tangential tractions are uncoupled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from typing import Any

import common
import jax
import numpy as np
import opensees_wall

import structid as si
from structid.engine.device import over_runs
from structid.engine.lanes import machine
from structid.engine.slopes import with_slopes
from structid.mechanics.cohesive_laws import SmcNp2, cohesive_law
from structid.models.masonry.equations.dense_newton import DenseWall, simulate
from structid.models.masonry.finite_elements.assembly import Assembly

NAME = "facade"
STEP = 1e-3
BOX = dict(
    normal_energy=si.Uniform(1e3, 10e3),
    normal_strength=si.Uniform(0.87e6, 1.23e6),
    tangential_energy=si.Uniform(0.5e5, 8e5),
    tangential_strength=si.Uniform(0.3e6, 3.7e6),
)
COORDINATES = {
    "log_normal_stiffness": "log(normal_strength**2 / normal_energy)",
    "log_normal_strength": "log(normal_strength)",
    "log_tangential_stiffness": "log(tangential_strength**2 / tangential_energy)",
    "log_tangential_strength": "log(tangential_strength)",
}
MONITORED = ("ux_top_left", "uy_top_left", "uy_top_right")
POINT = np.array([3e3, 0.95e6, 2e5, 0.6e6])
LIMITS = {0.065: 0.42, 0.100: 0.31, 0.130: 0.225, 0.150: 0.20, 0.200: 0.15, 0.250: 0.019}
"""Drifts [m], and the fraction of the prior range that exceeds them in another program."""
THESIS_SECONDS = 40.0


def el_centro() -> si.GroundMotion:
    """Record of the published study, 2.5 s long."""
    record = si.GroundMotion.read(common.EL_CENTRO).lowpass(20.0, order=3)
    return common.shorter_if_quick(record.scale_to_pga(6.36).trim(1.0, 3.5), 1.2)


def wall(*channels: str) -> si.MasonryWall:
    return si.MasonryWall(free=tuple(BOX), channels=channels, step=STEP)


# --- cost -----------------------------------------------------------------------------------------------------------


def cost_rows(record: si.GroundMotion, quick: bool) -> list[list[str]]:
    """Seconds per run: in vector code, by JAX, by dense Newton iterations and in OpenSees."""
    space, model = si.ParameterSpace(**BOX), wall("ux_top_left")
    batches = (8,) if quick else (8, 64, 512)
    designs = {count: space.sample(count, seed=count).values for count in batches}
    for theta in designs.values():
        model.simulate(theta, record)  # compiles the code, for every batch size
    timings = common.interleaved(
        {str(count): partial(model.simulate, theta, record) for count, theta in designs.items()},
        1 if quick else 5,
    )
    rows = []
    for count in batches:
        timing = timings[str(count)]
        rows.append(
            [
                f"condensed, in vector code, {count} at once",
                f"{timing.cpu_median / count:.4f}",
                f"{timing.median / count:.4f}",
                f"{THESIS_SECONDS * count / timing.cpu_median:,.0f}",
                "0.04 (0.02)",
            ]
        )
    by_jax, traced = over_runs(model.response, (2, 0)), model.traced(record)
    rows.append(_timed("condensed, by JAX, 8 at once", partial(by_jax, designs[8], traced), 8))
    base = np.interp(STEP * np.arange(round(record.duration / STEP) + 1), record.time, record.values)
    base = base[:251] if quick else base
    assembly = Assembly(model.mesh, model.masonry)
    dense = DenseWall(assembly, SmcNp2(), cohesive_law(*POINT))
    scale = round(record.duration / STEP) / (len(base) - 1)
    rows.append(_timed("dense Newton, NumPy", lambda: simulate(dense, base, STEP), 1, scale))
    theirs = _in_opensees(assembly, base)
    if theirs is not None:
        rows.append(_timed("OpenSeesPy, uncoupled joints", theirs, 1, scale))
    return rows


def gradient_rows(record: si.GroundMotion, quick: bool) -> list[list[str]]:
    """Seconds per log density with its four parameter derivatives, in vector code and by JAX."""
    space, model = si.ParameterSpace(**BOX), wall(*MONITORED)
    measured = si.Observation(record, model.simulate(POINT[None], record).values[0], MONITORED)
    posterior = si.Posterior(space, model, measured, si.IID(variance=1e-8))
    phi = posterior.bijection.inverse(space.sample(8 if quick else 64, seed=64).values)
    density, data = posterior.traceable()
    in_lanes = jax.jit(jax.value_and_grad(lambda points: density(points, data).sum()))

    def forward(points: Any, data: Any) -> tuple[Any, Any]:
        return with_slopes(lambda at: sum(posterior.parts_in_coordinates(at, data)[:2]), points)

    by_jax = over_runs(forward, (0, 1))
    rows = [
        _timed(
            f"log density and gradient, four parameters, in vector code, {len(phi)} at once",
            lambda: jax.block_until_ready(in_lanes(phi)),
            len(phi),
        )
    ]
    if not quick:  # half a minute of compilation
        rows.append(
            _timed(
                "log density and gradient, four parameters, by JAX, 8 at once",
                lambda: by_jax(phi[:8], posterior.data),
                8,
            )
        )
    return rows


def _timed(name: str, call: Any, runs: int, scale: float = 1.0) -> list[str]:
    call()
    timing = common.interleaved({name: call}, 3)[name]
    cpu, wall_clock = scale * timing.cpu_median / runs, scale * timing.median / runs
    return [name, f"{cpu:.4f}", f"{wall_clock:.4f}", f"{THESIS_SECONDS / cpu:,.0f}", ""]


def _in_opensees(assembly: Assembly, base: np.ndarray) -> Any:
    try:
        import openseespy.opensees as ops
    except (ImportError, RuntimeError) as error:
        print(f"skipped: OpenSeesPy cannot be imported ({error})")
        return None
    joints = opensees_wall.Uncoupled(cohesive_law(*POINT))

    def run() -> None:
        opensees_wall.build(ops, assembly, joints)
        opensees_wall.loaded(ops, assembly)
        opensees_wall.shaken(ops, base, STEP, 0.427, 9.8e-4, assembly.mesh.corner("top_left"))

    return run


def growth_rows(record: si.GroundMotion, quick: bool) -> tuple[list[list[str]], str]:
    """Time per step of larger walls, which run one at a time with sparse factorisation."""
    part, rows, sizes, seconds = record.trim(0.0, 0.1), [], [], []
    for courses, across in ((4, 3), (6, 4)) if quick else ((10, 5), (10, 10), (20, 10), (20, 20)):
        shape = si.Wall(width=4.0, height=3.0, openings=(), courses=(courses,), block_length=4.0 / across)
        joints = dict(zip(BOX, POINT, strict=True))
        model = si.MasonryWall(**joints, wall=shape, channels=("drift",), step=STEP)
        model.simulate([[]], part)
        timing = common.interleaved({"one": partial(model.simulate, [[]], part)}, 3)["one"]
        sizes.append(len(model.mesh.blocks))
        seconds.append(timing.cpu_median)
        steps = round(part.duration / STEP)
        rows.append([f"{sizes[-1]}", f"{len(model.mesh.joints)}", f"{1e3 * seconds[-1] / steps:.1f}"])
    whole, last = common.growth_exponent(sizes, seconds)
    return (
        rows,
        f"The cost grows with the number of blocks to the power {whole:.2f} ({last:.2f} for the last doubling; limit 1.5).",
    )


def set_up_rows(quick: bool) -> list[list[str]]:
    """Seconds of the first eight runs, with an empty and with a filled cache of compiled code."""
    if quick:  # a minute of compilation
        return []
    with tempfile.TemporaryDirectory() as cache:
        seconds = []
        for _ in range(2):
            process = [sys.executable, "-W", "ignore", __file__, "--alone"]
            environment = os.environ | {"XDG_CACHE_HOME": cache}
            said = subprocess.run(process, env=environment, capture_output=True, text=True, check=True)
            seconds.append(float(said.stdout))
    return [["first eight runs of a new process", f"{seconds[0]:.1f}", f"{seconds[1]:.1f}"]]


def alone() -> None:
    """Time the first eight runs of this new process."""
    record, theta = el_centro(), si.ParameterSpace(**BOX).sample(8, seed=1)
    began = time.perf_counter()
    wall("ux_top_left").simulate(theta, record)
    print(time.perf_counter() - began)


# --- the prior range ------------------------------------------------------------------------------------------------


def box_rows(record: si.GroundMotion, runs: int) -> tuple[list[list[str]], str]:
    """Fractions of the prior range that exceed each drift, and the time of all runs."""
    design = si.ParameterSpace(**BOX).sample(runs, seed=1)
    model = wall("drift")
    model.simulate(design[:256], record)
    began = time.perf_counter()
    drift = model.simulate(design, record)
    seconds = time.perf_counter() - began
    rows = []
    for limit, expected in LIMITS.items():
        times = si.first_passage(drift, "drift", limit)
        share, error = np.isfinite(times).mean(), 2.0 * np.sqrt(expected * (1.0 - expected) * (1.0 / runs + 1.0 / 2000))
        rows.append(
            [
                f"{1e3 * limit:.0f}",
                f"{share:.1%}",
                f"{expected:.1%}",
                f"{error:.1%}",
                f"{np.nanmin(times):.2f} to {np.nanmax(times):.2f}",
            ]
        )
    peaks = 1e3 * np.quantile(np.abs(drift.channel("drift")).max(axis=1), [0.05, 0.25, 0.5, 0.75, 0.95])
    told = (
        f"{runs:,} runs take {seconds:.0f} s on this machine ({seconds / runs * 1e3:.1f} ms per run; limit 24 ms), and "
        f"{int((~drift.done).sum())} do not converge. The 5, 25, 50, 75 and 95 % quantiles of the peak drift are "
        f"{', '.join(f'{p:.0f}' for p in peaks)} mm (19, 37, 54, 125, 228 mm in the other program)."
    )
    return rows, told


# --- surrogates -----------------------------------------------------------------------------------------------------


def surrogate_rows(record: si.GroundMotion, sizes: tuple[int, ...], unseen: int) -> list[list[str]]:
    """Errors of POD-Kriging over the whole prior range, in transformed coordinates and in the parameters."""
    rows, model = [], wall(*MONITORED)
    for size in sizes:
        for coordinates in (COORDINATES, None):
            space = si.ParameterSpace(coordinates=coordinates, **BOX)
            runs = si.Campaign(model, record, space.sample(size, seed=1)).run()
            others = si.Campaign(model, record, space.sample(unseen, seed=2)).run()
            surrogate = si.PODKriging().fit(runs)
            found = surrogate.validate(others)
            rows.append(
                [
                    f"{size}",
                    "log stiffness, log strength" if coordinates else "energies, strengths",
                    f"{found.mean:.4f}",
                    f"{found.median:.4f}",
                    f"{surrogate.fitted.seconds:.1f}",
                    "0.03; 0.008" if size == 900 and coordinates else "",
                ]
            )
    return rows


def main() -> None:
    if "--alone" in sys.argv:
        alone()
        return
    quick = common.is_quick(__doc__.splitlines()[0])
    record = el_centro()
    costs, set_up = cost_rows(record, quick) + gradient_rows(record, quick), set_up_rows(quick)
    growth, grown = growth_rows(record, quick)
    box, told = box_rows(record, 16 if quick else 10_000)
    surrogates = surrogate_rows(record, (40,) if quick else (300, 900), 10 if quick else 100)
    heads = {
        "cost": ["2.5 s at 1 ms", "CPU s/run", "elapsed s/run", "speed-up over the thesis", "limit (stretch goal)"],
        "set up": ["", "empty cache [s]", "warm cache [s]"],
        "growth": ["blocks", "joints", "CPU ms per step"],
        "box": ["drift [mm]", "exceeded", "other program, 2000 runs", "two sds of the difference", "first passage [s]"],
        "surrogates": ["runs", "fitted in", "mean error", "median error", "fit [s]", "limits: mean; median"],
    }
    text = f"""# The masonry façade

`benchmarks/facade.py`. {common.machine("openseespy")}. Engine: {machine.engine()}.

15 blocks, 34 cohesive joints, 112 degrees of freedom, El Centro. OpenSees only has joints with uncoupled tractions. With the same
blocks and such joints, structid and OpenSees agree (`tests/verification/test_facade_opensees.py`). Vector code computes several
runs at once on one core.

{common.markdown_table(heads["cost"], costs)}

{common.markdown_table(heads["set up"], set_up)}

**Larger walls** are solid, have equal blocks, and use the formulation for large walls. {grown}

{common.markdown_table(heads["growth"], growth)}

**The prior ranges of the thesis** for four parameters are sampled by Latin hypercube. {told}

{common.markdown_table(heads["box"], box)}

**Surrogates** over these ranges: errors of three channels in validation runs:

{common.markdown_table(heads["surrogates"], surrogates)}
"""
    common.record_result(
        NAME,
        quick=quick,
        machine=common.machine(),
        cost=costs,
        growth=growth,
        box=box,
        surrogates=surrogates,
        told=told,
    )
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
