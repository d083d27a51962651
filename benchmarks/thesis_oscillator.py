"""Chapter 3 of the thesis: the hysteretic oscillator, its calibration, and its metamodels."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import common
import numpy as np
from thesis_rows import Chapter, Clock, Row, el_centro, figures_folder, interval, joined

import structid as si
from structid.figures import posterior as figures
from structid.figures.response import bands
from structid.surrogates.narx.structure.candidate_terms import absolute_terms

THESIS_PGA = 3.59
"""PGA of the thesis's record [m/s²]."""
START = np.array([[5.0e6, 57.0, 0.0, 0.5]])
"""Starting point of the thesis's deterministic searches: k_i, β, γ, α."""
PUBLISHED = si.AIES(
    walkers=100, steps=700, ensembles=1, discard=0.5, differential_evolution=0.0, start_candidates=1, settling_steps=0
)
"""The thesis's sampler: one ensemble from draws of the prior, only stretch moves, 70 000 runs, first half discarded."""
CONVERGED = si.AIES(
    walkers=32,
    ensembles=4,
    steps=3000,
    discard=0.25,
    differential_evolution=0.8,
    start_candidates=10,
    settling_steps=500,
)
SEVERAL_MODES = si.SMC(particles=1000)
"""Sampler for posteriors with several modes, for which an ensemble does not converge."""
PARAMETERS = ("stiffness", "beta", "gamma_ratio", "alpha", "sigma2")
SYMBOLS = ("k_i", "β", "γ*", "α", "σ²")
SCALES = (1e-6, 1.0, 1.0, 1.0, 1e4)
"""Factors from SI to the thesis's units: kN/mm, 10⁻³/mm, –, –, 10⁻⁴ (m/s)²."""


def degrading(record: si.GroundMotion, *channels: str) -> np.ndarray:
    """Response of the thesis's experiment (time, channel)."""
    return common.degrading_oscillator(substeps=1, channels=channels).simulate(np.zeros((1, 0)), record).values[0]


def calibrated(space: si.ParameterSpace) -> si.BoucWen:
    """The calibrated model, an oscillator without degradation."""
    return si.BoucWen(mass=common.MASS, damping_ratio=common.DAMPING_RATIO, free=space.names, substeps=1)


# --- experiment and prior information -----------------------------------------------------------------------------


def linear_limit(folder: Path) -> Row:
    sys.path.insert(0, str(common.ROOT / "examples"))
    import linear_limit as example

    difference = example.main(folder / "linear_limit")
    return Row(
        "F 3.3",
        "linear limit compared with Duhamel's integral",
        "“yes”, to 2 mm",
        "–",
        f"{difference:.1e} of the norm",
        "the thesis compares peaks; structid compares the whole history",
    )


def loop(record: si.GroundMotion, folder: Path) -> Row:
    lines = si.LoopLines.fit(*degrading(record, "displacement", "restoring_force").T)
    lines.plot(folder / "loop")
    low, high = (end * 1e-6 for end in lines.initial_interval)
    first, last = lines.alpha_interval
    held = ["contains" if low < 7.6 < high else "misses", "contains" if first < common.ALPHA < last else "misses"]
    return Row(
        "F 3.7",
        "two lines through the measured loop",
        joined(["k_i 7.42 kN/mm", "α 0.063"]),
        joined([f"k_i {lines.initial_stiffness * 1e-6:.2f} kN/mm", f"α {lines.alpha:.3f}"]),
        joined(
            [
                f"k_i {low:.2f} to {high:.2f}, {held[0]} the true 7.6",
                f"α {first:.3f} to {last:.3f}, {held[1]} the true 0.05",
            ]
        ),
        "another record; the slopes of a smooth loop depend on the range of the lines. For twelve records at two PGAs, 80 of 92 "
        "intervals contain α",
    )


# --- deterministic calibration ------------------------------------------------------------------------------------


