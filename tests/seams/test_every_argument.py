"""Every argument of every public name refuses what would be read silently wrong: text, NaN, masks, complex numbers, quantities."""

import inspect
from fractions import Fraction

import numpy as np
import pandas
import pytest

import structid as si
from structid.core.errors import InputError
from structid.core.validation import _Check, _spelt_out, real_array, real_number

pytestmark = pytest.mark.quick


def public_functions():
    """What the package exports, and the public methods of its classes, by name."""
    for name in dir(si):
        thing = getattr(si, name)
        if inspect.ismodule(thing):
            for function in vars(thing).values():
                if inspect.isfunction(function) and function.__module__.startswith("structid"):
                    yield f"{name}.{function.__name__}", function
        elif isinstance(thing, type):
            yield name, thing.__init__
            for method_name, method in vars(thing).items():
                method = getattr(method, "__func__", method)
                if inspect.isfunction(method) and not method_name.startswith("_"):
                    yield f"{name}.{method_name}", method
        elif callable(thing):
            yield name, thing


def arguments(kind):
    """Arguments of one kind, as (function, name of the argument), of functions that check theirs."""
    for label, function in public_functions():
        if not hasattr(function, "__wrapped__"):
            continue
        for name, parameter in inspect.signature(function).parameters.items():
            check = _Check.of(_spelt_out(parameter.annotation, function))
            if name not in ("self", "cls") and parameter.kind is not parameter.VAR_POSITIONAL and kind(check):
                yield pytest.param(function, name, id=f"{label}-{name}")


class Quantity:
    """What pint, astropy and unyt have in common."""

    units, magnitude = "millimeter", np.ones(3)

    def __array__(self, dtype=None, copy=None):
        return self.magnitude


MASKED = np.ma.masked_array([1.0, 2.0, 3.0], mask=[False, True, False])
LOSSY_ARRAYS = {
    "masked": (MASKED, "1 masked value"),
    "masked rows": ([MASKED, MASKED], "masked value"),
    "complex": (np.array([1.0, 2.0 + 1e-3j]), "complex numbers"),
    "text": (np.array(["1.5", "2.5"]), "strings such as '1.5'"),
    "text in a list": ([1.0, "2.5"], "the string '2.5'|strings such as"),
    "objects": (np.array([1.0, None], dtype=object), "None"),
    "text objects": (np.array([1.0, "2.5"], dtype=object), "the string '2.5'"),
    "quantities": (Quantity(), "quantities in millimeter"),
    "text in a table": (pandas.Series(["1.5", "2.5"], dtype="string"), "strings such as|the string '1.5'"),
}
WRONG_NUMBERS = {
    "nan": (float("nan"), "nan, which is not a number"),
    "NumPy's nan": (np.float32("nan"), "nan, which is not a number"),
    "complex": (1.0 + 2.0j, "complex"),
    "masked": (np.ma.masked, "masked value"),
    "a quantity": (Quantity(), "a quantity in millimeter"),
}


def refusal(function, name, value):
    """What a call with one argument says; what is left out otherwise is asked for later."""
    with pytest.raises(InputError) as caught:
        if "self" in inspect.signature(function).parameters:
            function(object(), **{name: value})
        elif "cls" in inspect.signature(function).parameters:
            function(object, **{name: value})
        else:
            function(**{name: value})
    assert f"({name})" in caught.value.where
    return str(caught.value)


@pytest.mark.parametrize(("function", "name"), arguments(lambda check: check.number))
def test_a_number_is_a_number(function, name):
    for value, words in WRONG_NUMBERS.values():
        assert words in refusal(function, name, value)


@pytest.mark.parametrize(("function", "name"), arguments(lambda check: check.number and not check.open))
def test_text_is_never_a_number(function, name):
    assert "the string '1.5'" in refusal(function, name, "1.5")


@pytest.mark.parametrize(("function", "name"), arguments(lambda check: check.array and not check.number))
def test_an_array_loses_nothing(function, name):
    for value, words in LOSSY_ARRAYS.values():
        said = refusal(function, name, value)
        assert any(word in said for word in words.split("|")), said


def test_the_search_finds_arguments():
    """The tests above are about as many arguments as there are: none of the loops is empty."""
    assert len(list(arguments(lambda check: check.number))) > 200
    assert len(list(arguments(lambda check: check.array and not check.number))) > 40


@pytest.mark.parametrize(
    "value",
    [np.float32(0.25), np.float64(0.25), np.array(0.25), Fraction(1, 4), np.longdouble(0.25), np.ma.masked_array(0.25)],
    ids=lambda value: type(value).__name__,
)
def test_numbers_of_other_libraries_are_numbers(value):
    assert type(real_number("x", value)) is float and real_number("x", value) == 0.25
    assert si.IID(variance=value).describe() == si.IID(variance=0.25).describe()
    assert si.AR1(variance=value).describe() == si.AR1(variance=0.25).describe()
    assert si.IID(variance={"velocity": value}).describe() == si.IID(variance={"velocity": 0.25}).describe()
    assert si.Uniform(0.0, value).describe() == si.Uniform(0.0, 0.25).describe()
    assert si.Kriging(nugget=value) == si.Kriging(nugget=0.25)
    oscillator = dict(mass=1.0, stiffness=1.0, beta=1.0, gamma=1.0)
    assert si.BoucWen(alpha=value, **oscillator).content_hash == si.BoucWen(alpha=0.25, **oscillator).content_hash


@pytest.mark.parametrize("value", [np.int64(40), np.uint8(40), np.array(40)], ids=lambda value: type(value).__name__)
def test_whole_numbers_of_other_libraries_are_whole_numbers(value):
    assert type(real_number("x", value)) is int
    assert si.SMC(particles=value) == si.SMC(particles=40)
    assert si.AIES(walkers=value) == si.AIES(walkers=40)


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3],
        (1.0, 2.0, 3.0),
        np.array([1, 2, 3], dtype=object),
        np.array([1, 2, 3], dtype=np.float16),
        np.ma.masked_array([1.0, 2.0, 3.0]),
        np.array([1.0, 2.0, 3.0], dtype=complex),
        pandas.Series([1, 2, 3], dtype="Int64"),
        [Fraction(1), Fraction(2), 3],
        range(1, 4),
    ],
    ids=lambda value: type(value).__name__,
)
def test_arrays_of_other_libraries_are_arrays(value):
    array = real_array("x", value)
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(si.GroundMotion(value, 0.01).values, [1.0, 2.0, 3.0])


def test_missing_values_of_a_table_are_refused_with_their_place():
    column = pandas.Series([1.0, None, 3.0], dtype="Float64")
    with pytest.raises(InputError, match="1 values that are not finite, the first at sample 1"):
        si.GroundMotion(column, 0.01)


def test_a_mask_is_not_lost_in_what_a_solver_returns(short_record):
    def solve(theta, excitation):
        return np.ma.masked_array(np.zeros(len(excitation)), mask=np.arange(len(excitation)) == 7)

    model = si.CallableModel(solve, free=("k",), channels=("displacement",), isolated=False)
    run = model.simulate([[1.0]], short_record)
    assert not run.done[0] and "1 masked value" in run.reasons[0]
