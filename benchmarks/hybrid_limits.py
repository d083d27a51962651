"""Limits of hybrid tests, compared with the predictions of the check before a test.

The tables give critical delays as predicted and as found in the loop, the effect of compensations, and spectral radii and spurious
damping of the couplings. Faults of the disk, of processes and of the network are tested in ``tests/hybrid``.

Run with ``python benchmarks/hybrid_limits.py [--quick]``.
"""

from __future__ import annotations

from dataclasses import replace

import common
import numpy as np
from one_mass import OMEGA, RATIO, SCALE, growth, one_mass_test

from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.compensation import AdaptiveTimeSeries, PolynomialExtrapolation
from structid.hybrid.control.delay import critical_delay
from structid.hybrid.control.transfer_system import Actuator, Sensor
from structid.hybrid.coupling.base import Coupling
from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame
from structid.hybrid.coupling.gravouil_combescure import GravouilCombescure
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.coupling.stability import free_oscillations, spectral_radius
from structid.hybrid.coupling.whole_structure import WholeStructure
from structid.hybrid.experiment import HybridTest
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.substructures.frame_parts import cut_frame

NAME = "hybrid_limits"
FIRST = 2.0 * np.pi / 15.553514
COUPLINGS: list[tuple[str, Coupling]] = [
    ("PH, N fine, ss = 10", PrakashHjelmstad(10)),
    ("PH, N fine, ss = 100", PrakashHjelmstad(100)),
    ("PH, P fine, ss = 10", PrakashHjelmstad(10, "physical")),
    ("GC, N fine, ss = 10", GravouilCombescure(10)),
    ("GC, P fine, ss = 10", GravouilCombescure(10, "physical")),
]


def met() -> list[list[str]]:
    """Delays at which the amplitude of a loop stays constant, searched within 1 % of the predicted delay."""
    rows = []
    for share in (1.0, 0.5):
        predicted = critical_delay(OMEGA, RATIO, share).delay
        shares = [0.99, 1.01]
        grown = [
            growth(one_mass_test(SCALE * s * predicted, share=share, cycles=30, substeps=5)._run_unchecked())
            for s in shares
        ]
        found = float(np.interp(0.0, grown, shares))
        rows.append(
            [
                f"one mass, p = {share:g}",
                f"{1e3 * predicted:.5f}",
                f"{1e3 * found * predicted:.5f}",
                f"{abs(found - 1.0):.1e}",
            ]
        )
    return rows


def known() -> list[list[str]]:
    """Critical delays compared with published figures."""
    parts = cut_frame(two_floor_frame(), 1, linear=True)
    whole = WholeStructure.of(PrakashHjelmstad().joined(*parts, 0.01))
    two = whole.critical_delay
    rows = [["two floors", f"{1e3 * two.delay:.5f}", "5.31929"]]
    for name, hertz, scale, printed in (
        ("#1a", 0.55, 500.0, 17.4),
        ("#1b", 1.38, 200.0, 6.9),
        ("#2 to #5", 0.56, 200.0, 17.1),
    ):
        found = critical_delay(2.0 * np.pi * hertz * scale, RATIO).on_the_wall(scale)
        rows.append([f"façade, {name}, λ τ_c", f"{1e3 * found:.1f}", f"{printed}"])
    return rows


def compensated(cases: int | None) -> list[list[str]]:
    """Growth of the amplitude of one mass per cycle with 30 ms delay at λ = 10, and tracking error of the specimen."""
    rows = []
    for name, compensation, noise in [
        ("none", None, 0.0),
        ("polynomial, n = 3", PolynomialExtrapolation(0.030), 0.0),
        ("adaptive, starting at 20 ms", AdaptiveTimeSeries(0.020), 0.0),
        ("adaptive, starting at 20 ms, 5 µm of noise", AdaptiveTimeSeries(0.020), 5e-6),
    ][:cases]:
        sensor = Sensor(noise)
        result = one_mass_test(0.030, compensation, displacement_sensor=sensor)._run_unchecked()
        rows.append([name, f"{growth(result):.4f}", f"{result.tracking['displacement'].error:.1e}"])
    return [*rows, ["(no delay)", f"{-2.0 * np.pi * RATIO:.4f}", "0"]]


