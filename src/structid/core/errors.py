"""Exceptions that say what to do, and the status of a run."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum


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
    """Say of a file that cannot be read what it was, and what is lost with it."""
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


@contextmanager
def within(where: str) -> Iterator[None]:
    """Say in a refusal where in the user's file the cause stands."""
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
"""What is meant by abbreviations of the field that are unlike the names here."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Say which known name is nearest to a wrong one."""
    names = list(known)
    meant = ABBREVIATIONS.get(name.lower())
    close = [meant] if meant in names else difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'?" if close else ""


def check_choice(where: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of `allowed`, else raise with the nearest allowed one."""
    names = list(allowed)
    if value not in names:
        raise InputError(where, f"'{value}'", ", ".join(f"'{n}'" for n in names), suggestion(str(value), names))
    return value
