"""A fitted NARX with an interpolation of its residuals on the records of its runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.hashing import digest
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.models.traceable import TracedExcitation
from structid.surrogates.base import Surrogate
from structid.surrogates.fit import Fit
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
from structid.surrogates.pod.score_shortcut import ScoreShortcut


class NARXWithRest(Surrogate):
    """A fitted `CorrectedNARX`: accepts any record, and is most accurate on those of its runs."""

    own_records: ClassVar[bool] = True  # not only these, but its response to them is another one

    def __init__(self, fit: Fit, narx: ParametricNARX, rest: ResponseSpaceSurrogate, whole: bool = False) -> None:
        super().__init__(fit)
        self.narx, self.rest, self.whole = narx, rest, whole

    @property
    def kind_in_words(self) -> str:
        """The kind named by the user, with its correction on some records."""
        return f"{self.narx.fitted.kind} surrogate (interpolated on the records of its runs)"

    @property
    def structure_in_words(self) -> list[tuple[str, str]]:
        """The terms, and the records with a correction."""
        records = ", ".join(f"'{fit.name}'" for fit in self.rest.records.values())
        of = "the response itself is interpolated on" if self.whole else "what they leave over is interpolated on"
        return [*self.narx.structure_in_words, (of, records)]

    def knows(self, identity: str) -> bool:
        """Whether the surrogate was fitted to runs on a record."""
        return identity in self.rest.records

    def _alone(self, identity: str) -> ParametricNARX | ResponseSpaceSurrogate | None:
        """The part that responds alone to a record; None where their sum does."""
        if not self.knows(identity):
            return self.narx
        return self.rest if self.whole else None

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation of another kind or step; see `ParametricNARX.check_excitation`."""
        self.narx.check_excitation(excitation)

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check excitation and points; warn of an excitation stronger than those of the fit."""
        super().before_run(theta, excitation)
        if not self.knows(excitation.content_hash):
            self.narx.before_run(theta, excitation)

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop:
        """Loop of the free run with the correction added at each sample; see `TraceableModel.time_loop`."""
        admitted = self.admitted(theta)
        alone = self._alone(excitation.identity)
        if alone is not None:
            loop = alone.time_loop(theta, excitation)
            return loop._replace(usable=lambda state: loop.usable(state) & admitted)
        narx, rest = self.narx.time_loop(theta, excitation), self.rest.time_loop(theta, excitation)

        def step(states: tuple[Any, Any], rows: tuple[Any, Any]) -> tuple[tuple[Any, Any], Any]:
            of_narx, free = narx.step(states[0], rows[0])
            of_rest, left_over = rest.step(states[1], rows[1])
            return (of_narx, of_rest), free + left_over

        def usable(states: tuple[Any, Any]) -> Any:
            return narx.usable(states[0]) & rest.usable(states[1]) & admitted

        # Nothing of the lead-in is kept; the rest has no rows for it.
        rows = narx.rows, tuple(jnp.tile(x, (1 + excitation.lead_in_periods, *[1] * (x.ndim - 1))) for x in rest.rows)
        return TimeLoop((narx.start, rest.start), step, rows, narx.lead_in, usable, narx.unroll)

    def shortcut(
        self, excitation: Excitation, values: Float[np.ndarray, "time channel measurement"], channels: tuple[str, ...]
    ) -> ScoreShortcut | None:
        """Sum modes and measurements over time where the whole response is interpolated; see `TraceableModel.shortcut`."""
        if self._alone(excitation.content_hash) is not self.rest:
            return None
        return self.rest.shortcut(excitation, values, channels)

    def error_variance(
        self,
        theta: Float[Array, "run parameter"],
        excitation: TracedExcitation,
        values: Float[Array, "time channel run"],
    ) -> Float[Array, "channel run"]:
        """Variance of the error, averaged over time; see `StandIn.error_variance`."""
        knowing = self.rest if self.knows(excitation.identity) else self.narx
        return knowing.error_variance(theta, excitation, values)

    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Standard deviation in time: that of the correction on the records of the runs, that of the NARX on others."""
        knowing = self.rest if self.knows(excitation.content_hash) else self.narx
        return knowing.standard_deviation(theta, excitation, values)

    def sampled(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation, rng: np.random.Generator
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw responses from the error estimate; see `Surrogate.sampled`."""
        alone = self._alone(excitation.content_hash)
        if alone is not None:
            return alone.sampled(theta, excitation, rng)
        return np.asarray(self.narx.run(theta, excitation).values + self.rest.sampled(theta, excitation, rng))

    def left_out(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation
    ) -> Float[np.ndarray, "run time channel"]:
        """Predict each run of the fit with a correction from all others; see `ResponseSpaceSurrogate.left_out`."""
        if self.whole:
            return self.rest.left_out(theta, excitation)
        values = self.narx.run(theta, excitation).values
        through = np.isfinite(values).all(axis=(1, 2))
        values[through] += self.rest.left_out(theta[through], excitation)
        values[~through] = np.nan
        return values

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on, excluding fit times, which a file contains."""
        fit = self.fitted
        return digest(fit.outside, fit.low, fit.high, self.whole, self.narx.content_hash, self.rest.content_hash)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Contents for a file."""
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for name, part in (("narx", self.narx), ("rest", self.rest)):
            contents, part_arrays = part.to_plain()
            plain[name] = {"fit": part.fitted.to_plain(), "said": contents}
            arrays |= put_under(name, part_arrays)
        return {**plain, "whole": self.whole}, arrays

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> NARXWithRest:
        """Rebuild from the result of `to_plain`."""

        def part(kind: Any, name: str) -> Any:
            description = plain[name]
            return kind.from_plain(Fit.from_plain(description["fit"]), description["said"], found_under(name, arrays))

        return cls(fit, part(ParametricNARX, "narx"), part(ResponseSpaceSurrogate, "rest"), plain["whole"])
