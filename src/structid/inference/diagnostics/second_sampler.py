"""Check, with a second sampler of a different kind, that draws represent their density.

Particles from the prior lose narrow modes and move slowly along ridges. Chains depend on their starting points. An
optimiser therefore searches for modes from the draws, from known points (such as a calibration's model runs) and from
the prior. Particles then start evenly around all these modes and are tempered to the density. The masses of the modes
in the first sampler's draws are not used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from structid.core.notebook import ShownAsText
from structid.core.streams import Purpose, derived_seed, stream
from structid.inference.convergence import standard_error
from structid.inference.sampling.base import Drawn, Evidence
from structid.inference.sampling.moves import EnsembleState
from structid.inference.sampling.smc.lost_modes import Mode, all_modes
from structid.inference.sampling.smc.reference_density import FromReference
from structid.inference.sampling.smc.smc import SMC
from structid.inference.target import Target

SCOUTS = 100
"""Number of prior draws from which the search for modes starts, divided by the square of the number of parameters."""
DRAWN = 10
"""Number of prior draws per chosen starting point of a search."""
MOST_DRAWN = 100_000
"""Largest number of prior draws, unless more starting points are chosen."""
NEGLIGIBLE = 1e-3
"""Laplace approximation of a mode's mass, relative to the total, below which the mode is ignored."""
TOLERANCE = 0.05
"""Accepted difference of modes' mass fractions, of means (in standard deviations), and of standard deviations (relative)."""
EVIDENCE = 0.25
"""Accepted difference of log Z [nat]. A tempering run along a ridge loses this much, and draws that miss a fifth of the
probability also differ in mass fractions, means or standard deviations."""
ERRORS = 3.0
"""Number of standard errors beyond the tolerance above which two samplers disagree."""
PARTICLES = 2000
"""Approximate number of the first sampler's draws from which the second sampler is set up."""
SECOND_SAMPLER = SMC(particles=250, steps=30, effective_share=0.5, correlation=0.3, scouts=0)
"""The second sampler."""
LONGEST = 16
"""Factor on the number of steps of a second attempt, after a disagreement; the attempt discards their first half."""


