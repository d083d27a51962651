"""The law against OpenSees, each part on the material that has it: degradation on `BoucWen`, pinching on `BWBN`.

How the two formulations were matched:

* OpenSees measures hysteretic energy as E = (1−α) k_o ∫ z du in J; structid's e_h = (1−α) ω² ∫ z du is E/m in J/kg.
  So what multiplies an energy is divided by the mass on its way there: δ_A, δ_ν, δ_η, p and δ_ψ.
* OpenSees takes γ before β, its z_u = [1/(β+γ)]^(1/n) lacks A and ν, and `BWBN` does not degrade: the two agree for
  A₀ = 1, which these tests keep wherever there is pinching.
* Nothing else differs: the same α, k, n, β, γ, A₀, ζ₀ (`zetas`), q, ψ₀ (`Shi`), λ (`lamda`).

Both materials integrate z by one backward-Euler step per strain increment, of order 1. At the increments of a practical
analysis their error hides any difference of the laws, so it is extrapolated away: with errors c h + O(h²),
2 y(h/2) − y(h) is of order 2. What is left is below 1e-7 of the force; leaving out degradation or pinching changes it by
8 % to 45 %, and a rate that is off by a thousandth by 1e-4.
"""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

import structid as si

try:  # without the system's libblas the package is there, and raises a RuntimeError
    import openseespy.opensees as ops
except (ImportError, RuntimeError) as error:
    pytest.skip(f"OpenSeesPy cannot be imported: {error}", allow_module_level=True)

MASS, STIFFNESS, ALPHA = 12_000.0, 7.6e6, 0.05
NEWTON = (1e-14, 100)
"""Tolerance on z [m] and iterations of the materials' own Newton loop."""
INCREMENTS = 200
"""Strain increments per sample of the coarser of the two runs that are extrapolated."""
LIMIT = 5e-7
"""Relative difference of two force histories that counts as the same law; 6e-8 is what is seen."""

STUDY = {"beta": 63.0, "gamma": 63.0, "delta_nu": 2.43, "delta_eta": 6.5}
DEGRADING = {
    "study": STUDY,
    "all_rates": {"beta": 63.0, "gamma": -20.0, "delta_a": 0.5, "delta_nu": 2.43, "delta_eta": 6.5},
    "exponent": {"beta": 500.0, "gamma": 300.0, "exponent": 1.5, "delta_a": 0.3, "delta_nu": 1.0, "delta_eta": 3.0},
}
PINCHING = {
    # The set of the source, its ζ₀ = 1 read as 0.95.
    "source": {
        "beta": 63.0,
        "gamma": 63.0,
        "zeta0": 0.95,
        "p": 2.0,
        "q": 1.0,
        "psi0": 0.5e-3,
        "delta_psi": 0.6,
        "lambda_": 0.9,
    },
    "wide": {
        "beta": 63.0,
        "gamma": 50.0,
        "zeta0": 0.95,
        "p": 2.0,
        "q": 0.3,
        "psi0": 5e-3,
        "delta_psi": 6e-3,
        "lambda_": 0.9,
    },
    "exponent": {
        "beta": 500.0,
        "gamma": 300.0,
        "exponent": 1.5,
        "zeta0": 0.8,
        "p": 10.0,
        "q": 0.1,
        "psi0": 2e-3,
        "delta_psi": 0.05,
        "lambda_": 0.4,
    },
}


def growing_cycles() -> si.DisplacementHistory:
    """Five cycles from 4 to 15 mm: well past yielding, with reversals on and off the samples."""
    time = np.arange(401) * 0.01
    return si.DisplacementHistory((0.004 + 0.003 * time) * np.sin(2.0 * np.pi * time / 0.8), 0.01)


def restoring_force(law: dict[str, float], history: si.DisplacementHistory) -> np.ndarray:
    model = si.BoucWen(mass=MASS, stiffness=STIFFNESS, alpha=ALPHA, channels=("restoring_force",), substeps=40, **law)
    return model.simulate(np.zeros((1, 0)), history).channel("restoring_force")[0]


def define_bouc_wen(beta, gamma, exponent=1.0, delta_a=0.0, delta_nu=0.0, delta_eta=0.0):
    rates = (delta_a / MASS, delta_nu / MASS, delta_eta / MASS)
    ops.uniaxialMaterial("BoucWen", 1, ALPHA, STIFFNESS, exponent, gamma, beta, 1.0, *rates, *NEWTON)


def define_bwbn(beta, gamma, zeta0, p, q, psi0, delta_psi, lambda_, exponent=1.0):
    pinching = (q, zeta0, p / MASS, psi0, delta_psi / MASS, lambda_)
    ops.uniaxialMaterial("BWBN", 1, ALPHA, STIFFNESS, exponent, gamma, beta, 1.0, *pinching, *NEWTON)


