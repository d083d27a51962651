"""One posterior under many simulated measurements, evaluated together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.hashing import digest
from structid.engine.batches import LARGEST_BATCH, in_batches
from structid.engine.device import over_runs
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.lanes.signals import Signals
from structid.inference.likelihood.observation_likelihood import Measured
from structid.inference.likelihood.posterior import Posterior
from structid.inference.target import Target
from structid.models.traceable import TracedExcitation


class ReplicatedPosterior(Target):
    """Posteriors of many measurements, evaluated together; points are ordered by replica, equally many for each."""

    def __init__(self, posterior: Posterior, values: Sequence[np.ndarray]) -> None:
        self.names, self.bijection = posterior.names, posterior.bijection
        self._posterior = posterior
        self._values = [np.ascontiguousarray(v.transpose(1, 2, 0)) for v in values]
        self._count = len(values[0])
        self._kept_signals: tuple[int, list[tuple[slice, Signals]]] | None = None

    @property
    def knows_prior(self) -> bool:
        """Always."""
        return True

    @cached_property
    def _measured(self) -> tuple[Measured, ...]:
        """Data of each observation in all replicas."""
        bounds = self._posterior.likelihood.of
        return tuple(bound.measured_as(values) for bound, values in zip(bounds, self._values, strict=True))

    @cached_property
    def _compiled(self) -> Callable[..., Any]:
        def parts(phi_and_replica: Any, data: tuple[Measured, ...]) -> tuple[Any, Any, Any]:
            phi, replica = phi_and_replica[:, :-1], phi_and_replica[:, -1].astype(int)
            replicas = tuple(measured.for_runs(replica) for measured in data)
            return self._posterior.parts_in_coordinates(phi, replicas)

        return over_runs(parts, shard=self._posterior.likelihood.loops_over_time)

    @cached_property
    def _in_lanes(self) -> Callable[..., Any] | None:
        """Compiled vector code of the density, with the measurements as signals; None if impossible.

        A likelihood shortcut needs the measurements in a different form than a loop over time does.
        """
        posterior = self._posterior
        if not (posterior.model.traceable and posterior.likelihood.loops_over_time and len(self._values) == 1):
            return None
        (measured,) = self._measured
        if measured.shortcut is not None:
            return None

        def parts(phi: Any, signals: Any, excitation: TracedExcitation) -> tuple[Any, Any, Any]:
            return posterior.parts_in_coordinates(phi, (Measured(excitation, signals, None),))

        return InLanes(parts).compiled(posterior.dimension, (measured.excitation,), measured.values.shape[:2])

    def _replicas(self, runs: int) -> np.ndarray:
        """Index of the replica of every run."""
        return np.repeat(np.arange(self._count), runs // self._count)

    def _signals(self, runs: int) -> list[tuple[slice, Signals]]:
        """Batches of runs, ordered by replica, with their measurements; cached by number of runs."""
        if self._kept_signals is None or self._kept_signals[0] != runs:
            measured_values = self._measured[0].values.transpose(2, 0, 1)
            batches = [slice(start, start + LARGEST_BATCH) for start in range(0, runs, LARGEST_BATCH)]
            replica = self._replicas(runs)
            self._kept_signals = runs, [(batch, Signals(measured_values, replica[batch])) for batch in batches]
        return self._kept_signals[1]

    def evaluate_parts(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log prior and log-likelihood; see `Target.evaluate_parts`."""
        lanes = self._in_lanes
        if lanes is not None:
            parts = [lanes(phi[runs], signals) for runs, signals in self._signals(len(phi))]
            prior, likelihood, failed = (np.concatenate(column) for column in zip(*parts, strict=True))
            return prior, likelihood, failed
        replica = self._replicas(len(phi))
        if self._posterior.model.traceable:
            rows = np.concatenate([phi, replica[:, None]], axis=1)
            prior, likelihood, failed = in_batches(self._compiled, rows, self._measured)
            return prior, likelihood, failed
        theta, jacobian = self.bijection(phi)
        prior = self._posterior.space.log_density(theta)
        values_of_replicas = [values[:, :, replica] for values in self._values]
        likelihood, failed = self._posterior.likelihood.on_host(theta, np.isfinite(prior), values_of_replicas)
        return prior + jacobian, likelihood, failed

    def evaluate(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Log density; see `Target.evaluate`."""
        prior, likelihood, failed = self.evaluate_parts(phi)
        return prior + likelihood, failed

    def log_density(self, theta: Float[np.ndarray, "run parameter"]) -> Float[np.ndarray, " run"]:
        """Log density with respect to the parameters; see `Target.log_density`."""
        phi = self.bijection.inverse(theta)
        return np.asarray(self.evaluate(phi)[0] - self.bijection(phi)[1])

    def initial(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count parameter"]:
        """Draw from the prior; see `Target.initial`."""
        return self._posterior.initial(count, rng)

    @property
    def content_hash(self) -> str:
        """Hash of the posterior and the measurements."""
        return digest(self._posterior.content_hash, *self._values)
