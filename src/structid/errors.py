"""Exceptions that say what to do, and the status of a run."""

from __future__ import annotations

import difflib
import functools
import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, TypeVar, cast


class StructidError(Exception):
    """Base of every error structid raises on purpose."""


class InputError(StructidError, ValueError):
    """Something the caller gave is wrong; the message says what came, what is allowed and what to do.

    Parameters
    ----------
    where : str
        The file, key, line or argument at fault.
    came : str
        What was found there.
    allowed : str
        What may stand there.
    cure : str, optional
        What to do about it, as a full sentence.
    """

    def __init__(self, where: str, came: str, allowed: str, cure: str = "") -> None:
        self.where, self.came, self.allowed, self.cure = where, came, allowed, cure
        super().__init__(f"{where}: {came}. Allowed: {allowed}.{' ' + cure if cure else ''}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        return (type(self), (self.where, self.came, self.allowed, self.cure))


@contextmanager
def undamaged(path: object, content: str) -> Iterator[None]:
    """Say of a file that cannot be read what it was, and what is lost with it.

    Parameters
    ----------
    path : object
        The file.
    content : str
        What it holds.

    Yields
    ------
    None
        While it is read.

    Raises
    ------
    InputError
        If reading fails in a way that only a damaged file explains.
    """
    try:
        yield
    except StructidError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, IndexError, OverflowError) as cause:
        raise InputError(
            f"{path}",
            f"it is damaged, or no file of structid ({type(cause).__name__}: {cause})",
            f"a file with {content}, as it was written",
            "Take it from a copy. Or remove it: what it holds is then done again.",
        ) from cause


T = TypeVar("T", bound=Callable[..., Any])


NUMBERS = {"float", "int", "None"}
"""Annotations in whose place a text is a mistake."""


KINDS = {
    "ParameterSpace": ("marginals", "a structid.ParameterSpace"),
    "Model": ("simulate", "a model such as structid.BoucWen or structid.CallableModel"),
    "Target": ("log_density", "a structid.Posterior or structid.LogDensity"),
    "Posterior": ("observations", "a structid.Posterior"),
    "Excitation": ("duration", "a structid.GroundMotion, ForceHistory or DisplacementHistory"),
    "Observation": ("check_new", "a structid.Observation"),
    "ErrorLaw": ("added", "a law of errors such as structid.AR1()"),
    "Sampler": ("ensembles", "a sampler such as structid.SMC()"),
    "SurrogateSettings": ("fit", "settings of a surrogate such as structid.PODKriging()"),
}
"""Annotations, something that everything of that kind has, and what to give."""


def names_checked(what: T) -> T:
    """Make a class or function refuse arguments that it does not know, and values of another kind, by a sentence.

    Parameters
    ----------
    what : callable
        A function; or a class, whose ``__init__`` and public methods are wrapped.

    Returns
    -------
    callable
        The wrapped function, or the same class.
    """
    if not isinstance(what, type):
        return cast(T, _checked(what, what.__qualname__))
    setattr(what, "__init__", _checked(getattr(what, "__init__"), what.__qualname__))  # noqa: B009, B010, as mypy wants it
    for name, method in vars(what).copy().items():
        if not name.startswith("_") and isinstance(method, (classmethod, staticmethod)):
            setattr(what, name, type(method)(_checked(method.__func__, method.__func__.__qualname__)))
        elif not name.startswith("_") and inspect.isfunction(method):
            setattr(what, name, _checked(method, method.__qualname__))
    return what


def _checked(function: Callable[..., Any], called: str) -> Callable[..., Any]:
    every = inspect.signature(function).parameters
    parameters = {name: p for name, p in every.items() if name not in ("self", "cls")}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    known = [name for name in parameters if not name.startswith("_")]
    numbers = {n for n, p in parameters.items() if set(re.split(r"\s*\|\s*", str(p.annotation))) <= NUMBERS}
    kinds = {n: found for n, p in parameters.items() if (found := _kinds(str(p.annotation)))}
    in_order = tuple(every)
    needed = [
        name
        for name, p in parameters.items()
        if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]

    @functools.wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        for name in named:
            if not open_ended and name not in parameters:
                cure = suggestion(name, known)
                raise InputError(
                    f"{called}({name})", "an argument that it does not have", ", ".join(known) or "none", cure
                )
        missing = [name for name in needed if name not in in_order[: len(arguments)] and name not in named]
        if missing:
            wanted = f"{called}({', '.join(needed)}, …)"
            raise InputError(called, f"{' and '.join(missing)} left out", wanted, f"See help({called}).")
        for name, value in (*zip(in_order, arguments, strict=False), *named.items()):
            if isinstance(value, str) and name in numbers:
                cure = f"Write it without quotes. help({called}) says in which unit."
                raise InputError(f"{called}({name})", f"the text '{value}'", "a number", cure)
            if name in kinds and value is not None:
                _refuse_another_kind(f"{called}({name})", value, *kinds[name])
        return function(*arguments, **named)

    return checked


