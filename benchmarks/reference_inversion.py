"""Time of the reference inversion (100 walkers x 700 steps of the full model), and its growth with the problem.

Run with ``python benchmarks/reference_inversion.py [--quick]``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import common
import numpy as np

import structid as si
from structid.models.hysteretic.hysteretic_parameters import DEFAULT_SUBSTEPS

NAME = "reference_inversion"
DURATION, WALKERS, STEPS = 40.0, 100, 700
PUBLISHED_HOURS, LIMIT, STRETCH = 33.0, 1.5, 1.0
GROWTH_STEPS = 100
DURATIONS = (10.0, 20.0, 40.0, 80.0)
WALKER_COUNTS = (50, 100, 200, 400, 800)
STOREY_COUNTS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Growth:
    """Seconds of `GROWTH_STEPS` steps as a function of one size."""

    label: str
    sizes: tuple[float, ...]
    timings: tuple[common.Timing, ...]

    @property
    def seconds(self) -> list[float]:
        """Median times [s]."""
        return [t.median for t in self.timings]


def inversion(posterior: si.Posterior, walkers: int, steps: int) -> Callable[[], Any]:
    """Return a call that samples with one ensemble; both batch sizes (start, half ensemble) are already compiled."""
    sampler = si.AIES(walkers=walkers, steps=steps, ensembles=1)
    si.sample(posterior, si.AIES(walkers=walkers, steps=2, ensembles=1), seed=1)
    return lambda: si.sample(posterior, sampler, seed=1)


def study(duration: float, substeps: int = 1) -> si.Posterior:
    return common.study_posterior(common.study_record(duration, common.STUDY_PGA), substeps)


# --- the inversion ----------------------------------------------------------------------------------------------


def time_inversion(repeats: int, steps: int) -> dict[int, common.Timing]:
    """Times of the inversion by the number of substeps."""
    calls = {str(s): inversion(study(DURATION, s), WALKERS, steps) for s in (1, DEFAULT_SUBSTEPS)}
    return {int(name): timing for name, timing in common.interleaved(calls, repeats).items()}


# --- growth -----------------------------------------------------------------------------------------------------


def growth(label: str, calls: dict[float, Callable[[], Any]], repeats: int) -> Growth:
    times = common.interleaved({str(size): call for size, call in calls.items()}, repeats)
    return Growth(label, tuple(calls), tuple(times.values()))


def growth_with_duration(repeats: int, steps: int) -> Growth:
    return growth("length of the record [s]", {d: inversion(study(d), WALKERS, steps) for d in DURATIONS}, repeats)


def growth_with_walkers(repeats: int, steps: int) -> Growth:
    posterior = study(DURATION)
    return growth("walkers", {n: inversion(posterior, n, steps) for n in WALKER_COUNTS}, repeats)


def growth_with_storeys(repeats: int, steps: int) -> Growth | None:
    """Time shear frames of equal springs with the top velocity observed; return None if this model is missing."""
    if find_spec("structid.models.hysteretic.shear_frame") is None:
        print("skipped: growth with storeys, structid.models.hysteretic.shear_frame is missing")
        return None
    calls = {n: inversion(frame_posterior(n), WALKERS, steps) for n in STOREY_COUNTS}
    return growth("storeys", calls, repeats)


def frame_posterior(storeys: int) -> si.Posterior:
    """Return the posterior of a frame of equal springs without degradation, given the response of a degrading frame."""
    from structid.models.hysteretic.shear_frame import ShearFrame

    record = common.study_record(DURATION, common.STUDY_PGA)
    settings = {
        "storeys": storeys,
        "mass": common.MASS,
        "damping_ratio": common.DAMPING_RATIO,
        "channels": (f"velocity_{storeys}",),
        "substeps": 1,
    }
    truth = ShearFrame(
        stiffness=common.STIFFNESS,
        alpha=common.ALPHA,
        beta=common.BETA,
        gamma_ratio=common.GAMMA / common.BETA,
        delta_nu=common.DELTA_NU,
        delta_eta=common.DELTA_ETA,
        **settings,
    )
    measured = truth.simulate(np.zeros((1, 0)), record).values[0]
    space = common.study_space()
    observation = si.Observation(record, measured, settings["channels"])
    return si.Posterior(space, ShearFrame(free=space.names, **settings), observation, si.IID())


# --- report -----------------------------------------------------------------------------------------------------


def inversion_rows(times: dict[int, common.Timing], steps: int) -> list[list[str]]:
    rows = []
    for substeps, timing in times.items():
        default = " (default)" if substeps == DEFAULT_SUBSTEPS else ""
        held = substeps == 1 and steps == STEPS
        verdict = ("met" if timing.median <= LIMIT else "MISSED") if held else "-"
        stretch = ("met" if timing.median <= STRETCH else "not met") if held else "-"
        faster = f"{PUBLISHED_HOURS * 3600.0 / timing.median:.0f}" if steps == STEPS else "-"
        cells = [f"{timing.median:.2f}", f"{100 * timing.spread:.0f} %", f"{timing.cpu_median:.2f}"]
        rows.append([f"{substeps} per sample{default}", *cells, verdict, stretch, faster])
    return rows


def growth_rows(curves: list[Growth]) -> list[list[str]]:
    rows = []
    for curve in curves:
        slope, last = common.growth_exponent(curve.sizes, curve.seconds)
        sizes = " / ".join(f"{s:g}" for s in curve.sizes)
        rows.append([curve.label, sizes, " / ".join(f"{s:.2f}" for s in curve.seconds), f"{slope:.2f}", f"{last:.2f}"])
    return rows


def draw(curves: list[Growth], steps: int, path: Path) -> None:
    """Plot one panel for each size, with the medians and a line of slope 1 through the last point."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(curves), figsize=(3.4 * len(curves), 3.4), layout="constrained", squeeze=False)
    for axes, curve in zip(panels[0], curves, strict=True):
        sizes, seconds = np.array(curve.sizes), np.array(curve.seconds)
        slope, _ = common.growth_exponent(sizes, seconds)
        axes.plot(sizes, seconds, "o-", linewidth=1.0, label=f"measured, slope {slope:.2f}")
        axes.plot(sizes, seconds[-1] * sizes / sizes[-1], "--", color="grey", linewidth=0.8, label="slope 1")
        axes.set(xscale="log", yscale="log", xlabel=curve.label)
        axes.set_xticks(sizes, [f"{s:g}" for s in sizes])
        axes.minorticks_off()
        ticks = [
            t for t in (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if seconds.min() / 3 < t < seconds.max() * 3
        ]
        axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=8, loc="upper left")
    panels[0, 0].set_ylabel(f"seconds for {steps} steps")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def store(times: dict[int, common.Timing], curves: list[Growth], steps: int, growth_steps: int, quick: bool) -> None:
    shared = {"machine": common.machine(), "quick": quick, "walkers": WALKERS, "duration": DURATION}
    for substeps, timing in times.items():
        common.record_result(
            NAME, question="inversion", steps=steps, substeps=substeps, seconds=timing.seconds, **shared
        )
    for curve in curves:
        slope, last = common.growth_exponent(curve.sizes, curve.seconds)
        common.record_result(
            NAME,
            question=curve.label,
            steps=growth_steps,
            sizes=curve.sizes,
            exponent=slope,
            last_exponent=last,
            seconds=[t.seconds for t in curve.timings],
            **shared,
        )


