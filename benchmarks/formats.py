"""Real files of strong-motion networks: structid's reader beside gmprocess and ObsPy, and beside the headers of the files.

    python benchmarks/formats.py FOLDER [--gmprocess PYTHON]

FOLDER holds files of any formats, such as the test data of gmprocess. gmprocess has many dependencies; PYTHON is the interpreter
of an environment in which it is installed. Without a folder, the synthetic files of the tests take its place.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import common
import numpy as np

from structid.core.errors import InputError
from structid.core.units import same_dimension
from structid.data_files.inspection import times_of
from structid.data_files.read_file import read_file

NAME = "formats"
OTHER = (
    ".xml",
    ".json",
    ".yml",
    ".yaml",
    ".png",
    ".xlsx",
    ".pkl",
    ".h5",
    ".hdf",
    ".csv",
    ".zip",
    ".md",
    ".grd",
    ".geojson",
)
"""Suffixes of files that are no records."""
ALIKE = 2e-3
"""Relative difference of two peaks up to which they are the same."""

WITH_GMPROCESS = """
import json, logging, sys, time, warnings
warnings.simplefilter("ignore"); logging.disable(logging.CRITICAL)
from gmprocess.io.read import read_data
for path in json.load(sys.stdin):
    begin = time.perf_counter()
    try:
        traces = [trace for stream in read_data(path) for trace in stream]
        read = [[float(t.stats.delta), int(t.stats.npts), float(abs(t.data).max())] for t in traces]
    except BaseException as problem:
        read = f"{type(problem).__name__}: {problem}"
    print(json.dumps([path, read, time.perf_counter() - begin]), flush=True)
"""
"""gmprocess in another interpreter: step [s], samples and largest value [cm/s²] of each trace of each file."""


def ours(path: str) -> tuple[str, list | str, float]:
    """Format, and step [s], samples and peak [cm/s²] of each acceleration; a refusal is a text."""
    begin = time.perf_counter()
    try:
        file = read_file(path)
    except InputError as refusal:
        return "refused", str(refusal), time.perf_counter() - begin
    channels = [
        c for c in file.channels if c.quantity == "acceleration" and c.unit != "counts" and same_dimension(c.unit, "g")
    ]
    read = [
        [float(np.median(np.diff(times_of(c)))), len(c.values), 100.0 * float(np.abs(c.in_si).max())] for c in channels
    ]
    return file.format, read, time.perf_counter() - begin


def with_obspy(path: str) -> list | str:
    """Step [s], samples and largest value times the calibration [cm/s²] of each trace."""
    import obspy

    try:
        traces = obspy.read(path)
    except Exception as problem:
        return f"{type(problem).__name__}: {problem}"
    return [
        [float(t.stats.delta), int(t.stats.npts), 100.0 * float(np.abs(t.data * t.stats.calib).max())] for t in traces
    ]


def with_gmprocess(interpreter: str, paths: list[str]) -> dict[str, tuple[list | str, float]]:
    """What gmprocess reads, by file."""
    done = subprocess.run(
        [interpreter, "-c", WITH_GMPROCESS], input=json.dumps(paths), capture_output=True, text=True, check=False
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
    return {path: (read, seconds) for path, read, seconds in lines}


def compared(mine: list, other: list | str) -> str:
    """Say how another reader's channels compare with ours: same, another step, another peak, or another number."""
    if isinstance(other, str):
        return "not read"
    if len(other) != len(mine):
        return "other channels"
    for (step, _, peak), (other_step, _, other_peak) in zip(
        sorted(mine, key=_peak), sorted(other, key=_peak), strict=True
    ):
        if abs(other_step / step - 1.0) > ALIKE:
            return "another step"
        if abs(other_peak - peak) > ALIKE * peak:
            return "another peak"
    return "the same"


def _peak(channel: list) -> float:
    return float(channel[2])


