"""Section of a programme: online estimates of the specimen's parameters by a filter during the tests."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.units import factor, label
from structid.figures import hybrid as figure
from structid.figures.style import pretty, pretty_unit
from structid.hybrid.online.unscented_filter import BAND
from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import number

IN_DOUBT = 3.0
"""Distance between filter and posterior above which the filter is called overconfident, in standard deviations of the filter."""
SIGMAS = 2.0 * BAND
"""Width of a 95 % band, in standard deviations."""


def _followed(material: ProgrammeMaterial) -> bool:
    return any(test.online is not None for test in material.begun.values())


def _words(material: ProgrammeMaterial) -> list[str]:
    if not _followed(material):
        return []
    sentences = [
        "A filter estimated the parameters after every move. It assumes that the hysteretic model is right, the state is normal, "
        "and the force noise is independent. The filter helps during a test; it does not replace the posterior."
    ]
    overconfident = [row[0] for row in _beside(material) if row[-1] == "overconfident"]
    if overconfident:
        sentences.append(
            f"It is overconfident in {', '.join(overconfident)}: its estimate is {IN_DOUBT:g} or more of its own standard "
            "deviations away from the posterior mean of the same tests."
        )
    return sentences


def _beside(material: ProgrammeMaterial) -> list[list[str]]:
    """Rows that compare the filter's estimate at the end of the test used for learning with the posterior."""
    learnt = material.learnt
    if learnt is None or (online := material.programme.tests[learnt.from_test].online) is None:
        return []
    summary = learnt.result.summary()
    rows = []
    for k, name in enumerate(online.names):
        if name not in summary.names:
            continue
        index = list(summary.names).index(name)
        unit, by = summary.units[index], factor(summary.units[index])
        mean, sd = online.mean[-1, k] / by, (online.high - online.low)[-1, k] / SIGMAS / by
        whole, whole_sd = (float(summary.columns[c][index]) for c in ("mean", "sd"))
        far = abs(mean - whole) / sd if sd > 0.0 else np.inf
        verdict = "overconfident" if far >= IN_DOUBT else ""
        heads = label(pretty(name), pretty_unit(unit))
        rows.append(
            [heads, number(mean, sd), f"{sd:.2g}", number(whole, whole_sd), f"{whole_sd:.2g}", f"{far:.1f}", verdict]
        )
    return rows


def _tables(material: ProgrammeMaterial) -> list[Table]:
    rows = _beside(material)
    assert material.learnt is not None or not rows
    heads = ["parameter", "filter mean", "filter sd", "posterior mean", "posterior sd", "difference [filter sd]", ""]
    end = material.learnt.from_test if material.learnt is not None else ""
    return [Table(f"Filter and posterior at the end of test {end}", (heads, rows))] if rows else []


def _draw(material: ProgrammeMaterial) -> Picture:
    tests = {name: test.online for name, test in material.begun.items() if test.online is not None}
    paths = list(tests.values())
    names = paths[0].names
    lengths = np.cumsum([0, *(len(path.mean) for path in paths)])
    summary = material.learnt.result.summary() if material.learnt is not None else None
    units = [
        dict(zip(summary.names, summary.units, strict=True)).get(name, "") if summary is not None else ""
        for name in names
    ]
    by = np.array([factor(unit) for unit in units])
    path_values = [np.concatenate([getattr(path, part) for path in paths]) / by for part in ("mean", "low", "high")]
    posterior = {}
    if summary is not None:
        for index, name in enumerate(summary.names):
            mean, sd = float(summary.columns["mean"][index]), float(summary.columns["sd"][index])
            posterior[name] = (mean - SIGMAS / 2.0 * sd, mean + SIGMAS / 2.0 * sd)
    starts = [(name, int(first)) for name, first in zip(tests, lengths, strict=False)]
    drawn = figure.filtered_path(names, units, starts, (path_values[0], path_values[1], path_values[2]), posterior)
    return Picture("filtered_path", "Estimates of the filter, and the posterior; grey lines: start of a test.", drawn)


def _drawings(material: ProgrammeMaterial) -> list[Drawing]:
    return [partial(_draw, material=material)] if _followed(material) else []


SECTION: Section[ProgrammeMaterial] = Section("online", "Online filter", _drawings, _tables, _words)
