"""The words of a failed run: put together where it fails, shortened and counted where it is shown."""

from __future__ import annotations

import re

_LAST_SAID = "; it last said: "
_PLACE = re.compile(r" \[kept: [^\]]*\]")
_NUMBER = re.compile(
    r"(?<!within )(?<![\w.])[-+]?(?:\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?!\w)|(?<=returned )\d+|(?<=from )\d+(?= s on)"
)


def with_words(how: str, words: str) -> str:
    """Say how a run ended, and what its solver said last.

    Parameters
    ----------
    how : str
        ``"exit code 3"``.
    words : str
        What it said; nothing is added where it said nothing.

    Returns
    -------
    str
        ``"exit code 3; it last said: matrix is singular"``.
    """
    return f"{how}{_LAST_SAID}{words}" if words and _LAST_SAID not in how else how


def general_reason(reason: str) -> str:
    """Make reasons that differ in their numbers and places alike, so that they can be counted.

    Parameters
    ----------
    reason : str
        ``"not finite from 3.41 s on"``.

    Returns
    -------
    str
        ``"not finite from … s on"``, one line.
    """
    return _NUMBER.sub("…", short_reason(_PLACE.sub("", reason)))


def short_reason(reason: str) -> str:
    """Put a reason on one line: how the run ended, and the last line the solver said.

    Parameters
    ----------
    reason : str
        Up to a page of it.

    Returns
    -------
    str
        One line.
    """
    place = _PLACE.search(reason)
    how, said, words = _PLACE.sub("", reason).partition(_LAST_SAID)
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    text = how.split("\n")[0] + (said + lines[-1] if lines else "")
    return (text if len(text) <= 160 else text[:159] + "…") + (place.group() if place else "")
