"""Progress of long computations: the callback type, and stages combined into one count."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Progress = Callable[[int, int], None]
"""Called with the number of finished steps and their total."""


class Stages:
    """Combines the progress of stages of different weight into percent of the whole."""

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
        """Report a stage as finished, however many of its steps it took."""
        self.of(stage)(1, 1)


class Steps:
    """Counts steps; each call counts one."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one more step."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
