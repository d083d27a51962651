"""Terms of a NARX read as they are written."""

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.surrogates.narx.structure.candidate_terms import (
    absolute_terms,
    exponential_terms,
    hysteretic_terms,
    polynomial_terms,
    prony_terms,
)
from structid.surrogates.narx.structure.terms import Memory, Term


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x(t-3)*|y(t-1)|", 2.0 * 3.0),
        ("y(t-1)^2", 9.0),
        ("exp(x(t))", np.e),
        ("|y(t-1) - y(t-2)|", 8.0),
        ("x(t)*exp(2*t)*cos(2*pi*t + 0.5)", np.exp(1.0) * np.cos(np.pi + 0.5)),
        ("1", 1.0),
        ("exp(t)*x(t)", np.exp(0.5)),
    ],
)
def test_a_term_says_what_it_means(text, value):
    values = {("x", 0): 1.0, ("x", 3): 2.0, ("y", 1): -3.0, ("y", 2): 5.0}
    np.testing.assert_allclose(Term(text).evaluate(values, 0.5), value, rtol=1e-12)
    assert str(Term(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x*y(t-1)", r"'x'.*lagged signal such as x\(t-1\)"),
        ("x(t-1) if y(t-1) else 2", "term"),
        ("sinh(x(t))", "sinh"),
        ("x(t-1", "arithmetic expression"),
        ("y(t+1)", r"'y\(t\+1\)'.*y\(t-1\) or earlier"),
    ],
)
def test_a_term_that_cannot_be_read(text, words):
    with pytest.raises(InputError, match=words):
        Term(text)


def test_generators():
    assert len(absolute_terms()) == 19  # the thesis's 18 products and |y(t-1)|
    assert len(polynomial_terms(1, 1, 2)) == 1 + 3 + 6
    assert {str(t) for t in exponential_terms(1)} == {"x(t)^2", "x(t-1)^2", "exp(x(t))", "exp(x(t-1))"}
    assert len(prony_terms()) == 60
    terms, memories = hysteretic_terms(("y1", "y2"), ("x",), (1, 0))
    assert [str(m) for m in memories] == ["u1 = integral(y1)", "z1 = hysteresis(u1)", "z2 = hysteresis(y2)"]
    assert "z2(t-1)*|y2(t-1) - y2(t-2)|" in {str(t) for t in terms}


def test_memories_are_named_once():
    with pytest.raises(InputError, match="is a function"):
        Memory("exp", "integral", "y")


@pytest.mark.parametrize(
    ("text", "value"), [("|x(t) - |y(t-1)||", 2.0), ("||y(t-1)| - |x(t-3)||*x(t-3)", 2.0), ("| y(t-1) | * 2", 6.0)]
)
def test_bars_within_bars(text, value):
    assert Term(text).evaluate({("x", 0): 1.0, ("x", 3): 2.0, ("y", 1): -3.0}) == value


def test_bars_that_are_no_pairs():
    with pytest.raises(InputError, match="bars in pairs"):
        Term("|x(t)*y(t-1)")