def searches(record: si.GroundMotion, starts: int) -> Row:
    """Table 3.3: both methods from the thesis's starting point, and from several starting points."""
    space = si.ParameterSpace(
        stiffness=si.Uniform(4.27, 11.85, unit="kN/mm"),
        beta=si.Uniform(55.0, 65.0, unit="1/m"),
        gamma=si.Uniform(-65.0, 65.0, unit="1/m"),
        alpha=si.Uniform(0.0, 1.0),
    )
    velocity = degrading(record, "velocity")
    misfit = si.Posterior(space, calibrated(space), si.Observation(record, velocity)).misfit
    bounds = ("gamma <= beta", "-beta <= gamma")

    def told(result: Any) -> str:
        k, beta, gamma, alpha = result.best.theta
        share = result.best.value / misfit.scale
        return f"k_i {k * 1e-6:.2f}, β {beta:.1f}, γ {gamma:.1f}, α {alpha:.4f}, J {share:.4f} Σy²"

    one, many, found = [], [], []
    for name, search in (("pattern", si.optimize.pattern_search), ("interior point", si.optimize.interior_point)):
        one.append(f"{name}: {told(search(misfit, constraints=bounds, starts=START, seed=1))}")
        several = search(misfit, constraints=bounds, starts=starts, seed=1)
        reached = int(np.sum(several.values < 1.001 * several.best.value))
        many.append(f"{name}: {told(several)}, from {reached} of {starts} starts")
        found.append(several.best.theta)
    apart = float((np.abs(found[0] - found[1]) / np.ptp(space.bounds, axis=1)).max())
    return Row(
        "T 3.3, F 3.5, 3.6",
        "identified parameters, no degradation in the model",
        joined(["pattern: k_i 4, β 65, γ −23, α 0", "interior point: k_i 5.00, β 57, γ 0, α 0.5"]),
        joined(one),
        joined([*many, f"both minima differ by {apart:.0e} of the ranges"]),
        "the printed interior-point result is the starting point, so this search did not move. There is one best minimum, not two",
    )


# --- posteriors ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sampled:
    """A sampled posterior, and the time of sampling."""

    result: si.SamplingResult
    seconds: float

    @property
    def moments(self) -> list[str]:
        """Mean ± sd of every parameter in the thesis's units."""
        return [
            f"{symbol} {interval(self.result.mean[i] * scale, self.result.sd[i] * scale)}"
            for symbol, scale, i in zip(SYMBOLS, SCALES, self._columns, strict=True)
        ]

    @property
    def quantiles(self) -> list[str]:
        """5 and 95 % quantiles of every parameter, and the MAP estimate."""
        low, high = self.result.quantile(np.array([0.05, 0.95]))
        return [
            f"{symbol} {low[i] * s:.4g} to {high[i] * s:.4g}, MAP {self.result.map_estimate[i] * s:.4g}"
            for symbol, s, i in zip(SYMBOLS, SCALES, self._columns, strict=True)
        ]

    @property
    def _columns(self) -> list[int]:
        return [self.result.names.index(name) for name in PARAMETERS]

    @property
    def convergence(self) -> str:
        """Kept steps divided by the longest autocorrelation time, and the verdict."""
        tau = float(np.max(self.result.summary().columns["tau"]))
        return f"length {len(self.result.kept) / tau:.0f} × autocorrelation time, {self.verdict}"

    @property
    def verdict(self) -> str:
        """Whether the sampler has converged."""
        return "converged" if self.result.verdict().converged else "not converged"

    @property
    def stuck(self) -> int:
        """Number of walkers whose mean stiffness is more than five standard deviations from the median."""
        means = self.result.kept[..., 0].mean(axis=0).ravel()
        spread = 1.4826 * np.median(np.abs(means - np.median(means)))
        return int(np.sum(np.abs(means - np.median(means)) > 5.0 * max(spread, 1e-9 * means.mean())))


def sampled(model: Any, space: si.ParameterSpace, measured: si.Observation, sampler: Any, seed: int) -> Sampled:
    posterior = si.Posterior(space, model, measured, si.IID())
    began = time.perf_counter()
    result = si.sample(posterior, sampler, seed=seed)
    return Sampled(result, time.perf_counter() - began)


