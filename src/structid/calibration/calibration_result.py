"""The result of a calibration: draws, certificate, rounds, model runs."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import Runs
from structid.certification.certificate import Certificate
from structid.core.notebook import ShownAsText
from structid.core.renamed import renamed_attribute
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.inference.diagnostics.posterior_summary import Summary
from structid.inference.diagnostics.second_sampler import Representation
from structid.inference.diagnostics.verdict import Verdict
from structid.inference.error_model_choice import ErrorModelChoice
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.prediction import Prediction, first_that_takes, predict
from structid.inference.sampling.base import Evidence
from structid.inference.sampling_result import THINNED_DRAWS, SamplingResult
from structid.surrogates.base import Surrogate

PROMISING = 0.07
"""Spread of the log weights of a round's draws, and surrogate error of the log density, that promise a certificate."""


@dataclass(frozen=True, eq=False)
class Round:
    """One round of a calibration."""

    number: int  # index
    training: int  # number of points the surrogate was fitted to
    error: float  # mean relative error of the surrogate, by its own estimate
    fresh: int  # number of fresh draws of its posterior at which the model was run
    others: int  # number of further model runs
    # Of the likelihood, up to which the surrogate was sure of its posterior; 1 for the posterior itself
    exponent: float
    # Standard deviation of the log density over the surrogate's own error, where the posterior is [nat]
    deviation: float
    # Standard deviation of the log weights of the fresh draws; infinite where a model run failed, or where there are
    # none
    spread: float
    failed: int  # number of fresh draws with a failed model run
    certificate: Certificate | None  # the certificate, if the round ended with one
    # log π_true/π_surrogate of the fresh draws, −∞ where the model run failed
    log_weights: Float[np.ndarray, " draw"] = field(repr=False)
    # What each fresh draw counts in an average over the surrogate's posterior
    shares: Float[np.ndarray, " draw"] = field(repr=False)
    # Whether the fresh draws are those of the certificate before, each left out in turn: the round has run nothing
    again: bool = False

    @property
    def promising(self) -> bool:
        """Whether a certificate is worth its model runs, by the round's own plain draws."""
        judged_before_they_train = self.certificate is None and self.fresh > 0 and self.failed == 0
        return judged_before_they_train and self.spread <= PROMISING and self.deviation <= PROMISING

    @property
    def to_be_judged_again(self) -> bool:
        """Whether its certificate was refused, so that its draws can assess the next surrogate."""
        return self.certificate is not None and not self.certificate.certified and not self.again

    def __str__(self) -> str:
        text = f"round {self.number + 1}: surrogate of {self.training} runs, "
        if self.fresh:
            which = "the same draws, each left out in turn" if self.again else "fresh draws of its posterior"
            text += f"the model's log density is {self.spread:.2g} nats (sd) off its own at {self.fresh} {which}"
        else:
            text += f"not yet sure of its posterior (of the likelihood to the power of {self.exponent:.2g})"
        return text + (f": {self.certificate.agreement}" if self.certificate is not None else "")


