"""The oscillator against mathematics: Duhamel's integral, closed forms, energy, order, another integrator, differences."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import structid as si
from oscillators import DEGRADING
from structid.core.errors import InputError, Status
from structid.ground_motion.processing import integrate

NOTHING_FREE = np.zeros((1, 0))
PINCHING = dict(zeta0=0.95, p=2.0, q=0.1, psi0=0.5e-3, delta_psi=0.6e-3, lambda_=0.9)


def run(model, excitation, *channels):
    histories = model.recording(*channels).simulate(NOTHING_FREE, excitation)
    assert histories.done.all()
    return tuple(histories.channel(c)[0] for c in channels)


def relative(found, expected):
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


# --- linear limit -----------------------------------------------------------------------------------------------------


def duhamel(record, mass, stiffness, damping_ratio, refinement=20):
    """u(t) = ∫ p(τ) h(t − τ) dτ with p = −m a_g and h = exp(−ζω t) sin(ω_d t)/(m ω_d) [3.20, 3.21]."""
    dt = record.dt / refinement
    t = np.arange((len(record) - 1) * refinement + 1) * dt
    force = -mass * np.interp(t, record.time, record.values)
    omega = np.sqrt(stiffness / mass)
    damped = omega * np.sqrt(1 - damping_ratio**2)
    impulse = np.exp(-damping_ratio * omega * t) * np.sin(damped * t) / (mass * damped)
    # Trapezoidal: both end terms of the convolution vanish or are halved (h(0) = 0, p(0) weighs half).
    return ((scipy.signal.fftconvolve(force, impulse)[: t.size] - 0.5 * force[0] * impulse) * dt)[::refinement]


def test_linear_limit_equals_duhamels_integral(record):
    """The source's figure 3.3: all hysteresis parameters zero, n = 100; a perfect match and a straight restoring force."""
    model = si.BoucWen(
        mass=12_000.0, damping_ratio=0.03, stiffness=7.6e6, alpha=0.3, beta=0.0, gamma=0.0, exponent=100.0, substeps=8
    )
    u, force = run(model, record, "displacement", "restoring_force")
    error = relative(u, duhamel(record, 12_000.0, 7.6e6, 0.03))
    print(f"Duhamel: relative error {error:.1e}")
    assert error < 2e-4  # the trapezoidal convolution's own error, which falls with its refinement
    np.testing.assert_allclose(force, 7.6e6 * u, rtol=1e-12, atol=1e-9)


