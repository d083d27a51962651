"""The budget of a calibration's model runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from structid.certification.limits import Limits
from structid.core.errors import InputError
from structid.core.renamed import renamed_argument, renamed_attribute
from structid.core.validation import check_arguments
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.smc.smc import SMC
from structid.probability.designs import Design
from structid.surrogates.base import SurrogateSettings

FIRST_DESIGN = (2, 2)
"""Number of points of a first design, and number of additional points for each parameter."""

FEWEST = 10
"""Minimum number of points of a first design."""

IN_A_ROUND, FURTHER, AMONG = 10, 4, 4
"""Points in a round, additional points for each further parameter, and number of parameters without such points."""

ENLARGED = 1.25
"""Factor by which a first design grows until a surrogate can be fitted to it."""

FEWEST_IN_A_BATCH = 4
"""Smallest batch for which another round precedes the last certificate."""


@renamed_argument(explorer="exploration_sampler")
@check_arguments
@dataclass(frozen=True)
class Plan:
    """The budget of model runs and its use.

    Parameters
    ----------
    true_runs : int
        Largest number of parameter points at which the true model is run, including the certificate's points. Each is run on
        every record.
    start : int, optional
        Points of the first design. By default two plus two for each parameter, at least ten, or as many as the surrogate
        requires.
    batch : int, optional
        Points added in each round. By default ten for up to four parameters, and four more for each further parameter. A larger
        batch takes fewer rounds but more runs, which suits many simultaneous runs. With less than half of the default, a
        surrogate of many parameters may never come near the posterior.
    certificate : int
        Fresh draws for a certificate, a third of them tempered.
    widen : float
        Reach of the first design relative to the prior, in normal scores.
    limits : Limits
        Limits that the certificate must meet.
    exploration_sampler : SMC
        Sampler that explores the surrogate's posterior in each round.

    Examples
    --------
    >>> import structid as si
    >>> plan = si.Plan(true_runs=200, limits=si.Limits(mean=0.05))
    >>> plan.true_runs
    200
    """

    true_runs: int = 500
    start: int | None = None
    batch: int | None = None
    certificate: int = 30
    widen: float = 1.0
    limits: Limits = field(default_factory=Limits)
    exploration_sampler: SMC = field(
        default_factory=lambda: SMC(particles=250, steps=10, effective_share=0.5, correlation=0.5, scouts=0)
    )

    explorer = renamed_attribute("explorer", "exploration_sampler")

    def __post_init__(self) -> None:
        for name, least in (("start", FEWEST), ("batch", 4), ("certificate", 20)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"calibrate({name})", f"{value!r}", f"a whole number, {least} or more")
        drawn = self.exploration_sampler.particles * self.exploration_sampler.ensembles
        if drawn < 2 * self.certificate:
            raise InputError("calibrate(exploration_sampler)", f"{drawn} particles", f"{2 * self.certificate} or more")
        self._check_budget()

    def _check_budget(self) -> None:
        start = FEWEST if self.start is None else self.start
        if self.true_runs < start + self.certificate:
            raise InputError(
                "calibrate(true_runs)",
                f"{self.true_runs}",
                f"{start + self.certificate} or more: {start} for the first design and {self.certificate} for a certificate",
            )

    def sized(self, posterior: Posterior, settings: SurrogateSettings) -> Plan:
        """Fill in the numbers that were left open.

        Parameters
        ----------
        posterior : Posterior
            Posterior to calibrate.
        settings : PODKriging, PODPCE, PCNARX or KrigingNARX
            Settings of the surrogate.

        Returns
        -------
        Plan
            Plan with the numbers of points in the first design and in each round.

        Raises
        ------
        InputError
            If the first design leaves no runs in the budget for a certificate.
        """
        dimension = posterior.model_space.dimension
        points, each = IN_A_ROUND + FURTHER * max(dimension - AMONG, 0), FIRST_DESIGN[1] * dimension
        sized = replace(self, batch=points if self.batch is None else self.batch)
        if self.start is None:
            sized = replace(sized, start=self._enough(max(FIRST_DESIGN[0] + each, FEWEST), posterior, settings))
        return sized

    def _enough(self, start: int, posterior: Posterior, settings: SurrogateSettings) -> int:
        """Return the smallest sufficient number of points tried for a surrogate; `start` if none suffices."""
        space, records = (
            posterior.model_space,
            tuple({o.record.content_hash: o.record for o in posterior.observations}.values()),
        )
        count = start
        while count <= self.true_runs - self.certificate:
            points = np.repeat(space.sample(count, 0, "sobol").values, len(records), axis=0)
            try:
                settings.check(Design(points, space), records, posterior.model.channels)
            except InputError:
                count = math.ceil(ENLARGED * count)
            else:
                return count
        return start

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of points in the first design and in each round, for a plan returned by `sized`."""
        assert self.start is not None and self.batch is not None
        return self.start, self.batch

    @property
    def rounds(self) -> int:
        """Largest number of rounds between the first design and the last certificate."""
        start, batch = self.sizes
        return (self.true_runs - start - self.certificate) // batch

    def describe(self) -> dict[str, Any]:
        """Return the settings that determine the points of model runs: all except the budget and the limits.

        Returns
        -------
        dict
            Settings for hashes. A larger budget leaves them unchanged, and therefore continues a stored calibration.
        """
        return {
            "start": self.start,
            "batch": self.batch,
            "certificate": self.certificate,
            "widen": self.widen,
            "explorer": {**self.exploration_sampler.describe(), "steps": self.exploration_sampler.steps},
        }