def posteriors(record: si.GroundMotion, clock: Clock, folder: Path, quick: bool) -> list[Row]:
    """Tables 3.5 to 3.7: the model itself, PC-NARX and Kriging-NARX, by the published and by the best method."""
    space = common.study_space()
    model = calibrated(space)
    measured = si.Observation(record, degrading(record, "velocity"))
    runs = si.Campaign(model, record, space.sample(40 if quick else 1000, 1)).run()
    published, best = (small(PUBLISHED), small(CONVERGED)) if quick else (PUBLISHED, CONVERGED)
    settings = dict(terms=absolute_terms(), training="per-experiment", selection="lars", most_terms=10, limit=10.0)
    few = si.Campaign(model, record, space.sample(90 if quick else 500, 1, "sobol", 2.0)).run()
    models: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
        "the model": (lambda: model, lambda: model),
        "PC-NARX": (lambda: si.PCNARX(**settings).fit(runs), lambda: si.PCNARX(limit=10.0).fit(few)),
        "Kriging-NARX": (lambda: si.KrigingNARX(**settings).fit(runs), lambda: si.KrigingNARX(limit=10.0).fit(few)),
    }
    printed = {
        "the model": (
            "T 3.5, F 3.9–3.11",
            (4.5, 0.018),
            (65, 0.36),
            (-0.38, 0.25),
            (0.035, 0.0053),
            (2.0, 0.047),
            "33 h",
        ),
        "PC-NARX": (
            "T 3.6, F 3.17–3.19",
            (4.6, 0.11),
            (61, 1.7),
            (-0.14, 0.19),
            (0.043, 0.0098),
            (2.0, 0.051),
            "55 min",
        ),
        "Kriging-NARX": (
            "T 3.7, F 3.20–3.22",
            (4.5, 0.01),
            (64, 0.25),
            (-0.22, 0.014),
            (0.023, 0.0025),
            (1.9, 0.039),
            "18 h",
        ),
    }
    why = {
        "the model": "another record; after 700 steps some walkers of the ensemble have not left their start, which widens the "
        "posterior. The printed sd of γ* (0.25) is inconsistent with its quantiles (−0.42 to −0.34)",
        "PC-NARX": "4001 samples make the posterior narrow (0.2 % in k_i), so that a response error of 0.8 % shifts it. "
        "Polynomials of high degree oscillate, and the chains find several modes, as in the thesis",
        "Kriging-NARX": "the response error of 0.5 % is smooth in the parameters: the posterior has one mode, several sds away "
        "from the mode of the model",
    }
    rows = []
    for name, (as_published, as_we_can) in models.items():
        place, *moments, hours = printed[name]
        fitted, better = as_published(), as_we_can()
        ways = {"published": (fitted, published), "best": (better, best)}
        if fitted is not better:  # separates the error of the metamodel from the error of the sampler
            ways["published, by SMC"] = fitted, si.SMC(particles=40, steps=3) if quick else SEVERAL_MODES
        found = {way: sampled(of, space, measured, sampler, 1) for way, (of, sampler) in ways.items()}
        for way, of in found.items():
            clock(f"{name}, {way}: {of.seconds:.1f} s of sampling, {of.convergence}")
        one, other = found["published"], found["best"]
        alone = found.get("published, by SMC")
        converged = [] if alone is None else [f"by SMC, {alone.verdict}:", *alone.moments[:4]]
        told = [f"{s} {interval(*m)}" for s, m in zip(SYMBOLS, moments, strict=True)]
        rows.append(
            Row(
                place,
                f"posterior under {name}; k_i in kN/mm, β in 10⁻³/mm, σ² in 10⁻⁴ (m/s)²",
                joined([*told, hours]),
                joined(
                    [*one.moments, one.convergence, f"{one.stuck} walkers stuck", f"{one.seconds:.1f} s", *converged]
                ),
                joined([*other.moments, other.convergence, f"{other.seconds:.1f} s"]),
                why[name],
            )
        )
        pictures(other if name == "the model" else one, name, folder)
        if name == "the model":
            rows.append(
                Row(
                    "T 3.5",
                    "5 and 95 % quantiles, and MAP estimates, of this posterior",
                    joined(
                        [
                            "k_i 4.4 to 4.5, MAP 4.4",
                            "β 64 to 65, MAP 64",
                            "γ* −0.42 to −0.34, MAP −0.40",
                            "α 0.027 to 0.044, MAP 0.031",
                            "σ² 1.9 to 2.1, MAP 2",
                        ]
                    ),
                    joined(one.quantiles),
                    joined(other.quantiles),
                    "see the row above",
                )
            )
    return rows


def small(sampler: Any) -> Any:
    """Return the sampler with as few walkers and steps as possible."""
    return replace(sampler, walkers=20, steps=40, settling_steps=0, start_candidates=1)


def pictures(of: Sampled, name: str, folder: Path) -> None:
    """Draw traces, marginals and pairs, and the response at the MAP estimate with its band."""
    key = name.lower().replace(" ", "_").replace("-", "_")
    result, factors = of.result, of.result.target.factors
    names, units = result.names, list(result.target.units.values())
    history = result.history / factors
    figures.traces(names, units, history, result.discarded, save=folder / f"traces_{key}")
    figures.pairs(
        names, units, result.thinned(8000) / factors, result.map_estimate / factors, save=folder / f"pairs_{key}"
    )
    posterior = result.target
    assert isinstance(posterior, si.Posterior)
    prediction, [observation] = result.predict(draws=200), posterior.observations
    best = posterior.predict(result.map_estimate[None])[0, :, 0] * 1e3
    inner, outer = (
        tuple(1e3 * edge[:, 0] for edge in prediction.band(discrepancy=discrepancy)) for discrepancy in (False, True)
    )
    bands(
        prediction.time,
        1e3 * observation.values[:, 0],
        best,
        inner,
        outer,
        "velocity",
        "mm/s",
        save=folder / f"response_{key}",
    )


