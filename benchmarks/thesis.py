"""Comparison of structid with every table and figure of the MSc thesis, and the reasons for differences.

Run with ``python benchmarks/thesis.py [--quick]``. El Centro is read from ``../shared/data``. The script writes docs/thesis.md
and its pictures in about ten minutes.
"""

from __future__ import annotations

import warnings

import common
import thesis_facade
import thesis_oscillator
from thesis_rows import Chapter, Clock, Row, figures_folder, joined, without_vectors

NAME = "thesis"


def times() -> Row:
    """Computing times of the thesis's inversions and of structid."""
    return Row(
        "text",
        "computing times",
        joined(["33 h the model", "55 min PC-NARX", "18 h Kriging-NARX", "40 s a run of the façade"]),
        "–",
        joined(["0.4 to 0.8 s", "0.5 s", "0.5 s", "0.008 s of one core"]),
        "compiled batches instead of one run at a time; see the benchmarks",
    )


def page(chapters: list[Chapter], seconds: float) -> str:
    """Return the whole page."""
    count = sum(len(chapter.rows) for chapter in chapters)
    beginning = f"""# The thesis, reproduced

`benchmarks/thesis.py`, {seconds / 60.0:.0f} min. {common.machine()}.

structid began from an MSc thesis ([1] in the [bibliography](bibliography.md)), whose tables and figures are compared in {count}
rows. "Published method" is the thesis's method, computed by structid. "Best method" is the method that structid offers instead.
Sketches, flow charts and photographs (figures 2.1, 3.1, 4.1 to 4.7, 4.12) are not compared.
"""
    return "\n".join([beginning, *(chapter.text() for chapter in chapters)])


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    warnings.simplefilter("ignore")
    clock = Clock()
    chapters = [thesis_oscillator.chapter(clock, quick)]
    chapters.append(Chapter("Computing times", "", (times(),), ()))
    chapters += [thesis_facade.hybrid_chapter(clock, quick), thesis_facade.facade_chapter(clock, quick)]
    seconds = clock.last - clock.began
    rows = [[r.place, r.shows, r.printed, r.published, r.best] for chapter in chapters for r in chapter.rows]
    common.record_result(NAME, quick=quick, machine=common.machine(), seconds=seconds, rows=rows)
    without_vectors(figures_folder(quick))
    (common.documents(quick) / "thesis.md").write_text(page(chapters, seconds), encoding="utf-8")
    print(f"{seconds:.0f} s")


if __name__ == "__main__":
    main()
