"""Choice of the hysteretic law of real specimens, from the files of their cyclic tests.

    python benchmarks/cyclic_tests.py FILE...
    python benchmarks/cyclic_tests.py --quick

A file has a displacement in mm and a force in kN. The tests are public, but not part of this package: `SOURCES` says where each
comes from, and which of its samples were used. Outcomes add up: a run appends its own to the results, and writes the page of all.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import common
from virtual_tests import NEAR_BEST, virtual_test

import structid as si
from structid.law_choice.law_comparison import DECISIVE

NAME = "cyclic_tests"


class Source(NamedTuple):
    """A specimen, and where its test comes from."""

    specimen: str
    reference: str


SOURCES = {
    "FD_PG1_Almeida2012": Source("stone-masonry wall PG1", "Almeida 2012, StoneMasonryDatabase"),
    "FD_T11_Faella1992": Source("stone-masonry wall T11", "Faella 1992, StoneMasonryDatabase"),
    "FD_CT01_Magenes2010": Source("stone-masonry wall CT01", "Magenes 2010, StoneMasonryDatabase"),
    "timber_clt_wall_spc1": Source(
        "CLT wall with perforated steel plates SPC1", "Drexler 2021, github.com/cslotboom/hysteresis, every 6th sample"
    ),
    "rocking_clt_wall_ts1": Source(
        "rocking CLT wall TS1", "Ganey 2015, github.com/cslotboom/hysteresis, without its 8400 samples at rest"
    ),
    "rc_column_soesianawati1986": Source(
        "reinforced-concrete column", "Soesianawati 1986, github.com/NHERI-SimCenter/quoFEM, digitised"
    ),
    "rc_wall_wsh6": Source("reinforced-concrete wall WSH6", "Dazio 2009, github.com/SiamakTY/DeltaU_Data, thinned out"),
    "steel_beamcolumn_ut04": Source(
        "steel moment connection UT04", "Shin 2017, github.com/DonCammne/OpenSeesPyAssistant, every 6th sample"
    ),
    "cfs_osb_joint_c54o6_1": Source(
        "screwed joint of cold-formed steel and OSB",
        "Peterman 2014, github.com/EngineerWithData/FastenerConnectionTests, every 2nd sample",
    ),
    "friction_damper_brfd": Source(
        "banded rotary friction damper, 0.25 Hz",
        "github.com/ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash, every 5th sample",
    ),
    "bilinear 0": Source("virtual bilinear specimen", "benchmarks/virtual_tests.py"),
}
"""Specimens by the names of their files."""


def outcome(test: si.CyclicTest, laws: tuple[str, ...] | None, quick: bool) -> dict[str, Any]:
    """Choose the law of one specimen; the outcome is appended to the results."""
    begin = time.perf_counter()
    choice = si.choose_model(test, laws, seed=1)
    seconds = time.perf_counter() - begin
    print(choice, choice.result.verdict(), sep="\n", flush=True)
    result = {
        "test": test.name,
        "samples": len(test.force),
        "half_cycles": len(test.turns) - 1,
        "chosen": choice.chosen.name,
        "parameters": len(choice.chosen.fit.fitted),
        "unexplained": choice.least_squares,
        "error": choice.chosen.prediction_error,
        "smallest": min(c.prediction_error for c in choice.candidates),
        "coverage": choice.held_out.coverage,
        "shown": [mechanism for mechanism, gain in choice.mechanisms.items() if gain > DECISIVE],
        "converged": choice.result.verdict().converged,
        "seconds": seconds,
    }
    common.record_result(NAME, quick=quick, **result)
    return result


def row(result: dict[str, Any]) -> list[str]:
    """One line of the table."""
    source = SOURCES[result["test"]]
    law = result["chosen"].rsplit(", ", 1)[0].replace("|", r"\|")  # without the error model
    return [
        source.specimen,
        f"{result['samples']}",
        f"{result['half_cycles']}",
        f"`{law}`",
        f"{result['parameters']}",
        f"{result['unexplained']:.1%}",
        f"{result['error']:.1%}",
        f"{result['smallest']:.1%}",
        f"{result['coverage']:.0%}",
        ", ".join(result["shown"]) or "–",
        f"{result['seconds']:.0f}",
    ]


def main() -> None:
    """Choose the laws of all given tests, and write the page of all recorded ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="a cyclic test: mm and kN")
    parser.add_argument("--quick", action="store_true", help="one virtual test; does not write to docs/")
    given = parser.parse_args()
    if given.quick:
        outcome(virtual_test("bilinear", 0), ("elastic_plastic", "bilinear"), quick=True)
    for path in given.files:
        outcome(si.CyclicTest.read(path, "mm", "kN"), None, quick=False)
    last = common.last_results(NAME, "test", quick=given.quick)
    results = [last[name,] for name in SOURCES if (name,) in last]
    near = sum(result["error"] <= NEAR_BEST * result["smallest"] for result in results)
    heads = ["specimen", "samples", "half-cycles", "law", "parameters", "unexplained", "error of the rest", "smallest"]
    heads += ["samples in the 90 % band", "mechanisms that the test shows", "seconds"]
    sources = "\n".join(f"* {SOURCES[r['test']].specimen}: {SOURCES[r['test']].reference}" for r in results)
    text = f"""
# Cyclic tests of real specimens

`benchmarks/cyclic_tests.py`. {common.machine()}.

`si.choose_model` chooses the law of {len(results)} specimens among all laws and two error models. *Unexplained* is the residual
variance of the force over its variance, whole test, raw samples. *Error of the rest* is the root mean square on the last 30 % of
the half-cycles, predicted from the first 70 % by the chosen law, as a share of the largest force. *Smallest* is the same for the
law that predicts best; the chosen law is within 20 % of it in {near} of {len(results)} tests. The band is
that of the averaged prediction of the same half-cycles.

{common.markdown_table(heads, [row(result) for result in results])}

{sources}
"""
    common.write_page(given.quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
