"""Solvers that behave, and solvers that do not; small, and known to the processes that run them by this module's name."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

from structid.models.external.protocol import SolverError


def wave(parameters, record):
    """A history that depends on every parameter."""
    return parameters["a"] * np.sin(parameters["b"] * record.time) + record.values


def noisy_wave(parameters, record, seed):
    return wave(parameters, record) + np.random.default_rng(seed).standard_normal(len(record))


def two_channels(parameters, record):
    return {"velocity": wave(parameters, record), "displacement": np.cumsum(wave(parameters, record)) * record.dt}


def own_process(parameters, record):
    """Who did the run."""
    return np.full(len(record), float(os.getpid()))


def logged_wave(parameters, record):
    """`wave`, a few milliseconds long, that notes in a file when it was called."""
    with Path(os.environ["CALLS"]).open("a") as file:
        file.write(f"{parameters['a']!r}\n")
    time.sleep(0.004)
    return wave(parameters, record)


def badly_behaved(parameters, record):
    """A tenth of the runs crash, a twentieth hang, a twentieth diverge: by the value of ``a`` in [0, 1)."""
    a = parameters["a"]
    if a < 0.10:
        os.kill(os.getpid(), 11)
    if a < 0.15:
        time.sleep(60.0)
    values = wave(parameters, record)
    if a < 0.20:
        values[len(values) // 2 :] = np.inf
    return values


def misbehaving(parameters, record):
    """One way to fail for each value of ``a``."""
    samples = len(record)
    match int(parameters["a"]):
        case 0:
            return np.ones(samples)
        case 1:
            return np.ones(samples - 7)
        case 2:
            values = np.ones(samples)
            values[100] = np.nan
            return values
        case 3:
            return np.ones((samples, 3))
        case 4:
            return None
        case 5:
            print("matrix is singular", file=sys.stderr)
            sys.exit(3)
        case 6:
            print("still iterating", flush=True)
            time.sleep(60.0)
        case 7:
            os.kill(os.getpid(), 9)
        case 8:
            raise ArithmeticError("no convergence in step 12")
        case 9:
            raise SolverError("gave up", np.ones(50))
        case 10:
            return {"speed": np.ones(samples)}
        case _:
            return "what?"


def with_jax(parameters, record):
    """A solver that is itself one of ours: JAX must work in the child."""
    import structid as si

    model = si.BoucWen(mass=1.0, damping_ratio=0.05, alpha=1.0, beta=0.0, gamma=0.0, free=("stiffness",))
    return model.simulate(np.array([[parameters["a"] * 100.0]]), record).values[0]


def fails_once(parameters, record):
    """Fails at the first attempt at each point, works at the second."""
    mark = Path(os.environ["MARKS"]) / repr(parameters["a"])
    if not mark.exists():
        mark.touch()
        raise RuntimeError("the licence server is busy")
    return wave(parameters, record)


def noisy_output(parameters, record):
    """Solvers that treat their output badly, one after another in the same process."""
    match int(parameters["a"]):
        case 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        case 1:
            sys.stdout.close()
        case 2:
            print("junk \x00 \x1b[31m \udcff".encode("utf-8", "surrogateescape").decode("latin-1"))
            raise SolverError(ValueError("not a text"))
        case 3:
            print("here I stop")
            sys.exit("no convergence in the first step")
        case 4:
            return np.ones(len(record)) * 1j
    return np.ones(len(record))


class Frame:
    """A solver with a state."""

    def __init__(self, mass):
        self.mass = mass

    def __call__(self, parameters, record):
        return self.respond(parameters, record)

    def respond(self, parameters, record):
        return self.mass * wave(parameters, record)