def _kinds(annotation: str) -> tuple[list[str], bool] | None:
    """Kinds that an argument may be of, and whether several may come; None if it may be something else, too."""
    words = [word for word in re.split(r"\s*\|\s*", annotation) if word != "None"]
    single = [re.sub(r"^Sequence\[(\w+)\]$", r"\1", word) for word in words]
    return (single, single != words) if single and set(single) <= KINDS.keys() else None


def _refuse_another_kind(where: str, value: Any, kinds: list[str], several: bool) -> None:
    for one in value if several and isinstance(value, (list, tuple)) else [value]:
        if not any(hasattr(one, KINDS[kind][0]) for kind in kinds):
            raise InputError(where, _in_words(one), " or ".join(dict.fromkeys(KINDS[kind][1] for kind in kinds)))


def _in_words(value: Any) -> str:
    """What came, with an article."""
    if isinstance(value, str):
        return f"the text '{value}'"
    name = "array" if type(value).__name__ == "ndarray" else type(value).__name__
    return f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"


@contextmanager
def within(where: str) -> Iterator[None]:
    """Say in a refusal where in the user's file the cause stands.

    Parameters
    ----------
    where : str
        The table or key, which is put before the argument that was refused.

    Yields
    ------
    None
        While what may refuse is called.

    Raises
    ------
    InputError
        What was raised inside, with the place in front.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.came, error.allowed, error.cure) from None


class StoreMismatchError(InputError):
    """A store on disk belongs to another study; it is refused and left as it is."""


class StoreError(StructidError):
    """A store on disk cannot be written; what it holds is safe, and the message says how to go on."""


class CampaignStoppedError(StructidError):
    """A campaign could not go on, for a reason that is not the fault of a single run. What is finished is stored."""


class ConvergenceError(StructidError):
    """A numerical procedure could not deliver what was asked, and the cause is not the caller's input."""


class StructidWarning(UserWarning):
    """Something that the caller should know about. Like any warning, it can be silenced or turned into an error."""


class UnlikeMeasuredWarning(StructidWarning):
    """Runs of a model are not like the measurement: a unit, a sign or a clock is probably wrong."""


class Status(IntEnum):
    """What became of one run of a model.

    A run that failed (diverged, failed, timed out) says nothing about the structure. It is left out of fits, and may be tried
    again. A run in which the structure failed (it collapsed, or passed a limit) is data. Its end came before the record's, and it
    would end the same way again.
    """

    DONE = 0
    DIVERGED = 1
    FAILED = 2
    TIMED_OUT = 3
    PENDING = 4
    STRUCTURE_FAILED = 5

    @property
    def words(self) -> str:
        """In words, such as ``"timed out"``."""
        return self.name.lower().replace("_", " ")

    @property
    def run_failed(self) -> bool:
        """Whether the run says nothing about the structure, and might end differently if it were tried again."""
        return self in (Status.DIVERGED, Status.FAILED, Status.TIMED_OUT)


def suggestion(name: str, known: Iterable[str]) -> str:
    """Say which known name is nearest to a wrong one.

    Parameters
    ----------
    name : str
        The name that came.
    known : iterable of str
        The names that are allowed.

    Returns
    -------
    str
        ``"Did you mean 'stiffness'?"``, or an empty string when nothing is near.
    """
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'?" if close else ""


def check_choice(where: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of `allowed`, else raise with the nearest allowed one.

    Parameters
    ----------
    where : str
        The argument or key, for the message.
    value : str
        What came.
    allowed : iterable of str
        What may come.

    Returns
    -------
    str
        `value` itself.

    Raises
    ------
    InputError
        If `value` is none of `allowed`.
    """
    names = list(allowed)
    if value not in names:
        raise InputError(where, f"'{value}'", ", ".join(f"'{n}'" for n in names), suggestion(str(value), names))
    return value