@dataclass(frozen=True, eq=False)
class CalibrationResult(ShownAsText):
    """A calibration and whether it may be believed.

    Parameters
    ----------
    sampling : SamplingResult
        Draws of the posterior under the last surrogate, or of the model's own by delayed acceptance.
    certificate : Certificate
        Whether that posterior is the true model's.
    rounds : tuple of Round
        How it came about.
    posterior : Posterior
        On the true model.
    surrogate : Surrogate
        The last one.
    runs : Runs
        All model runs.
    error_model_choice : ErrorModelChoice or None
        Which error model the data chose, where it was left to them.
    representation : Representation or None
        Draws of the surrogate's posterior beside those of a second explorer.
    """

    sampling: SamplingResult = field(repr=False)
    certificate: Certificate
    rounds: tuple[Round, ...]
    posterior: Posterior = field(repr=False)
    surrogate: Surrogate = field(repr=False)
    runs: Runs = field(repr=False)
    error_model_choice: ErrorModelChoice | None = field(default=None, repr=False)
    representation: Representation | None = field(default=None, repr=False)

    law_choice = renamed_attribute("law_choice", "error_model_choice")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.posterior.names

    @property
    def training_runs(self) -> int:
        """Number of points the last surrogate was fitted to."""
        return self.rounds[-1].training

    @property
    def depth(self) -> int:
        """Number of successive rounds of model runs, without the first design."""
        return sum(not r.again for r in self.rounds)

    @property
    def enough_to_go_on(self) -> int:
        """Smallest budget with which a refused calibration continues: enough for one more round with a certificate."""
        last = self.rounds[-1]
        return self.certificate.true_runs + last.fresh + last.others

    @property
    def exact(self) -> bool:
        """Whether the draws are of the model's own posterior, whatever the certificate of the surrogate's."""
        return self.sampling.cost is not None

    @property
    def certified(self) -> bool:
        """Whether model runs certify the surrogate's posterior."""
        return self.certificate.certified

    @property
    def draws(self) -> np.ndarray:
        """Draws in SI, shape (chain, draw, parameter); not re-weighted."""
        return self.sampling.draws

    def to_netcdf(self, path: str | os.PathLike[str], predictions: bool = True, thinned: int | None = None) -> Path:
        """Write draws, predictions and statistics to a netCDF file of the ArviZ schema; see `SamplingResult.to_netcdf`.

        Parameters
        ----------
        path : path-like
            The file.
        predictions : bool
            Include the groups that need simulations, which the surrogate makes.
        thinned : int, optional
            How many draws every group has, the posterior included; see `SamplingResult.to_datatree`.

        Returns
        -------
        Path
            The file written.
        """
        return self.sampling.to_netcdf(path, predictions, thinned)

    def verdict(self) -> Verdict:
        """Say whether the sampling has converged, and what speaks against the model and the error model.

        Returns
        -------
        Verdict
            ``print`` it. The certificate is another question: see `certified`.
        """
        return self.sampling.verdict()

    @property
    def trusted(self) -> bool:
        """Whether the numbers may be believed: certified, or converged draws of the model itself."""
        return self.verdict().converged if self.exact else self.certified

    @property
    def reweighted(self) -> bool:
        """Whether moments and quantiles come from the certificate's weighted draws instead of the sampler's."""
        return self.certificate.verdict == "usable with re-weighting" and not self.exact

    @property
    def mean(self) -> np.ndarray:
        """Posterior means in SI, shape (parameter,)."""
        if self.reweighted:
            return np.asarray(self.certificate.weights @ self.certificate.draws)
        return self.sampling.mean

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations in SI, shape (parameter,)."""
        if self.reweighted:
            return np.asarray(np.sqrt(self.certificate.weights @ (self.certificate.draws - self.mean) ** 2))
        return self.sampling.sd

    @check_arguments
    def quantile(self, p: float | np.ndarray) -> Float[np.ndarray, "... parameter"]:
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
        if self.reweighted:
            c = self.certificate
            return np.asarray(np.quantile(c.draws, p, axis=0, weights=c.weights, method="inverted_cdf"))
        return self.sampling.quantile(p)

    def corrected(self, evidence: Evidence) -> Evidence:
        """Evidence of the true model from that of its surrogate, Z_true = Z_surrogate E[π_true/π_surrogate].

        Parameters
        ----------
        evidence : Evidence
            Under the surrogate.

        Returns
        -------
        Evidence
            With the mean weight of the certificate's draws, and its error.
        """
        ratios, shares = self.rounds[-1].log_weights, self.rounds[-1].shares
        largest = ratios.max()
        mean = float(shares @ np.exp(ratios - largest) / shares.sum())
        shift = float(largest + np.log(mean))
        error = self.certificate.variation.estimate / np.sqrt(self.certificate.variation.draws)
        return Evidence(evidence.value + shift, float(np.hypot(evidence.error, error)), evidence.each + shift)

    @property
    def log_evidence(self) -> Evidence | None:
        """Log Z of the model, where the sampler estimates that of the surrogate."""
        evidence = self.sampling.log_evidence
        return None if evidence is None else self.corrected(evidence)

    @check_arguments
    def predict(
        self, record: Excitation | None = None, channels: tuple[str, ...] | None = None, **settings: Any
    ) -> Prediction:
        """Predict, on the measured record or another one: by the surrogate if it takes the record, else by the model itself.

        Parameters
        ----------
        record : Excitation, optional
            Another record; the first measured one when left out.
        channels : tuple of str, optional
            What to predict; what was measured when left out.
        **settings
            ``draws``, ``seed``, ``progress``; see `prediction.predict`. The draws are the sampler's, which are not re-weighted.

        Returns
        -------
        Prediction
            Draws of the response with and without discrepancy, bands, peaks.
        """
        assert isinstance(self.sampling.target, Posterior)
        theta = self.sampling.thinned(settings.pop("draws", THINNED_DRAWS))
        by = first_that_takes(record, self.sampling.target, self.posterior)
        return predict(by, theta, record, channels, drift=self.sampling.drift, **settings)

    def summary(self) -> Summary:
        """Give moments, quantiles and diagnostics as a table, re-weighted where the certificate asks for it.

        Returns
        -------
        Summary
            In display units.
        """
        table = self.sampling.summary()
        if not self.reweighted:
            return table
        factors = self.posterior.factors
        q05, median, q95 = self.quantile(np.array([0.05, 0.5, 0.95])) / factors
        moments = {"mean": self.mean / factors, "sd": self.sd / factors, "q05": q05, "median": median, "q95": q95}
        return replace(table, columns={**table.columns, **moments})

    def __str__(self) -> str:
        again = [] if self.representation is None else [f"  {line}" for line in str(self.representation).splitlines()]
        rounds = [f"  {r}" for r in self.rounds]
        return "\n".join([str(self.certificate), *again, *rounds, str(self.verdict()), str(self.summary())])
