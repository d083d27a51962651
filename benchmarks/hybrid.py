"""Accuracy of hybrid tests, and speed of their loop with recorder and live view.

The two-floor benchmark is compared with published peaks and, if it is installed, with OpenSees. Further tables give orders of
convergence, critical delays, and the speed of the loop between two processes.

Run with ``python benchmarks/hybrid.py [--quick]``.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import common
import numpy as np
import opensees_frame

from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.delay import critical_delay
from structid.hybrid.coupling.base import Coupling
from structid.hybrid.coupling.coupling_benchmark import MASS, STIFFNESS, pulse, two_floor_frame, two_floors
from structid.hybrid.coupling.gravouil_combescure import GravouilCombescure
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.specimen import Reading
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.report.live import live

NAME = "hybrid"
SECRET = "a secret of both sides"
PRINTED: list[tuple[str, Coupling, bool, tuple[float, float, float]]] = [
    ("linear, ss = 1", PrakashHjelmstad(), False, (1.47911427e-2, 2.29329718e-2, 8.72500081e4)),
    ("PH, P fine, ss = 10", PrakashHjelmstad(10, "physical"), False, (1.47936573e-2, 2.29321529e-2, 8.73402560e4)),
    ("PH, P fine, ss = 100", PrakashHjelmstad(100, "physical"), False, (1.47936805e-2, 2.29321432e-2, 8.73411682e4)),
    ("PH, N fine, ss = 10", PrakashHjelmstad(10, "numerical"), False, (1.48089255e-2, 2.29680681e-2, 8.73661145e4)),
    ("GC, P fine, ss = 10", GravouilCombescure(10, "physical"), False, (1.47567906e-2, 2.28869129e-2, 8.72042951e4)),
    ("BWBN, ss = 1", PrakashHjelmstad(), True, (4.456357e-2, 5.069414e-2, 4.998511e4)),
    ("BWBN, PH, P fine, ss = 10", PrakashHjelmstad(10, "physical"), True, (4.466134e-2, 5.080801e-2, 5.003363e4)),
]
"""Peaks of u₁, u₂ [m] and Λ [N], from an earlier program with the same equations."""
SERVER = """
import sys
from structid.hybrid.coupling.coupling_benchmark import two_floor_frame
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
_, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
server = SpecimenServer(SimulatedSpecimen(lower.force, stiffness=lower.stiffness), sys.argv[1], port=int(sys.argv[2]))
print(server.address, flush=True)
server.serve()
"""
"""Code of a specimen in a separate process."""


def peaks() -> list[list[str]]:
    rows = []
    for name, coupling, hysteretic, printed in PRINTED:
        coarse = two_floors(coupling, hysteretic=hysteretic).coarse
        found = [*np.abs(coarse.u).max(axis=0), np.abs(coarse.traction).max()]
        apart = max(abs(f / p - 1.0) for f, p in zip(found, printed, strict=True))
        rows.append(
            [
                name,
                *(f"{x:.8e}" for x in found),
                f"{apart:.1e}",
                f"{coarse.gap.max():.4e}",
                f"{coarse.pseudo_energy.sum():.4g}",
            ]
        )
    return rows


def orders() -> list[list[str]]:
    """Orders of convergence of the largest displacement error over 0.8 s, from Δt = 0.01 to 0.005 s."""
    rows = []
    for hysteretic in (False, True):
        fine_step = 0.01 / 64
        exact = two_floors(PrakashHjelmstad(), hysteretic=hysteretic, dt=fine_step, duration=0.8).coarse.u[::64]
        for name, make in (("PH", PrakashHjelmstad), ("GC", GravouilCombescure)):
            for substeps, fine in ((1, "numerical"), (10, "numerical"), (10, "physical")):
                errors = []
                for parts in (1, 2):
                    run = two_floors(make(substeps, fine), hysteretic=hysteretic, dt=0.01 / parts, duration=0.8)
                    errors.append(np.abs(run.coarse.u[::parts] - exact).max())
                law = "BWBN" if hysteretic else "linear"
                rows.append([name, law, str(substeps), fine, f"{np.log2(errors[0] / errors[1]):.2f}"])
    return rows


def opensees() -> str:
    """Largest difference from OpenSees' Newmark integration of the undivided frame."""
    try:
        import openseespy.opensees as ops
    except ImportError:
        return "not installed here"
    found = opensees_frame.displacements(ops)
    apart = np.abs(two_floors().coarse.u[1:] - found).max() / np.abs(found).max()
    return f"{apart:.1e} of the peak"


def delays() -> list[list[str]]:
    """Critical delays of one mass, with all or half of its stiffness in the laboratory."""
    rows = []
    for name, omega, share, known in (
        ("12 t on 7.6 kN/mm, p = 1", float(np.sqrt(STIFFNESS / MASS)), 1.0, 2.385588e-3),
        ("1 Hz, p = 1/2", 2.0 * np.pi, 0.5, 1.914456e-2),
    ):
        found = critical_delay(omega, 0.03, share).delay
        rows.append([name, f"{1e3 * found:.6f}", f"{1e3 * known:.6f}", f"{abs(found / known - 1.0):.1e}"])
    return rows


# --- the loop -------------------------------------------------------------------------------------------------------


