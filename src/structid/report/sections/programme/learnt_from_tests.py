"""Section of a programme: posterior of the specimen's parameters after a test, and the prediction of a later test."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.units import label
from structid.figures import hybrid as figure
from structid.figures import loops as loop_figure
from structid.figures.style import pretty, pretty_unit
from structid.report.material.programme_material import BAND, Learnt, ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import lines_without_markers, number


def _words(material: ProgrammeMaterial) -> list[str]:
    learnt = material.learnt
    if learnt is None:
        return []
    verdict, calibration = learnt.result.verdict(), learnt.calibration
    how = (
        "No surrogate was used: the draws come from the posterior of the model itself."
        if calibration is None
        else "A surrogate replaced the model in the sampling."
    )
    sentences = [
        f"The measured displacements of test {learnt.from_test} and of the tests before it were imposed on the model. The "
        f"likelihood compares model forces and measured forces ({learnt.observation.values.size:,} values). {how}",
        *([] if calibration is None else lines_without_markers(str(calibration.certificate))),
        *lines_without_markers(str(verdict)),
    ]
    if learnt.prediction is not None:
        sentences += learnt.prediction.sentences
    return sentences


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
    caption = f"Loops up to the end of test {learnt.from_test}: measured, and at the most probable parameters."
    return Picture("learnt_loops", caption, drawn)


def _prediction(learnt: Learnt) -> Picture:
    prediction = learnt.prediction
    assert prediction is not None
    low, high = (1e3 * edge for edge in np.quantile(prediction.drifts, BAND, axis=0))
    observed = ("drift", prediction.time[: len(prediction.happened)], 1e3 * prediction.happened)
    drawn = figure.predicted_test(
        prediction.time, (low, high), observed, 1e3 * prediction.peaks, 1e3 * prediction.peak, "mm"
    )
    caption = f"Test {prediction.name}: prediction from test {learnt.from_test}, and observed response."
    return Picture("predicted_test", caption, drawn)


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    learnt = material.learnt
    if learnt is None:
        return []
    drawn: list[Drawing] = [partial(_loops, learnt=learnt)]
    if learnt.prediction is not None and len(learnt.prediction.drifts):
        drawn.append(partial(_prediction, learnt=learnt))
    return drawn


SECTION: Section[ProgrammeMaterial] = Section("learnt", "Parameters learnt from the tests", _drawings, _tables, _words)
