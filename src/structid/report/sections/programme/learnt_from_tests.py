"""Section of a programme: what was learnt of the specimen from a test, and the prediction of a later one."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.units import label
from structid.figures import hybrid as figure
from structid.figures import loops as loop_figure
from structid.figures.style import pretty, pretty_unit
from structid.report.material.programme_material import BAND, Learnt, ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import number


def _words(material: ProgrammeMaterial) -> list[str]:
    learnt = material.learnt
    if learnt is None:
        return []
    verdict, calibration = learnt.result.verdict(), learnt.calibration
    how = (
        "No surrogate was used: these are draws of the model's own posterior."
        if calibration is None
        else "A surrogate stood in for the model."
    )
    sentences = [
        f"Measured displacements were imposed on the model, and its forces compared with those that were measured, in test "
        f"{learnt.from_test} and those before ({learnt.observation.values.size:,} values). {how}",
        *([] if calibration is None else _lines(str(calibration.certificate))),
        *_lines(str(verdict)),
    ]
    if learnt.prediction is not None:
        sentences += learnt.prediction.sentences
    return sentences


def _lines(text: str) -> list[str]:
    """A paragraph for each line, without list markers."""
    return [line.strip().removeprefix("- ").removeprefix("! ") for line in text.splitlines()]


def _tables(material: ProgrammeMaterial) -> list[Table]:
    learnt = material.learnt
    if learnt is None:
        return []
    summary, rows = learnt.result.summary(), []
    factors = dict(zip(learnt.result.names, learnt.result.target.factors, strict=True))
    for i, (name, unit) in enumerate(zip(summary.names, summary.units, strict=True)):
        c = {key: float(column[i]) for key, column in summary.columns.items()}
        shown = [number(c[key], c["sd"]) for key in ("mean", "q05", "q95")]
        truth = material.true_values.get(name)
        truths = [] if not material.true_values else ["–" if truth is None else number(truth / factors[name], c["sd"])]
        rows.append([label(pretty(name), pretty_unit(unit)), shown[0], f"{c['sd']:.2g}", *shown[1:], *truths])
    heads = ["parameter", "mean", "sd", "5 %", "95 %", *(["specimen"] if material.true_values else [])]
    return [Table("Posterior", (heads, rows))]


def _loops(learnt: Learnt) -> Picture:
    values = np.asarray(learnt.observation.record.values)
    displacement = 1e3 * (values if values.ndim == 1 else values[:, 0])
    measured, model = 1e-3 * learnt.observation.values[:, 0], 1e-3 * learnt.fitted[:, 0]
    drawn = loop_figure.loops(learnt.observation.record.time, (displacement, measured), (displacement, model))
    return Picture(
        "learnt_loops", f"Loops to the end of test {learnt.from_test}, and of the most probable parameters.", drawn
    )


def _prediction(learnt: Learnt) -> Picture:
    prediction = learnt.prediction
    assert prediction is not None
    low, high = (1e3 * edge for edge in np.quantile(prediction.drifts, BAND, axis=0))
    happened = ("drift", prediction.time[: len(prediction.happened)], 1e3 * prediction.happened)
    drawn = figure.predicted_test(
        prediction.time, (low, high), happened, 1e3 * prediction.peaks, 1e3 * prediction.peak, "mm"
    )
    caption = f"Test {prediction.name}: what was predicted from test {learnt.from_test}, and what happened."
    return Picture("predicted_test", caption, drawn)


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    learnt = material.learnt
    if learnt is None:
        return []
    drawn: list[Drawing] = [partial(_loops, learnt=learnt)]
    if learnt.prediction is not None and len(learnt.prediction.drifts):
        drawn.append(partial(_prediction, learnt=learnt))
    return drawn


SECTION: Section[ProgrammeMaterial] = Section("learnt", "What the tests have taught", _drawings, _tables, _words)
