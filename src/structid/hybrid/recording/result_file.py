"""Files of a hybrid test: a recording during the test, and one HDF5 file after its end."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.journal import opened_hdf5, refuse_other_layout, write_then_rename
from structid.core.validation import check_arguments
from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling.partitioned_run import (
    CoarseHistory,
    FineHistory,
    PartHistory,
    PartitionedHistories,
    StepFrame,
)
from structid.hybrid.feasibility import Feasibility
from structid.hybrid.hybrid_result import Event, HybridResult, MoveHistory
from structid.hybrid.laboratory.specimen import SpecimenDescription
from structid.hybrid.laboratory.specimen_force import Move
from structid.hybrid.online.unscented_filter import FilteredPath
from structid.hybrid.recording.recorder import SCHEMA, journal_of, recorded

CUT_OFF = "The recording was interrupted: its process was killed, or its disk was full. All finished steps are kept."


@dataclasses.dataclass(frozen=True, eq=False)
class About:
    """Description of a test, stored before it starts and needed to read its recording."""

    description: SpecimenDescription  # description of the specimen
    feasibility: Feasibility  # result of the check before the test
    record: GroundMotion  # ground acceleration
    frame: StepFrame  # layout of the steps
    moves_per_step: int  # moves of the specimen in a coarse step

    def to_plain(self) -> dict[str, Any]:
        """Convert to JSON-compatible values, exact to the last bit."""
        frame = {f.name: getattr(self.frame, f.name) for f in dataclasses.fields(self.frame)}
        return {
            "description": self.description.model_dump(mode="json"),
            "feasibility": dataclasses.asdict(self.feasibility),
            "record": {"values": self.record.values.tolist(), "dt": self.record.dt, "name": self.record.name},
            "frame": {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in frame.items()},
            "moves_per_step": self.moves_per_step,
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> About:
        """Rebuild a description from the result of `to_plain`."""
        frame: dict[str, Any] = {n: np.array(v) if isinstance(v, list) else v for n, v in plain["frame"].items()}
        return cls(
            SpecimenDescription.model_validate(plain["description"]),
            _feasibility(plain["feasibility"]),
            GroundMotion(np.array(plain["record"]["values"]), plain["record"]["dt"], name=plain["record"]["name"]),
            StepFrame(**frame),
            plain["moves_per_step"],
        )

    # --- rows ---------------------------------------------------------------------------------------------------

    @property
    def width(self) -> int:
        """Number of values in a row: the values of a step, then the values of its moves."""
        return self.frame.width + self.moves_per_step * 4 * len(self.description.channels)

    def row(self, step: Float[np.ndarray, " frame_width"], moves: list[Move]) -> Float[np.ndarray, " width"]:
        """Write a step and its moves as one row."""
        row = np.full(self.width, np.nan)
        row[: len(step)] = step
        values = np.ravel(moves)
        row[len(step) : len(step) + len(values)] = values
        return row

    def result(
        self, rows: Float[np.ndarray, "row width"], events: list[Event], stiffness_ratio: float = np.nan
    ) -> HybridResult:
        """Read rows as a result."""
        channels, frame = len(self.description.channels), self.frame
        histories = frame.histories(rows[:, : frame.width]) if len(rows) else None
        moves = rows[:, frame.width :].reshape(-1, 4, channels)
        moves = moves[~np.isnan(moves[:, 0, 0])]
        time = np.arange(len(moves)) * frame.dt / self.moves_per_step
        history = MoveHistory(time, *np.moveaxis(moves, 1, 0))
        return HybridResult(
            histories, history, tuple(events), self.feasibility, self.description, self.record, stiffness_ratio
        )


def _feasibility(plain: dict[str, Any]) -> Feasibility:
    """Rebuild a `Feasibility` from JSON, in which tuples are lists."""
    fields: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in plain.items()}
    return Feasibility(**fields)


def save(result: HybridResult, path: Path) -> None:
    """Write a result completely or not at all."""
    import h5py

    content = io.BytesIO()  # in memory: HDF5 does not survive a disk that fills up while it closes a file
    with h5py.File(content, "w") as file:
        file.attrs["schema"] = SCHEMA
        file.attrs["about"] = json.dumps(
            {
                "description": result.description.model_dump(mode="json"),
                "feasibility": dataclasses.asdict(result.feasibility),
                "events": [list(event) for event in result.events],
                "stiffness_ratio": result.stiffness_ratio,
                "record": {"dt": result.record.dt, "name": result.record.name},
                "online": [] if result.online is None else list(result.online.names),
            }
        )
        file["record"] = result.record.values
        _write(file, "moves", result.moves)
        if result.histories is not None:
            _write(file, "histories", result.histories)
        if result.online is not None:
            for name in FILTERED:
                file[f"online/{name}"] = getattr(result.online, name)
    write_then_rename(path, content.getvalue())


def _write(group: Any, name: str, value: Any) -> None:
    """Write the arrays of nested dataclasses under the names of their fields."""
    if isinstance(value, np.ndarray):
        group.create_dataset(name, data=value)
        return
    inner = group.create_group(name)
    for field in dataclasses.fields(value):
        _write(inner, field.name, getattr(value, field.name))


NESTED: dict[str, type] = {
    "histories": PartitionedHistories,
    "coarse": CoarseHistory,
    "fine": FineHistory,
    "numerical": PartHistory,
    "physical": PartHistory,
    "part": PartHistory,
    "moves": MoveHistory,
}
"""Class of each group in the file, by its name."""


def _read(group: Any, name: str) -> Any:
    result = group[name]
    if name not in NESTED:
        return result[()]
    return NESTED[name](*(_read(result, field.name) for field in dataclasses.fields(NESTED[name])))


FILTERED = ("mean", "low", "high")
"""Names of the arrays in a `FilteredPath`."""


def _filtered(file: Any, names: list[str]) -> FilteredPath | None:
    return FilteredPath(tuple(names), *(file[f"online/{name}"][()] for name in FILTERED)) if names else None


@check_arguments
def open_hybrid(path: str | Path) -> HybridResult:
    """Open the result of a finished or interrupted hybrid test.

    Parameters
    ----------
    path : path-like
        Store of the test.

    Returns
    -------
    HybridResult
        Result from the store, or from the recording if the process was killed.

    Raises
    ------
    InputError
        If neither store nor recording exists, or if the file is damaged.

    Examples
    --------
    >>> import structid as si
    >>> result = si.open_hybrid("hybrid.h5")  # doctest: +SKIP
    >>> result.plot(save="test.png")  # doctest: +SKIP
    """
    store = Path(path)
    if not store.exists() and journal_of(store).exists():
        about, rows = recorded(store)
        about_test = About.from_plain(about)
        return about_test.result(rows, [Event(max(len(rows) - 1, 0) * about_test.frame.dt, CUT_OFF)])
    if not store.exists():
        raise InputError(f"store {store}", "no such file", "the store of a hybrid test")
    with opened_hdf5(store, "a hybrid test") as file:
        refuse_other_layout(store, file.attrs["schema"], SCHEMA)
        about = json.loads(file.attrs["about"])
        histories = _read(file, "histories") if "histories" in file else None
        return HybridResult(
            histories,
            _read(file, "moves"),
            tuple(Event(*event) for event in about["events"]),
            _feasibility(about["feasibility"]),
            SpecimenDescription.model_validate(about["description"]),
            GroundMotion(file["record"][()], about["record"]["dt"], name=about["record"]["name"]),
            about["stiffness_ratio"],
            _filtered(file, about["online"]),
        )
