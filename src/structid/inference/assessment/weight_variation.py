"""How unequal importance weights are: their coefficient of variation χ, and a bound for it from few draws.

With π the true posterior, q the one that was drawn from and w = π/q, scaled so that E_q w = 1, χ = sd_q(w). For every function f of
the parameters E_π f − E_q f = E_q[(w − 1) (f − E_q f)], so that by the inequality of Cauchy and Schwarz

    |E_π f − E_q f| ≤ χ sd_q(f).

One number bounds the shift of every mean (f = x), of every probability (f = 1 in the event: χ √(p (1 − p))) and, by f = (x − μ)²,
of every standard deviation. χ² is the chi-squared divergence of π from q (Liese & Vajda 2006, IEEE Trans. Inf. Theory 52(10)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from structid.inference.assessment.diagnostics import weighted_size

KURTOSIS = 6.0
"""Smallest kurtosis of the weights that the bound reckons with: twice a normal law's, since errors of a surrogate are largest in
the tails. Where the draws themselves show a larger one, that is taken."""


@dataclass(frozen=True)
class WeightVariation:
    """The coefficient of variation of importance weights.

    Parameters
    ----------
    estimate : float
        χ̂ from the draws; infinite where all weights but one vanish.
    bound : float
        U, which is above χ with the confidence asked for if the weights are no more heavy-tailed than they look.
    confidence : float
        That.
    draws : float
        Effective number of draws behind it.
    """

    estimate: float
    bound: float
    confidence: float
    draws: float

    def of_probability(self, p: float | np.ndarray) -> float | np.ndarray:
        """Largest error of the probability of an event.

        Parameters
        ----------
        p : float or ndarray
            Its probability under q.

        Returns
        -------
        float or ndarray
            U √(p (1 − p)).
        """
        return self.bound * np.sqrt(p * (1.0 - p))

    @property
    def inflation(self) -> float:
        """U/χ̂: how much larger than an estimate from these draws a standard deviation may be."""
        return self.bound / self.estimate if self.estimate > 0.0 else 1.0

    def of_variance(self, kurtosis: np.ndarray) -> np.ndarray:
        """Largest relative error of a variance.

        Parameters
        ----------
        kurtosis : ndarray
            κ = E (x − μ)⁴ / σ⁴ of the marginal under q.

        Returns
        -------
        ndarray
            U √(κ − 1) + U²: the first by f = (x − μ)², of which (κ − 1) σ⁴ is the variance, the second since the mean shifts, too.
        """
        return np.asarray(self.bound * np.sqrt(np.maximum(kurtosis, 1.0) - 1.0) + self.bound**2)


def weight_variation(log_ratios: np.ndarray, shares: np.ndarray, confidence: float) -> WeightVariation:
    """Estimate χ from draws, and bound it.

    Parameters
    ----------
    log_ratios : ndarray, shape (draw,)
        log π/q at each draw, both up to a constant; −inf where π vanishes.
    shares : ndarray, shape (draw,)
        What each draw counts in an average over q, up to a constant: one where it was drawn from q, q/g where from g.
    confidence : float
        With which the bound shall hold.

    Returns
    -------
    WeightVariation
        With s² the variance of the weights, ν s²/χ² is nearly of a chi-squared law of ν = 2 (n − 1)/(κ − 1) degrees of freedom (n
        effective draws, κ the kurtosis of the weights), whence U = χ̂ √(ν/χ²_ν(1 − confidence)).
    """
    shares = shares / shares.sum()
    count = weighted_size(shares)
    ran = np.isfinite(log_ratios)
    if not ran.any():
        return WeightVariation(np.inf, np.inf, confidence, count)
    weights = np.exp(log_ratios - log_ratios[ran].max())
    weights = weights / (shares @ weights)
    moments = [float(shares @ (weights - 1.0) ** power) for power in (2, 4)]
    if moments[0] == 0.0:
        return WeightVariation(0.0, 0.0, confidence, count)
    kurtosis = max(KURTOSIS, moments[1] / moments[0] ** 2)
    freedom = 2.0 * (count - 1.0) / (kurtosis - 1.0)
    variation = float(np.sqrt(moments[0] * count / (count - 1.0)))
    quantile = float(scipy.stats.chi2.ppf(1.0 - confidence, freedom))
    bound = variation * np.sqrt(freedom / quantile) if quantile > 0.0 else np.inf
    return WeightVariation(variation, float(bound), confidence, count)
