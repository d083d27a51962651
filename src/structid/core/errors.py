"""Exceptions and warnings of the package, and the status of a model run."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum


class StructidError(Exception):
    """Base class of every error that structid raises on purpose.

    Examples
    --------
    >>> import structid as si
    >>> try:
    ...     si.Uniform(2.0, 1.0)
    ... except si.StructidError as problem:
    ...     print(type(problem).__name__)
    InputError
    """


class InputError(StructidError, ValueError):
    """Invalid input from the caller. The message states the fault, the expected input and the remedy.

    Parameters
    ----------
    where : str
        The file, key, line or argument at fault.
    came : str
        Short phrase that states the fault or the given value.
    allowed : str
        Noun phrase for the expected input.
    cure : str, optional
        Remedy, as a full sentence.

    Examples
    --------
    >>> import structid as si
    >>> try:
    ...     si.Uniform(2.0, 1.0)
    ... except si.InputError as refusal:
    ...     print(str(refusal).startswith("Uniform"))
    True
    """

    def __init__(self, where: str, came: str, allowed: str, cure: str = "") -> None:
        self.where, self.came, self.allowed, self.cure = where, came, allowed, cure
        super().__init__(f"{where}: {came}. Expected: {allowed}.{' ' + cure if cure else ''}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        return (type(self), (self.where, self.came, self.allowed, self.cure))


@contextmanager
def undamaged(path: object, content: str) -> Iterator[None]:
    """Turn a read error into a message that names the damaged file and its content."""
    try:
        yield
    except StructidError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, IndexError, OverflowError) as cause:
        raise InputError(
            f"{path}",
            f"it is damaged, or structid did not write it ({type(cause).__name__}: {cause})",
            f"an undamaged file with {content}",
            "Restore it from a copy, or remove it: structid then computes its content again.",
        ) from cause


@contextmanager
def within(where: str) -> Iterator[None]:
    """Prefix an error message with the location in the user's file."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.came, error.allowed, error.cure) from None


class StoreMismatchError(InputError):
    """A store on disk belongs to another study. The store is refused and left unchanged."""


class StoreError(StructidError):
    """A store on disk cannot be written. Its contents are safe, and the message says how to continue."""


class CampaignStoppedError(StructidError):
    """A campaign stopped for a reason outside a single run. Finished runs are stored."""


class ConvergenceError(StructidError):
    """A numerical procedure failed to converge on valid input."""


class StructidWarning(UserWarning):
    """Base class of structid's warnings. Like any warning, it can be silenced or turned into an error.

    Examples
    --------
    >>> import structid as si
    >>> import warnings
    >>> warnings.simplefilter("error", si.StructidWarning)  # doctest: +SKIP
    """


class UnlikeMeasuredWarning(StructidWarning):
    """Model runs differ from the measurement so much that a unit, a sign or the time base is probably wrong."""


class Status(IntEnum):
    """How a run of a model ended.

    A failed run (diverged, failed, timed out) contains no information about the structure. Fits omit such runs, which
    may be repeated. A run in which the structure failed (it collapsed or passed a limit) is data: the same run would
    end in the same way.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> model = si.BoucWen(mass=12e3, stiffness=7.4e6, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0)
    >>> histories = model.simulate(np.empty((1, 0)), si.GroundMotion.synthetic(seed=7))
    >>> bool(histories.status[0] == si.Status.DONE)
    True
    """

    DONE = 0
    DIVERGED = 1
    FAILED = 2
    TIMED_OUT = 3
    PENDING = 4
    STRUCTURE_FAILED = 5

    @property
    def words(self) -> str:
        """The status in words, such as ``"timed out"``."""
        return self.name.lower().replace("_", " ")

    @property
    def run_failed(self) -> bool:
        """Whether the run itself failed, so that it contains no information and may be repeated."""
        return self in (Status.DIVERGED, Status.FAILED, Status.TIMED_OUT)


ABBREVIATIONS = {
    "lhs": "latin_hypercube",
    "qmc": "sobol",
    "sdof": "bouc_wen",
    "mdof": "shear_frame",
    "gp": "pod_kriging",
    "kriging": "pod_kriging",
    "pce": "pod_pce",
    "hmc": "nuts",
    "emcee": "aies",
    "tmcmc": "smc",
}
"""Common abbreviations, and their full names in this package."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the known name closest to a misspelt one."""
    names = list(known)
    meant = ABBREVIATIONS.get(name.lower())
    close = [meant] if meant in names else difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'?" if close else ""


def fixed_and_free(where: str, what: str = "the parameter") -> InputError:
    """Return the error for a parameter that has a value and is free as well."""
    return InputError(
        where,
        f"{what} has a value and is also free",
        "a value, or the name of the parameter in the argument free",
        "Remove one.",
    )


def check_choice(where: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is allowed; otherwise raise an error that suggests the closest allowed value."""
    names = list(allowed)
    if value not in names:
        raise InputError(where, f"'{value}'", ", ".join(f"'{n}'" for n in names), suggestion(str(value), names))
    return value