def corrected() -> str:
    """Error of the peak of two floors with and without force correction, at 6.36 m/s², λ = 50 and 60 ms."""
    upper, lower = cut_frame(two_floor_frame(hysteretic=True), 1)
    time = np.arange(0.0, 2.0005, 1e-3)
    record = GroundMotion(pulse(time), 1e-3).scale_to_pga(6.36)
    tests = [
        HybridTest(
            upper,
            SimulatedSpecimen(lower.force, Actuator(delay=delay)),
            record,
            dt=0.01,
            time_scale=50.0,
            physical=lower,
            coupling=PrakashHjelmstad(500, "physical"),
            force_correction=corrected,
        )
        for delay, corrected in ((0.0, False), (0.060, False), (0.060, True))
    ]
    peaks = [float(np.abs(test._run_unchecked().coarse.u[:, 0]).max()) for test in tests]
    return f"{peaks[1] / peaks[0] - 1.0:+.1%} without and {peaks[2] / peaks[0] - 1.0:+.1%} with it"


def stability(couplings: int | None) -> list[list[str]]:
    """Stability of couplings, for damped parts and for an undamped specimen that has softened."""
    parts = cut_frame(two_floor_frame(), 1, linear=True)
    bare = tuple(replace(part, damping=0.0 * part.damping) for part in parts)
    rows = []
    for name, coupling in COUPLINGS[:couplings]:
        radius = max(spectral_radius(coupling.joined(*parts, share * FIRST)) for share in np.geomspace(1e-3, 100.0, 11))
        dt = 0.3 / parts[1].largest_frequency
        found = []
        for share in (0.3, 0.01):
            free = free_oscillations(coupling.joined(bare[0], bare[1].softened(share), dt))
            found.append(float((free.damping_ratios * free.frequencies).min()) / parts[1].largest_frequency)
        own = free_oscillations(coupling.joined(*parts, FIRST / 40.0)).damping_ratios[0] - RATIO
        scaled = [0.0 if abs(f) < 1e-12 else f / 0.3**3 for f in found]
        rows.append([name, f"{radius - 1.0:+.0e}", f"{scaled[0]:.2g}", f"{scaled[1]:.2g}", f"{100.0 * own:+.2f}"])
    return rows


def main() -> None:
    quick = common.is_quick(__doc__ or "")
    few = 1 if quick else None
    results = {"known": known(), "stability": stability(few), "compensated": compensated(few)}
    results["met"] = [] if quick else met()
    correction = "–" if quick else corrected()
    common.record_result(NAME, quick=quick, machine=common.machine(), correction=correction, **results)
    text = f"""# Hybrid tests: delays, couplings and faults

`benchmarks/hybrid_limits.py`. {common.machine()}.

Critical delays [ms]: predicted, and found as the delay at which the amplitude of a simulated loop stays constant (limit of the
relative difference: 1e-3). The second table compares them with published values:

{common.markdown_table(["structure", "predicted", "found in the loop", "relative difference"], results["met"])}

{common.markdown_table(["structure", "structid [ms]", "published [ms]"], results["known"])}

One mass with a delay of 30 ms at λ = 10: logarithmic growth of the amplitude per cycle, and RMS of u_m − u divided by the RMS of u:

{common.markdown_table(["compensation", "growth per cycle", "NRMSE"], results["compensated"])}

The force correction r + K₀ (ũ − u_m) is applied to two hysteretic floors at 6.36 m/s², λ = 50 and a delay of 60 ms. The error of
the peak is {correction}.

Couplings: "radius" is the largest spectral radius for Δt of 10⁻³ to 100 fundamental periods. The decay ζω/(ω_P (ω_P Δt)³) is given
for an undamped structure at ω_P Δt = 0.3 with a specimen softened to 0.3 and 0.01 of K₀; negative values mean growth. The last
column is the numerical damping of the first mode at Δt = T₁/40, in addition to the structural damping of 3 %:

{common.markdown_table(["coupling", "radius − 1", "decay at 0.3 K₀", "decay at 0.01 K₀", "damping [%]"], results["stability"])}

Online filter (one run of the packaged programme): at the end of test #3, its six parameters differ from the certified posterior of
the same tests by 0.4 to 3.7 of the filter's standard deviations. The filter is reported as overconfident for the parameter that
differs by more than three.

Faults (`tests/hybrid/recording/test_faults.py`, `test_wire.py`), each injected at twenty random times during a test: client
killed, specimen killed, specimen suspended and resumed, answer not finite, cable unplugged, answer late, disk full. In all 140
cases no finished step is lost, the test ends within its time-outs, and the specimen holds its last accepted position. The server
refuses all of the following: 1000 random or altered frames, signed moves with one altered byte (every seventh byte in turn, and
thirty bytes at random), and 200 open connections that announce megabytes. The server keeps running, and its memory grows by less
than 50 MB. Results of a specimen behind a socket are bit-identical to those of a specimen in the same process.
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
