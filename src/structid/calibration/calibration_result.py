"""The result of a calibration: draws, certificate, rounds, model runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
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
"""Standard deviations of a round's log weights and surrogate error below which a certificate is likely [nat]."""
SLOW_ROUNDS = 3
"""Number of rounds after which a lack of progress is reported."""
SMALLEST_EXPONENT = 1e-3
"""Exponent below which a surrogate knows next to nothing."""
PROGRESS = 4.0
"""Growth of the exponent in these rounds that counts as progress; a usual calibration gains a factor of ten or more."""


@dataclass(frozen=True, eq=False)
class Round:
    """One round of a calibration."""

    number: int  # index
    training: int  # number of points the surrogate was fitted to
    error: float  # mean relative error of the surrogate, by its own estimate
    fresh: int  # number of fresh draws of its posterior at which the model was run
    others: int  # number of further model runs
    # Exponent of the likelihood up to which the surrogate was certain of its posterior; 1 for the posterior itself
    exponent: float
    # Standard deviation of the log density due to the surrogate error, averaged over the posterior [nat]
    deviation: float
    # Standard deviation of the log weights of the fresh draws; infinite if a model run failed or without fresh draws
    spread: float
    failed: int  # number of fresh draws with a failed model run
    certificate: Certificate | None  # the certificate, if the round ended with one
    # log π_true/π_surrogate of the fresh draws, −∞ where the model run failed
    log_weights: Float[np.ndarray, " draw"] = field(repr=False)
    # Weight of each fresh draw in an average over the surrogate's posterior
    shares: Float[np.ndarray, " draw"] = field(repr=False)
    # Whether the fresh draws are the previous certificate's, each left out in turn; the round then made no model runs
    again: bool = False

    @property
    def promising(self) -> bool:
        """Whether the model runs at the round's plain draws make a certificate likely."""
        judged_before_they_train = self.certificate is None and self.fresh > 0 and self.failed == 0
        return judged_before_they_train and self.spread <= PROMISING and self.deviation <= PROMISING

    @property
    def to_be_judged_again(self) -> bool:
        """Whether the round's certificate was refused, so that its draws can assess the next surrogate."""
        return self.certificate is not None and not self.certificate.certified and not self.again

    def __str__(self) -> str:
        text = f"round {self.number + 1}: surrogate of {self.training} runs, "
        if self.fresh:
            which = "certificate draws, each left out in turn" if self.again else "fresh draws of its posterior"
            text += f"its log density differs from the model's by {self.spread:.2g} nats (sd) at {self.fresh} {which}"
        else:
            text += f"not yet accurate for its posterior, only for the likelihood to the power of {self.exponent:.2g}"
        return text + (f": {self.certificate.agreement}" if self.certificate is not None else "")


def hint_for_slow_rounds(rounds: Sequence[Round], posterior: Posterior) -> str:
    """Return what to do if the last rounds have hardly improved the surrogate; empty if they have, or if it is good enough."""
    last = [r for r in rounds if not r.again][-SLOW_ROUNDS - 1 :]
    if len(last) <= SLOW_ROUNDS or last[-1].exponent == 1.0:
        return ""
    if last[-1].exponent > max(PROGRESS * last[0].exponent, SMALLEST_EXPONENT):
        return ""
    cure = (
        'A run of this model is cheap: sample the model itself, with kind = "none" in [surrogate] and without [calibration].'
        if posterior.model.batched
        else "Calibrate to one sensor or to a shorter part of the record, which shows the parameters that the data determine; fix "
        "the others; or allow more true_runs."
    )
    power = f"the likelihood to the power of {last[-1].exponent:.2g}" if last[-1].exponent else "the prior"
    return (
        f"The last {SLOW_ROUNDS} rounds have hardly improved the surrogate: it is accurate for {power} only, and the data are more "
        f"precise than that. {cure}"
    )


