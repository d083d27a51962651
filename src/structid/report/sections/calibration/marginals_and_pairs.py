"""The posterior: marginals, pairs, identifiability, priors."""

from __future__ import annotations

import functools

import numpy as np

from structid.core.streams import Purpose, derived_seed
from structid.figures import posterior as figures
from structid.figures.style import pretty
from structid.inference.diagnostics.identifiability import Identifiability
from structid.report.material.material import PosteriorMaterial
from structid.report.section import NEAREST, Drawing, Picture, Section, Table
from structid.report.tables import moments, number


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    drawings = [functools.partial(_marginals, material), functools.partial(_pairs, material)]
    if material.information is not None:
        drawings.append(functools.partial(_identifiability, material.information))
    return list(drawings)


def _marginals(material: PosteriorMaterial) -> Picture:
    result, space, shown = material.result, material.posterior.space, material.posterior.shown
    factors, names, units = space.factors, space.names, list(space.units.values())
    truth = {n: v / factors[names.index(n)] for n, v in material.true_values.items()}
    prior = space.sample(4000, seed=derived_seed(result.seed, Purpose.PRIOR_DRAWS)).values / factors
    figure = figures.marginals(
        tuple(names[i] for i in shown),
        [units[i] for i in shown],
        prior[:, shown],
        (result.thinned(20_000) / factors)[:, shown],
        [tuple(space.bounds[i] / factors[i]) for i in shown],
        (material.best / factors)[shown],
        truth,
    )
    dotted = " Dotted: true values." if truth else ""
    return Picture("marginals", f"Priors (with samples) and posterior marginals.{dotted}", figure)


def _pairs(material: PosteriorMaterial) -> Picture:
    space, shown = material.posterior.space, material.posterior.shown
    draws = (material.result.thinned(20_000) / space.factors)[:, shown]
    names, units = tuple(space.names[i] for i in shown), [list(space.units.values())[i] for i in shown]
    figure = figures.pairs(names, units, draws, (material.best / space.factors)[shown])
    return Picture("pairs", "Pairs of parameters, with correlations above the diagonal; + marks the MAP.", figure)


def _identifiability(information: Identifiability) -> Picture:
    figure = figures.identifiability(information.names, information.eigenvalues, information.eigenvectors)
    return Picture("identifiability", "Fisher information at the MAP estimate: information in the data.", figure)


def _tables(material: PosteriorMaterial) -> list[Table]:
    hidden = material.posterior.hidden
    marginals = material.posterior.space.marginals
    priors = [[pretty(name), str(prior)] for name, prior in marginals.items() if name not in hidden]
    tables = [
        *_in_coordinates(material),
        Table("Priors", (["parameter", "prior"], priors), of_words=True),
    ]
    information = material.information
    if information is None:
        return tables
    rows = [[str(i + 1), f"{v:.3g}", information.combination(i)] for i, v in enumerate(information.eigenvalues)]
    heads = ["combination", "information / prior", "weights, in prior standard deviations"]
    return [Table("Identifiability at the MAP estimate", (heads, rows)), *tables]


def _in_coordinates(material: PosteriorMaterial) -> list[Table]:
    """Table of the posterior in the study's coordinates, which affect the responses more simply than the parameters."""
    space = material.posterior.space
    if not space.coordinates:
        return []
    draws, weights = material.weighted_draws
    values = np.asarray(space.in_coordinates(draws))
    mean, sd, low, high = moments(values, weights)
    has_truth = set(material.true_values) >= set(material.posterior.model_space.names)
    truth = None
    if has_truth:
        of_the_model = [material.true_values.get(name, np.nan) for name in space.names]
        truth = np.asarray(space.in_coordinates(np.array(of_the_model)))
    heads = ["coordinate", "mean", "sd", "5 %", "95 %", *(["truth"] if has_truth else [])]
    rows = [
        [pretty(name), *(number(float(v), float(sd[i])) for v in (mean[i], sd[i], low[i], high[i]))]
        + ([] if truth is None else [number(float(truth[i]), float(sd[i]))])
        for i, name in enumerate(space.coordinates)
    ]
    return [Table("Posterior in the coordinates of the study, computed from parameters in SI", (heads, rows))]


def _words(material: PosteriorMaterial) -> list[str]:
    information = material.information
    if information is None or not information.unseen:
        return []
    return [f"The data contain less information than the prior about {'; '.join(information.unseen)}."]


SECTION = Section("posterior", "Posterior", _drawings, _tables, _words, NEAREST)
