"""Files of a three-storey frame on a shaking table, computed with NumPy and SciPy alone."""

import numpy as np
from scipy import interpolate, linalg, signal

GRAVITY = 9.80665
RATE = 256.0
BEFORE, DURATION = 5.0, 16.0
"""Rest before the motion, and length of the table's file [s]."""

LATER = 0.37
"""Start of the floors' logger after that of the table [s]."""

TRUTH = {"stiffness_1": 22e6, "stiffness_2": 19e6, "stiffness_3": 16e6, "gamma_ratio": 0.4, "alpha": 0.08}
MASS, DAMPING, BETA = 12e3, 0.03, 63.0
SUBSTEPS = 4
NOISE = 0.02


def table_motion(peak):
    """Time [s] and acceleration [m/s²] of the table: rest, then band-limited noise that decays."""
    time = np.arange(int(DURATION * RATE) + 1) / RATE
    after = np.clip(time - BEFORE, 0.0, None)
    envelope = np.clip(after / 1.5, 0.0, 1.0) * np.exp(-np.clip(after - 4.0, 0.0, None) / 2.0)
    band = signal.butter(2, [0.8, 12.0], btype="band", fs=RATE, output="sos")
    noise = np.random.default_rng(3).standard_normal(len(time))
    motion = signal.sosfiltfilt(band, noise) * envelope
    return time, peak * motion / np.abs(motion).max()


def response(time, ground):
    """Absolute accelerations of the floors and the drift of the first storey, as functions of time."""
    stiffness = np.array([TRUTH[f"stiffness_{n}"] for n in (1, 2, 3)])
    alpha, gamma = TRUTH["alpha"], TRUTH["gamma_ratio"] * BETA
    to_drifts = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    initial = to_drifts.T @ np.diag(stiffness) @ to_drifts / MASS
    damping = 2.0 * DAMPING * np.real(linalg.sqrtm(initial))  # the same ratio in every mode, per mass

    def absolute(state):
        drift, z = to_drifts @ state[0], state[2]
        return -damping @ state[1] - to_drifts.T @ (stiffness * (alpha * drift + (1.0 - alpha) * z)) / MASS

    def slope(state, ground_now):
        rate = to_drifts @ state[1]
        z_rate = rate - BETA * np.abs(rate) * state[2] - gamma * rate * np.abs(state[2])
        return np.array([state[1], absolute(state) - ground_now, z_rate])

    # Runge and Kutta's fourth order, with the record linear between its samples
    fine = np.linspace(time[0], time[-1], SUBSTEPS * (len(time) - 1) + 1)
    step = fine[1] - fine[0]
    at = np.interp(fine, time, ground)
    state, rows = np.zeros((3, 3)), []
    for now, after in zip(at, [*at[1:], at[-1]], strict=True):
        rows.append([*absolute(state), state[0][0]])
        middle = 0.5 * (now + after)
        first = slope(state, now)
        second = slope(state + 0.5 * step * first, middle)
        third = slope(state + 0.5 * step * second, middle)
        fourth = slope(state + step * third, after)
        state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return interpolate.CubicSpline(fine, np.array(rows))


def write_files(folder):
    """Write the files of the test; return the response to twice the table motion."""
    rng = np.random.default_rng(11)
    time, ground = table_motion(3.0)
    of = response(time, ground)
    for name, factor in (("table.csv", 1.0), ("table_double.csv", 2.0)):
        _write(folder / name, "time [s],table [g]", np.column_stack([time, factor * ground / GRAVITY + 0.012]))
    # 200 Hz, on a logger that starts later; offsets; the second is reversed, the third has a gap
    own = np.arange(0.0, 14.0, 1.0 / 200.0)
    floors = of(own + LATER)[:, :3]
    floors += NOISE * floors.std(axis=0) * rng.standard_normal(floors.shape)
    floors = floors / GRAVITY + np.array([0.004, -0.006, 0.003])
    floors[:, 1] *= -1.0
    floors[(own > 9.1) & (own < 9.8), 2] = np.nan
    _write(folder / "floors.csv", "time [s],floor 1 [g],floor 2 [g],floor 3 [g]", np.column_stack([own, floors]))
    # 100 Hz, on the logger of the table
    own = np.arange(0.0, 15.0, 1.0 / 100.0)
    drift = of(own)[:, 3]
    drift += NOISE * drift.std() * rng.standard_normal(len(own))
    _write(folder / "lvdt.csv", "time [s],drift 1 [mm]", np.column_stack([own, 1e3 * drift]))
    return response(time, 2.0 * ground)


def _write(path, titles, columns):
    """Write a table of a logger, with an empty cell for a missing value."""
    lines = [",".join("" if np.isnan(cell) else f"{cell:.7f}" for cell in row) for row in columns]
    path.write_text("\n".join([titles, *lines]) + "\n")


STUDY = """
name = "frame"
title = "Three-storey frame on a shaking table"
seed = 1

[record]
file = "table.csv"
baseline = ["0 s", "4.5 s"]
trim = ["4 s", "16 s"]

[model]
type = "shear_frame"
storeys = 3
mass = "12 t"
damping_ratio = "3 %"
beta = "63 1/m"

[parameters]
stiffness_1 = { distribution = "normal", unit = "kN/mm", mean = 20, sd = 4, low = 5 }
stiffness_2 = { distribution = "normal", unit = "kN/mm", mean = 20, sd = 4, low = 5 }
stiffness_3 = { distribution = "normal", unit = "kN/mm", mean = 20, sd = 4, low = 5 }
gamma_ratio = { distribution = "uniform", low = -1, high = 1 }
alpha = { distribution = "lognormal", mean = 0.1, sd = 0.05, high = 1 }

[[observation]]
file = "floors.csv"
column = "floor 1"
channels = ["absolute_acceleration_1"]
time_shift = "3.63 s"
baseline = ["0 s", "4.1 s"]

[[observation]]
file = "floors.csv"
column = "floor 2"
channels = ["absolute_acceleration_2"]
time_shift = "3.63 s"
baseline = ["0 s", "4.1 s"]
polarity = "unknown"

[[observation]]
file = "floors.csv"
column = "floor 3"
channels = ["absolute_acceleration_3"]
time_shift = "3.63 s"
missing = "leave_out"
offset = { distribution = "normal", unit = "g", mean = 0, sd = 0.02 }

[[observation]]
file = "lvdt.csv"
channels = ["drift_1"]
time_shift = "4 s"

[discrepancy]
kind = "iid"

[surrogate]
kind = "pod_kriging"

[calibration]

[deterministic]
methods = []

[prediction]
draws = 150

[[prediction.records]]
name = "twice the amplitude"
file = "table_double.csv"
baseline = ["0 s", "4.5 s"]
trim = ["4 s", "16 s"]
"""
"""From the files of the table test to a certified posterior."""
