"""A programme of hybrid tests on one specimen, which keeps its damage from test to test."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from structid.core.errors import InputError
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.hybrid.experiment import NEVER_RESUMED, HybridTest
from structid.hybrid.feasibility import Feasibility
from structid.hybrid.hybrid_result import HybridResult
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.hybrid.recording.result_file import open_hybrid
from structid.observation import Observation

Watching = Callable[[str, HybridTest], None]
"""Callback that receives the name of a test and the test before it starts."""

PREFIX, SUFFIX = "test_", ".h5"
"""Prefix and suffix of the file name of a store."""


def store_of(folder: Path, name: str) -> Path:
    """Return the path of the store of a test."""
    return folder / f"{PREFIX}{name}{SUFFIX}"


def tests_in(folder: Path, ending: str = "") -> list[str]:
    """Return the names of the tests that have a store in a folder, oldest first."""
    stores = sorted(folder.glob(f"{PREFIX}*{SUFFIX}{ending}"), key=lambda path: path.stat().st_mtime)
    return [path.name.removeprefix(PREFIX).removesuffix(f"{SUFFIX}{ending}") for path in stores]


@dataclass(frozen=True, eq=False)
class ProgrammeResult(ShownAsText):
    """Result of a programme of hybrid tests.

    Parameters
    ----------
    tests : dict of str to HybridResult
        Results of the tests that were started, in order.
    planned : tuple of str
        Names of all planned tests.
    not_released : str
        Reason why the specimen could not be released after the last of these tests; empty if there is none.

    Examples
    --------
    >>> import structid as si
    >>> result = programme.run("tests")  # doctest: +SKIP
    >>> result["2"].moves.measured.max()  # doctest: +SKIP
    """

    tests: dict[str, HybridResult]
    planned: tuple[str, ...]
    not_released: str = ""

    @property
    def finished(self) -> bool:
        """True if all tests were completed."""
        return len(self.tests) == len(self.planned) and all(test.finished for test in self.tests.values())

    @property
    def ended_by(self) -> str:
        """Reason for an early end, with the name of the test; empty for a completed programme."""
        for name, test in self.tests.items():
            if not test.finished:
                event = test.events[-1] if test.events else None
                return f"Test {name} ended" + (f" at {event.time:.3f} s: {event.what}" if event else ".")
        return f"The programme ended after test {name}: {self.not_released}" if self.not_released else ""

    @check_arguments
    def observation(
        self, name: str, channels: tuple[str, ...] = (), sd: float | Sequence[float] | np.ndarray | None = None
    ) -> Observation:
        """Observation of the specimen from a test and all earlier tests; see `HybridResult.observation`.

        Parameters
        ----------
        name : str
            Name of the last test.
        channels : tuple of str
            Names of the forces.
        sd : float or sequence of float, optional
            Known standard deviation of the forces [N, N·m]: one value for all channels, or one value per channel.

        Returns
        -------
        Observation
            Forces at the measured displacements.
        """
        before = self._before(name)
        return self.tests[name].observation(channels, before=before, sd=sd)

    @check_arguments
    def way_to(self, name: str) -> np.ndarray:
        """Measured displacements of the specimen in all earlier tests; input for `VirtualHybridTest.way`.

        Parameters
        ----------
        name : str
            Name of the test.

        Returns
        -------
        ndarray, shape (place, channel)
            Displacements relative to the first zero; the last row is the zero of the test.
        """
        places = [test.datum + test.moves.measured for test in self._before(name)]
        return np.concatenate([*places, self.tests[name].datum[None]])

    def _before(self, name: str) -> list[HybridResult]:
        if name not in self.tests:
            raise InputError("ProgrammeResult", f"no test '{name}'", ", ".join(self.tests) or "a started test")
        return [self.tests[other] for other in list(self.tests)[: list(self.tests).index(name)]]

    def __str__(self) -> str:
        lines = [f"{name}: {test}" for name, test in self.tests.items()]
        return "\n".join([*lines, "The programme is finished." if self.finished else self.ended_by])


@check_arguments
@dataclass(frozen=True, eq=False)
class Programme:
    """A programme of hybrid tests.

    Between two tests, the operator unloads the specimen and resets its zero; a simulated specimen does both by itself.

    Parameters
    ----------
    tests : mapping of str to HybridTest
        Tests by name, in order. All tests use the specimen of the first test.

    Examples
    --------
    >>> import structid as si
    >>> frame = si.ShearFrame(storeys=2, mass=12e3, stiffness=7.6e6, alpha=0.05, beta=63.0, gamma=63.0, damping_ratio=0.03)
    >>> upper, lower = si.cut_frame(frame, 1)
    >>> record, specimen = si.GroundMotion.synthetic(seed=7), si.SimulatedSpecimen(lower.force)
    >>> test = si.HybridTest(upper, specimen, record, dt=0.01, time_scale=100.0, physical=lower)
    >>> programme = si.Programme({"weak": test, "again": test})
    >>> tuple(programme.tests)
    ('weak', 'again')
    """

    tests: Mapping[str, HybridTest]

    def __post_init__(self) -> None:
        if not self.tests:
            raise InputError("Programme.tests", "no test", "one or more tests, by name")
        for name in self.tests:
            if not name.replace("_", "").replace("-", "").isalnum():
                raise InputError("Programme.tests", f"the name '{name}'", "a name of letters, digits, - and _")

    def check(self) -> dict[str, Feasibility]:
        """Check every test on the undamaged specimen; nothing moves.

        Returns
        -------
        dict of str to Feasibility
            Feasibility of each test, by name; see `HybridTest.check`.
        """
        return {name: test.check() for name, test in self.tests.items()}

    def run(
        self, folder: str | os.PathLike[str] | None = None, *, resume: bool = False, watching: Watching | None = None
    ) -> ProgrammeResult:
        """Run the tests in order; a test that ends early ends the programme.

        Parameters
        ----------
        folder : path-like, optional
            Folder for the stores of the tests.
        resume : bool
            Whether to continue the programme in the folder. A simulated specimen repeats all stored tests; the results
            must be equal. On a structure, stored tests are kept and the next test starts; the operator must have
            released the specimen.
        watching : callable, optional
            Called with the name of a test and the test before it starts.

        Returns
        -------
        ProgrammeResult
            Results of all tests that were started.

        Raises
        ------
        InputError
            If a test is infeasible; nothing has moved then. If the folder already contains a programme, or if an unfinished test
            on a structure is to be resumed.
        """
        for name, result in self.check().items():
            if not result.can_work:
                raise InputError(f"test {name}", " ".join(result.refusals).removesuffix("."), "a feasible test")
        stores = {name: None if folder is None else store_of(Path(folder), name) for name in self.tests}
        if not resume:
            for store in stores.values():
                if store is not None and store.exists():
                    raise InputError(f"{folder}", f"{store.name} already exists", "a new folder, or resume=True")
        specimen, has_moved = next(iter(self.tests.values())).specimen, False
        results: dict[str, HybridResult] = {}
        for name, planned in self.tests.items():
            stored = _stored(stores[name]) if resume else None
            if stored is not None and not stored.description.simulated:
                results[name] = _finished(stored, stores[name])
                continue
            try:
                test = replace(planned, specimen=specimen.released() if has_moved else specimen)
            except SpecimenError as error:
                return ProgrammeResult(results, tuple(self.tests), str(error))
            if watching is not None:
                watching(name, test)
            results[name], has_moved = _run(test, stores[name], resume, stored), True
            specimen = test.specimen
            specimen.close()
            if not results[name].finished:
                break
        return ProgrammeResult(results, tuple(self.tests))


def _stored(store: Path | None) -> HybridResult | None:
    """Return the stored result of a test, or None if there is no store."""
    return open_hybrid(store) if store is not None and store.exists() else None


def _finished(stored: HybridResult, store: Path | None) -> HybridResult:
    """Return the stored result of a test on a structure unchanged; refuse an unfinished test."""
    if not stored.finished:
        raise InputError(
            f"{store}",
            "an unfinished test on a structure",
            "a finished test",
            f"{NEVER_RESUMED} Start a new programme with the remaining tests.",
        )
    return stored


def _run(test: HybridTest, store: Path | None, resume: bool, stored: HybridResult | None) -> HybridResult:
    """Run a test, or repeat a stored test and compare the results."""
    if stored is None:
        return test.run(store, resume=resume)
    again = test.run()
    same = again.steps == stored.steps and np.array_equal(again.moves.measured, stored.moves.measured)
    if not same:
        raise InputError(f"{store}", "the repeated test differs", "the same test, with a specimen in its initial state")
    return stored