@dataclass(frozen=True, eq=False)
class CalibrationResult(ShownAsText):
    """Result of a calibration, with its certificate.

    Parameters
    ----------
    sampling : SamplingResult
        Draws of the posterior under the last surrogate, or of the model's own posterior by delayed acceptance.
    certificate : Certificate
        Bounds on the difference between the surrogate's and the true model's posterior.
    rounds : tuple of Round
        The rounds of the calibration, in order.
    posterior : Posterior
        Posterior with the true model.
    surrogate : Surrogate
        The last surrogate.
    runs : Runs
        All model runs.
    error_model_choice : ErrorModelChoice or None
        Choice of the error model, if the data chose it.
    representation : Representation or None
        Comparison of the draws of the surrogate's posterior with a second sampler.
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
    def hint(self) -> str:
        """What to do if the last rounds have hardly improved the surrogate; empty if they have."""
        return hint_for_slow_rounds(self.rounds, self.posterior)

    @property
    def depth(self) -> int:
        """Number of successive rounds of model runs, excluding the first design."""
        return sum(not r.again for r in self.rounds)

    @property
    def enough_to_go_on(self) -> int:
        """Smallest budget that allows one more round with a certificate after a refused certificate."""
        last = self.rounds[-1]
        return self.certificate.true_runs + last.fresh + last.others

    @property
    def exact(self) -> bool:
        """Whether the draws come from the model's own posterior, whatever the certificate's verdict."""
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
            Number of draws in every group, the posterior included; see `SamplingResult.to_datatree`.

        Returns
        -------
        Path
            The file written.
        """
        return self.sampling.to_netcdf(path, predictions, thinned)

    def verdict(self) -> Verdict:
        """Assess the convergence of the sampling, and the evidence against the model and the error model.

        Returns
        -------
        Verdict
            ``print`` it. The certificate is separate: see `certified`.
        """
        return self.sampling.verdict()

    @property
    def trusted(self) -> bool:
        """Whether the results are reliable: certified, or converged draws of the model itself."""
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
            Quantiles in SI.
        """
        if self.reweighted:
            c = self.certificate
            return np.asarray(np.quantile(c.draws, p, axis=0, weights=c.weights, method="inverted_cdf"))
        return self.sampling.quantile(p)

    def corrected(self, evidence: Evidence) -> Evidence:
        """Evidence of the true model from its surrogate's evidence, Z_true = Z_surrogate E[π_true/π_surrogate].

        Parameters
        ----------
        evidence : Evidence
            Evidence under the surrogate.

        Returns
        -------
        Evidence
            Evidence multiplied by the mean weight of the certificate's draws; its standard error includes that of the
            mean weight.
        """
        ratios, shares = self.rounds[-1].log_weights, self.rounds[-1].shares
        largest = ratios.max()
        mean = float(shares @ np.exp(ratios - largest) / shares.sum())
        shift = float(largest + np.log(mean))
        error = self.certificate.variation.estimate / np.sqrt(self.certificate.variation.draws)
        return Evidence(evidence.value + shift, float(np.hypot(evidence.error, error)), evidence.each + shift)

    @property
    def log_evidence(self) -> Evidence | None:
        """Log evidence of the model; None if the sampler does not estimate the surrogate's log evidence."""
        evidence = self.sampling.log_evidence
        return None if evidence is None else self.corrected(evidence)

    @check_arguments
    def predict(
        self, record: Excitation | None = None, channels: tuple[str, ...] | None = None, **settings: Any
    ) -> Prediction:
        """Predict the response to the measured or another record, by the surrogate if it takes the record, else by the model.

        Parameters
        ----------
        record : Excitation, optional
            Another record; by default the first measured record.
        channels : tuple of str, optional
            Channels to predict; by default the measured channels.
        **settings
            ``draws``, ``seed``, ``progress``; see `prediction.predict`. The prediction uses the sampler's draws,
            without re-weighting.

        Returns
        -------
        Prediction
            Draws of the response, with and without errors, and its bands and peaks.
        """
        assert isinstance(self.sampling.target, Posterior)
        theta = self.sampling.thinned(settings.pop("draws", THINNED_DRAWS))
        by = first_that_takes(record, self.sampling.target, self.posterior)
        return predict(by, theta, record, channels, drift=self.sampling.drift, **settings)

    def summary(self) -> Summary:
        """Return moments, quantiles and diagnostics as a table, re-weighted if the certificate requires it.

        Returns
        -------
        Summary
            Table in display units.
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
