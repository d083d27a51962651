"""Section of a cyclic test: posterior of the chosen law's parameters."""

from __future__ import annotations

from functools import partial

from structid.core.streams import Purpose, derived_seed
from structid.core.units import label
from structid.core.wording import listed
from structid.figures import posterior as figures
from structid.figures.style import pretty, pretty_unit
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.section import NEAREST, Drawing, Picture, Section, Table
from structid.report.tables import lines_without_markers, number


def _words(material: CyclicMaterial) -> list[str]:
    lines = lines_without_markers(str(material.choice.result.verdict()))
    return [
        "The model itself was sampled. No surrogate was used, so no certificate is needed.",
        *lines,
        *_unidentified(material),
        *_not_reached(material),
    ]


def _unidentified(material: CyclicMaterial) -> list[str]:
    names = [pretty(name) for name in material.choice.unidentified]
    if not names:
        return []
    return [f"The test does not identify {', '.join(names)}: the posterior is nearly as wide as the prior."]


def _not_reached(material: CyclicMaterial) -> list[str]:
    names = [pretty(name) for name in material.choice.not_reached]
    if not names:
        return []
    test = material.test
    return [
        f"The test does not reach {listed(names, 'or')}: its largest force is {1e-3 * test.largest_force:.3g} kN, its largest "
        f"displacement {1e3 * test.largest_displacement:.3g} mm. Such a value only shapes the curve below it."
    ]


def _tables(material: CyclicMaterial) -> list[Table]:
    result = material.choice.result
    described = material.choice.chosen.law.parameters()
    summary, marginals = result.summary(), result.target.space.marginals  # type: ignore[attr-defined]
    rows = []
    for i, (name, unit) in enumerate(zip(summary.names, summary.units, strict=True)):
        c = {key: float(column[i]) for key, column in summary.columns.items()}
        shown = [number(c[key], c["sd"]) for key in ("mean", "q05", "q95")]
        meaning = described[name].meaning if name in described else ""
        rows.append([label(pretty(name), pretty_unit(unit)), shown[0], f"{c['sd']:.2g}", *shown[1:], meaning])
    priors = [[pretty(name), str(prior)] for name, prior in marginals.items()]
    return [
        Table("Posterior", (["parameter", "mean", "sd", "5 %", "95 %", "meaning"], rows)),
        Table("Priors, from the scales of the test", (["parameter", "prior"], priors), of_words=True),
    ]


def _marginals(material: CyclicMaterial) -> Picture:
    result = material.choice.result
    space, count = result.target.space, len(material.choice.chosen.fit.model.free)  # type: ignore[attr-defined]
    factors, names, units = space.factors, space.names, list(space.units.values())
    prior = space.sample(4000, seed=derived_seed(result.seed, Purpose.PRIOR_DRAWS)).values / factors
    bounds = [tuple(space.bounds[i] / factors[i]) for i in range(count)]
    figure = figures.marginals(
        names[:count],
        units[:count],
        prior[:, :count],
        (result.flat / factors)[:, :count],
        bounds,
        material.choice.chosen.fit.best / factors[:count],
        {},
    )
    return Picture("marginals", "Priors and posterior marginals of the chosen law.", figure)


def _drawings(material: CyclicMaterial) -> list[Drawing]:
    return [partial(_marginals, material)]


SECTION: Section[CyclicMaterial] = Section(
    "parameters", "Parameters of the chosen law", _drawings, _tables, _words, under_doubt=NEAREST
)
