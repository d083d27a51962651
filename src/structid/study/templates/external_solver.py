"""Example of an external solver, to be replaced by yours: a hysteretic oscillator, integrated in plain Python.

structid calls `respond` once per run, in a child process. If a run crashes, hangs or returns incomplete histories, the other
runs continue. Parameters arrive in SI units, under their names in the study file. Return histories in SI units, with one value
per sample of the record. Raise an exception if a run fails. A value that is not finite means that the run diverged at that time.
"""

from itertools import pairwise

MASS = 12_000.0  # kg
DAMPING_RATIO = 0.03


def respond(parameters, record):
    """Relative velocity of the mass [m/s] for the record, shape (time,)."""
    stiffness = parameters["stiffness"]  # N/m
    yield_displacement = parameters["yield_displacement"]  # m
    hardening = parameters["hardening"]  # ratio of post-yield to initial stiffness
    damping = 2.0 * DAMPING_RATIO * (stiffness * MASS) ** 0.5

    def rates(state, ground):
        u, v, z = state
        spring = stiffness * (hardening * u + (1.0 - hardening) * z)
        # m v' = -m a_g - c v - f, and the Bouc-Wen equation z' = v - (|v| z + v |z|) / (2 z_y), so that |z| <= z_y
        return v, -ground - (damping * v + spring) / MASS, v - 0.5 * (abs(v) * z + v * abs(z)) / yield_displacement

    ground, dt = record.values.tolist(), record.dt
    state, velocities = (0.0, 0.0, 0.0), [0.0]
    for before, after in pairwise(ground):
        state = runge_kutta(rates, state, before, after, dt)
        velocities.append(state[1])
    return velocities


def runge_kutta(rates, state, before, after, dt):
    """Take one step with the classical fourth-order Runge-Kutta method; the ground acceleration is linear between samples."""
    middle = 0.5 * (before + after)
    k1 = rates(state, before)
    k2 = rates(moved(state, k1, 0.5 * dt), middle)
    k3 = rates(moved(state, k2, 0.5 * dt), middle)
    k4 = rates(moved(state, k3, dt), after)
    slopes = ((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return moved(state, slopes, dt)


def moved(state, rate, dt):
    """Advance a state by a rate times the time step."""
    return tuple(x + dt * dx for x, dx in zip(state, rate, strict=True))
