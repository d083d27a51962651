"""Starting points for chains that cannot reach a posterior from its prior: draws of a tempered posterior."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.inference.sampling.base import Block
from structid.inference.sampling.smc.smc import SMC
from structid.inference.sampling.smc.tempering import Population
from structid.inference.target import Target

STARTING_SAMPLER = SMC(particles=250, ensembles=4, steps=10, effective_share=0.5, correlation=0.5, scouts=0)
"""Sampler that reaches the posterior from the prior by tempering."""
START_EXPONENT = 0.5
"""Exponent of the likelihood. The draws scatter more widely than the posterior, so that R-hat is informative."""


def tempered_draws(
    target: Target, seed: int, sampler: SMC = STARTING_SAMPLER
) -> Float[np.ndarray, "particle parameter"]:
    """Draw from prior × likelihood^½."""
    blocks: list[Block] = []
    sampler.run(target, seed, None, [], lambda _index, block: blocks.append(block))
    stages = [Population.of(block) for block in blocks]
    nearest = min(stages, key=lambda p: abs(p.exponent - START_EXPONENT))
    return nearest.phi.reshape(-1, target.dimension)
