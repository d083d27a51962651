"""A programme of hybrid tests on one specimen, which keeps its damage."""

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
"""Called with the name of a test and the test, before it begins."""

PREFIX, SUFFIX = "test_", ".h5"
"""Prefix and suffix of a store's name."""


def store_of(folder: Path, name: str) -> Path:
    """Path of the store of a test."""
    return folder / f"{PREFIX}{name}{SUFFIX}"


def tests_in(folder: Path, ending: str = "") -> list[str]:
    """Names of the tests with a store in a folder."""
    stores = sorted(folder.glob(f"{PREFIX}*{SUFFIX}{ending}"), key=lambda path: path.stat().st_mtime)
    return [path.name.removeprefix(PREFIX).removesuffix(f"{SUFFIX}{ending}") for path in stores]


@dataclass(frozen=True, eq=False)
class ProgrammeResult(ShownAsText):
    """What a programme of hybrid tests leaves.

    Parameters
    ----------
    tests : dict of str to HybridResult
        Those that were begun, in their order.
    planned : tuple of str
        Names of all tests.
    not_released : str
        Why the specimen could not be moved again after the last of these tests; empty where it could.

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
        """Whether all tests were completed."""
        return len(self.tests) == len(self.planned) and all(test.finished for test in self.tests.values())

    @property
    def ended_by(self) -> str:
        """What ended it early, with the test; empty for a completed one."""
        for name, test in self.tests.items():
            if not test.finished:
                event = test.events[-1] if test.events else None
                return f"Test {name} ended" + (f" at {event.time:.3f} s: {event.what}" if event else ".")
        return f"The programme ended after test {name}: {self.not_released}" if self.not_released else ""

    @check_arguments
    def observation(
        self, name: str, channels: tuple[str, ...] = (), sd: float | Sequence[float] | np.ndarray | None = None
    ) -> Observation:
        """What a test and all those before it have shown of the specimen; see `HybridResult.observation`.

        Parameters
        ----------
        name : str
            The last test that is looked at.
        channels : tuple of str
            Names of the forces.
        sd : float or sequence of float, optional
            Known standard deviation of the forces [N, N·m], one for all channels or one for each.

        Returns
        -------
        Observation
            Forces against measured displacements.
        """
        before = self._before(name)
        return self.tests[name].observation(channels, before=before, sd=sd)

    @check_arguments
    def way_to(self, name: str) -> np.ndarray:
        """Where the specimen was moved to before a test, as it was measured; for `VirtualHybridTest.way`.

        Parameters
        ----------
        name : str
            The test.

        Returns
        -------
        ndarray, shape (place, channel)
            From the first zero; the last place is the zero of the test.
        """
        places = [test.datum + test.moves.measured for test in self._before(name)]
        return np.concatenate([*places, self.tests[name].datum[None]])

    def _before(self, name: str) -> list[HybridResult]:
        if name not in self.tests:
            raise InputError("ProgrammeResult", f"'{name}'", ", ".join(self.tests) or "no test was begun")
        return [self.tests[other] for other in list(self.tests)[: list(self.tests).index(name)]]

    def __str__(self) -> str:
        lines = [f"{name}: {test}" for name, test in self.tests.items()]
        return "\n".join([*lines, "The programme is finished." if self.finished else self.ended_by])


@check_arguments
@dataclass(frozen=True, eq=False)
class Programme:
    """A programme of hybrid tests.

    Between two of them the operator unloads the specimen and calls its place zero; a simulated one does so by itself.

    Parameters
    ----------
    tests : mapping of str to HybridTest
        By their names, in their order. All have the specimen of the first.

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
            raise InputError("Programme.tests", "none", "one test or more, by their names")
        for name in self.tests:
            if not name.replace("_", "").replace("-", "").isalnum():
                raise InputError("Programme.tests", f"the name '{name}'", "letters, digits, - and _")

    def check(self) -> dict[str, Feasibility]:
        """Check every test on the undamaged specimen; nothing moves.

        Returns
        -------
        dict of str to Feasibility
            See `HybridTest.check`.
        """
        return {name: test.check() for name, test in self.tests.items()}

    def run(
        self, folder: str | os.PathLike[str] | None = None, *, resume: bool = False, watching: Watching | None = None
    ) -> ProgrammeResult:
        """Run the tests until one does not come to its end.

        Parameters
        ----------
        folder : path-like, optional
            For a store of every test.
        resume : bool
            Whether to go on with what is there. A simulated specimen is moved through all of it again, and must do what it did. Of
            a structure finished tests stay as they are, and the next one begins: its operator has released the specimen since.
        watching : callable, optional
            Called before every test with its name and the test.

        Returns
        -------
        ProgrammeResult
            As far as it went.

        Raises
        ------
        InputError
            If a test cannot work, before anything moves; if the folder holds a programme already; if a test on a structure is to
            be resumed in its middle.
        """
        for name, result in self.check().items():
            if not result.can_work:
                raise InputError(f"test {name}", " ".join(result.refusals).removesuffix("."), "a test that can work")
        stores = {name: None if folder is None else store_of(Path(folder), name) for name in self.tests}
        if not resume:
            for store in stores.values():
                if store is not None and store.exists():
                    raise InputError(f"{folder}", f"{store.name} is there already", "a new folder, or resume=True")
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
    """The stored result of a test; None where there is none."""
    return open_hybrid(store) if store is not None and store.exists() else None


def _finished(known: HybridResult, store: Path | None) -> HybridResult:
    """Return a completed test on a structure unchanged; its operator has released the specimen since."""
    if not known.finished:
        raise InputError(
            f"{store}",
            "a test on a structure that did not come to its end",
            "one that did",
            f"{NEVER_RESUMED} Make a new programme of the tests that are left.",
        )
    return known


def _run(test: HybridTest, store: Path | None, resume: bool, known: HybridResult | None) -> HybridResult:
    """Run a test, or repeat what is stored of it."""
    if known is None:
        return test.run(store, resume=resume)
    again = test.run()
    same = again.steps == known.steps and np.array_equal(again.moves.measured, known.moves.measured)
    if not same:
        raise InputError(f"{store}", "it comes out otherwise than before", "the same test and specimen, from the start")
    return known
