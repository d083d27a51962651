"""Test that every damaged record or study file gives a result or one clear error message.

Run with ``python benchmarks/fuzzing.py [--minutes 60] [--seed 0]``. Files that crash are kept under ``build/fuzzing``. Records
come from ``../shared/data``, studies from the package. The expected error is an `InputError` or another `StructidError` of one
paragraph. Any other exception is a failure, as is a file that takes more than ten seconds.
"""

from __future__ import annotations

import argparse
import collections
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import common
import numpy as np

import structid as si
from structid.core.errors import StructidError
from structid.study.plausibility import plausibility
from structid.study.run import load

NAME = "fuzzing"
FOLDER = common.ROOT / "build" / "fuzzing"
SECONDS = 10
"""Largest CPU time of a file [s]."""
CHECKED = 0.02
"""Fraction of the accepted studies whose model is also simulated, as in `structid check`."""
WORDS = [
    "NPTS=",
    "DT=",
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "1e-308",
    "99999999999",
    "\x00",
    "\ufeff",
    "é",
    '"',
    "'''",
    "[[",
    "]]",
    "{",
    "}",
    "=",
    "\r",
    "\t",
    "g",
    "cm/s^2",
    "VELOCITY",
    "1.0D+03",
    "1,5",
    ";",
    "true",
    "2024-01-01",
    "#",
    "\\u0000",
    "\\x",
    "[discrepancy]",
]


def mutated(rng: np.random.Generator, text: bytes) -> bytes:
    """Apply one or more random changes: replaced bytes, inserted words, deleted, repeated or copied pieces, changed numbers."""
    for _ in range(int(rng.geometric(0.5))):
        # Damage to the header reveals more than damage among ten thousand numbers.
        end = len(text) if rng.random() < 0.5 else min(len(text), 400)
        at = int(rng.integers(end + 1))
        length = int(rng.geometric(0.05))
        kind = int(rng.integers(7))
        piece = text[at : at + length]
        if kind == 0 and piece:
            text = text[:at] + bytes([rng.integers(256)]) + text[at + 1 :]
        elif kind == 1:
            text = text[:at] + WORDS[int(rng.integers(len(WORDS)))].encode() + text[at:]
        elif kind == 2:
            text = text[:at] + text[at + length :]
        elif kind == 3:
            text = text[:at] + piece * int(rng.integers(1, 20)) + text[at:]
        elif kind == 4:
            other = int(rng.integers(len(text) + 1))
            text = text[:other] + piece + text[other:]
        elif kind == 5:
            lines = text.split(b"\n")
            rng.shuffle(lines[: int(rng.integers(1, len(lines) + 1))])
            drop = int(rng.integers(len(lines)))
            text = b"\n".join(lines[:drop] + lines[drop + 1 :])
        else:
            digits = [i for i, byte in enumerate(text[:end]) if 48 <= byte <= 57]
            if digits:
                where = digits[int(rng.integers(len(digits)))]
                text = (
                    text[:where] + str(int(rng.integers(10 ** int(rng.integers(1, 12))))).encode() + text[where + 1 :]
                )
    return text


def record(path: Path, rng: np.random.Generator) -> None:
    """Read a record file, and filter the record."""
    si.GroundMotion.read(path).lowpass(10.0)


def study(path: Path, rng: np.random.Generator) -> None:
    """Load a study, and sometimes check it."""
    loaded = load(path)
    if rng.random() < CHECKED:
        plausibility(loaded)


def outcome(read: Callable[[Path, np.random.Generator], None], path: Path, rng: np.random.Generator) -> str:
    """Return the outcome of reading a file: accepted, refused, or the name of the exception."""

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {SECONDS} s of CPU time")

    # CPU time, not elapsed time, since other work on the machine must not count.
    signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read(path, rng)
    except StructidError as refusal:
        return "refused" if str(refusal).strip() else "refused without a message"
    except Exception as error:
        (path.with_suffix(path.suffix + ".traceback")).write_text(traceback.format_exc())
        return type(error).__name__
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return "accepted"


def sources() -> dict[str, tuple[Callable[[Path, np.random.Generator], None], list[bytes]]]:
    """Reader and undamaged contents of each kind of file, by file name."""
    records = sorted((common.ROOT.parent / "shared" / "data" / "strong_motion").rglob("*.AT2"))
    studies = sorted((common.ROOT / "src").rglob("*.toml"))
    return {
        "record.AT2": (record, [p.read_bytes() for p in records]),
        "study.toml": (study, [p.read_bytes() for p in studies]),
    }


def main() -> None:
    """Damage and read files until the time is over, and print the number of each outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="six seconds; checks that the script works")
    given = parser.parse_args()
    minutes = 0.1 if given.quick else given.minutes
    FOLDER.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(given.seed)
    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    end = time.monotonic() + 60.0 * minutes
    while time.monotonic() < end:
        for name, (read, good) in sources().items():
            path = FOLDER / name
            for _ in range(20 if given.quick else 200):
                path.write_bytes(mutated(rng, good[int(rng.integers(len(good)))]))
                found = outcome(read, path, rng)
                counts[name, found] += 1
                if found not in ("accepted", "refused"):
                    kept = FOLDER / f"{found}_{counts[name, found]}_{name}"
                    path.replace(kept)
                    path.with_suffix(path.suffix + ".traceback").replace(kept.with_suffix(kept.suffix + ".traceback"))
        print({" ".join(key): count for key, count in sorted(counts.items())}, flush=True)
    finds = {" ".join(key): count for key, count in counts.items()}
    common.record_result(NAME, quick=minutes < 60.0, minutes=minutes, seed=given.seed, counts=finds)
    sys.exit(any(outcome not in ("accepted", "refused") for _, outcome in counts))


if __name__ == "__main__":
    main()
