"""The isoprobabilistic (Nataf) transform from the parameters to independent standard normal variables."""

from __future__ import annotations

import jax.scipy.special
import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.probability.space import ParameterSpace


def standard_normal(space: ParameterSpace, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
    """Transform parameters to independent standard normal variables, ξ = L⁻¹ Φ⁻¹(F(θ)), L Lᵀ = R."""
    correlation = np.eye(space.dimension) if space.correlation is None else space.correlation
    whitening = np.linalg.inv(np.linalg.cholesky(correlation))
    if isinstance(theta, np.ndarray):
        z = scipy.special.ndtri(np.clip(space.cdf(theta), 1e-15, 1 - 1e-15))
        return z @ whitening.T
    u = jnp.stack([m.jax_cdf(theta[..., i]) for i, m in enumerate(space.marginals.values())], axis=-1)
    return jax.scipy.special.ndtri(jnp.clip(u, 1e-15, 1 - 1e-15)) @ whitening.T
