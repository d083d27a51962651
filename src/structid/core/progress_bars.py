"""Progress bars for notebooks and scripts; the command line draws its own bars."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any

from structid.core.validation import check_arguments

if TYPE_CHECKING:
    from rich.progress import TaskID


@check_arguments
class ProgressBars:
    """Progress bars in a notebook or a terminal, to be passed as ``progress`` and used as a context manager.

    Every step that reports progress gets its own bar, with the remaining time::

        with si.ProgressBars() as bars:
            result = si.calibrate(model, space, measured, progress=bars)

    Examples
    --------
    >>> import structid as si
    >>> with si.ProgressBars() as bars:  # doctest: +SKIP
    ...     runs = si.Campaign(model, record, design).run(progress=bars("runs"))
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
        times = (MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._display = Progress(*columns, *times, TextColumn("{task.fields[failed]}"), console=Console(stderr=True))
        self._steps: dict[str, TaskID] = {}

    def __enter__(self) -> ProgressBars:
        self._display.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._display.stop()

    def __call__(self, *report: Any) -> None:
        """Show the progress that a step reports."""
        name, numbers = (report[0], report[1:]) if isinstance(report[0], str) else ("", report)
        done, total, *failed = numbers
        if name not in self._steps:
            self._steps[name] = self._display.add_task(name, total=total, failed="")
        step, words = self._steps[name], f"{failed[0]} failed" if failed and failed[0] else ""
        if done < self._display.tasks[step].completed:  # the step begins again, in the next round
            self._display.reset(step, total=total)
        self._display.update(step, completed=done, total=total, failed=words)
