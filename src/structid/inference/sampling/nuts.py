"""NUTS: Hamiltonian Monte Carlo that uses the exact gradient of a JAX posterior, by BlackJAX.

M. D. Hoffman & A. Gelman (2014), "The No-U-Turn sampler", JMLR 15, 1593-1623; BlackJAX: A. Cabezas et al. (2024), arXiv 2402.10797.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import jax
import numpy as np

from structid.core.errors import ConvergenceError, InputError
from structid.core.progress import Progress
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.engine.device import jnp, over_runs
from structid.engine.slopes import with_slopes
from structid.inference.sampling.base import (
    BLOCK_STEPS,
    Block,
    Drawn,
    Keep,
    Sampler,
    block_lengths,
    joined,
    without_cut_off,
)
from structid.inference.sampling.starting_points import tempered_draws
from structid.inference.target import Target

START_TRIES = 20
"""Largest number of attempts to draw starting points of finite density."""

LEAPFROGS = 12
"""Number of leapfrog steps of a trajectory, for a typical posterior."""


@check_arguments
@dataclass(frozen=True)
class NUTS(Sampler):
    """Settings of the No-U-Turn sampler.

    Chains start at draws of the tempered posterior if the target has a separate prior, otherwise at the target's starting points.
    During the warm-up, each chain tunes its step size and its dense mass matrix, starting from the mass matrix of the tempered
    draws.

    Parameters
    ----------
    steps : int
        Draws of every chain.
    chains : int
        Independent chains; R-hat compares them.
    warm_up : int
        Steps of the warm-up; they are not kept.
    target_acceptance : float
        Mean acceptance to which the step size is tuned.
    deepest : int
        Largest number of doublings of a trajectory.

    Examples
    --------
    >>> import structid as si
    >>> si.NUTS(steps=500, warm_up=300).needs_derivatives
    True
    """

    steps: int = 1000
    chains: int = 4
    warm_up: int = 500
    target_acceptance: float = 0.8
    deepest: int = 10

    discard = 0.0  # no field: the warm-up is separate
    needed_length: ClassVar[float] = 50.0
    needs_derivatives: ClassVar[bool] = True
    interacting: ClassVar[bool] = False
    compared: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name, least in (("steps", 2), ("chains", 1), ("warm_up", 50), ("deepest", 1)):
            value = getattr(self, name)
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"NUTS.{name}", f"{value!r}", f"a whole number, {least} or more")
        if not 0.0 < self.target_acceptance < 1.0:
            raise InputError("NUTS.target_acceptance", f"{self.target_acceptance}", "a fraction between 0 and 1")

    @property
    def ensembles(self) -> int:  # type: ignore[override]
        """Independent chains."""
        return self.chains

    @property
    def walkers(self) -> int:
        """One, since chains are independent."""
        return 1

    def describe(self) -> dict[str, float | str]:
        """Settings that determine the draws: all except their number."""
        return {"kind": "nuts", **{k: v for k, v in asdict(self).items() if k != "steps"}}

    def evaluations(self, dimension: int) -> int:
        """Approximate number of gradient evaluations; see `Sampler.evaluations`."""
        return self.chains * (self.warm_up + self.steps) * LEAPFROGS

    @property
    def in_words(self) -> str:
        """The settings in one line, for a report."""
        return f"NUTS, {self.chains} chains × {self.steps} draws after {self.warm_up} warm-up steps, dense mass matrix"

    def run(
        self,
        target: Target,
        seed: int,
        start: np.ndarray | None,
        blocks: list[Block],
        keep: Keep,
        progress: Progress | None = None,
    ) -> Drawn:
        """Draw; see `Sampler.run`."""
        kernels = _kernels(target, replace(self, steps=2))
        total = self.warm_up + self.steps
        lengths = list(block_lengths(self.steps))
        blocks = blocks[:1] + without_cut_off(blocks[1:], lengths)
        if not blocks:
            phi, inverse_mass = self._start(target, seed, start)
            blocks = [kernels.warmed_up(phi, inverse_mass, stream(seed, Purpose.NUTS_WARM_UP, 0))]
            keep(0, blocks[0])
        if progress is not None:
            progress(self.warm_up, total)
        tuned = blocks[0]
        for number in range(len(blocks), len(lengths) + 1):
            rng = stream(seed, Purpose.NUTS_STEPS, number)
            block = kernels.drawn(blocks[-1]["phi"][-1, :, 0], tuned, lengths[number - 1], rng)
            keep(number, block)
            blocks = [*blocks, block]
            if progress is not None:
                progress(self.warm_up + min(number * BLOCK_STEPS, self.steps), total)
        every = joined(blocks[1:], self.steps)
        return Drawn(every["phi"], every["log_density"], every["accepted"], 0, divergent=int(every["divergent"].sum()))

    def _start(self, target: Target, seed: int, points: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Starting points of finite density, (chain, parameter), and an initial inverse mass matrix."""
        rng = stream(seed, Purpose.NUTS_START, 0)
        inverse_mass = np.eye(target.dimension)
        if points is not None:
            candidates = target.bijection.inverse(np.atleast_2d(np.asarray(points, dtype=np.float64)))
        elif target.knows_prior:
            candidates = tempered_draws(target, seed)
            # With another mass matrix, the first trajectories along a narrow ridge would take a thousand steps each.
            inverse_mass = _covariance(candidates)
        else:
            candidates = target.initial(START_TRIES * self.chains, rng)
        finite = candidates[np.isfinite(target.evaluate(candidates)[0])]
        if len(finite) == 0:
            raise ConvergenceError(
                f"None of {len(candidates)} starting points has a finite log density. Check the priors."
            )
        chosen = rng.choice(len(finite), size=self.chains, replace=len(finite) < self.chains)
        return finite[chosen], inverse_mass


