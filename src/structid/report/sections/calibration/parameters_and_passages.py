"""Runs over the prior range: first passages of limits, their probability, and sensitivity of the peaks."""

from __future__ import annotations

import functools

import numpy as np

from structid.core.errors import Status
from structid.core.units import factor, label
from structid.figures import passages as figures
from structid.figures.style import pretty, pretty_unit
from structid.reliability.parameter_study import ParameterStudy
from structid.reliability.passage_probability import PassageProbability, coordinate_names, coordinates_of
from structid.report.material.material import RunsMaterial
from structid.report.section import Drawing, Picture, Rows, Section, Table
from structid.report.tables import in_display_unit

POOR = 0.1
"""Unexplained fraction of the variance above which the sensitivity indices of an expansion are unreliable."""


def _limit(study: ParameterStudy, number: int) -> str:
    """A limit with its unit."""
    return in_display_unit(study.passages[number].limit, study.passages[number].channel)


def _above(study: ParameterStudy) -> str:
    """The separately studied part of the prior range, as a string."""
    units = study.runs.design.space.units
    return " and ".join(
        f"{pretty(n)} above {value / factor(units[n]):g} {pretty_unit(units[n])}".strip()
        for n, value in study.above.items()
    )


def _shares(study: ParameterStudy) -> Rows:
    heads = ["limit", "runs that pass", "fraction", "first [s]", "median [s]", "last [s]"]
    heads += ["runs in the part"] if study.above else []
    rows = []
    for number, result in enumerate(study.passages):
        share, error = result.share
        times = result.time[result.passed]
        quantiles = [f"{q:.3f}" for q in np.quantile(times, [0.0, 0.5, 1.0])] if len(times) else ["–"] * 3
        row = [_limit(study, number), f"{result.passed.sum()}", f"{share:.1%} ± {error:.1%}", *quantiles]
        if study.above:
            part = result[study.inside]
            row.append(f"{part.passed.sum()} of {len(part)}" if len(part) else "no runs")
        rows.append(row)
    return heads, rows


def _concordances(study: ParameterStudy) -> Rows:
    heads = ["parameter or coordinate", *(_limit(study, i) for i in range(len(study.passages)))]
    values = study.columns
    return heads, [
        [pretty(name), *(_share(result.concordance(values[name])) for result in study.passages)] for name in values
    ]


