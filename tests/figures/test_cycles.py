"""Cycles that stand for a loop."""

import numpy as np
import pytest

from structid.figures.cycles import chosen_cycles, cycles

TIME = np.linspace(0.0, 20.0, 4001)


def test_a_cycle_goes_from_zero_upwards_to_zero_upwards():
    u = np.sin(2.0 * np.pi * TIME)
    found = cycles(u)
    assert len(found) == pytest.approx(19, abs=1)
    for cycle in found:
        assert TIME[cycle][-1] - TIME[cycle][0] == pytest.approx(1.0, abs=0.01)
        assert u[cycle].max() == pytest.approx(1.0, abs=1e-3) and u[cycle].min() == pytest.approx(-1.0, abs=1e-3)


def test_those_chosen_are_large_and_go_from_early_to_late():
    u = np.sin(2.0 * np.pi * TIME) * np.exp(-((TIME - 8.0) ** 2) / 20.0)
    shown = chosen_cycles(u)
    assert len(shown) == 4 and [c.start for c in shown] == sorted(c.start for c in shown)
    sizes = [np.ptp(u[c]) for c in shown]
    assert min(sizes) >= 0.3 * np.ptp(u) / 1.01
    largest = max(cycles(u), key=lambda c: np.ptp(u[c]))
    assert largest in shown and chosen_cycles(u, most=1) == [largest]


@pytest.mark.parametrize("u", [np.zeros(50), np.linspace(0.0, 1.0, 50), -np.ones(3)])
def test_what_never_returns_has_none(u):
    assert cycles(u) == [] and chosen_cycles(u) == []
