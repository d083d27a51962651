"""How the true runs of a calibration are spent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from structid.errors import InputError, names_checked
from structid.inference.assessment.certificate import Limits
from structid.inference.sampling.tempered import SMC


@names_checked
@dataclass(frozen=True)
class Plan:
    """How true runs are spent.

    Parameters
    ----------
    true_runs : int
        Largest number of parameter points at which the true model is run, including those of the certificate. Each is run on
        every record.
    start : int
        Points of the first design.
    batch : int
        Points added in each round. Who can run many at once may ask for as many: fewer rounds, and more runs.
    certificate : int
        Fresh draws for a certificate, a third of them tempered.
    widen : float
        How much further than the prior the first design reaches, in normal scores.
    limits : Limits
        What the certificate must meet.
    explorer : SMC
        Explores the surrogate's posterior in each round.
    """

    true_runs: int = 500
    start: int = 14
    batch: int = 10
    certificate: int = 30
    widen: float = 1.0
    limits: Limits = field(default_factory=Limits)
    explorer: SMC = field(
        default_factory=lambda: SMC(particles=250, steps=10, effective_share=0.5, correlation=0.5, scouts=0)
    )

    def __post_init__(self) -> None:
        for name, least in (("start", 10), ("batch", 4), ("certificate", 20)):
            value = getattr(self, name)
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"calibrate({name})", f"{value!r}", f"a whole number, {least} or more")
        if self.true_runs < self.start + self.certificate:
            raise InputError(
                "calibrate(true_runs)",
                f"{self.true_runs}",
                f"{self.start + self.certificate} or more: {self.start} of the first design and {self.certificate} of a "
                "certificate",
            )
        drawn = self.explorer.particles * self.explorer.ensembles
        if drawn < 2 * self.certificate:
            raise InputError("calibrate(explorer)", f"{drawn} particles", f"{2 * self.certificate} or more")

    @property
    def rounds(self) -> int:
        """Largest number of rounds between the first design and the last certificate."""
        return (self.true_runs - self.start - self.certificate) // self.batch

    def describe(self) -> dict[str, Any]:
        """Settings that decide the points: all except how many there may be.

        Returns
        -------
        dict
            For hashes; a calibration with more true runs continues the same one.
        """
        return {
            "start": self.start, "batch": self.batch, "certificate": self.certificate, "widen": self.widen,
            "explorer": {**self.explorer.describe(), "steps": self.explorer.steps},
        }  # fmt: skip
