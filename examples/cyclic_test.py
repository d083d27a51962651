"""Let a quasi-static cyclic test of a masonry wall choose its hysteretic law.

Data: force-displacement histories of stone-masonry walls (StoneMasonryDatabase, MIT licence), not part of this package.

    python examples/cyclic_test.py PATH/FD_PG1_Almeida2012.csv
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import structid as si
from structid.figures import loops

DEFAULT = Path(__file__).parents[2] / "shared" / "data" / "hysteresis" / "FD_PG1_Almeida2012.csv"


def main(path: Path = DEFAULT, save: Path | None = Path("cyclic_test"), laws: Sequence[str] | None = None) -> float:
    """Choose, draw, and return the fraction of the force's variance that the chosen law leaves unexplained."""
    test = si.CyclicTest.read(path, "mm", "kN")
    print(test)
    print("\n".join(test.questions))
    choice = si.choose_model(test, laws, seed=1)
    print(choice)
    print(choice.result.summary())
    print(f"The 90 % band holds {choice.held_out.coverage:.0%} of the last half-cycles, predicted from the first.")
    if save is not None:
        best = choice.least_squares_fit
        u, samples = test.displacement * 1e3, np.arange(len(test.force), dtype=float)
        title = f"{test.name}: {best.unexplained:.1%} of the force's variance unexplained"
        measured, model = (u, test.force * 1e-3), (u, best.fit.force(test) * 1e-3)
        loops.loops(samples, measured, model, title, save, names=("test", best.law.title))
    return choice.least_squares


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
