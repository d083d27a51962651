"""The question: does structid give what the MSc thesis prints, table by table and figure by figure; and where not, why.

Run with ``python benchmarks/thesis.py [--quick]``. El Centro comes from ``../shared/data``. It writes the page docs/thesis.md and
its pictures, in about ten minutes.
"""

from __future__ import annotations

import warnings

import common
import thesis_facade
import thesis_oscillator
from thesis_rows import Chapter, Clock, Row, figures_folder, joined, without_vectors

NAME = "thesis"


def times() -> Row:
    """What the thesis's inversions took, beside ours."""
    return Row(
        "text",
        "computing times",
        joined(["33 h the model", "55 min PC-NARX", "18 h Kriging-NARX", "40 s a run of the façade"]),
        "–",
        joined(["0.4 to 0.8 s", "0.5 s", "0.5 s", "0.008 s of one core"]),
        "compiled batches in place of a run at a time; see the pages of benchmarks",
    )


def page(chapters: list[Chapter], seconds: float) -> str:
    """The whole page."""
    count = sum(len(chapter.rows) for chapter in chapters)
    beginning = f"""# The thesis, reproduced

`benchmarks/thesis.py`, {seconds / 60.0:.0f} min. {common.machine()}.

structid began from an MSc thesis ([1] in the [bibliography](bibliography.md)). Its tables and figures are here in {count} rows.
"As published" is the thesis's own method by structid. "Best" is what structid does where it is left to itself. A figure that is a
sketch, a flow chart or a photograph (2.1, 3.1, 4.1 to 4.7, 4.12) has no row.
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