def material_force(define, law: dict[str, float], history: si.DisplacementHistory, increments: int) -> np.ndarray:
    """Force of an OpenSees material at every sample; the history runs straight between samples."""
    ops.wipe()
    define(**law)
    ops.testUniaxialMaterial(1)
    fractions = np.arange(1, increments + 1) / increments
    force = np.zeros(len(history))
    for i, (start, end) in enumerate(zip(history.values[:-1], history.values[1:], strict=True), start=1):
        for strain in (start + (end - start) * fractions).tolist():
            ops.setStrain(strain)  # sets the trial strain and commits it
        force[i] = ops.getStress()
    ops.wipe()
    return force


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def assert_same_law(define, law: dict[str, float]) -> None:
    history = growing_cycles()
    ours = restoring_force(law, history)
    coarse, fine = (material_force(define, law, history, n) for n in (INCREMENTS, 2 * INCREMENTS))
    # OpenSees comes to us at its own order, and no part of its error stays behind.
    assert relative(coarse, ours) / relative(fine, ours) == pytest.approx(2.0, abs=0.02)
    assert relative(2.0 * fine - coarse, ours) < LIMIT


@pytest.mark.parametrize("name", DEGRADING)
def test_degradation_is_that_of_opensees_bouc_wen(name):
    """Rates divided by the mass: see the top of this file."""
    law = DEGRADING[name]
    assert_same_law(define_bouc_wen, law)
    without = {k: v for k, v in law.items() if not k.startswith("delta")}
    history = growing_cycles()
    assert relative(restoring_force(without, history), restoring_force(law, history)) > 0.1


@pytest.mark.parametrize("name", PINCHING)
def test_pinching_is_that_of_opensees_bwbn(name):
    """p and δ_ψ divided by the mass: see the top of this file."""
    law = PINCHING[name]
    assert_same_law(define_bwbn, law)
    without = {k: v for k, v in law.items() if k in ("beta", "gamma", "exponent")}
    history = growing_cycles()
    assert relative(restoring_force(without, history), restoring_force(law, history)) > 0.05


@pytest.mark.parametrize("name", ["delta_nu", "delta_eta"])
def test_the_comparison_sees_a_rate_that_is_off_by_a_thousandth(name):
    history = growing_cycles()
    off = STUDY | {name: 1.001 * STUDY[name]}
    assert relative(restoring_force(off, history), restoring_force(STUDY, history)) > 100 * LIMIT


# --- the oscillator under base excitation -----------------------------------------------------------------------


def pulse() -> si.GroundMotion:
    """Three seconds that yield and degrade the oscillator and let it ring out."""
    time = np.arange(301) * 0.01
    return si.GroundMotion(3.0 * np.sin(2.0 * np.pi * 3.0 * time) * np.exp(-2.0 * time), 0.01)


def opensees_oscillator(motion: si.GroundMotion, damping_ratio: float, increments: int) -> np.ndarray:
    """Relative velocity [m/s] at every sample, by the average-acceleration Newmark rule."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(1, 0.0)
    ops.node(2, 0.0)
    ops.fix(1, 1)
    ops.mass(2, MASS)
    define_bouc_wen(**STUDY)
    ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
    ops.rayleigh(2.0 * damping_ratio * np.sqrt(STIFFNESS / MASS), 0.0, 0.0, 0.0)  # mass-proportional: c = 2 ζ ω m
    ops.timeSeries("Path", 1, "-dt", motion.dt, "-values", *motion.values.tolist(), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("ProfileSPD")
    ops.test("NormDispIncr", 1e-14, 50)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    velocity = np.zeros(len(motion))
    for i in range(1, len(motion)):
        assert ops.analyze(increments, motion.dt / increments) == 0
        velocity[i] = ops.nodeVel(2, 1)
    ops.wipe()
    return velocity


def test_degrading_oscillator_is_that_of_opensees():
    """Mass, damping and sign of the base excitation; c = 2 ζ ω m by mass-proportional Rayleigh damping."""
    motion = pulse()
    model = si.BoucWen(mass=MASS, stiffness=STIFFNESS, alpha=ALPHA, damping_ratio=0.03, substeps=10, **STUDY)
    ours = model.simulate(np.zeros((1, 0)), motion).channel("velocity")[0]
    coarse, fine = (opensees_oscillator(motion, 0.03, n) for n in (100, 200))
    assert relative(coarse, ours) / relative(fine, ours) == pytest.approx(2.0, abs=0.05)
    assert relative(2.0 * fine - coarse, ours) < 1e-4


@pytest.mark.parametrize("samples", [101, 1001, 2001])
def test_the_last_sample_of_a_record_drives_the_example(samples, monkeypatch):
    """A sum of steps may end above the last sample's time by rounding, where a series without -useLast is zero."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples" / "opensees_oscillator")
    respond = importlib.import_module("oscillator").respond
    acceleration = np.zeros(samples)
    acceleration[-1] = 5.0
    record = si.GroundMotion(acceleration, 0.01)
    parameters = {"stiffness": STIFFNESS, "alpha": ALPHA, "beta": 63.0, "gamma_ratio": 1.0}
    last = respond(parameters, record)[-1]
    # At rest until the last step, in which the average acceleration is half of the last sample's.
    assert last == pytest.approx(-0.5 * 5.0 * record.dt, rel=0.05)
