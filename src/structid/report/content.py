"""What a report shows, gathered once from a result, and its figures as files."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from structid.calibration.calibration_result import CalibrationResult
from structid.channels import standard_unit
from structid.errors import InputError
from structid.figures import calibration as calibration_figures
from structid.figures import loops as loop_figures
from structid.figures import posterior as posterior_figures
from structid.figures import response as response_figures
from structid.ground_motion.record import GroundMotion
from structid.inference.assessment.identifiability import Identifiability, identifiability
from structid.inference.assessment.prediction import Prediction, predict
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult, Summary
from structid.models.face import Model
from structid.optimize.minima import OptimizeResult
from structid.runs import Runs
from structid.streams import Purpose, derived_seed
from structid.surrogates.face import Surrogate
from structid.units import factor

LOOP_DRAWS = 40
"""Draws whose loops are drawn thin behind the MAP estimate's."""
RUNS_CAPTION = (
    "Left: the responses of the design; at each time the bands hold 50 and 90 % of the runs. Right: the design."
)
"""What the figure of a campaign shows."""


@dataclass(frozen=True)
class OtherRecord:
    """Prediction for a record that was not measured.

    Parameters
    ----------
    name : str
        The record.
    prediction : Prediction
        Draws of the response.
    best : ndarray, shape (time, channel)
        Response at the MAP estimate.
    """

    name: str
    prediction: Prediction = field(repr=False)
    best: np.ndarray = field(repr=False)


