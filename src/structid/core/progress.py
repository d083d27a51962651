"""Progress of long computations: the type of the callback, and stages combined into one percentage."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Progress = Callable[[int, int], None]
"""Callback whose arguments are the number of finished steps and the total number."""


class Stages:
    """Weighted progress of several stages, as a percentage of the total."""

    def __init__(self, progress: Progress | None, weights: Mapping[str, float]) -> None:
        self._progress, self._weights = progress, dict(weights)

    def of(self, stage: str) -> Progress:
        """Return the callback for the progress of one stage."""
        whole = sum(self._weights.values())
        names = list(self._weights)
        before = sum(self._weights[n] for n in names[: names.index(stage)])

        def report(done: int, total: int) -> None:
            if self._progress is not None:
                self._progress(int(100 * (before + self._weights[stage] * done / total) / whole + 1e-9), 100)

        return report

    def done(self, stage: str) -> None:
        """Report a stage as finished, even if it did not need all its steps."""
        self.of(stage)(1, 1)


class Steps:
    """A counter of steps; each call counts one step."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one step and report the progress."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