def _covariance(points: np.ndarray) -> np.ndarray:
    """Covariance of points (point, parameter), never singular."""
    covariance = np.atleast_2d(np.cov(points.T))
    return covariance + 1e-9 * np.diag(np.maximum(np.diag(covariance), 1e-12))


@functools.lru_cache(maxsize=2)
def _kernels(target: Target, settings: NUTS) -> _Kernels:
    """Compiled kernels of one target, shared by all runs on it, so that continuing a chain needs no recompilation."""
    return _Kernels(target, settings)


class _Kernels:
    """BlackJAX's warm-up and transition for one target, with the chains distributed over the devices."""

    def __init__(self, target: Target, settings: NUTS) -> None:
        self._function, self._data = target.traceable()
        self._settings = settings
        self._compiled: dict[Any, Callable[..., Any]] = {}

    def warmed_up(self, phi: np.ndarray, inverse_mass: np.ndarray, rng: np.random.Generator) -> Block:
        """Step size, inverse mass matrix and position of every chain after the warm-up, as a block of one step."""
        chains = len(phi)
        first = np.broadcast_to(inverse_mass, (chains, *inverse_mass.shape))
        position, step_size, inverse_mass = self._over_chains("warm-up", self._warm_up)(
            np.arange(chains), phi, first, _keys(rng, chains), self._data
        )
        return {
            "phi": position[None, :, None],
            "log_density": np.zeros((1, chains, 1)),
            "accepted": np.zeros((1, chains, 1), dtype=bool),
            "divergent": np.zeros((1, chains), dtype=bool),
            "step_size": step_size[None],
            "inverse_mass": inverse_mass[None],
        }

    def drawn(self, phi: np.ndarray, tuned: Block, length: int, rng: np.random.Generator) -> Block:
        """Draws of every chain from its current position, as a block."""
        chains = len(phi)
        advance = self._over_chains(("draws", length), lambda *a: self._draws(length, *a))
        positions, density, divergent = advance(
            np.arange(chains), phi, tuned["step_size"][-1], tuned["inverse_mass"][-1], _keys(rng, chains), self._data
        )
        positions, density, divergent = positions.swapaxes(0, 1), density.T, divergent.T
        before = np.concatenate([phi[None], positions[:-1]])
        return {
            "phi": positions[:, :, None],
            "log_density": density[:, :, None],
            "accepted": (positions != before).any(axis=2)[:, :, None],
            "divergent": divergent,
            "step_size": np.repeat(tuned["step_size"][-1:], length, axis=0),
            "inverse_mass": np.repeat(tuned["inverse_mass"][-1:], length, axis=0),
        }

    def _density(self, data: Any) -> Callable[[Any], Any]:
        """Log density at one point, with a forward-mode gradient, since parameters are few and histories long."""

        def plain(phi: Any) -> Any:
            return self._function(phi[None], data)[0]

        def forward(phi: Any) -> tuple[Any, Any]:
            (value,), slopes = with_slopes(lambda point: self._function(point, data), phi[None])
            gradient = slopes[:, 0]
            # Outside the support, the density is −∞ and its gradient NaN, which would make the momentum NaN for all later steps.
            return value, jnp.where(jnp.isfinite(gradient), gradient, 0.0)

        density: Any = jax.custom_vjp(plain)
        density.defvjp(forward, lambda gradient, cotangent: (cotangent * gradient,))
        result: Callable[[Any], Any] = density
        return result

    def _over_chains(self, name: Any, function: Callable[..., Any]) -> Callable[..., Any]:
        """Compile a function for all chains, once; `function` takes the arrays of one chain, its key, and the data."""
        if name not in self._compiled:

            def some_chains(which: Any, *arrays: Any) -> Any:
                *chain_arrays, data = arrays
                rows = which.astype(int)
                return jax.vmap(lambda *a: function(*a, data))(*(jnp.asarray(a)[rows] for a in chain_arrays))

            self._compiled[name] = over_runs(some_chains)
        return self._compiled[name]

    def _warm_up(self, phi: Any, inverse_mass: Any, key: Any, data: Any) -> tuple[Any, Any, Any]:
        import blackjax

        adaptation = blackjax.window_adaptation(
            blackjax.nuts,
            self._density(data),
            is_mass_matrix_diagonal=False,
            initial_inverse_mass_matrix=inverse_mass,
            target_acceptance_rate=self._settings.target_acceptance,
            max_num_doublings=self._settings.deepest,
        )
        (state, tuned), _ = adaptation.run(jax.random.wrap_key_data(key), phi, self._settings.warm_up)
        return state.position, tuned["step_size"], tuned["inverse_mass_matrix"]

    def _draws(self, length: int, phi: Any, step_size: Any, inverse_mass: Any, key: Any, data: Any) -> Any:
        import blackjax

        kernel = blackjax.nuts(self._density(data), step_size, inverse_mass, max_num_doublings=self._settings.deepest)

        def step(state: Any, key: Any) -> tuple[Any, Any]:
            state, info = kernel.step(key, state)
            return state, (state.position, state.logdensity, info.is_divergent)

        return jax.lax.scan(step, kernel.init(phi), jax.random.split(jax.random.wrap_key_data(key), length))[1]


def _keys(rng: np.random.Generator, chains: int) -> np.ndarray:
    """JAX random keys, one per chain, as numbers."""
    return rng.integers(2**32, size=(chains, 2), dtype=np.uint32)