def _share(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def _probabilities(study: ParameterStudy) -> Rows:
    heads = ["limit", "degree", "correct", "baseline", "log loss", "baseline"]
    rows = []
    for number, result in enumerate(study.probabilities):
        if result is None:
            rows.append([_limit(study, number), "–", "too few runs with or without a passage", "", "", ""])
        else:
            rows.append(
                [
                    _limit(study, number),
                    f"{result.degree}",
                    f"{result.accuracy:.1%}",
                    f"{result.base_accuracy:.1%}",
                    f"{result.log_loss:.3f}",
                    f"{result.base_log_loss:.3f}",
                ]
            )
    return heads, rows


def _indices(study: ParameterStudy) -> Rows:
    heads = ["parameter or coordinate"]
    for channel, result in study.sensitivities.items():
        heads += [f"{pretty(channel)}: first", f"total ({result.left_out:.1%} unexplained)"]
    results = list(study.sensitivities.values())
    rows = []
    for i, name in enumerate(results[0].names):
        row = [pretty(name)]
        for result in results:
            row += [
                f"{max(result.first[i], 0.0):.3f} ± {result.first_error[i]:.3f}",
                f"{max(result.total[i], 0.0):.3f} ± {result.total_error[i]:.3f}",
            ]
        rows.append(row)
    if results[0].coordinates != results[0].names:
        for i, name in enumerate(results[0].coordinates):
            row = [pretty(name)]
            for result in results:
                row += [f"{result.alone[i]:.3f}", ""]
            rows.append(row)
    return heads, rows


def _tables(material: RunsMaterial) -> list[Table]:
    study = material.results.get(ParameterStudy)
    if study is None:
        return []
    tables = [
        Table("First passages", _shares(study)),
        Table(
            "Concordance: probability that, of two runs, the run with the larger value passes the limit later (0.5: no relation)",
            _concordances(study),
        ),
        Table("Probability of a passage by logistic regression: cross-validated accuracy", _probabilities(study)),
    ]
    if study.sensitivities:
        tables.append(Table("Sobol' indices of the peaks", _indices(study)))
    return tables


def _words(material: RunsMaterial) -> list[str]:
    study = material.results.get(ParameterStudy)
    if study is None:
        return []
    runs = study.runs
    fell = int((runs.status == Status.STRUCTURE_FAILED).sum())
    ended = int((~runs.done).sum()) - fell
    words = [
        f"{len(runs):,} runs over the priors. {_early(fell, ended)} A run without a passage is censored: its passage time is later "
        "than its end."
    ]
    if study.above:
        words.append(f"A part of the prior range is also studied: {_above(study)}, {study.inside.sum():,} runs.")
    if study.sensitivities:
        words.append(
            "Sobol' indices are given for the parameters, which are independent. For a coordinate, the table gives the fraction of "
            "the variance that it explains alone. Coordinates that share a parameter are dependent, so these fractions may sum to "
            "more than 1."
        )
    poor = [pretty(channel) for channel, result in study.sensitivities.items() if result.left_out > POOR]
    if poor:
        words.append(
            f"The expansion of {' and of '.join(poor)} leaves more than {POOR:.0%} of the variance unexplained. Its indices "
            "describe only the explained part. Use more runs, or coordinates with a simpler effect on the response."
        )
    return words


def _early(fell: int, ended: int) -> str:
    """Sentence on the runs that did not reach the end of their record."""
    if not fell + ended:
        return "All runs reached the end of the record."
    return (
        f"The structure failed in {fell} runs, which counts as a passage. {ended} runs ended early for another reason; they count "
        "as censored at their end."
    )


def _drawings(material: RunsMaterial) -> list[Drawing]:
    study = material.results.get(ParameterStudy)
    if study is None:
        return []
    result: list[Drawing] = [functools.partial(_distributions, study)]
    for number, passages in enumerate(study.passages):
        if not passages.passed.any():
            continue
        result.append(functools.partial(_times, study, number, False))
        if study.above:
            result.append(functools.partial(_times, study, number, True))
        if study.runs.design.space.dimension > 1:
            result.append(functools.partial(_pairs, study, number))
        probability = study.probabilities[number]
        if probability is not None and len(study.leading_pair(number)) == 2:
            result.append(functools.partial(_map, study, number, probability))
    if study.sensitivities:
        result.append(functools.partial(_bars, study))
    return result


def _distributions(study: ParameterStudy) -> Picture:
    time = np.linspace(0.0, max(result.followed.max() for result in study.passages), 600)
    curves = [(_limit(study, i), *result.distribution(time)) for i, result in enumerate(study.passages)]
    figure = figures.distributions(time, curves)
    caption = "Fraction of the runs that have passed the limit, by the product-limit estimate, ± 2 standard errors."
    return Picture("passages_in_time", caption, figure)


def _times(study: ParameterStudy, number: int, filtered: bool) -> Picture:
    result, space = study.passages[number], study.runs.design.space
    rows = study.inside if filtered else np.ones(len(result), dtype=bool)
    points = np.asarray(result.design.values)[rows] / space.factors
    units = tuple(space.units.values())
    name = f"passages_{number + 1}_times{'_of_a_part' if filtered else ''}"
    figure = figures.times(points, space.names, units, result.time[rows], float(result.followed.max()))
    which = f" of the runs with {_above(study)}" if filtered else ""
    caption = (
        f"First-passage times of {_limit(study, number)}{which} against each parameter. "
        "Runs without a passage are above the line."
    )
    return Picture(name, caption, figure)


def _pairs(study: ParameterStudy, number: int) -> Picture:
    result, space = study.passages[number], study.runs.design.space
    points, name = np.asarray(result.design.values) / space.factors, f"passages_{number + 1}_pairs"
    figure = figures.pairs(points, space.names, tuple(space.units.values()), result.time)
    return Picture(name, f"First-passage times of {_limit(study, number)} over pairs of parameters.", figure)


def _map(study: ParameterStudy, number: int, probability: PassageProbability) -> Picture:
    result, space = study.passages[number], study.runs.design.space
    names, points = coordinate_names(space), coordinates_of(space, result.design.values)
    first, second = study.leading_pair(number)
    middle = np.median(points, axis=0)
    scale = np.ones(len(names)) if space.coordinates else space.factors
    units = ("",) * len(names) if space.coordinates else tuple(space.units.values())

    def at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        where = np.tile(middle, (x.size, 1))
        where[:, first], where[:, second] = x.ravel() * scale[first], y.ravel() * scale[second]
        return probability.at_coordinates(where).reshape(x.shape)

    name = f"passages_{number + 1}_probability"
    figure = figures.probability_map(
        points[:, [first, second]] / scale[[first, second]],
        [names[first], names[second]],
        [units[first], units[second]],
        result.passed,
        probability.at_coordinates(points),
        at,
    )
    caption = (
        f"Probability of a passage of {_limit(study, number)} over the two {'coordinates' if space.coordinates else 'parameters'} "
        f"that best separate runs with and without a passage; the other {'coordinates' if space.coordinates else 'parameters'} are "
        "at their medians. Right: mean probability and observed fraction of passages, in forty groups of runs along the first axis."
    )
    return Picture(name, caption, figure)


def _bars(study: ParameterStudy) -> Picture:
    groups = [
        (label(f"largest {pretty(c)}", ""), s.first, s.total, s.first_error, s.total_error)
        for c, s in study.sensitivities.items()
    ]
    figure = figures.indices(study.runs.design.space.names, groups)
    return Picture("sobol_indices", "Sobol' indices, with 95 % intervals.", figure)


SECTION = Section(
    "parameters-and-passages", "Parameters and first passages", _drawings, _tables, _words, of_draws=False
)
"""Results of runs over the priors, independent of any measurement."""
