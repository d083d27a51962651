"""The result of sampling: draws, moments, best point, verdict, and export in the ArviZ schema."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structid.core.errors import InputError, StructidWarning
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.inference.convergence import parameter_diagnostics, stuck_walkers
from structid.inference.diagnostics.arviz_groups import LIBRARY, groups_of_draws, groups_of_measurement
from structid.inference.diagnostics.caveats import surrogate_warnings, wrong_model
from structid.inference.diagnostics.maximum import maximum
from structid.inference.diagnostics.posterior_summary import Summary
from structid.inference.diagnostics.prior_warnings import PriorWarning, prior_warnings
from structid.inference.diagnostics.residuals import WhitenedResidual, residual_warnings, whitened_residuals
from structid.inference.diagnostics.robust_spread import RobustSpread, robust_spread
from structid.inference.diagnostics.verdict import (
    Verdict,
    convergence_failures,
    disagreements,
    uneven_shares,
    unrest,
)
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction import prediction as predictive
from structid.inference.prediction.best_prediction import UNMEASURED, BestPrediction, best_prediction
from structid.inference.prediction.parameter_drift import ParameterDrift, drift_of
from structid.inference.sampling.base import Cost, Evidence, Sampler
from structid.inference.target import Target

if TYPE_CHECKING:
    import xarray

THINNED_DRAWS = 1000
"""Number of draws used for predictive histories."""
STORED_DRAWS = 300
"""Number of draws whose predictive histories and pointwise likelihoods enter the ArviZ groups."""


@dataclass(frozen=True, eq=False)
class SamplingResult(ShownAsText):
    """Draws of a target with their diagnostics. ``print`` it for the verdict and the table of the parameters.

    Parameters
    ----------
    target : Target
        The sampled target.
    sampler : Sampler
        The sampler with its settings.
    seed : int
        Seed.
    history : ndarray, shape (step, ensemble, walker, parameter)
        Every draw in SI, including the discarded start.
    log_density : ndarray, shape (step, ensemble, walker)
        Log density with respect to the parameters.
    coordinate_log_density : ndarray, shape (step, ensemble, walker)
        Log density in the sampler's coordinates.
    accepted : ndarray of bool, shape (step, ensemble, walker)
        Whether each proposal was accepted.
    failed_simulations : int
        Simulations inside the prior's support that failed.
    seconds : float
        Time spent sampling.
    log_evidence : Evidence, optional
        log Z and its error, for samplers that estimate it.
    cost : Cost, optional
        Runs of the model and of the surrogate, for delayed acceptance.
    divergent : int
        Trajectories that did not conserve energy, for NUTS.
    certified : bool or None
        Whether model runs have shown that the surrogate gives the model's own posterior. None if not checked.
    beside : ndarray, shape (step, ensemble, walker, parameter), optional
        Draws of an independent population in SI, with which the draws of a few chains are compared.

    Examples
    --------
    >>> import structid as si
    >>> result = si.sample(posterior, seed=1)  # doctest: +SKIP
    >>> print(result.verdict(), result.summary())  # doctest: +SKIP
    """

    target: Target
    sampler: Sampler
    seed: int
    history: np.ndarray = field(repr=False)
    log_density: np.ndarray = field(repr=False)
    coordinate_log_density: np.ndarray = field(repr=False)
    accepted: np.ndarray = field(repr=False)
    failed_simulations: int
    seconds: float
    log_evidence: Evidence | None = None
    cost: Cost | None = None
    divergent: int = 0
    certified: bool | None = None
    beside: np.ndarray | None = field(default=None, repr=False)

    def __str__(self) -> str:
        return f"{self.verdict()}\n{self.summary()}"

    # --- draws --------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.target.names

    @property
    def discarded(self) -> int:
        """Steps dropped at the start."""
        return int(self.sampler.discard * len(self.history))

    @property
    def kept(self) -> np.ndarray:
        """Kept draws in SI, shape (step, ensemble, walker, parameter)."""
        return self.history[self.discarded :]

    @property
    def draws(self) -> np.ndarray:
        """Kept draws in SI, shape (chain, draw, parameter); a chain is a walker."""
        steps, ensembles, walkers, dimension = self.kept.shape
        return self.kept.transpose(1, 2, 0, 3).reshape(ensembles * walkers, steps, dimension)

    @property
    def flat(self) -> np.ndarray:
        """All kept draws in SI, shape (draw, parameter)."""
        return self.kept.reshape(-1, self.target.dimension)

    @property
    def mean(self) -> np.ndarray:
        """Posterior means in SI, shape (parameter,)."""
        return np.asarray(self.flat.mean(axis=0))

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations in SI, shape (parameter,)."""
        return np.asarray(self.flat.std(axis=0))

    @property
    def covariance(self) -> np.ndarray:
        """Posterior covariance in SI, shape (parameter, parameter)."""
        return np.cov(self.flat.T).reshape(self.target.dimension, -1)

    @check_arguments
    def quantile(self, p: float | np.ndarray) -> np.ndarray:
        """Quantiles of the marginals.

        Parameters
        ----------
        p : float or ndarray
            Probabilities.

        Returns
        -------
        ndarray, shape (..., parameter)
            In SI.
        """
        return np.asarray(np.quantile(self.flat, p, axis=0))

    @check_arguments
    def thinned(self, count: int = THINNED_DRAWS) -> np.ndarray:
        """Draws taken evenly from all kept steps and walkers.

        Parameters
        ----------
        count : int
            Largest number of draws.

        Returns
        -------
        ndarray, shape (draw, parameter)
            In SI.
        """
        return np.asarray(self.flat[self._evenly(count)])

    def _evenly(self, count: int) -> np.ndarray:
        """Indices of draws spread evenly over all kept steps and walkers."""
        total = len(self.flat)
        # A golden-ratio stride visits steps and walkers evenly; an integer stride may pick the same walkers.
        index = np.floor(((np.arange(min(count, total)) * 0.6180339887498949) % 1.0) * total).astype(int)
        return np.unique(index)

    @cached_property
    def map_estimate(self) -> np.ndarray:
        """Maximum of the posterior density, optimised from the best draw, in SI, shape (parameter,)."""
        return maximum(self.target, self.flat, self.log_density[self.discarded :].ravel())

    # --- tables and verdict -------------------------------------------------------------------------------------

    @cached_property
    def _diagnostics(self) -> dict[str, Any]:
        return {name: parameter_diagnostics(self.target.compared_of(i, self.kept)) for i, name in enumerate(self.names)}

    def summary(self) -> Summary:
        """Return moments, quantiles, best point and diagnostics as a table.

        Returns
        -------
        Summary
            In display units.
        """
        factors, drift = self.target.factors, self.drift
        q05, median, q95 = self.quantile(np.array([0.05, 0.5, 0.95]))
        d = list(self._diagnostics.values())
        columns = {
            "mean": self.mean / factors,
            "sd": self.sd / factors,
            **({} if self.robust is None or self.robust.same else {"robust_sd": self.robust.sd / factors}),
            **({} if drift is None or not drift.found else {"sd_elsewhere": drift.widened(self.sd) / factors}),
            "q05": q05 / factors,
            "median": median / factors,
            "q95": q95 / factors,
            "map": self.map_estimate / factors,
            "r_hat": np.array([x.r_hat for x in d]),
            "ess_bulk": np.array([x.bulk_size for x in d]),
            "ess_tail": np.array([x.tail_size for x in d]),
            "tau": np.array([x.autocorrelation_time for x in d]),
        }
        units = tuple(self.target.units.values())
        return Summary(self.names, units, columns, self.target.sd_units).of(self.target.shown)

    @cached_property
    def robust(self) -> RobustSpread | None:
        """Variation of the means over repeated measurements, valid even if model or error model is wrong; see `robust_spread`.

        It equals the posterior's standard deviations if the residuals are white, and is never smaller. None for an unconverged
        run, without a measurement, and for an external solver, which would take a thousand runs.
        """
        posterior = self._measured
        if posterior is None or posterior.costs_runs or self._convergence[1]:
            return None
        if all(residual.as_assumed for residual in self.residuals):
            return RobustSpread(self.sd, np.zeros(len(self.names)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)  # the verdict reports draws outside a surrogate's range
            return robust_spread(posterior, self.thinned()).at_least(self.sd)

    @property
    def robust_sd(self) -> np.ndarray | None:
        """Standard deviations of `robust` in SI, shape (parameter,)."""
        return None if self.robust is None else self.robust.sd

    @cached_property
    def drift(self) -> ParameterDrift | None:
        """Drift of the model's parameters in time; see `parameter_drift`.

        None for an unconverged run, without a measurement, and for an external solver.
        """
        posterior = self._measured
        if posterior is None or posterior.costs_runs or self._convergence[1]:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)
            return drift_of(posterior, self.flat, self.map_estimate)

    @cached_property
    def residuals(self) -> tuple[WhitenedResidual, ...]:
        """Whitened residuals at the MAP estimate, one for each measured channel; none without a measurement."""
        if self._measured is None:
            return ()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)
            return whitened_residuals(self._measured, self.map_estimate)

    @cached_property
    def _convergence(self) -> tuple[int, list[str]]:
        """Number of stuck walkers, and the criteria of convergence that are not met."""
        kept = slice(self.discarded, None)
        length, sampler, stuck = len(self.kept), self.sampler, 0
        if sampler.starts_elsewhere:
            stuck = int(stuck_walkers(self.accepted[kept], self.coordinate_log_density[kept]).sum())
        failures = convergence_failures(self._diagnostics, length, sampler.ensembles, stuck, sampler.needed_length)
        if not sampler.starts_elsewhere:
            failures += unrest(self.names, self.kept, self.coordinate_log_density[kept])
        failures += uneven_shares(self.coordinate_log_density[kept])
        if self.beside is not None:
            failures += disagreements(self.target.compared_names, *map(self.target.compared, (self.kept, self.beside)))
        return stuck, failures

    @cached_property
    def _verdict(self) -> Verdict:
        accepted, (stuck, failures) = self.accepted[self.discarded :], self._convergence
        best, against_priors = self._best_prediction(), () if failures else self._against_priors()
        return Verdict(
            converged=not failures,
            failures=tuple(failures),
            warnings=(*(warned.said for warned in against_priors), *self._warnings(best.unexplained)),
            against_priors=against_priors,
            wrong_model=() if failures else tuple(wrong_model(best, self.drift, self.mean)),
            wrong_error_model=() if best.of_another_size else tuple(self._wrong_error_model()),
            parameters=self._diagnostics,
            acceptance=accepted.mean(axis=0),
            stuck=stuck,
            failed_simulations=self.failed_simulations,
            best=best,
            kept_steps=len(accepted),
            needed_length=self.sampler.needed_length,
            smallest_basin=float("nan") if self.log_evidence is None else self.log_evidence.smallest_basin,
        )

    @property
    def failures(self) -> tuple[str, ...]:
        """Evidence against convergence, one sentence each; cheaper than the whole verdict."""
        return tuple(self._convergence[1])

    def verdict(self) -> Verdict:
        """Assess whether the run has converged, and list further warnings.

        Returns
        -------
        Verdict
            ``print`` it.
        """
        return self._verdict

    def _best_prediction(self) -> BestPrediction:
        if self._measured is None:
            return UNMEASURED
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StructidWarning)  # the verdict reports draws outside a surrogate's range
            return best_prediction(self._measured, self.map_estimate)

    def _against_priors(self) -> tuple[PriorWarning, ...]:
        """Disagreements between prior and data, for a target with priors."""
        space = getattr(self.target, "space", None)
        return () if space is None else tuple(prior_warnings(space, self.flat))

    def _warnings(self, unexplained: float) -> list[str]:
        """Further warnings about the draws; for an unconverged run only warnings about the sampling."""
        warnings = []
        if not self._convergence[1] and self._measured is not None:
            warnings += surrogate_warnings(self._measured, self.thinned(10_000), unexplained, self.certified)
        if self.divergent:
            warnings.append(
                f"{self.divergent} of {self.accepted.size} trajectories diverged: the posterior curves more sharply than the steps "
                "of NUTS can follow, and draws may be missing there; raise target_acceptance, or compare with SMC"
            )
        if self.failed_simulations:
            warnings.append(f"{self.failed_simulations} simulations failed and were given zero probability")
        return warnings

    def _wrong_error_model(self) -> list[str]:
        """Warnings about residuals that the error model does not describe."""
        if self._measured is None or self._convergence[1]:
            return []
        count = self._measured.model_space.dimension  # the model's own parameters come first
        ratios = (
            None if self.robust_sd is None else dict(zip(self.names[:count], self.robust_sd / self.sd, strict=False))
        )
        return residual_warnings(self.residuals, self._measured.error_model, ratios)

    @check_arguments
    def predict(
        self, record: Excitation | None = None, channels: tuple[str, ...] | None = None, **settings: Any
    ) -> predictive.Prediction:
        """Predict the response to the measured record or another record; see `prediction.predict`.

        Parameters
        ----------
        record : Excitation, optional
            Another record; by default the first measured record.
        channels : tuple of str, optional
            Channels to predict; by default the measured channels.
        **settings
            ``draws``, ``seed``, ``progress``.

        Returns
        -------
        Prediction
            Draws of the response with and without errors, bands, peaks.
        """
        theta = self.thinned(settings.pop("draws", THINNED_DRAWS))
        return predictive.predict(self._posterior(), theta, record, channels, drift=self.drift, **settings)

    @property
    def _measured(self) -> Posterior | None:
        """The sampled posterior; None for a bare log density, which has neither model nor measurement."""
        return self.target if isinstance(self.target, Posterior) else None

    def _posterior(self) -> Posterior:
        if self._measured is None:
            raise InputError(
                "prediction", "a bare log density, which has no model", "the result of sampling a Posterior"
            )
        return self._measured

    # --- ArviZ schema -------------------------------------------------------------------------------------------

    @check_arguments
    def to_datatree(self, predictions: bool = True, thinned: int | None = None) -> xarray.DataTree:
        """Return all results in the ArviZ schema, for ArviZ 1; earlier versions of ArviZ read the file of `to_netcdf`.

        Parameters
        ----------
        predictions : bool
            Include the groups that need simulations of thinned draws.
        thinned : int, optional
            Number of draws in every group, the posterior included. By default, the posterior has all draws and the groups of
            predictions have 300. ArviZ's ``loo``, ``compare`` and ``loo_pit`` need the same draws in the posterior and in
            ``log_likelihood``.

        Returns
        -------
        xarray.DataTree
            Groups ``posterior``, ``sample_stats`` and, for a `Posterior`, ``prior``, ``observed_data``, ``constant_data``,
            ``posterior_predictive``, ``prior_predictive``, ``log_likelihood``.
        """
        import xarray

        if thinned is not None and thinned < 2:
            raise InputError("to_datatree(thinned)", f"{thinned}", "2 draws or more, ideally a few hundred")
        # Each walker is a chain. Particles are too many and move too few steps: the particles of an ensemble form one chain.
        ensembles, pooled = self.sampler.ensembles, not self.sampler.starts_elsewhere
        count = ensembles if pooled else ensembles * self.sampler.walkers

        places = None if thinned is None else self._evenly(thinned)

        def by_chain(array: np.ndarray) -> np.ndarray:
            kept = array[self.discarded :]
            return kept.transpose(1, 2, 0).reshape(count, -1) if places is None else kept.ravel()[None, places]

        groups = groups_of_draws(
            np.stack([by_chain(column) for column in np.moveaxis(self.history, -1, 0)], axis=-1),
            # Thinned draws form one chain of practically independent draws.
            np.repeat(np.arange(ensembles), count // ensembles) if places is None else np.zeros(1, dtype=int),
            {"lp": by_chain(self.log_density), "accepted": by_chain(self.accepted)},
            self.target.units,
        )
        if self._measured is not None:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", StructidWarning
                )  # draws of the prior are outside a surrogate's range, too
                some = self.thinned(STORED_DRAWS if thinned is None else thinned)
                groups |= groups_of_measurement(self._measured, some, self.seed, predictions)
        tree = xarray.DataTree.from_dict(groups)
        tree.attrs |= {
            **LIBRARY,
            "sampler": repr(self.sampler),
            "seed": self.seed,
            "sampling_time": self.seconds,
            "converged": int(self.verdict().converged),
            "verdict": str(self.verdict()),
        }
        if self.log_evidence is not None:
            tree.attrs |= {"log_evidence": self.log_evidence.value, "log_evidence_error": self.log_evidence.error}
        return tree

    @check_arguments
    def to_netcdf(self, path: str | os.PathLike[str], predictions: bool = True, thinned: int | None = None) -> Path:
        """Write `to_datatree` to a netCDF file, completely or not at all.

        Parameters
        ----------
        path : path-like
            The file.
        predictions : bool
            Include the groups that need simulations.
        thinned : int, optional
            Number of draws in every group, the posterior included; see `to_datatree`.

        Returns
        -------
        Path
            The file written.
        """
        file = Path(path)
        temporary = file.with_name(file.name + ".partial")
        self.to_datatree(predictions, thinned).to_netcdf(temporary, engine="h5netcdf")
        temporary.replace(file)
        return file
