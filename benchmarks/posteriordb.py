"""Two posteriors of posteriordb, written from their Stan models, and deviations of draws from the reference draws."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import structid as si
from structid.inference import convergence as diagnostics
from structid.mechanics.runge_kutta import runge_kutta_4

Quantities = Callable[[np.ndarray], dict[str, np.ndarray]]
"""Function from draws (..., parameter) to the quantities of the reference draws."""


def load(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the data of a posterior, and its reference draws by name."""
    data = json.loads((folder / "data.json").read_text())
    with np.load(folder / "reference_draws.npz") as file:
        draws, names = file["draws"], [str(n) for n in file["params"]]
    return data, {name: draws[:, i] for i, name in enumerate(names)}


def eight_schools(data: dict[str, Any]) -> tuple[si.LogDensity, Quantities]:
    """t_j ~ N(0, 1), μ ~ N(0, 5), τ ~ half-Cauchy(0, 5), y_j ~ N(μ + τ t_j, σ_j)."""
    y, sigma = jnp.array(data["y"]), jnp.array(data["sigma"])

    def density(x: Any) -> Any:
        t, mu, tau = x[:8], x[8], x[9]
        prior = -0.5 * (t**2).sum() - 0.5 * (mu / 5) ** 2 - jnp.log1p((tau / 5) ** 2)
        return prior - 0.5 * (((y - mu - tau * t) / sigma) ** 2).sum()

    names = [*(f"t{j}" for j in range(1, 9)), "mu", "tau"]
    # As wide as the prior, but without its half-Cauchy density; tempering may start from any density.
    space = si.ParameterSpace(
        **{n: si.Normal(0.0, 1.0) for n in names[:8]},
        mu=si.Normal(0.0, 5.0),
        tau=si.LogNormal(log_mean=1.0, log_sd=1.2),
    )
    target = si.LogDensity(density, names, space, {"tau": (0.0, np.inf)}, backend="jax")

    def quantities(draws: np.ndarray) -> dict[str, np.ndarray]:
        found = {f"theta[{j}]": draws[..., 8] + draws[..., 9] * draws[..., j - 1] for j in range(1, 9)}
        return found | {"mu": draws[..., 8], "tau": draws[..., 9]}

    return target, quantities


def lotka_volterra(data: dict[str, Any]) -> tuple[si.LogDensity, Quantities]:
    """u′ = (θ₁ − θ₂ v) u, v′ = (−θ₃ + θ₄ u) v, with yearly data and lognormal errors."""
    years, first = jnp.array(data["y"]), jnp.array(data["y_init"])
    steps = 40

    def density(x: Any) -> Any:
        theta, z, sigma = x[:4], x[4:6], x[6:8]

        def rate(s: Any, _: Any) -> Any:
            return jnp.array([(theta[0] - theta[1] * s[1]) * s[0], (-theta[2] + theta[3] * s[0]) * s[1]])

        def year(s: Any, _: Any) -> Any:
            s = jax.lax.fori_loop(0, steps, lambda _, y: runge_kutta_4(rate, y, (0.0, 0.0, 0.0), 1.0 / steps), s)
            return s, s

        _, path = jax.lax.scan(year, z, None, length=len(data["y"]))
        prior = -0.5 * (((theta - jnp.array([1, 0.05, 1, 0.05])) / jnp.array([0.5, 0.05, 0.5, 0.05])) ** 2).sum()
        prior = prior - (0.5 * (jnp.log(sigma) + 1.0) ** 2 + jnp.log(sigma)).sum()
        prior = prior - (0.5 * (jnp.log(z) - jnp.log(10.0)) ** 2 + jnp.log(z)).sum()
        errors = jnp.concatenate([jnp.log(first)[None] - jnp.log(z)[None], jnp.log(years) - jnp.log(path)])
        return prior - (0.5 * (errors / sigma) ** 2 + jnp.log(sigma)).sum()

    names = ["theta1", "theta2", "theta3", "theta4", "z1", "z2", "sigma1", "sigma2"]
    centre = (0.6, 0.03, 0.8, 0.025, 30.0, 5.0, 0.3, 0.3)
    space = si.ParameterSpace(
        **{n: si.LogNormal(log_mean=float(np.log(c)), log_sd=0.3) for n, c in zip(names, centre, strict=True)}
    )
    target = si.LogDensity(density, names, space, {n: (0.0, np.inf) for n in names}, backend="jax")
    reference = [*(f"theta[{i}]" for i in range(1, 5)), "z_init[1]", "z_init[2]", "sigma[1]", "sigma[2]"]
    return target, lambda draws: {n: draws[..., i] for i, n in enumerate(reference)}


POSTERIORS = {
    "eight_schools-eight_schools_noncentered": eight_schools,
    "hudson_lynx_hare-lotka_volterra": lotka_volterra,
}
"""Posteriors by folder."""


def deviations(draws: np.ndarray, reference: dict[str, np.ndarray], quantities: Quantities) -> dict[Any, float]:
    """Deviations of means and second moments from the reference, in combined Monte Carlo standard errors.

    `draws` have the shape (step, ensemble, walker, parameter).
    """
    found, worst = quantities(draws), {}
    for name, theirs in reference.items():
        ours, centre = found[name], theirs.mean()
        for moment, a, b in (("mean", ours, theirs), ("sd", (ours - centre) ** 2, (theirs - centre) ** 2)):
            error = np.hypot(a.std() / np.sqrt(diagnostics.effective_sample_size(a)), b.std() / np.sqrt(b.size))
            worst[name, moment] = float((a.mean() - b.mean()) / error)
    return worst