# --- metamodels ---------------------------------------------------------------------------------------------------


def metamodels(record: si.GroundMotion, clock: Clock, folder: Path, quick: bool) -> list[Row]:
    """Figures 3.12 to 3.16: NARX by the published method, and by the method of structid."""
    space = common.study_space()
    model = calibrated(space)
    runs = si.Campaign(model, record, space.sample(60 if quick else 1000, 1)).run()
    unseen = si.Campaign(model, record, space.sample(50 if quick else 10_000, 2, "random")).run()
    widened = si.Campaign(model, record, space.sample(90 if quick else 500, 1, "sobol", 2.0)).run()
    rows, found = [], {}
    for most in (10, 15):
        settings = dict(
            terms=absolute_terms(), training="per-experiment", selection="lars", most_terms=most, limit=10.0
        )
        for kind in (si.PCNARX, si.KrigingNARX):
            surrogate = kind(**settings).fit(runs)
            found[kind.__name__, most] = surrogate, surrogate.validate(unseen)
            clock(f"{kind.__name__} as published, {len(surrogate.terms)} terms: {surrogate.validation}")
    ours = {kind.__name__: kind().fit(widened) for kind in (si.PCNARX, si.KrigingNARX)}
    for name, surrogate in ours.items():
        clock(f"{name}: {surrogate.validate(unseen)}")
    pc, more = found["PCNARX", 10][0], found["KrigingNARX", 15][0]
    own, of_more = (s.validate_structure(runs, refined=False) for s in (pc, more))
    best = ours["KrigingNARX"].validate_structure(runs)
    own.plot(save=folder / "narx_over_the_design")
    pc.plot_coefficients(runs[:200], folder / "coefficients", refined=False)
    pc.validation.plot(save=folder / "pc_narx")
    ours["PCNARX"].validation.plot(save=folder / "pc_narx_best")
    rows.append(
        Row(
            "F 3.12, 3.13",
            "NARX alone: free runs over the design of 1000, coefficients of each run by least squares",
            "ε̄ 7.74e-3, 10 terms",
            joined([f"ε̄ {own.mean:.2e}, {len(pc.terms)} terms", f"ε̄ {of_more.mean:.2e}, {len(more.terms)} terms"]),
            f"ε̄ {best.mean:.1e}",
            "structid uses terms with a hysteretic memory, and refines coefficients on the free run",
        )
    )
    loo = {most: found["PCNARX", most][0].coefficients.deviation.leave_one_out_error for most in (10, 15)}
    kriging = {most: found["KrigingNARX", most][0].coefficients.deviation for most in (10, 15)}
    errors = {most: np.asarray(getattr(k, "leave_one_out_error", np.nan)) for most, k in kriging.items()}
    rows.append(
        Row(
            "F 3.14",
            "leave-one-out errors of the coefficients",
            joined(["PCE below 9.77e-3", "Kriging 4.39e-3"]),
            joined(
                [
                    f"PCE {loo[m].min():.1e} to {loo[m].max():.1e}, Kriging {np.nanmin(errors[m]):.1e} to "
                    f"{np.nanmax(errors[m]):.1e}, {len(found['PCNARX', m][0].terms)} terms"
                    for m in (10, 15)
                ]
            ),
            "–",
            "structid trains all coefficients together, and interpolates none separately",
        )
    )

    def told(name: str, most: int) -> str:
        surrogate, validation = found[name, most]
        lost = f", {validation.diverged} diverged" if validation.diverged else ""
        mean = validation.overall[np.isfinite(validation.overall)].mean()
        return f"{'PC' if name == 'PCNARX' else 'Kriging'}, {len(surrogate.terms)} terms: {mean:.2e}{lost}"

    rows.append(
        Row(
            "F 3.15, 3.16",
            f"mean error over {len(unseen):,} validation runs",
            joined(["PC 9.66e-3", "Kriging 9.00e-3"]),
            joined(told(name, most) for most in (10, 15) for name in ("PCNARX", "KrigingNARX")),
            joined([f"PC {ours['PCNARX'].validation.mean:.1e}", f"Kriging {ours['KrigingNARX'].validation.mean:.1e}"]),
            "the published error comes from the terms; structid trains on the free run, with a hysteretic memory",
        )
    )
    return rows


