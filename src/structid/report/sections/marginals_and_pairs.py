"""The posterior: marginals, pairs, what the data see, priors."""

from __future__ import annotations

import functools
from pathlib import Path

from structid.figures import posterior as figures
from structid.figures.style import pretty
from structid.inference.assessment.identifiability import Identifiability
from structid.report.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.streams import Purpose, derived_seed


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    drawings = [functools.partial(_marginals, material), functools.partial(_pairs, material)]
    if material.information is not None:
        drawings.append(functools.partial(_identifiability, material.information))
    return list(drawings)


def _marginals(material: PosteriorMaterial, folder: Path) -> Picture:
    result, space = material.result, material.posterior.space
    factors, names = space.factors, space.names
    truth = {n: v / factors[names.index(n)] for n, v in material.true_values.items()}
    figures.marginals(
        names,
        list(space.units.values()),
        space.sample(4000, seed=derived_seed(result.seed, Purpose.PRIOR_DRAWS)).values / factors,
        result.thinned(20_000) / factors,
        [tuple(b / f) for b, f in zip(space.bounds, factors, strict=True)],
        material.best / factors,
        truth,
        save=folder / "marginals",
    )
    return Picture(
        "marginals", "Priors (with samples) and posterior marginals." + (" Dotted: the truth." if truth else "")
    )


def _pairs(material: PosteriorMaterial, folder: Path) -> Picture:
    space = material.posterior.space
    draws = material.result.thinned(20_000) / space.factors
    units = list(space.units.values())
    figures.pairs(space.names, units, draws, material.best / space.factors, save=folder / "pairs")
    return Picture("pairs", "Pairs of parameters, their correlation above the diagonal; + is the MAP.")


def _identifiability(information: Identifiability, folder: Path) -> Picture:
    figures.identifiability(
        information.names, information.eigenvalues, information.eigenvectors, save=folder / "identifiability"
    )
    return Picture("identifiability", "What the data see: Fisher information at the MAP estimate.")


def _tables(material: PosteriorMaterial) -> list[Table]:
    priors = [[pretty(name), str(prior)] for name, prior in material.posterior.space.marginals.items()]
    tables = [Table("Priors", (["parameter", "prior (native parameters)"], priors), of_words=True)]
    information = material.information
    if information is None:
        return tables
    rows = [[str(i + 1), f"{v:.3g}", information.combination(i)] for i, v in enumerate(information.eigenvalues)]
    heads = ["combination", "information / prior's", "in prior standard deviations"]
    return [Table("Identifiability at the MAP estimate", (heads, rows)), *tables]


def _words(material: PosteriorMaterial) -> list[str]:
    information = material.information
    if information is None or not information.unseen:
        return []
    return [f"The data say less than the prior about: {'; '.join(information.unseen)}."]


SECTION = Section("posterior", "Posterior", _drawings, _tables, _words)
