"""What compares shapes with signatures finds a wrong one, in arguments, results and fields."""

import importlib
import inspect

import numpy as np
import pytest

import shape_checks

SOURCE = """
from __future__ import annotations
import dataclasses
import numpy as np
from jaxtyping import Float

def total(
    values: Float[np.ndarray, "run parameter"], weights: Float[np.ndarray, " run"] | None = None
) -> Float[np.ndarray, " run"]:
    return values.sum(axis=1) if weights is None or weights[0] < 9.0 else values

def mean_and_rest(values: Float[np.ndarray, " run"]) -> tuple[float, Float[np.ndarray, " run"]]:
    return float(values.mean()), values - values.mean() if values[0] < 9.0 else values[:1]

@dataclasses.dataclass
class Pair:
    first: Float[np.ndarray, " n"]
    second: Float[np.ndarray, " n"]
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "some_shapes.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("some_shapes")
    shape_checks.check_module(module)
    return module


def test_what_agrees_passes(module):
    assert module.total(np.ones((3, 2)), np.ones(3)).shape == (3,)
    assert module.total(np.ones((3, 2))).shape == (3,)
    module.Pair(np.ones(2), np.ones(2))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.ones(3),), r"total, values: ndarray \(3,\)"),
        ((np.ones((3, 2)), np.ones(4)), r"total, weights: ndarray \(4,\)"),
        ((np.ones((3, 2), dtype=int),), "values: .* of int64"),
        (([[1.0]],), "values: list"),
        ((np.ones((3, 2)), np.full(3, 9.0)), r"total, return: ndarray \(3, 2\)"),
    ],
)
def test_what_does_not_is_refused(module, arguments, words):
    with pytest.raises(TypeError, match=words):
        module.total(*arguments)


def test_each_part_of_a_tuple_is_compared(module):
    assert module.mean_and_rest(np.ones(3))[0] == 1.0
    with pytest.raises(TypeError, match="mean_and_rest, return: tuple"):
        module.mean_and_rest(np.full(3, 9.0))


def test_fields_of_different_sizes_are_refused(module):
    with pytest.raises(TypeError, match=r"Pair.__init__, second"):
        module.Pair(np.ones(2), np.ones(3))


def test_the_package_is_watched():
    """Other tests may have used up the calls that are checked, so that the constructor is watched anew."""
    from structid.probability.bijections import Bijection

    constructor = inspect.unwrap(Bijection.__init__)
    assert constructor is not Bijection.__init__
    with pytest.raises(TypeError, match=r"Bijection.__init__, bounds: ndarray \(2,\)"):
        shape_checks.checked(constructor)(object.__new__(Bijection), np.ones(2))
