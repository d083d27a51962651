"""Cost and error of one run of the Bouc-Wen-Baber-Noori oscillator.

All programs solve the same degrading oscillator under the same 48 s record. Errors are relative to SciPy's DOP853 with a relative
tolerance of 1e-10. Run with ``python benchmarks/forward_model.py [--quick]``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from scipy.integrate import solve_ivp

import structid as si
from structid.models.hysteretic.hysteretic_parameters import DEFAULT_SUBSTEPS

NAME = "forward_model"
DURATION, PGA = 48.0, 3.59
FREE = ("stiffness", "alpha", "beta", "gamma_ratio", "delta_nu", "delta_eta")
TRUTH = (common.STIFFNESS, common.ALPHA, common.BETA, common.GAMMA / common.BETA, common.DELTA_NU, common.DELTA_ETA)
BATCHES, SUBSTEPS = (50, 200, 2000), (1, 2, 3, 4)
OPENSEES_DIVISIONS = (1, 2, 5, 10)
NUMBA_RUNS = 200


@dataclass(frozen=True)
class Entry:
    """A row of the table: a callable to be timed, its number of runs, and its errors."""

    peer: str
    setting: str
    call: Callable[[], Any]
    runs: int
    velocity_error: float
    displacement_error: float


def parameter_rows(count: int) -> np.ndarray:
    """Parameters of different oscillators near the true one, shape (run, parameter); equal runs would not be representative."""
    return np.array(TRUTH) * np.random.default_rng(5).uniform(0.9, 1.1, (count, len(FREE)))


def relative(history: np.ndarray, truth: np.ndarray) -> float:
    """Relative L2 error of a history."""
    return float(np.linalg.norm(history - truth) / np.linalg.norm(truth))


# --- peers ------------------------------------------------------------------------------------------------------


def scipy_right_hand_side(record: si.GroundMotion) -> Callable[[float, Any], tuple[float, ...]]:
    """Return the equations in plain Python floats, the fastest form that `solve_ivp` can call."""
    samples, dt, last = record.values.tolist(), record.dt, len(record) - 2
    omega2 = common.STIFFNESS / common.MASS
    viscous = 2.0 * common.DAMPING_RATIO * omega2**0.5
    alpha, beta, gamma, delta_nu, delta_eta = common.ALPHA, common.BETA, common.GAMMA, common.DELTA_NU, common.DELTA_ETA

    def rate(time: float, state: Any) -> tuple[float, ...]:
        u, v, z, e = state
        i = min(int(time / dt), last)
        ground = samples[i] + (samples[i + 1] - samples[i]) * (time / dt - i)
        shape = beta * abs(v) * z + gamma * v * abs(z)
        return (
            v,
            -ground - viscous * v - omega2 * (alpha * u + (1.0 - alpha) * z),
            (v - (1.0 + delta_nu * e) * shape) / (1.0 + delta_eta * e),
            (1.0 - alpha) * omega2 * z * v,
        )

    return rate


def solve_with_scipy(record: si.GroundMotion, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and velocity at the samples."""
    time = record.time
    rate = scipy_right_hand_side(record)
    solution = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), t_eval=time, max_step=record.dt, **settings)
    if not solution.success:
        raise RuntimeError(solution.message)
    return solution.y[0], solution.y[1]


def opensees() -> Any:
    """Return the OpenSeesPy module; print the reason and return None if it cannot be imported."""
    try:
        import openseespy.opensees as module
    except (ImportError, RuntimeError) as error:
        print(f"skipped: OpenSeesPy cannot be imported ({error}); it needs the system's libblas3 and liblapack3")
        return None
    return module


