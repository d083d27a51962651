"""Partitioned integration against all equations of a step solved at once, and against OpenSees."""

import numpy as np
import opensees_frame
import pytest
from scipy.linalg import block_diag

from structid.hybrid.coupling.coupling_benchmark import pulse, two_floor_frame, two_floors
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.substructures.frame_parts import cut_frame


def equations_of(part, step, count):
    """Average acceleration over `count` steps of (u, v, a): S x_k = T x_(k−1) + load, for all k; and T, for the first."""
    one, none = np.eye(part.dofs), np.zeros((part.dofs, part.dofs))
    after = np.block(
        [[one, none, -(step**2) / 4.0 * one], [none, one, -step / 2.0 * one], [part.stiffness, part.damping, part.mass]]
    )
    before = np.block([[one, step * one, step**2 / 4.0 * one], [none, one, step / 2.0 * one], [none, none, none]])
    return np.kron(np.eye(count), after) - np.kron(np.eye(count, k=-1), before), before


def all_equations_at_once(fine, substeps, dt=0.01, steps=100):
    """Both parts on their own clocks, Λ linear in a coarse step, equal velocities at its end: one system for everything."""
    numerical, physical = cut_frame(two_floor_frame(), 1, linear=True)
    counts = (substeps, 1) if fine == "numerical" else (1, substeps)
    base = pulse(np.arange(steps * substeps + 1) * dt / substeps)
    parts = [(numerical, 1.0, counts[0]), (physical, -1.0, counts[1])]
    systems = [equations_of(part, dt / count, count) for part, _, count in parts]
    last, traction, found = [np.zeros(3 * part.dofs) for part, _, _ in parts], 0.0, []
    for step in range(steps):
        pulled, loads, velocities = [], [], []
        for (part, sign, count), (_, before), state in zip(parts, systems, last, strict=True):
            shares = np.arange(1, count + 1) / count
            row = np.concatenate([np.zeros(2 * part.dofs), sign * part.interface[0]])
            inertia = np.concatenate([np.zeros(2 * part.dofs), part.base_load])
            ends = base[step * substeps : (step + 1) * substeps + 1 : substeps // count][1:]
            load = np.outer(ends, inertia) + np.outer((1.0 - shares) * traction, row)
            load[0] += before @ state
            pulled.append(np.outer(shares, row).ravel())
            loads.append(load.ravel())
            at_end = np.concatenate([0.0 * part.interface[0], sign * part.interface[0], 0.0 * part.interface[0]])
            velocities.append(np.concatenate([np.zeros(load[:-1].size), at_end]))
        matrix = np.block(
            [
                [block_diag(*(s for s, _ in systems)), -np.concatenate(pulled)[:, None]],
                [np.concatenate(velocities)[None], np.zeros((1, 1))],
            ]
        )
        scale = np.abs(matrix).max(axis=1)
        solved = np.linalg.solve(matrix / scale[:, None], np.append(np.concatenate(loads), 0.0) / scale)
        middle, traction = loads[0].size, solved[-1]
        last = [solved[:middle][-last[0].size :], solved[middle:-1][-last[1].size :]]
        found.append([last[1][0], last[0][1], traction])
    return np.array(found)


@pytest.mark.parametrize("fine", ["numerical", "physical"])
@pytest.mark.parametrize("substeps", [2, 10])
def test_all_equations_at_once(fine, substeps):
    exact = all_equations_at_once(fine, substeps)
    coarse = two_floors(PrakashHjelmstad(substeps, fine), duration=1.0).coarse
    ours = np.column_stack([coarse.u, coarse.traction])[1:]
    scale = np.abs(exact).max(axis=0)
    np.testing.assert_allclose(ours / scale, exact / scale, rtol=0.0, atol=1e-9)


def test_opensees_has_the_same_frame():
    ops = pytest.importorskip("openseespy.opensees")
    found = opensees_frame.displacements(ops)
    ours = two_floors().coarse.u[1:]
    np.testing.assert_allclose(ours, found, rtol=0.0, atol=1e-6 * np.abs(found).max())
