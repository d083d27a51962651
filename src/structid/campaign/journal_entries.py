"""Entries of a campaign's journals: the design with the common data of all runs, and completed runs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.campaign.run_file import Header, Row, record_from_plain
from structid.campaign.runs import StoredInMemory
from structid.core.errors import InputError
from structid.core.journal import Journal
from structid.models.external.protocol import Outcome
from structid.probability.space import ParameterSpace


@dataclass(frozen=True)
class Finished:
    """A completed run to be stored."""

    key: str  # identifies point and record
    outcome: Outcome  # its outcome
    attempts: int  # number of attempts


def design_entry(
    header: Header,
    keys: Sequence[str],
    theta: Float[np.ndarray, "run parameter"],
    record_of_run: Int[np.ndarray, " run"],
) -> dict[str, np.ndarray]:
    """Make the journal entry of a design; it contains all common data, so the journals can be read without other files."""
    shared = {
        "space": header.space.to_plain(),
        "records": [r.to_plain() for r in header.records],
        "samples": [len(r) for r in header.records],
        "channels": header.channels,
    }
    return {
        "key": np.array(keys, dtype="S16"),
        "theta": theta,
        "record_of_run": record_of_run,
        "excitation": np.concatenate([r.values for r in header.records]),
        "told": np.array(json.dumps(shared)),
    }


def read_design(journal: Journal, path: Path) -> tuple[Header, list[str], np.ndarray, np.ndarray]:
    """Read the newest design of a journal."""
    entries = list(journal)
    if not entries:
        raise InputError(
            f"{path}",
            "the campaign stopped before its first run",
            "a store with runs",
            "Run the campaign again.",
        )
    entry = entries[-1]  # each extension of the design adds an entry
    shared = json.loads(str(entry["told"]))
    ends = np.cumsum(shared["samples"])
    parts = np.split(entry["excitation"], ends[:-1])
    records = tuple(record_from_plain(p, v) for p, v in zip(shared["records"], parts, strict=True))
    header = Header(journal.identity, ParameterSpace.from_plain(shared["space"]), records, tuple(shared["channels"]))
    return header, [k.decode() for k in entry["key"]], entry["theta"], entry["record_of_run"].astype(int)


def runs_entry(finished: Sequence[Finished], header: Header) -> dict[str, np.ndarray]:
    """Make the journal entry of completed runs: one string and one array, because more arrays have a large overhead."""
    values = np.full((len(finished), header.samples, len(header.channels)), np.nan)
    ended = []
    for row, run in zip(values, finished, strict=True):
        o = run.outcome
        row[: len(o.values)] = o.values
        reason = printable(o.reason)
        ended.append([run.key, int(o.status), reason, o.failure_time, o.seconds, run.attempts, time.time()])
    return {"told": np.array(json.dumps(ended)), "values": values}


def rows_of(entry: dict[str, np.ndarray], source: Any) -> dict[str, Row]:
    """Turn a journal entry into rows."""
    rows = {}
    for position, run in enumerate(json.loads(str(entry["told"]))):
        key, status, reason, failure_time, seconds, attempts, finished = run
        rows[key] = Row(key, status, reason, failure_time, seconds, attempts, finished, source, position)
    return rows


def journalled_rows(journal: Journal) -> Iterator[dict[str, Row]]:
    """Read the runs in each entry of a journal, with their histories in memory."""
    for entry in journal:
        yield rows_of(entry, StoredInMemory(entry["values"]))


def printable(text: str) -> str:
    """Replace characters in a solver's output that a file format may reject."""
    return "".join(c if c.isprintable() or c in "\n\t" else "�" for c in text)