def chapter(clock: Clock, quick: bool) -> Chapter:
    """Return all rows and pictures of chapter 3.

    Parameters
    ----------
    clock : Clock
        Prints the time of each part.
    quick : bool
        Whether the run is as short as possible.

    Returns
    -------
    Chapter
        Rows and pictures.
    """
    folder = figures_folder(quick)
    strong, study = el_centro(THESIS_PGA), el_centro(common.STUDY_PGA)
    strong.plot(folder / "record")
    si.GroundMotion.read(common.EL_CENTRO).trim(0.0, 40.0).scale_to_pga(THESIS_PGA).plot_filter(
        strong, folder / "filter"
    )
    experiment = common.degrading_oscillator(substeps=1)
    experiment.plot_response(strong, save=folder / "experiment")
    space = common.study_space()
    space.sample(700, 1).plot(folder / "prior")
    frequency = experiment.properties()["f"]
    rows = [
        Row(
            "T 3.1, F 3.4",
            "the simulated experiment",
            "f ≈ 4 Hz",
            f"f {frequency:.3f} Hz",
            "–",
            "same numbers; δ_ν is 2.43 in the thesis and 2.3 in its code",
        ),
        Row("F 3.2", "the record", "PGA 3.59 m/s²", f"PGA {strong.pga:.2f} m/s²", "–", "El Centro replaces it"),
        linear_limit(folder),
        Row("T 3.2", "ranges of the searches", "k_i 4.27 to 11.85, β 55 to 65, |γ| ≤ β, α 0 to 1", "the same", "–", ""),
    ]
    clock("figures of the experiment")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", si.StructidWarning)
        rows.append(searches(study, 2 if quick else 8))
        clock("deterministic searches")
        rows += [
            loop(strong, folder),
            Row(
                "T 3.4, F 3.8",
                "priors, and their samples",
                "sd of k_i 0.1 kN/mm",
                "sd of k_i 0.742 kN/mm",
                "–",
                "the value is a coefficient of variation; as an sd, it would place the printed posterior 29 sds away",
            ),
        ]
        rows += metamodels(strong, clock, folder, quick)
        rows += posteriors(study, clock, folder, quick)
    words = (
        "El Centro 1940 replaces the thesis's record, Montenegro 1979, which is not available. It has the same filter and the "
        "same PGA of 3.59 m/s². At this PGA, El Centro damages the structure so much that the model without degradation "
        "explains a quarter of its response. Posteriors are therefore computed at a PGA of 1.8 m/s², where the fit is as good "
        "as in the thesis. As in the thesis, searches and posteriors use the exact response as data."
    )
    drawn = (
        ("record", "F 3.2: the substitute record and its spectrum."),
        ("filter", "The record of F 3.2 before and after its filter at 20 Hz."),
        ("linear_limit", "F 3.3: the linear limit compared with Duhamel's integral."),
        ("experiment", "F 3.4: the simulated experiment."),
        ("loop", "F 3.7: two lines through the loop of the experiment."),
        ("prior", "F 3.8: samples of the priors, by Latin hypercube."),
        ("narx_over_the_design", "F 3.12, 3.13: free runs of the NARX (published method) at the points of its design."),
        ("coefficients", "F 3.14: coefficients of PC-NARX (published method) against coefficients fitted to each run."),
        ("pc_narx", "F 3.15, 3.16: predictions of PC-NARX (published method) for validation runs."),
        ("pc_narx_best", "Predictions of PC-NARX (default settings) for validation runs."),
        ("traces_the_model", "F 3.9: converged traces of the posterior under the model itself."),
        ("pairs_the_model", "F 3.10: the posterior under the model itself."),
        ("response_the_model", "F 3.11: the response at the MAP estimate, with its band."),
        ("traces_pc_narx", "F 3.17: traces of the posterior under PC-NARX (published method)."),
        ("pairs_pc_narx", "F 3.18: the posterior under PC-NARX."),
        ("response_pc_narx", "F 3.19: the response of PC-NARX."),
        ("traces_kriging_narx", "F 3.20: traces of the posterior under Kriging-NARX (published method)."),
        ("pairs_kriging_narx", "F 3.21: the posterior under Kriging-NARX."),
        ("response_kriging_narx", "F 3.22: the response of Kriging-NARX."),
    )
    return Chapter("Chapter 3: the hysteretic oscillator", words, tuple(rows), drawn)