def test_linear_limit_equals_the_exact_recurrence(record):
    from structid.ground_motion.spectra import oscillator_displacement

    model = si.BoucWen(
        mass=1.0, damping_ratio=0.05, stiffness=(2 * np.pi / 0.25) ** 2, alpha=1.0, beta=0.0, gamma=0.0, substeps=16
    )
    (u,) = run(model, record, "displacement")
    exact = oscillator_displacement(record.values, record.dt, 0.25, 0.05)
    assert relative(u, exact[:: (exact.size - 1) // (len(record) - 1)]) < 1e-7


# --- closed forms of the law, n = 1 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("beta", "gamma"), [(63.0, 63.0), (63.0, -20.0), (50.0, 0.0), (63.0, -80.0)])
def test_loading_and_unloading_follow_the_closed_forms(beta, gamma):
    """Loading z = (1 − e^(−(β+γ)u))/(β+γ); unloading at positive z from (u₁, z₁): dz/du = 1 + (β−γ) z."""
    up = np.linspace(0.0, 0.02, 401)
    down = np.linspace(0.02, 0.015, 101)[1:]
    path = si.DisplacementHistory(np.concatenate([up, down]), 0.01)
    model = si.BoucWen(mass=1.0, stiffness=1.0, alpha=0.1, beta=beta, gamma=gamma, substeps=4)
    u, z, force = run(model, path, "displacement", "hysteretic_displacement", "restoring_force")
    s, d = beta + gamma, beta - gamma
    loading = -np.expm1(-s * up) / s if s else up
    np.testing.assert_allclose(z[: up.size], loading, atol=1e-8 * loading.max())
    u1, z1 = up[-1], loading[-1]
    w = 1 + d * z1
    unloading = z1 + (w * np.expm1(d * (down - u1)) / d if d else down - u1)
    assert unloading.min() > 0
    np.testing.assert_allclose(z[up.size :], unloading, atol=1e-8 * z1)
    np.testing.assert_allclose(force, 0.1 * u + 0.9 * z, rtol=1e-12)


def test_rate_independence():
    path = 0.01 * np.sin(np.linspace(0, 20, 2001)) * np.linspace(0, 1, 2001)
    model = si.BoucWen(**DEGRADING, **PINCHING)
    slow, fast = (run(model, si.DisplacementHistory(path, dt), "restoring_force")[0] for dt in (1.0, 1e-3))
    np.testing.assert_allclose(slow, fast, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0])
def test_ultimate_hysteretic_displacement(exponent):
    """Far loading tends to z_u = [1/(β+γ)]^(1/n) [3.10]."""
    beta, gamma = 0.7 / 0.005**exponent, 0.3 / 0.005**exponent
    model = si.BoucWen(mass=1.0, stiffness=1.0, alpha=0.0, beta=beta, gamma=gamma, exponent=exponent, substeps=4)
    (z,) = run(model, si.DisplacementHistory(np.linspace(0, 0.1, 2001), 0.01), "hysteretic_displacement")
    assert z[-1] == pytest.approx(0.005, rel=1e-6)


# --- energy -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extra", [{}, PINCHING], ids=["degrading", "pinching"])
def test_energy_balance(record, extra):
    """½v² + e_h + e_e + ∫2ζω v² dt = −∫a_g v dt, to 1e-6 of the input (it tests the integrator, not the law)."""
    fine = si.GroundMotion(np.interp(np.arange(40_001) * 0.001, record.time, record.values), 0.001)
    model = replace(si.BoucWen(**DEGRADING, **extra), substeps=1)
    v, absorbed, damping_input = run(model, fine, "velocity", "absorbed_energy", "relative_acceleration")
    omega = np.sqrt(DEGRADING["stiffness"] / DEGRADING["mass"])
    h = fine.dt

    def simpson(x):
        return scipy.integrate.simpson(x, dx=h)

    given = -simpson(fine.values * v)
    kept = 0.5 * v[-1] ** 2 + absorbed[-1] / DEGRADING["mass"] + simpson(2 * 0.03 * omega * v**2)
    scale = simpson(np.abs(fine.values * v))
    print(f"energy balance: {abs(kept - given) / scale:.1e} of the input")
    assert abs(kept - given) < 1e-6 * scale
    assert damping_input.size == len(fine)


def test_elastic_energy_is_the_work_of_the_elastic_part(record):
    model = si.BoucWen(**DEGRADING)
    u, elastic = run(model, record, "displacement", "elastic_energy")
    np.testing.assert_allclose(elastic, 0.5 * 0.05 * 7.6e6 * u**2, atol=1e-5 * elastic.max())


# --- order and another integrator -------------------------------------------------------------------------------------


def test_fourth_order_on_a_smooth_case():
    """Without reversals of velocity or z the right-hand side is smooth and the error falls as h⁴."""
    rise = si.ForceHistory(2e4 * (1 - np.cos(np.linspace(0, np.pi, 5))), 0.01)
    errors = []
    model = si.BoucWen(
        **DEGRADING | dict(damping_ratio=0.4, gamma_ratio=0.5),
        exponent=2.0,
        initial_velocity=0.3,
        initial_hysteretic_displacement=1e-3,
        initial_displacement=1e-3,
    )
    (exact,) = run(replace(model, substeps=512), rise, "displacement")
    for substeps in (2, 4, 8, 16):
        (u,) = run(replace(model, substeps=substeps), rise, "displacement")
        errors.append(np.abs(u - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    print("observed orders", np.round(orders, 2))
    assert (np.abs(orders[-2:] - 4.0) < 0.15).all()


def right_hand_side(record, p, pinching):
    omega2 = p["stiffness"] / p["mass"]
    c = 2 * p["damping_ratio"] * np.sqrt(omega2)

    def rate(t, y):
        u, v, z, e = y
        a = np.interp(t, record.time, record.values)
        nu, eta = 1 + p["delta_nu"] * e, 1 + p["delta_eta"] * e
        beta, gamma = p["beta"], p["beta"] * p["gamma_ratio"]
        h = 1.0
        if pinching:
            zeta1 = pinching["zeta0"] * (1 - np.exp(-pinching["p"] * e))
            zeta2 = (pinching["psi0"] + pinching["delta_psi"] * e) * (pinching["lambda_"] + zeta1)
            zu = 1 / (nu * (beta + gamma))
            h = 1 - zeta1 * np.exp(-((z * np.sign(v) - pinching["q"] * zu) ** 2) / zeta2**2)
        dz = h * (v - nu * (beta * abs(v) * z + gamma * v * abs(z))) / eta
        alpha = p["alpha"]
        return [v, -a - c * v - omega2 * (alpha * u + (1 - alpha) * z), dz, (1 - alpha) * omega2 * z * v]

    return rate


@pytest.mark.parametrize("pinching", [{}, PINCHING], ids=["degrading", "pinching"])
def test_against_dop853(short_record, pinching):
    """SciPy's DOP853 at rtol 1e-10, written from the equations; the default substeps err by less than 1e-4 in velocity."""
    truth = scipy.integrate.solve_ivp(
        right_hand_side(short_record, DEGRADING, pinching),
        (0, short_record.duration),
        np.zeros(4),
        "DOP853",
        short_record.time,
        rtol=1e-10,
        atol=1e-14,
        max_step=short_record.dt,
    )
    model = si.BoucWen(**DEGRADING, **pinching)
    u, v, z, e = run(model, short_record, "displacement", "velocity", "hysteretic_displacement", "hysteretic_energy")
    print(f"default substeps: velocity error {relative(v, truth.y[1]):.1e}")
    if not pinching:
        assert relative(v, truth.y[1]) < 1e-4
    fine = run(
        replace(model, substeps=100),
        short_record,
        "displacement",
        "velocity",
        "hysteretic_displacement",
        "hysteretic_energy",
    )
    for found, expected in zip(fine, (*truth.y[:3], truth.y[3] * DEGRADING["mass"]), strict=True):
        assert relative(found, expected) < 2e-6
    assert len(u) == len(z) == len(e)


# --- gradients --------------------------------------------------------------------------------------------------------


def test_gradient_of_the_misfit_against_central_differences(short_posterior):
    """Step 1e-6 of the range; larger ones meet the kinks of |v|. Relative error at most 1e-5."""
    misfit = short_posterior.misfit
    widths = np.array([7.58e6, 10.0, 2.0, 0.1])
    for theta in misfit.space.sample(4, seed=3).values:
        _, gradient, _ = misfit.linearised(theta)
        for i, width in enumerate(widths):
            step = np.zeros(4)
            step[i] = 1e-6 * width
            high, low = misfit(np.array([theta + step, theta - step]))
            numeric = (high - low) / (2e-6 * width)
            # A component far below the others is compared on the scale of the gradient, in units of the ranges.
            scale = max(abs(numeric), 1e-4 * np.abs(gradient[0] * widths).max() / width)
            assert abs(gradient[0, i] - numeric) < 1e-5 * scale


def test_reverse_mode_is_finite_from_the_initial_state(short_record):
    """The derivative of |z|^(n−1) z at z = 0, where every history starts, is NaN by naive differentiation."""
    free = ("stiffness", "alpha", "beta", "gamma", "exponent")
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=free, **PINCHING, delta_nu=2.43, delta_eta=6.5)
    excitation = model.traced(short_record)

    def energy(theta):
        return (model.response(theta[None], excitation)[0] ** 2).sum()

    both_ways = jax.jit(lambda theta: (jax.grad(energy)(theta), jax.jacfwd(energy)(theta)))
    for exponent in (1.0, 1.3, 2.0):
        reverse, forward = both_ways(np.array([7.6e6, 0.05, 63.0, 30.0, exponent]))
        assert np.isfinite(reverse).all(), exponent
        np.testing.assert_allclose(reverse, forward, rtol=1e-8)


# --- the benchmark of nonlinear identification ------------------------------------------------------------------------


def test_benchmark_is_a_case_of_the_family():
    """m ÿ + c ẏ + k y + z = f, z′ = α ẏ − β(γ|ẏ||z|^(ν−1)z + δ ẏ|z|^ν), integrated as printed."""
    from structid.models.hysteretic.bouc_wen_benchmark import benchmark_parameters

    m, c, k, alpha, beta, gamma, delta, nu = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1, 1.0
    t = np.arange(600) / 3000
    force = si.ForceHistory(60 * np.sin(2 * np.pi * 30 * t), 1 / 3000)

    def rate(time, y):
        u, v, z = y
        f = np.interp(time, t, force.values)
        return [
            v,
            (f - c * v - k * u - z) / m,
            alpha * v - beta * (gamma * abs(v) * abs(z) ** (nu - 1) * z + delta * v * abs(z) ** nu),
        ]

    truth = scipy.integrate.solve_ivp(
        rate, (0, t[-1]), np.zeros(3), "DOP853", t, rtol=1e-10, atol=1e-14, max_step=1 / 3000
    )
    model = si.BoucWen(mass=m, damping=c, substeps=20, **benchmark_parameters(k, alpha, beta, gamma, delta, nu))
    u, z = run(model, force, "displacement", "hysteretic_displacement")
    assert relative(u, truth.y[0]) < 1e-6
    assert relative(alpha * z, truth.y[2]) < 1e-6


def test_periodic_force_reaches_its_steady_state():
    """A linear oscillator under a sine: the amplitude and phase of the transfer function, after the lead-in."""
    samples, dt = 200, 0.01
    force = si.ForceHistory(
        np.sin(2 * np.pi * 5 * np.arange(samples) / samples), dt, interpolation="periodic", lead_in_periods=12
    )
    model = si.BoucWen(mass=1.0, stiffness=400.0, damping_ratio=0.1, alpha=1.0, beta=0.0, gamma=0.0, substeps=20)
    (u,) = run(model, force, "displacement")
    w = 2 * np.pi * 5 / (samples * dt)
    transfer = 1 / (400.0 - w**2 + 1j * w * 2 * 0.1 * 20.0)
    np.testing.assert_allclose(u, (transfer * np.exp(1j * w * force.time)).imag, atol=1e-8)


# --- failure is data --------------------------------------------------------------------------------------------------


def test_a_run_that_blows_up_is_a_failed_row_with_its_time(record):
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma_ratio=0.5, free=("stiffness",))
    histories = model.simulate(np.array([[7.6e6], [7.6e11], [7.0e6]]), record)
    bad = histories.status == Status.DIVERGED
    assert bad[1] and not bad.all()
    time = histories.failure_time[1]
    assert 0 < time <= record.duration
    values = histories.values[1, :, 0]
    at = round(time / record.dt)
    assert np.isfinite(values[:at]).all() and np.isnan(values[at:]).all()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(), "mass"),
        (dict(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0), "gamma"),
        (dict(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0, gamma_ratio=1.0), "one of the two"),
        (dict(mass=1.0, stiffness=-1.0, alpha=0.1, beta=1.0, gamma=1.0), "positive"),
        (dict(mass=1.0, free=("stifness",)), "Did you mean 'stiffness'"),
        (dict(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0, channels=("speed",)), "velocity"),
        (dict(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0, zeta0=1.0), "below 1"),
        (dict(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0, zeta0=0.5), "psi0"),
        (dict(mass="heavy", stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0), "number"),
    ],
)
def test_bad_models_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        si.BoucWen(**settings)


