"""A fitted NARX, combined with a POD-Kriging for the records of its runs."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.engine.time_loop import TimeLoop
from structid.ground_motion.excitation import Excitation
from structid.models.traceable import TracedExcitation
from structid.surrogates.base import Surrogate
from structid.surrogates.fit import Fit
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.narx.parametric_narx import ParametricNARX
from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
from structid.surrogates.pod.score_shortcut import ScoreShortcut


class NARXBesideKriging(Surrogate):
    """A fitted `CorrectedNARX`, which accepts any record and is most accurate on the records of its runs."""

    own_records: ClassVar[bool] = True  # other records are allowed, but the NARX responds to them

    def __init__(self, fit: Fit, narx: ParametricNARX, kriging: ResponseSpaceSurrogate) -> None:
        super().__init__(fit)
        # The Kriging must admit the same points as the whole, because a shortcut uses it directly.
        self.narx, self.kriging = narx, copy.copy(kriging)
        self.kriging.fitted = replace(kriging.fitted, low=fit.low, high=fit.high, outside=fit.outside)

    @property
    def kind_in_words(self) -> str:
        """Name of the NARX surrogate, with a note that the records of its runs are interpolated."""
        return f"{self.narx.fitted.kind} surrogate (interpolated on the records of its runs)"

    @property
    def structure_in_words(self) -> list[tuple[str, str]]:
        """Terms of the NARX, and records on which the response is interpolated."""
        records = ", ".join(f"'{fit.name}'" for fit in self.kriging.records.values())
        return [*self.narx.structure_in_words, ("response interpolated on", records)]

    def knows(self, identity: str) -> bool:
        """Whether the surrogate was fitted to runs on a record."""
        return identity in self.kriging.records

    def _responding(self, identity: str) -> ParametricNARX | ResponseSpaceSurrogate:
        """Return the part that computes the response to a record."""
        return self.kriging if self.knows(identity) else self.narx

    def check_excitation(self, excitation: Excitation) -> None:
        """Refuse an excitation of another kind or step; see `ParametricNARX.check_excitation`."""
        self.narx.check_excitation(excitation)

    def before_run(self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation) -> None:
        """Check excitation and points; warn of an excitation stronger than the training excitations."""
        super().before_run(theta, excitation)
        if not self.knows(excitation.content_hash):
            self.narx.before_run(theta, excitation)

    def time_loop(self, theta: Float[Array, "run parameter"], excitation: TracedExcitation) -> TimeLoop:
        """Return the loop of the part that computes the response; see `TraceableModel.time_loop`."""
        admitted = self.admitted(theta)
        loop = self._responding(excitation.identity).time_loop(theta, excitation)
        return loop._replace(usable=lambda state: loop.usable(state) & admitted)

    def shortcut(
        self,
        excitation: Excitation,
        values: Float[np.ndarray, "sample channel measurement"],
        channels: tuple[str, ...],
        sampled: Callable[[np.ndarray], np.ndarray] | None = None,
        instrument: Float[np.ndarray, "sample channel column"] | None = None,
    ) -> ScoreShortcut | None:
        """Return the shortcut of the Kriging, if the record is one of its records; see `TraceableModel.shortcut`."""
        if not self.knows(excitation.content_hash):
            return None
        return self.kriging.shortcut(excitation, values, channels, sampled, instrument)

    def error_variance(
        self,
        theta: Float[Array, "run parameter"],
        excitation: TracedExcitation,
        values: Float[Array, "time channel run"],
    ) -> Float[Array, "channel run"]:
        """Return the variance of the error, averaged over time; see `StandIn.error_variance`."""
        return self._responding(excitation.identity).error_variance(theta, excitation, values)

    def standard_deviation(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        values: Float[np.ndarray, "run time channel"],
    ) -> Float[np.ndarray, "run time channel"]:
        """Return the standard deviation in time of the part that computes the response."""
        return self._responding(excitation.content_hash).standard_deviation(theta, excitation, values)

    def sampled(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation, rng: np.random.Generator
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw responses from the error estimate; see `Surrogate.sampled`."""
        return self._responding(excitation.content_hash).sampled(theta, excitation, rng)

    def left_out(
        self, theta: Float[np.ndarray, "run parameter"], excitation: Excitation
    ) -> Float[np.ndarray, "run time channel"]:
        """Predict each training run from all others; see `ResponseSpaceSurrogate.left_out`."""
        return self.kriging.left_out(theta, excitation)

    @property
    def content_hash(self) -> str:
        """Hash of all data on which a response depends, without the fit times in a file."""
        fit = self.fitted
        return digest(fit.outside, fit.low, fit.high, self.narx.content_hash, self.kriging.content_hash)

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents for a file."""
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for name, part in (("narx", self.narx), ("kriging", self.kriging)):
            contents, part_arrays = part.to_plain()
            plain[name] = {"fit": part.fitted.to_plain(), "said": contents}
            arrays |= put_under(name, part_arrays)
        return plain, arrays

    @classmethod
    def from_plain(cls, fit: Fit, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> NARXBesideKriging:
        """Rebuild from the result of `to_plain`."""
        if "kriging" not in plain:
            raise InputError(
                "load_surrogate",
                "a CorrectedNARX of version 0.2, a sum of a NARX and a Kriging",
                "a CorrectedNARX of this version, in which the Kriging replaces the NARX on its records",
                "Fit the surrogate to its runs again.",
            )

        def part(kind: Any, name: str) -> Any:
            description = plain[name]
            return kind.from_plain(Fit.from_plain(description["fit"]), description["said"], found_under(name, arrays))

        return cls(fit, part(ParametricNARX, "narx"), part(ResponseSpaceSurrogate, "kriging"))
