"""Reasons why runs failed: how they are composed, shortened and counted."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_LAST_SAID = "; it last said: "
_PLACE = re.compile(r" \[kept: [^\]]*\]")
_NUMBER = re.compile(
    r"(?<!within )(?<![\w.])[-+]?(?:\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?!\w)|(?<=returned )\d+|(?<=from )\d+(?= s on)"
)


_FAREWELL = re.compile(r"Process \d+ Terminating")
"""Last line that OpenSees always prints."""
LINES_SHOWN, LONGEST = 3, 200
"""Maximum number of solver lines in a one-line reason, and maximum length of the reason."""
SHOWN = 10
"""Largest number of reasons in a list."""


def counted_reasons(failures: Sequence[tuple[str, int]]) -> list[str]:
    """List reasons with their counts, most frequent first, and count the reasons that are not shown."""
    lines = [f"  {count:6d} x {reason}" for reason, count in failures[:SHOWN]]
    runs = sum(count for _, count in failures[SHOWN:])
    if runs:
        lines.append(
            f"  {runs:6d} runs, for {len(failures) - SHOWN} more reasons: see .failures, or structid runs --failed"
        )
    return lines


def grouped_reasons(reasons: Iterable[str]) -> list[tuple[str, int]]:
    """Count the reasons; reasons that differ only in numbers and paths count as equal."""
    groups: dict[str, list[str]] = {}
    for reason in filter(None, reasons):
        plain = _without_place(reason)
        groups.setdefault(_NUMBER.sub("…", plain), []).append(plain)
    counted = [(same[0] if len(set(same)) == 1 else general, len(same)) for general, same in groups.items()]
    return sorted(counted, key=lambda one: -one[1])


def with_words(how: str, words: str) -> str:
    """Append the last output of the solver to the reason why a run ended."""
    return f"{how}{_LAST_SAID}{words}" if words and _LAST_SAID not in how else how


def general_reason(reason: str) -> str:
    """Remove numbers and paths from a reason, so that similar reasons count as equal."""
    return _NUMBER.sub("…", _without_place(reason))


def _without_place(reason: str) -> str:
    """Reduce a reason to one line, without the path of the run folder that was kept."""
    return short_reason(_PLACE.sub("", reason))


def short_reason(reason: str) -> str:
    """Shorten a reason to one line: why the run ended, and at most the last three lines of solver output."""
    folder = _PLACE.search(reason)
    how, label, words = _PLACE.sub("", reason).partition(_LAST_SAID)
    lines = [line.strip() for line in words.splitlines() if line.strip() and not _FAREWELL.fullmatch(line.strip())]
    lines = lines[-LINES_SHOWN:]
    while len(lines) > 1 and len(how) + len(" | ".join(lines)) > LONGEST:
        lines = lines[1:]
    text = how.split("\n")[0] + (label + " | ".join(lines) if lines else "")
    return (text if len(text) <= LONGEST else text[: LONGEST - 1] + "…") + (folder.group() if folder else "")