def test_print_says_frequencies_and_damping():
    text = str(si.BoucWen(**DEGRADING))
    for part in ("f 4.005 Hz", "T 0.2497 s", "ω_n 25.17", "ω_d 25.15", "c 1.812e+04"):
        assert part in text


def test_absolute_acceleration_and_integrated_velocity(record):
    u, v, relative_acceleration, absolute = run(
        si.BoucWen(**DEGRADING), record, "displacement", "velocity", "relative_acceleration", "absolute_acceleration"
    )
    np.testing.assert_allclose(absolute - relative_acceleration, record.values, atol=1e-9)
    np.testing.assert_allclose(integrate(v, record.dt), u, atol=5e-3 * np.abs(u).max())
    assert relative_acceleration.size == v.size


@pytest.mark.parametrize("runs", [1, 2, 3, 4, 5])
def test_blow_ups_in_batches_of_every_size(short_record, runs):
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma_ratio=0.5, free=("stiffness",))
    histories = model.simulate(np.full((runs, 1), 7.6e11), short_record)
    assert (histories.status == Status.DIVERGED).all() and np.isfinite(histories.failure_time).all()


def test_the_last_velocity_of_an_imposed_displacement():
    path = si.DisplacementHistory(0.005 * np.arange(11), 0.1)
    for substeps in (1, 3):
        (v,) = run(si.BoucWen(**DEGRADING, substeps=substeps), path, "velocity")
        np.testing.assert_allclose(v, 0.05, rtol=1e-12)


