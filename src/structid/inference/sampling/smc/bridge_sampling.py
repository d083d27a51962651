"""The evidence from particles of neighbouring tempering steps, by Bennett's acceptance ratio."""

from __future__ import annotations

import itertools

import numpy as np
import scipy
from jaxtyping import Float
from scipy.special import expit

from structid.inference.sampling.base import Evidence
from structid.inference.sampling.smc.falling_root import root_of_falling
from structid.inference.sampling.smc.tempering import Population


def evidence_of(
    stages: list[Population], rise: Float[np.ndarray, "stage ensemble"], left: Float[np.ndarray, " stage"]
) -> Evidence:
    """Evidence from the particles of all tempering steps.

    After weighting and resampling, the particles should follow the distribution at the next exponent, which moves leave unchanged
    on average. If a narrow peak becomes dominant, too few particles lie on it: their mean log-likelihood rises while they
    move. When their correlation with their start has fallen to ρ, a fraction ρ of this deficit D remains: after a rise of
    (1 − ρ) D, ρ D is missing.
    """
    left = np.clip(left, 0.0, 1.0 - np.finfo(np.float64).eps)
    each = np.zeros(len(stages[0].prior))
    variance = np.zeros_like(each)
    for stage, (now, then) in enumerate(itertools.pairwise(stages)):
        for row in range(len(each)):
            increment = then.exponent - now.exponent
            ratio, ratio_error = bennett_ratio(increment * now.likelihood[row], increment * then.likelihood[row])
            each[row] += ratio
            # If neighbouring tempering steps correlate by ρ, the variance of their sum is (1 + ρ) / (1 − ρ) times the
            # variance for independent steps.
            variance[row] += ratio_error * (1.0 + left[stage + 1]) / (1.0 - left[stage + 1])
    # log Z = ∫ ⟨log L⟩ dβ = ∫ β ⟨log L⟩ d log β (thermodynamic integration): log Z shares the deficit of ⟨log L⟩. The
    # first exponents lie decades apart, where ⟨log L⟩ falls like 1/β.
    exponent = np.array([stage.exponent for stage in stages])[1:]
    lacked = rise[1:] * (exponent * left[1:] / (1.0 - left[1:]))[:, None]
    lacking = lacked[0] + scipy.integrate.trapezoid(lacked, np.log(exponent), axis=0)
    return Evidence.of_populations(each, variance, lacking)


def bennett_ratio(
    forward: Float[np.ndarray, " draw"], backward: Float[np.ndarray, " other_draw"]
) -> tuple[float, float]:
    """Log Z₁/Z₀ of two densities from draws of both (C. H. Bennett 1976, doi 10.1016/0021-9991(76)90078-4).

    With f(x) = 1/(1 + eˣ) and equally many draws of each, log Z₁/Z₀ is the C that solves Σ₀ f(C − w) = Σ₁ f(w − C).
    """

    def difference(constant: float) -> float:
        return float(expit(forward - constant).sum() - expit(constant - backward).sum())

    weighing, weighing_other = forward[np.isfinite(forward)], backward[np.isfinite(backward)]
    if not (weighing.size and weighing_other.size):  # the densities do not overlap
        return -np.inf, np.inf
    # The search starts at the draws with most weight.
    result = root_of_falling(difference, 0.5 * (float(weighing.max()) + float(np.median(weighing_other))), 1e-10)
    shares = (expit(forward - result), expit(result - backward))
    variance = sum(float(np.mean(f**2) / np.mean(f) ** 2 - 1.0) / len(f) for f in shares)
    return float(result), variance