def build_opensees(ops: Any, record: si.GroundMotion) -> None:
    """Build the oscillator; the material's energy is in J, so rates per J/kg are divided by the mass."""
    mass = common.MASS
    omega = (common.STIFFNESS / mass) ** 0.5
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, mass)
    rates = (0.0, common.DELTA_NU / mass, common.DELTA_ETA / mass)
    shape = (1.0, common.GAMMA, common.BETA, 1.0)
    ops.uniaxialMaterial("BoucWen", 1, common.ALPHA, common.STIFFNESS, *shape, *rates, 1e-12, 100)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.rayleigh(2.0 * common.DAMPING_RATIO * omega, 0.0, 0.0, 0.0)
    ops.timeSeries("Path", 1, "-dt", record.dt, "-values", *record.values.tolist(), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("ProfileSPD")
    ops.test("NormDispIncr", 1e-12, 50)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")


def solve_with_opensees(ops: Any, record: si.GroundMotion, divisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and velocity at the samples, read from Python in every step."""
    build_opensees(ops, record)
    displacement, velocity = np.zeros(len(record)), np.zeros(len(record))
    for i in range(1, len(record)):
        if ops.analyze(divisions, record.dt / divisions) != 0:
            raise RuntimeError(f"OpenSees did not converge at sample {i}")
        displacement[i], velocity[i] = ops.nodeDisp(2, 1), ops.nodeVel(2, 1)
    ops.wipe()
    return displacement, velocity


def record_with_opensees(ops: Any, record: si.GroundMotion, path: Path) -> None:
    """Run the whole record in one call while OpenSees writes the velocity to a file, its fastest mode."""
    build_opensees(ops, record)
    ops.recorder("Node", "-file", str(path), "-dT", record.dt, "-node", 2, "-dof", 1, "vel")
    if ops.analyze(len(record) - 1, record.dt) != 0:
        raise RuntimeError("OpenSees did not converge")
    ops.wipe()


def numba_solvers() -> tuple[Callable[..., Any], Callable[..., Any]] | None:
    """Compile RK4 for one oscillator, and for a batch over all cores; return None if Numba is missing."""
    try:
        import numba
    except ImportError as error:
        print(f"skipped: Numba cannot be imported ({error})")
        return None

    @numba.njit
    def rate(u, v, z, e, ground, p):
        viscous, omega2, alpha, beta, gamma, delta_nu, delta_eta = p
        shape = beta * abs(v) * z + gamma * v * abs(z)
        acceleration = -ground - viscous * v - omega2 * (alpha * u + (1.0 - alpha) * z)
        return (
            v,
            acceleration,
            (v - (1.0 + delta_nu * e) * shape) / (1.0 + delta_eta * e),
            (1.0 - alpha) * omega2 * z * v,
        )

    @numba.njit
    def single(ground, dt, substeps, mass, damping_ratio, row, out):
        stiffness, alpha, beta, ratio, delta_nu, delta_eta = row
        omega2 = stiffness / mass
        p = (2.0 * damping_ratio * np.sqrt(omega2), omega2, alpha, beta, ratio * beta, delta_nu, delta_eta)
        h = dt / substeps
        u = v = z = e = 0.0
        for i in range(ground.size - 1):
            slope = (ground[i + 1] - ground[i]) / substeps
            for j in range(substeps):
                a0 = ground[i] + slope * j
                a1, a2 = a0 + 0.5 * slope, a0 + slope
                k1 = rate(u, v, z, e, a0, p)
                k2 = rate(u + h / 2 * k1[0], v + h / 2 * k1[1], z + h / 2 * k1[2], e + h / 2 * k1[3], a1, p)
                k3 = rate(u + h / 2 * k2[0], v + h / 2 * k2[1], z + h / 2 * k2[2], e + h / 2 * k2[3], a1, p)
                k4 = rate(u + h * k3[0], v + h * k3[1], z + h * k3[2], e + h * k3[3], a2, p)
                u += h / 6 * (k1[0] + 2 * (k2[0] + k3[0]) + k4[0])
                v += h / 6 * (k1[1] + 2 * (k2[1] + k3[1]) + k4[1])
                z += h / 6 * (k1[2] + 2 * (k2[2] + k3[2]) + k4[2])
                e += h / 6 * (k1[3] + 2 * (k2[3] + k3[3]) + k4[3])
            out[0, i + 1], out[1, i + 1] = u, v

    @numba.njit(parallel=True)
    def batch(ground, dt, substeps, mass, damping_ratio, rows, out):
        for run in numba.prange(len(rows)):
            single(ground, dt, substeps, mass, damping_ratio, rows[run], out[run])

    return single, batch


# --- timed calls ------------------------------------------------------------------------------------------------


def scipy_entries(record: si.GroundMotion, truth: tuple[np.ndarray, np.ndarray]) -> list[Entry]:
    def call() -> tuple[np.ndarray, np.ndarray]:
        return solve_with_scipy(record, method="RK45", rtol=1e-3)

    return [entry("SciPy RK45", "rtol 1e-3, max_step dt", call, 1, call(), truth)]


def opensees_entries(record: si.GroundMotion, truth: tuple[np.ndarray, np.ndarray], folder: Path) -> list[Entry]:
    ops = opensees()
    if ops is None:
        return []
    entries = []
    for divisions in OPENSEES_DIVISIONS:

        def call(divisions: int = divisions) -> tuple[np.ndarray, np.ndarray]:
            return solve_with_opensees(ops, record, divisions)

        entries.append(entry("OpenSeesPy", f"dt {record.dt / divisions:g}", call, 1, call(), truth))

    def recorded() -> None:
        record_with_opensees(ops, record, folder / "velocity.out")

    errors = (entries[0].velocity_error, entries[0].displacement_error)
    return [*entries, Entry("OpenSeesPy, file recorder", f"dt {record.dt:g}", recorded, 1, *errors)]


def numba_entries(record: si.GroundMotion, truth: tuple[np.ndarray, np.ndarray]) -> list[Entry]:
    solvers = numba_solvers()
    if solvers is None:
        return []
    single, batch = solvers
    rows = parameter_rows(BATCHES[-1])
    fixed = (common.MASS, common.DAMPING_RATIO)
    entries = []
    for substeps in (1, 3):
        history = np.zeros((2, len(record)))
        single(record.values, record.dt, substeps, *fixed, np.array(TRUTH), history)

        def serial(substeps: int = substeps) -> None:
            for row in rows[:NUMBA_RUNS]:
                single(record.values, record.dt, substeps, *fixed, row, np.zeros((2, len(record))))

        def parallel(substeps: int = substeps) -> None:
            batch(record.values, record.dt, substeps, *fixed, rows, np.zeros((len(rows), 2, len(record))))

        parallel()
        entries.append(entry("Numba RK4, serial", label(substeps), serial, NUMBA_RUNS, tuple(history), truth))
        entries.append(entry("Numba RK4, all cores", label(substeps), parallel, len(rows), tuple(history), truth))
    return entries


def structid_entries(record: si.GroundMotion, truth: tuple[np.ndarray, np.ndarray]) -> list[Entry]:
    entries = []
    for substeps in SUBSTEPS:
        recorded = common.degrading_oscillator(channels=("displacement", "velocity"), substeps=substeps)
        history = tuple(recorded.simulate(np.zeros((1, 0)), record).values[0].T)
        loose = {name: None for name in FREE} | {"delta_nu": 0.0, "delta_eta": 0.0}
        model = common.degrading_oscillator(**loose, free=FREE, substeps=substeps)
        for runs in BATCHES:
            rows = parameter_rows(runs)

            def call(model: si.BoucWen = model, rows: np.ndarray = rows) -> si.Histories:
                return model.simulate(rows, record)

            call()  # compiles
            entries.append(entry(f"structid, batch {runs}", label(substeps), call, runs, history, truth))
    return entries


def likelihood_calls(quick: bool) -> dict[tuple[int, int], Callable[[], Any]]:
    """Calls of the compiled log posterior density, as a sampler makes them, by substeps and batch size."""
    calls = {}
    for substeps in (1,) if quick else SUBSTEPS:
        posterior = common.study_posterior(common.study_record(DURATION, common.STUDY_PGA), substeps)
        for runs in BATCHES:
            phi = posterior.initial(runs, np.random.default_rng(3))
            posterior.evaluate(phi)  # compiles

            def call(posterior: si.Posterior = posterior, phi: np.ndarray = phi) -> Any:
                return posterior.evaluate(phi)

            calls[substeps, runs] = call
    return calls


def label(substeps: int) -> str:
    return f"{substeps} substep{'s' * (substeps > 1)}"


def entry(
    peer: str,
    setting: str,
    call: Callable[[], Any],
    runs: int,
    history: tuple[np.ndarray, ...],
    truth: tuple[np.ndarray, np.ndarray],
) -> Entry:
    """Return an entry with the errors of (displacement, velocity) against the truth."""
    return Entry(peer, setting, call, runs, relative(history[1], truth[1]), relative(history[0], truth[0]))


# --- report -----------------------------------------------------------------------------------------------------


def ratio_rows(ms: dict[tuple[str, str], float]) -> list[list[str]]:
    """Speed ratios and their limits for one substep, and the ratios for the default substeps."""
    limits = [
        (200, ("OpenSeesPy", "dt 0.01"), 1500),
        (200, ("OpenSeesPy, file recorder", "dt 0.01"), None),
        (200, ("SciPy RK45", "rtol 1e-3, max_step dt"), 5000),
        (2000, ("OpenSeesPy", "dt 0.01"), 1500),
        (2000, ("OpenSeesPy, file recorder", "dt 0.01"), None),
        (200, ("Numba RK4, serial", label(1)), 10),
        (2000, ("Numba RK4, serial", label(1)), 10),
        (2000, ("Numba RK4, all cores", label(1)), None),
    ]
    rows = []
    for runs, peer, limit in limits:
        if peer not in ms:
            continue
        held, default = (ms[peer] / ms[f"structid, batch {runs}", label(s)] for s in (1, DEFAULT_SUBSTEPS))
        verdict = "-" if limit is None else "met" if held >= limit else "MISSED"
        rows.append(
            [f"batch {runs} against {', '.join(peer)}", str(limit or "-"), f"{held:.4g}", verdict, f"{default:.4g}"]
        )
    return rows


def draw(entries: list[Entry], ms: dict[tuple[str, str], float], path: Path) -> None:
    """Plot cost against velocity error, with one marker per program."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.2, 5.0), layout="constrained")
    shown = ("SciPy RK45", "OpenSeesPy", "Numba RK4, serial", *(f"structid, batch {runs}" for runs in BATCHES))
    for peer, marker in zip(shown, "sD^vox", strict=True):
        points = [e for e in entries if e.peer == peer]
        x, y = [e.velocity_error for e in points], [ms[e.peer, e.setting] for e in points]
        axes.plot(x, y, marker=marker, linewidth=0.8, label=peer)
        for e in points:
            _annotate(axes, e, ms)
    axes.set(xscale="log", yscale="log", xlabel="relative error of the velocity", ylabel="cost of one run [ms]")
    axes.set_xlim(right=3.0)
    axes.set_ylim(bottom=0.4 * min(ms.values()))
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8, loc="center right", bbox_to_anchor=(1.0, 0.3))
    axes.set_title(f"Degrading Bouc-Wen oscillator, {DURATION:g} s record; numbers: RK4 steps per sample", fontsize=10)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _annotate(axes: Any, point: Entry, ms: dict[tuple[str, str], float]) -> None:
    """Label the OpenSees points by their time step, and the cheapest structid points by their substeps."""
    position = (point.velocity_error, ms[point.peer, point.setting])
    if point.peer == "OpenSeesPy":
        axes.annotate(point.setting, position, (8, 0), fontsize=8, textcoords="offset points", va="center")
    elif point.peer.startswith("structid") and position[1] == min(
        cost for (peer, setting), cost in ms.items() if peer.startswith("structid") and setting == point.setting
    ):
        axes.annotate(point.setting.split()[0], position, (0, -15), fontsize=8, textcoords="offset points", ha="center")


def report(entries: list[Entry], times: dict[str, common.Timing], quick: bool, repeats: int) -> None:
    """Print and store the table, the ratios and the cost of the likelihood."""
    ms = {(e.peer, e.setting): 1e3 * times[f"{e.peer} | {e.setting}"].median / e.runs for e in entries}
    table = []
    for e in entries:
        timing = times[f"{e.peer} | {e.setting}"]
        cells = [
            f"{ms[e.peer, e.setting]:.4g}",
            f"{100 * timing.spread:.0f} %",
            f"{1e3 * timing.cpu_median / e.runs:.4g}",
        ]
        table.append([f"{e.peer}, {e.setting}", *cells, f"{e.velocity_error:.1e}", f"{e.displacement_error:.1e}"])
        common.record_result(
            NAME,
            machine=common.machine("openseespy", "numba"),
            quick=quick,
            peer=e.peer,
            setting=e.setting,
            runs=e.runs,
            ms_per_run=ms[e.peer, e.setting],
            seconds=timing.seconds,
            cpu_seconds=timing.cpu_seconds,
            velocity_error=e.velocity_error,
            displacement_error=e.displacement_error,
        )
    likelihood = []
    for name, timing in times.items():
        if name.startswith("likelihood"):
            _, setting, runs = name.split(" | ")
            cost = 1e3 * timing.median / int(runs)
            likelihood.append([setting, runs, f"{1e3 * timing.median:.3g}", f"{cost:.3g}"])
            common.record_result(
                NAME,
                quick=quick,
                peer="structid likelihood",
                setting=setting,
                runs=int(runs),
                ms_per_run=cost,
                seconds=timing.seconds,
                cpu_seconds=timing.cpu_seconds,
            )
    header = ("speed-up of structid", "limit", label(1), "verdict", f"{label(DEFAULT_SUBSTEPS)} (default)")
    folder = common.documents(quick)
    draw(entries, ms, folder / "figures" / f"{NAME}.png")
    text = f"""# One run of the oscillator

Degrading oscillator of the study under a {DURATION:g} s record (4801 samples, PGA {PGA} m/s²). The cost of one run is the median
of {repeats} interleaved repeats after compilation. Errors are relative L2 errors against DOP853 at rtol 1e-10. The other programs
compute one run after another on one core, unless the row states all cores. structid distributes a batch over the cores and returns
the velocity histories. {common.machine("openseespy", "numba")}.

{common.markdown_table(("solver", "ms per run", "spread", "CPU ms per run", "velocity error", "displacement error"), table)}

OpenSees' material integrates the degrading hysteresis by backward Euler (order 1) and converges to the same solution
(`tests/verification/test_opensees.py`).

{common.markdown_table(header, ratio_rows(ms))}

Cost of one call of the log posterior density in a sampler, for a model without degradation and the same record at PGA
{common.STUDY_PGA} m/s²:

{common.markdown_table(("likelihood", "batch", "ms per call", "ms per run"), likelihood)}

![cost against error](../../figures/{NAME}.png)
"""
    common.write_page(quick, NAME, text)
    print(text)


def main() -> None:
    quick = common.is_quick(__doc__)
    repeats = 2 if quick else 9
    record = common.study_record(DURATION, PGA)
    print("computing the reference solution (DOP853, rtol 1e-10) ...", flush=True)
    truth = solve_with_scipy(record, method="DOP853", rtol=1e-10, atol=1e-13)
    with tempfile.TemporaryDirectory() as folder:
        entries = [
            *scipy_entries(record, truth),
            *opensees_entries(record, truth, Path(folder)),
            *numba_entries(record, truth),
            *structid_entries(record, truth),
        ]
        calls = {f"{e.peer} | {e.setting}": e.call for e in entries}
        calls |= {f"likelihood | {label(s)} | {runs}": call for (s, runs), call in likelihood_calls(quick).items()}
        times = common.interleaved(calls, repeats)
    report(entries, times, quick, repeats)


if __name__ == "__main__":
    main()