def test_wrong_excitations_and_empty_designs_are_refused(short_record):
    model = si.BoucWen(**DEGRADING)
    with pytest.raises(InputError, match=r"simulate\(excitation\): an array"):
        model.simulate(NOTHING_FREE, short_record.values)
    with pytest.raises(InputError, match="no runs"):
        model.simulate(np.zeros((0, 0)), short_record)
    with pytest.raises(InputError, match="also free"):
        si.BoucWen(**DEGRADING, free=("stiffness",))


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0, 5.0])
def test_whole_exponents_are_the_same_by_products_and_by_logarithms(short_record, exponent):
    """A fixed whole exponent is a product, a free one exp(n log |z|)."""
    law = DEGRADING | dict(zeta0=0.5, p=2.0, q=0.2, psi0=0.01, delta_psi=0.001, lambda_=0.5)
    fixed = si.BoucWen(**law, exponent=exponent).simulate(NOTHING_FREE, short_record).values
    free = si.BoucWen(**law, free=("exponent",)).simulate([[exponent]], short_record).values
    np.testing.assert_allclose(free, fixed, rtol=0.0, atol=1e-11 * np.abs(fixed).max())


@pytest.mark.parametrize(
    "name", [*DEGRADING, "exponent", "amplitude", "delta_a", "initial_displacement", "initial_velocity"]
)
def test_every_parameter_may_be_free(short_record, name):
    """The same response whether a parameter is fixed or comes with the run; and a finite derivative in it."""
    values = DEGRADING | dict(exponent=1.0, amplitude=1.0, delta_a=0.0, initial_displacement=1e-3, initial_velocity=0.0)
    fixed = si.BoucWen(**values).simulate(NOTHING_FREE, short_record).values
    free = si.BoucWen(**{k: v for k, v in values.items() if k != name}, free=(name,))
    np.testing.assert_allclose(free.simulate([[values[name]]], short_record).values, fixed, rtol=1e-7, atol=1e-9)
    excitation = free.traced(short_record)
    slope = jax.jacfwd(lambda t: free.response(t[None], excitation)[0])(jax.numpy.array([values[name]]))
    assert np.isfinite(slope).all()