@dataclass(frozen=True, eq=False)
class ReportContent:
    """Everything a report shows.

    Parameters
    ----------
    result : SamplingResult
        Of a `Posterior`.
    searches : dict of str to OptimizeResult
        Deterministic calibrations by method.
    raw_record, record : GroundMotion
        First record before and after processing.
    title, settings : str
        Title, and the study file's text.
    true_values : dict of str to float
        True parameters of a virtual experiment, in SI.
    truth_loops : tuple
        For each observation displacement, force and energy of the true model, or None.
    best_predictions : tuple of ndarray
        For each observation the MAP prediction (time, channel).
    predictions : tuple of Prediction
        For each observation.
    loops : tuple
        For each observation the loop channels of MAP and of draws (draw, time, channel), or None.
    search_loops : dict of str to ndarray, shape (time, channel)
        Loop channels at the best minimum of every method.
    information : Identifiability or None
        Fisher information at the MAP estimate.
    others : tuple of OtherRecord
        Predictions for other records.
    runs : Runs or None
        The study's campaign.
    model : Model
        The model itself.
    surrogate : Surrogate or None
        What was sampled in its place.
    calibration : CalibrationResult or None
        Certificate and rounds.
    figures : list of tuple of str
        Section, file name and caption of every figure drawn so far.
    """

    result: SamplingResult
    searches: dict[str, OptimizeResult]
    raw_record: GroundMotion
    record: GroundMotion
    title: str
    settings: str
    true_values: dict[str, float]
    truth_loops: tuple[np.ndarray | None, ...]
    best_predictions: tuple[np.ndarray, ...]
    predictions: tuple[Prediction, ...]
    loops: tuple[np.ndarray | None, ...]
    search_loops: dict[str, np.ndarray]
    information: Identifiability | None
    others: tuple[OtherRecord, ...]
    model: Model
    runs: Runs | None = None
    surrogate: Surrogate | None = None
    calibration: CalibrationResult | None = None
    figures: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def posterior(self) -> Posterior:
        """The posterior that was sampled."""
        assert isinstance(self.result.target, Posterior)
        return self.result.target

    @classmethod
    def gather(
        cls,
        result: SamplingResult,
        searches: dict[str, OptimizeResult],
        raw_record: GroundMotion,
        record: GroundMotion,
        truths: tuple[Model | None, ...],
        true_values: dict[str, float],
        other_records: tuple[GroundMotion, ...],
        prediction_draws: int,
        title: str,
        settings: str,
        runs: Runs | None = None,
        true_posterior: Posterior | None = None,
        calibration: CalibrationResult | None = None,
    ) -> ReportContent:
        """Simulate what the report needs.

        Parameters
        ----------
        result : SamplingResult
            Of a `Posterior`.
        searches : dict of str to OptimizeResult
            Deterministic calibrations.
        raw_record, record : GroundMotion
            First record before and after processing.
        truths : tuple of Model or None
            True models of virtual experiments.
        true_values : dict of str to float
            True parameters in SI.
        other_records : tuple of GroundMotion
            Records to predict for.
        prediction_draws : int
            Draws for the bands.
        title, settings : str
            Title, and the study file's text.
        runs : Runs, optional
            The study's campaign.
        true_posterior : Posterior, optional
            That of the model itself, where a surrogate was sampled: for channels and records the surrogate does not know.
        calibration : CalibrationResult, optional
            Certificate and rounds, where the study asks for them.

        Returns
        -------
        ReportContent
            Ready to draw.
        """
        posterior = result.target
        assert isinstance(posterior, Posterior)
        true_posterior = true_posterior or posterior
        best = result.map_estimate
        draws = result.thinned(prediction_draws)
        observations = posterior.observations
        predictions = tuple(predict(posterior, draws, o.record, seed=result.seed) for o in observations)
        others = tuple(_other(posterior, true_posterior, draws, best, r, result.seed) for r in other_records)
        return cls(
            result=result,
            searches=searches,
            raw_record=raw_record,
            record=record,
            title=title,
            settings=settings,
            true_values=true_values,
            truth_loops=tuple(
                None if t is None else _loop(t, np.zeros((1, 0)), o.record)
                for t, o in zip(truths, observations, strict=True)
            ),
            best_predictions=tuple(posterior.predict(best[None], i)[0] for i in range(len(observations))),
            predictions=predictions,
            loops=tuple(_loops(true_posterior, np.vstack([best, draws]), o.record) for o in observations),
            search_loops={
                name: loops
                for name, search in searches.items()
                if (loops := _search_loop(true_posterior, search, best)) is not None
            },
            information=identifiability(posterior, best) if posterior.model.traceable else None,
            others=others,
            model=true_posterior.model,
            runs=runs,
            surrogate=_surrogate_of(result),
            calibration=calibration,
        )

    # --- figures ------------------------------------------------------------------------------------------------

    def drawings(self, folder: Path) -> list[Callable[[], None]]:
        """Give what draws the figures into a folder, as PNG and PDF, step by step.

        Parameters
        ----------
        folder : Path
            The folder; made if it is not there.

        Returns
        -------
        list of callable
            To be called in order.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.figures.clear()
        parts = (
            self._draw_calibration,
            self._draw_data,
            self._draw_responses,
            self._draw_residuals,
            self._draw_parameters,
            self._draw_convergence,
            self._draw_searches,
            self._draw_others,
            self._draw_surrogate,
            self._draw_runs,
        )
        return [functools.partial(part, folder) for part in parts]

    def _add(self, section: str, name: str, caption: str) -> str:
        self.figures.append((section, name, caption))
        return name

    def _draw_calibration(self, folder: Path) -> None:
        if self.calibration is None:
            return
        rounds, certificate = self.calibration.rounds, self.calibration.certificate
        calibration_figures.rounds(
            [r.training for r in rounds],
            [r.log_weights for r in rounds],
            certificate.limits.spread,
            save=folder
            / self._add(
                "calibration",
                "rounds",
                "Every point is a draw of a surrogate's posterior at which the model itself was run: how much more density the "
                "model gives it than the surrogate, relative to the median of its round. Where the two posteriors are the same, "
                "all lie on zero; the band is one standard deviation of what a certificate allows.",
            ),
        )

    @property
    def summary(self) -> Summary:
        """Moments and quantiles, re-weighted where the certificate asks for it."""
        return self.result.summary() if self.calibration is None else self.calibration.summary()

    def _draw_data(self, folder: Path) -> None:
        self.record.plot(folder / self._add("data", "record", f"The record as used: {self.record}."))
        if not np.array_equal(self.raw_record.values, self.record.values):
            scale = self.record.pga / self.raw_record.pga
            self.raw_record.scale(scale).plot_filter(
                self.record,
                folder
                / self._add("data", "processing", "The record before (scaled to the same peak) and after processing."),
            )
        for index, observation in enumerate(self.posterior.observations):
            units = [observation.channel_unit(c).display for c in observation.channels]
            columns = [observation.values[:, i] / factor(u) for i, u in enumerate(units)]
            name = self._add(
                "data", f"measurement{self._suffix(index)}", f"The measurement on {observation.record.name}."
            )
            response_figures.histories(
                observation.record.time, columns, observation.channels, units, save=folder / name
            )

    def _suffix(self, index: int) -> str:
        return "" if len(self.posterior.observations) == 1 else f"_{index + 1}"

    def _draw_responses(self, folder: Path) -> None:
        for index, observation in enumerate(self.posterior.observations):
            prediction, best = self.predictions[index], self.best_predictions[index]
            inner, outer = prediction.band(), prediction.band(discrepancy=True)
            for c, channel in enumerate(observation.channels):
                unit = observation.channel_unit(channel).display
                by = factor(unit)
                name = self._add(
                    "response",
                    f"response_{channel}{self._suffix(index)}",
                    f"Measured {channel} on {observation.record.name} against the posterior prediction. The dark band is what the "
                    "parameters' uncertainty alone does to the model; the light one, with the discrepancy, is where a measurement "
                    "would lie.",
                )
                response_figures.bands(
                    prediction.time,
                    observation.values[:, c] / by,
                    best[:, c] / by,
                    (inner[0][:, c] / by, inner[1][:, c] / by),
                    (outer[0][:, c] / by, outer[1][:, c] / by),
                    channel,
                    unit,
                    save=folder / name,
                )
            self._draw_loops(folder, index)

    def _draw_residuals(self, folder: Path) -> None:
        for index, residual in enumerate(self.result.residuals):
            name = f"residuals_{residual.channel}" + ("" if len(self.posterior.observations) == 1 else f"_{index + 1}")
            verdict = (
                "They are correlated: the law of the discrepancy does not describe them, and the standard deviations are too small"
                if residual.correlated
                else "Nothing speaks against the law of the discrepancy"
            )
            response_figures.residuals(
                np.arange(len(residual.autocorrelation)) * residual.dt,
                residual.autocorrelation,
                residual.bound,
                *residual.spectrum,
                residual.values,
                save=folder
                / self._add(
                    "residuals",
                    name,
                    f"Whitened residuals of {residual.channel} on {residual.record} at the MAP estimate; where model and law are "
                    "right they are independent unit normals: no autocorrelation, a flat spectrum, quantiles on the line. "
                    f"{verdict}.",
                ),
            )

    def _draw_loops(self, folder: Path, index: int) -> None:
        loops = self.loops[index]
        if loops is None:
            return
        time = self.posterior.observations[index].record.time
        truth = self.truth_loops[index]
        known = None if truth is None else (truth[:, 0] * 1e3, truth[:, 1] * 1e-3)
        caption = "Hysteresis loops at the MAP estimate and at posterior draws (thin)"
        caption += "." if truth is None else ", against the virtual experiment's, which the calibration has not seen."
        loop_figures.loops(
            known,
            (loops[0, :, 0] * 1e3, loops[0, :, 1] * 1e-3),
            save=folder / self._add("response", f"loops{self._suffix(index)}", caption),
            names=("virtual experiment", "MAP"),
            draws=[(d[:, 0] * 1e3, d[:, 1] * 1e-3) for d in loops[1 : 1 + LOOP_DRAWS]],
        )
        low, high = np.quantile(loops[1:, :, 2], [0.05, 0.95], axis=0)
        response_figures.energy(
            time,
            None if truth is None else truth[:, 2],
            loops[0, :, 2],
            (low, high),
            save=folder / self._add("response", f"energy{self._suffix(index)}", "Energy absorbed by the spring."),
        )

    def _draw_parameters(self, folder: Path) -> None:
        result, space = self.result, self.posterior.space
        factors, names = space.factors, space.names
        units = list(space.units.values())
        draws = result.thinned(20_000) / factors
        prior = space.sample(4000, seed=derived_seed(result.seed, Purpose.PRIOR_DRAWS)).values / factors
        supports = [tuple(b / f) for b, f in zip(space.bounds, factors, strict=True)]
        best = result.map_estimate / factors
        truth = {n: v / factors[names.index(n)] for n, v in self.true_values.items()}
        caption = "Priors (with samples) and posterior marginals." + (" Dotted: the truth." if truth else "")
        posterior_figures.marginals(
            names,
            units,
            prior,
            draws,
            supports,
            best,
            truth,
            save=folder / self._add("posterior", "marginals", caption),
        )
        posterior_figures.pairs(
            names,
            units,
            draws,
            best,
            save=folder
            / self._add(
                "posterior", "pairs", "Pairs of parameters, their correlation above the diagonal; + is the MAP."
            ),
        )
        if self.information is not None:
            info = self.information
            posterior_figures.identifiability(
                info.names,
                info.eigenvalues,
                info.eigenvectors,
                save=folder
                / self._add(
                    "posterior", "identifiability", "What the data see: Fisher information at the MAP estimate."
                ),
            )

    def _draw_convergence(self, folder: Path) -> None:
        result, space = self.result, self.posterior.space
        factors, names, units = space.factors, space.names, list(space.units.values())
        posterior_figures.traces(
            names,
            units,
            result.history / factors,
            result.discarded,
            save=folder / self._add("convergence", "traces", "Walkers and ensemble means."),
        )
        posterior_figures.acceptance(
            result.verdict().acceptance,
            save=folder / self._add("convergence", "acceptance", "Acceptance rate of every walker; dotted: median."),
        )

    def _draw_searches(self, folder: Path) -> None:
        if not self.search_loops:
            return
        observation = self.posterior.observations[0]
        channel = observation.channels[0]
        unit = observation.channel_unit(channel).display
        truth = self.truth_loops[0]
        predictions = {
            name: self.posterior.predict(self._with_rest(s.best.theta)[None])[0, :, 0] / factor(unit)
            for name, s in self.searches.items()
        }
        loop_figures.identified(
            observation.record.time,
            observation.values[:, 0] / factor(unit),
            predictions,
            None if truth is None else (truth[:, 0] * 1e3, truth[:, 1] * 1e-3),
            {n: (v[:, 0] * 1e3, v[:, 1] * 1e-3) for n, v in self.search_loops.items()},
            channel,
            unit,
            save=folder / self._add("deterministic", "identified", "Deterministic calibration: loops and histories."),
        )

    def _with_rest(self, theta: np.ndarray) -> np.ndarray:
        return np.concatenate([theta, self.result.map_estimate[len(theta) :]])

    def _draw_others(self, folder: Path) -> None:
        for index, other in enumerate(self.others):
            inner, outer = other.prediction.band(), other.prediction.band(discrepancy=True)
            for c, channel in enumerate(other.prediction.channels):
                unit = standard_unit(channel).display
                by = factor(unit)
                name = self._add(
                    "other records", f"other_{index + 1}_{channel}", f"Predicted {channel} for {other.name}."
                )
                response_figures.bands(
                    other.prediction.time,
                    None,
                    other.best[:, c] / by,
                    (inner[0][:, c] / by, inner[1][:, c] / by),
                    (outer[0][:, c] / by, outer[1][:, c] / by),
                    channel,
                    unit,
                    save=folder / name,
                )

    def _draw_surrogate(self, folder: Path) -> None:
        if self.surrogate is not None and self.surrogate.validation is not None:
            self.figures.extend(("surrogate", *drawn) for drawn in draw_surrogate(self.surrogate, folder))

    def _draw_runs(self, folder: Path) -> None:
        if self.runs is not None:
            self.runs.plot(folder / self._add("true runs", "runs", RUNS_CAPTION))


def draw_surrogate(surrogate: Surrogate, folder: Path) -> list[tuple[str, str]]:
    """Draw how a surrogate stood its validation.

    Parameters
    ----------
    surrogate : Surrogate
        Validated.
    folder : Path
        Where the figures go.

    Returns
    -------
    list of tuple of str
        File name and caption of each.
    """
    validation = surrogate.validation
    assert validation is not None
    drawn = []
    for channel in validation.channels:
        name = f"surrogate_{channel}"
        validation.plot(channel, folder / name)
        drawn.append(
            (name, f"The surrogate's {channel} against runs of the model that it has not seen: the best, the median and the worst "
             "history, peaks, samples, and the distribution of the error.")
        )  # fmt: skip
    return drawn


def _surrogate_of(result: SamplingResult) -> Surrogate | None:
    """The surrogate that was sampled, or that made the proposals."""
    assert isinstance(result.target, Posterior)
    model = result.sampler.proposal_model or result.target.model
    return None if model.stand_in is None else cast(Surrogate, model)


def _other(
    posterior: Posterior,
    true_posterior: Posterior,
    draws: np.ndarray,
    best: np.ndarray,
    record: GroundMotion,
    seed: int,
) -> OtherRecord:
    """Predict for another record, by the model itself where the surrogate knows only its own."""
    if posterior.model.stand_in is not None:
        try:
            posterior.model.check_excitation(record)
        except InputError:
            posterior = true_posterior
    best_response = predict(posterior, best[None], record).response[0]
    return OtherRecord(record.name, predict(posterior, draws, record, seed=seed), best_response)


def _loop(model: Any, theta: np.ndarray, record: Any) -> np.ndarray | None:
    loops = _simulate_loops(model, theta, record)
    return None if loops is None else loops[0]


def _simulate_loops(model: Any, theta: np.ndarray, record: Any) -> np.ndarray | None:
    channels = model.loop_channels
    return None if channels is None else model.recording(*channels).simulate(theta, record).values


def _loops(posterior: Posterior, theta: np.ndarray, record: Any) -> np.ndarray | None:
    return _simulate_loops(posterior.model, np.asarray(posterior.model_parameters(theta)), record)


def _search_loop(posterior: Posterior, search: OptimizeResult, best: np.ndarray) -> np.ndarray | None:
    theta = np.concatenate([search.best.theta, best[len(search.best.theta) :]])[None]
    loops = _loops(posterior, theta, posterior.observations[0].record)
    return None if loops is None else loops[0]