class Timed(RemoteSpecimen):
    """Remote specimen that records the arrival time of every answer."""

    def __init__(self, address: str, secret: str) -> None:
        super().__init__(address, secret)
        self.came: list[float] = []

    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Move, and record the time."""
        reading = super().move(path, averaged)
        self.came.append(time.perf_counter())
        return reading


@contextlib.contextmanager
def server() -> Iterator[str]:
    process = subprocess.Popen([sys.executable, "-c", SERVER, SECRET, "0"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.kill()


@contextlib.contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Live view with one browser that polls, and another that sends requests and never reads the answers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    over = threading.Event()

    def browse(address: str) -> None:
        known = {"test": "", "moves": 0, "steps": 0}
        while not over.wait(0.4):
            with contextlib.suppress(OSError, KeyError):
                query = "&".join(f"{k}={v}" for k, v in known.items())
                seen = json.loads(urllib.request.urlopen(f"{address}/state?{query}", timeout=5.0).read())
                known = {"test": seen["running"], "moves": seen["moves"], "steps": seen["steps"]}

    with live(folder, port) as address, socket.socket() as stuck:
        browser = threading.Thread(target=browse, args=(address,))
        browser.start()
        with contextlib.suppress(OSError):
            stuck.connect(("127.0.0.1", port))
            stuck.sendall(b"GET /state HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 50)
        yield
        over.set()
        browser.join()


def loop(seconds: float, everything: bool) -> list[str]:
    """Rate and duration of moves over the loopback."""
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    record = GroundMotion(pulse(np.arange(0.0, seconds + 0.0005, 1e-3)), 1e-3, name="pulse")
    with tempfile.TemporaryDirectory() as folder, server() as address:
        specimen = Timed(address, SECRET)
        coupling = PrakashHjelmstad(100, "physical")
        test = HybridTest(upper, specimen, record, dt=0.01, time_scale=10.0, coupling=coupling, physical=lower)
        with watched(Path(folder)) if everything else contextlib.nullcontext():
            result = test.run(Path(folder) / "test_1.h5" if everything else None)
        assert result.finished, str(result)
        took = 1e3 * np.diff(specimen.came[2:])
    rate = 1e3 / took.mean()
    quantiles = (np.median(took), np.quantile(took, 0.99), np.quantile(took, 0.999), took.max())
    name = "recorder and live view" if everything else "neither"
    return [name, str(len(took)), f"{rate:.0f}", *(f"{q:.2f}" for q in quantiles), f"{100.0 * np.mean(took > 1.0):.1f}"]


PEAKS = ["case", "u₁ [m]", "u₂ [m]", "Λ [N]", "relative difference", "largest gap [m]", "Σ pseudo-energy [W/s]"]
LOOP = ["active", "moves", "per second", "median [ms]", "99 % [ms]", "99.9 % [ms]", "longest [ms]", "above 1 ms [%]"]


def main() -> None:
    quick = common.is_quick(__doc__ or "")
    results: dict[str, Any] = {"peaks": peaks(), "delays": delays(), "opensees": opensees()}
    results["orders"] = [] if quick else orders()
    seconds = 0.2 if quick else 20.0
    results["loop"] = (
        [loop(seconds, False), loop(seconds, True)]
        if quick
        else [loop(seconds, everything) for everything in (False, True, True, True)]
    )
    common.record_result(NAME, quick=quick, machine=common.machine(), **results)
    text = f"""# Hybrid tests: accuracy, delays and speed of the loop

`benchmarks/hybrid.py`. {common.machine()}.

Two-storey frame with a physical lower storey, Δt = 0.01 s, 200 steps. Peaks are compared with those of another program. PH is the
Prakash–Hjelmstad coupling, and GC the Gravouil–Combescure coupling. With "P fine" or "N fine", the physical or the numerical part
has ss substeps. The peak u₂ of "PH, N fine, ss = 10" differs by 5e-7: the reference prints 2.29680681e-2; the monolithic solution
of each step (`tests/verification/test_partitioned.py`) and structid both give 2.29680806e-2.

{common.markdown_table(PEAKS, results["peaks"])}

Difference from OpenSees' Newmark integration of the undivided frame: {results["opensees"]}. With ss = 1, the result equals the
assembled method to 1e-10 for any split, α and interface (`tests/hybrid/coupling/test_couplings.py`).

Orders of convergence of the largest error over 0.8 s, from Δt = 0.01 to 0.005 s; the load is a pulse of half a second. For the
error at 2 s and shorter steps, the same tests find 1.0 ± 0.06 for GC, and 2.0 ± 0.05 for PH with 1, 2, 10 and 100 substeps.

{common.markdown_table(["coupling", "springs", "ss", "fine part", "order"], results["orders"])}

Critical delays ([limits of hybrid tests](hybrid_limits.md) compares them with a simulated loop):

{common.markdown_table(["structure", "structid [ms]", "reference [ms]", "relative difference"], results["delays"])}

Round trip over the loopback interface on two cores: test and specimen (Bouc-Wen-Baber-Noori, 100 fine steps per coarse step) run
in separate processes, and HMAC signs every message. With the recorder, every finished step is in mapped memory when the next step
begins, and on disk 75 ms later. The live view is a separate process. One browser polls it every 0.4 s; another sends fifty
requests and never reads an answer. Python gives no real-time guarantee: a late answer pauses the specimen. For a test in real
time, the controller of the laboratory must interpolate between commands.

{common.markdown_table(LOOP, results["loop"])}
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