@dataclass(frozen=True, eq=False)
class Representation(ShownAsText):
    """Comparison of two samplers of one density."""

    names: tuple[str, ...]  # parameters, or their logarithms; see `Target.compared`
    # Local maxima in SI, of the density with respect to unconstrained coordinates
    modes: Float[np.ndarray, "mode parameter"]
    shares: Float[np.ndarray, " mode"]  # fraction of the first sampler's draws nearest to each mode
    shares_again: Float[np.ndarray, " mode"]  # fraction of the second sampler's draws nearest to each mode
    mean_gap: Float[np.ndarray, " parameter"]  # difference of the means, in standard deviations
    mean_error: Float[np.ndarray, " parameter"]  # standard error of `mean_gap`
    sd_gap: Float[np.ndarray, " parameter"]  # second sampler's standard deviation over the first's, minus 1
    sd_error: Float[np.ndarray, " parameter"]  # standard error of `sd_gap`
    evidence_gap: float  # log Z of the second sampler minus log Z of the first; NaN if the first has none
    failures: tuple[str, ...]  # disagreements, one sentence each

    @property
    def agreed(self) -> bool:
        """Whether the two samplers agree."""
        return not self.failures

    def to_entry(self) -> dict[str, np.ndarray]:
        """Convert to arrays for a journal."""
        return {field.name: np.array(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def of(cls, entry: Mapping[str, np.ndarray]) -> Representation:
        """Read the result of `to_entry`."""
        read: dict[str, Any] = dict(entry)
        words = {name: tuple(str(word) for word in read[name]) for name in ("names", "failures")}
        return cls(**read | words | {"evidence_gap": float(read["evidence_gap"])})

    def __str__(self) -> str:
        worst, widest = int(np.argmax(np.abs(self.mean_gap))), int(np.argmax(np.abs(self.sd_gap)))
        modes = "one mode" if len(self.modes) == 1 else f"{len(self.modes)} modes"
        heading = (
            f"a second sampler finds {modes}; the means of {self.names[worst]} differ by {abs(self.mean_gap[worst]):.2g} ± "
            f"{self.mean_error[worst]:.1g} standard deviations, the standard deviations of {self.names[widest]} by "
            f"{abs(self.sd_gap[widest]):.1%} ± {self.sd_error[widest]:.1%}"
        )
        if len(self.modes) > 1:
            shares = zip(self.shares, self.shares_again, strict=True)
            heading += "; shares of the modes " + ", ".join(f"{a:.2f} and {b:.2f}" for a, b in shares)
        return "\n".join([heading, *(f"  - {failure}" for failure in self.failures)])


def check_representation(
    target: Target,
    draws: Float[np.ndarray, "step ensemble walker parameter"],
    known: Float[np.ndarray, "point parameter"],
    seed: int,
    sampler: SMC = SECOND_SAMPLER,
    evidence: Evidence | None = None,
    longest: int = LONGEST,
    log_density: Float[np.ndarray, "step ensemble walker"] | None = None,
) -> Representation:
    """Sample a target with a second sampler, and compare the given draws with the result.

    The log density of draws of unknown origin, with respect to unconstrained coordinates, is compared, too: draws along an arc may
    have the moments of a thicker arc.
    """
    phi = target.bijection.inverse(draws.reshape(-1, target.dimension))
    some = phi[np.isfinite(phi).all(axis=1)][:: max(1, len(phi) // PARTICLES)]
    density = target.evaluate(some)[0]
    modes = _modes(target, some, density, known, stream(seed, Purpose.SMC_SCOUTS))
    reference = FromReference(target, EnsembleState(some[None], density[None]), modes)
    again = derived_seed(seed, Purpose.BESIDE)
    for times in dict.fromkeys((1, longest)):  # after a disagreement, the second sampler may be wrong
        longer = replace(sampler, steps=times * sampler.steps)
        second = longer.run(reference, again, None, [], lambda _index, _block: None)
        settled = slice(0 if times == 1 else longer.steps // 2, None)
        comparison = _compared(target, draws, modes, second, second.phi[settled], evidence)
        if log_density is not None:
            apart = _apart_in_density(log_density, second.log_density[settled])
            comparison = replace(comparison, failures=(*comparison.failures, *apart))
        if comparison.agreed:
            break
    return comparison


def _compared(
    target: Target,
    draws: np.ndarray,
    modes: list[Mode],
    second: Drawn,
    settled: np.ndarray,
    evidence: Evidence | None,
) -> Representation:
    """Compare draws with the second sampler's draws after it has settled."""
    assert second.log_evidence is not None  # a tempered sampler estimates it
    again = target.bijection(settled.reshape(-1, target.dimension))[0].reshape(settled.shape)
    phi = target.bijection.inverse(draws.reshape(-1, target.dimension)).reshape(draws.shape)
    shares = [_labelled(modes, points) for points in (phi, settled)]
    gaps = _moment_gaps(target.compared(draws), target.compared(again))
    return Representation(
        target.compared_names,
        target.bijection(np.stack([mode.middle for mode in modes]))[0],
        shares[0].mean(axis=(0, 1, 2)),
        shares[1].mean(axis=(0, 1, 2)),
        gaps.mean,
        gaps.mean_error,
        gaps.sd,
        gaps.sd_error,
        float("nan") if evidence is None else second.log_evidence.value - evidence.value,
        (
            *_apart_in_shares(*shares),
            *_apart_in_moments(target.compared_names, gaps),
            *([] if evidence is None else _apart_in_evidence(evidence, second.log_evidence)),
        ),
    )


def _modes(
    target: Target, phi: np.ndarray, density: np.ndarray, known: np.ndarray, rng: np.random.Generator
) -> list[Mode]:
    """All relevant modes, found from the draws, from known points and from the prior."""
    count = SCOUTS * target.dimension**2 if target.knows_prior else 0
    many = target.initial(max(count, min(DRAWN * count, MOST_DRAWN)), rng) if count else phi[:0]
    modes = all_modes(target, phi, density, target.bijection.inverse(known), many, count)
    masses = np.array([mode.log_mass for mode in modes])
    matters = masses >= logsumexp(masses) + np.log(NEGLIGIBLE)
    return [mode for mode, does in zip(modes, matters, strict=True) if does]


def _labelled(modes: list[Mode], phi: np.ndarray) -> np.ndarray:
    """Nearest mode of each point under the Laplace approximations, as zeros and ones of shape (..., mode)."""
    distances = []
    for mode in modes:
        standard = np.linalg.solve(mode.factor, (phi.reshape(-1, phi.shape[-1]) - mode.middle).T)
        distances.append(0.5 * np.sum(standard**2, axis=0) + np.log(np.diag(mode.factor)).sum())
    nearest = np.argmin(distances, axis=0)
    return np.asarray(
        (nearest[:, None] == np.arange(len(modes))).reshape(*phi.shape[:-1], len(modes)), dtype=np.float64
    )


def _apart_in_shares(first: np.ndarray, second: np.ndarray) -> list[str]:
    """Modes whose mass fractions differ."""
    sentences = []
    for mode in range(first.shape[-1] if first.shape[-1] > 1 else 0):
        shares = first[..., mode], second[..., mode]
        error = math.hypot(*(standard_error(x) for x in shares))
        gap = abs(shares[0].mean() - shares[1].mean())
        if gap > TOLERANCE + ERRORS * error:
            sentences.append(
                f"{shares[0].mean():.0%} of the draws lie at mode {mode + 1} of {first.shape[-1]}, against "
                f"{shares[1].mean():.0%} of the draws of a second sampler, which starts evenly at all modes"
            )
    return sentences


class _Gaps(NamedTuple):
    """Differences of means, in sd, and relative differences of sd, each with its standard error, shape (parameter,)."""

    mean: np.ndarray
    mean_error: np.ndarray
    sd: np.ndarray
    sd_error: np.ndarray


def _moment_gaps(first: np.ndarray, second: np.ndarray) -> _Gaps:
    """Differences between the moments of two samplers' draws."""
    gaps = np.zeros((4, first.shape[-1]))
    for index in range(first.shape[-1]):
        first_draws, second_draws = first[..., index], second[..., index]
        centre, sd = first_draws.mean(), first_draws.std()
        if sd == 0.0:
            continue
        # The mean of a standardised parameter and of its square; a standard deviation has half the relative error of the square.
        standard = [(x - centre) / sd for x in (first_draws, second_draws)]
        error = math.hypot(*(standard_error(x) for x in standard))
        error_of_square = math.hypot(*(standard_error((x - x.mean()) ** 2) for x in standard))
        gaps[:, index] = standard[1].mean(), error, standard[1].std() - 1.0, 0.5 * error_of_square
    return _Gaps(*gaps)


def _apart_in_moments(names: tuple[str, ...], gaps: _Gaps) -> list[str]:
    """The parameter with the largest gap in mean or standard deviation, if it exceeds the tolerance."""
    of_means, of_sds = np.abs(gaps.mean) - ERRORS * gaps.mean_error, np.abs(gaps.sd) - ERRORS * gaps.sd_error
    if max(of_means.max(), of_sds.max()) <= TOLERANCE:
        return []
    if of_means.max() >= of_sds.max():
        worst = int(np.argmax(of_means))
        return [f"a second sampler shifts the mean of {names[worst]} by {gaps.mean[worst]:+.2f} standard deviations"]
    worst = int(np.argmax(of_sds))
    return [f"a second sampler gives {1.0 + gaps.sd[worst]:.2f} times the standard deviation of {names[worst]}"]


def _apart_in_density(first: np.ndarray, second: np.ndarray) -> list[str]:
    """Sentence if the log densities at the draws of two samplers differ in mean or standard deviation."""
    gaps = _moment_gaps(first[..., None], second[..., None])
    if not _apart_in_moments(("",), gaps):
        return []
    return [
        f"the log densities at the draws of a second sampler differ by {gaps.mean[0]:+.2g} standard deviations on average, and "
        f"vary {1.0 + gaps.sd[0]:.2g} times as much"
    ]


def _apart_in_evidence(first: Evidence, second: Evidence) -> list[str]:
    """Sentence if log Z differs, that is, if only one of the samplers finds a part of the total probability."""
    gap, error = second - first
    if abs(gap) <= EVIDENCE + ERRORS * error:
        return []
    missing = (
        "the draws have missed a part"
        if gap > 0.0
        else "the second sampler has missed a part, so this check is inconclusive"
    )
    return [f"a second sampler finds {np.exp(gap):.2g} times the total probability: {missing}"]
