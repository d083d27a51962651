"""Durations and progress bars of the stages of a study."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from structid.core.journal import write_then_rename
from structid.core.progress import Progress

Stage = Callable[[str], Any]
"""Function that opens a progress bar for a stage: it returns a context manager that yields a `Progress`."""


@contextmanager
def silent(_: str) -> Iterator[Progress | None]:
    """Run a stage without a progress bar."""
    yield None


class Timings:
    """Durations of all stages, stored on disk: a stage that is read from disk keeps the duration of its computation."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.seconds: dict[str, float] = json.loads(path.read_text()) if path.is_file() else {}

    def put(self, name: str, seconds: float) -> None:
        """Store the duration of a stage."""
        self.seconds[name] = seconds
        write_then_rename(self.path, json.dumps(self.seconds, indent=2).encode())

    @contextmanager
    def measured(self, name: str, goes_on: bool = False, once: bool = False) -> Iterator[None]:
        """Measure and store the duration of a stage."""
        before = self.seconds.get(name, 0.0)
        began = time.perf_counter()
        yield
        if not (once and before):
            self.put(name, (before if goes_on else 0.0) + time.perf_counter() - began)


class StepProgress:
    """Callback that opens a progress bar for each step of a calibration, and adds up the durations of the steps."""

    def __init__(self, stage: Stage, timings: Timings) -> None:
        self._stage, self._timings, self._doing = stage, timings, ""
        self._open, self._bar = ExitStack(), None

    def __enter__(self) -> StepProgress:
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def __call__(self, what: str, done: int, total: int) -> None:
        """Show the progress of a step."""
        if what != self._doing:
            self._open.close()
            self._doing = what
            self._bar = self._open.enter_context(self._stage(what))
            self._open.enter_context(self._timings.measured(what, goes_on=True))
        if self._bar is not None:
            self._bar(done, total)
