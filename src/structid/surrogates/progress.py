"""How far a fit is, told as one count although it has several stages."""

from __future__ import annotations

from collections.abc import Mapping

from structid.models.face import Progress


class Stages:
    """Progress of work in stages of different weight, told in hundredths of the whole.

    Parameters
    ----------
    progress : callable or None
        Told how many hundredths are done, and of a hundred.
    weights : mapping of str to float
        The stages in order, and the share of the time each takes.
    """

    def __init__(self, progress: Progress | None, weights: Mapping[str, float]) -> None:
        self._progress, self._weights = progress, dict(weights)

    def of(self, stage: str) -> Progress:
        """Give what a stage tells its own progress.

        Parameters
        ----------
        stage : str
            Its name.

        Returns
        -------
        callable
            Takes what is done, and of how many.
        """
        whole = sum(self._weights.values())
        names = list(self._weights)
        before = sum(self._weights[n] for n in names[: names.index(stage)])

        def tell(done: int, total: int) -> None:
            if self._progress is not None:
                self._progress(int(100 * (before + self._weights[stage] * done / total) / whole + 1e-9), 100)

        return tell

    def done(self, stage: str) -> None:
        """Say that a stage has ended, however many of its steps it took.

        Parameters
        ----------
        stage : str
            Its name.
        """
        self.of(stage)(1, 1)


class Steps:
    """Counts steps; calling it is one more.

    Parameters
    ----------
    progress : callable or None
        Told how many are done, and of how many.
    total : int
        How many there are.
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one step more."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