def main() -> None:
    quick = common.is_quick(__doc__)
    repeats, steps, growth_steps = (1, 100, 20) if quick else (3, STEPS, GROWTH_STEPS)
    times = time_inversion(repeats, steps)
    curves = [growth_with_duration(repeats, growth_steps), growth_with_walkers(repeats, growth_steps)]
    storeys = growth_with_storeys(repeats, growth_steps)
    curves += [] if storeys is None else [storeys]
    store(times, curves, steps, growth_steps, quick)
    folder = common.documents(quick)
    draw(curves, growth_steps, folder / "figures" / f"{NAME}_growth.png")
    header = (
        "substeps",
        "seconds",
        "spread",
        "CPU seconds",
        f"limit {LIMIT:g} s",
        f"stretch goal {STRETCH:g} s",
        "speed-up over the published time",
    )
    growth_header = ("varied size", "values", f"seconds for {growth_steps} steps", "exponent", "last exponent")
    text = f"""# The reference inversion

One ensemble of {WALKERS} walkers x {steps} steps ({WALKERS * steps} runs) of the full oscillator under a {DURATION:g} s record
(4001 samples, PGA {common.STUDY_PGA} m/s²). The data come from the degrading oscillator with {100 * common.NOISE:g} % noise; the
model has no degradation. Times are medians of {repeats}, after compilation. The published inversion took {PUBLISHED_HOURS:g} h for
70 000 runs. {common.machine()}.

{common.markdown_table(header, inversion_rows(times, steps))}

Growth of the time with one size, for one substep per sample. The other sizes are {WALKERS} walkers, one storey and {DURATION:g} s.
The exponent is the slope of log time against log size. It is below 1 while the fixed cost of a call still contributes.

{common.markdown_table(growth_header, growth_rows(curves))}

![growth](../../figures/{NAME}_growth.png)
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