def files_of(folder: Path | None) -> list[str]:
    """Return the files of a folder, or synthetic ones."""
    if folder is not None:
        return sorted(str(f) for f in folder.rglob("*") if f.is_file() and f.suffix.lower() not in OTHER)
    sys.path.insert(0, str(common.ROOT / "tests" / "helpers"))
    from format_writers import CASES

    place = Path(tempfile.mkdtemp())
    for name, case in CASES.items():
        (place / f"{name.replace('/', '_')}.dat").write_text(case.write()[0], encoding="latin-1")
    return sorted(map(str, place.iterdir()))


def main(quick: bool, folder: Path | None, interpreter: str | None) -> None:
    """Read all files by all readers, and write the page."""
    paths = files_of(folder)
    mine = {path: ours(path) for path in paths}
    known = [
        path for path in paths if mine[path][0] not in ("refused", "text columns", "miniSEED", "SAC") and mine[path][1]
    ]
    others: dict[str, dict[str, list | str]] = {}
    if importlib.util.find_spec("obspy") is not None:
        others["ObsPy"] = {path: with_obspy(path) for path in known}
    seconds: dict[str, float] = {}
    if interpreter is not None:
        read = with_gmprocess(interpreter, known)
        others["gmprocess"] = {path: read[path][0] for path in known if path in read}
        seconds = {path: read[path][1] for path in known if path in read}
    by_format = defaultdict(list)
    for path in known:
        by_format[mine[path][0]].append(path)
    rows = []
    tally: dict[str, dict[str, dict[str, int]]] = {}
    for name, members in sorted(by_format.items()):
        cells = [name, str(len(members)), str(sum(len(mine[path][1]) for path in members))]
        tally[name] = {}
        for other, reader in others.items():
            counts: dict[str, int] = defaultdict(int)
            for path in members:
                counts[compared(mine[path][1], reader.get(path, "")) if path in reader else "not read"] += 1
            cells.append(", ".join(f"{counts[kind]} {kind}" for kind in sorted(counts)))
            tally[name][other] = counts
        ratios = [
            mine[path][2] / seconds[path]
            for path in members
            if path in seconds and not isinstance(others["gmprocess"][path], str)
        ]
        cells.append(f"{statistics.median(ratios):.2f}" if ratios else "–")
        rows.append("| " + " | ".join(cells) + " |")
    refused = [mine[path][1] for path in paths if mine[path][0] == "refused"]
    titles = ["format", "files", "accelerations", *others, "time, structid / gmprocess"]
    table = "\n".join(["| " + " | ".join(titles) + " |", "|" + " --- |" * len(titles), *rows])
    text = f"""# Files of strong-motion networks

`benchmarks/formats.py`. {common.machine()}.

{len(paths)} files{" of a folder" if folder else ", the synthetic ones of the tests"}. {len(known)} are records with a header.
structid refuses {len(refused)} files, each with one sentence. "The same" means: the same steps, and peaks that differ by less than
{100 * ALIKE:.1f} %. Every peak, count and step that a header states agrees with structid's values, since structid refuses a file
for which it does not.

{table}

Differences: gmprocess and ObsPy keep the mean of K-NET and KiK-net counts. The `Max. Acc.` of the headers is that of the values
without their mean, to the last of its three decimals, and so are structid's values. gmprocess interpolates the points of a film
to a step of its own; structid gives them as they are, and interpolates at a step that the user gives. gmprocess refuses most
files of RENADIC, since two of its formats claim them. ObsPy reads none of the other formats.
"""
    agreements = {name: {other: dict(kinds) for other, kinds in counts.items()} for name, counts in tally.items()}
    common.record_result(NAME, quick=quick, files=len(paths), read=len(known), refused=len(refused), readers=agreements)
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--gmprocess", help="interpreter with gmprocess")
    parser.add_argument("--quick", action="store_true")
    chosen = parser.parse_args()
    main(chosen.quick, chosen.folder, chosen.gmprocess)
