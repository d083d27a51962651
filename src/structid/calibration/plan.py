"""How the true runs of a calibration are spent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from structid.errors import InputError, names_checked
from structid.inference.assessment.certificate import Limits
from structid.inference.sampling.tempered import SMC


START = 10
"""Points of a first design, and one more for each parameter."""


@names_checked
@dataclass(frozen=True)
class Plan:
    """How true runs are spent.

    Parameters
    ----------
    true_runs : int
        Largest number of parameter points at which the true model is run, including those of the certificate. Each is run on
        every record.
    start : int, optional
        Points of the first design; ten and one for each parameter when left out.
    batch : int
        Points added in each round. A solver that runs on many cores at once may be given as many: fewer rounds, more runs.
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
    start: int | None = None
    batch: int = 10
    certificate: int = 30
    widen: float = float(__import__('os').environ.get('WID','1.0'))
    limits: Limits = field(default_factory=Limits)
    explorer: SMC = field(
        default_factory=lambda: SMC(particles=250, steps=10, effective_share=0.5, correlation=0.5, scouts=0)
    )

    def __post_init__(self) -> None:
        for name, least in (("start", 10), ("batch", 4), ("certificate", 20)):
            value = getattr(self, name)
            if value is None and name == "start":
                continue
            if not (isinstance(value, (int, np.integer)) and value >= least):
                raise InputError(f"calibrate({name})", f"{value!r}", f"a whole number, {least} or more")
        first = START if self.start is None else self.start
        if self.true_runs < first + self.certificate:
            raise InputError(
                "calibrate(true_runs)",
                f"{self.true_runs}",
                f"{first + self.certificate} or more: {first} of the first design and {self.certificate} of a certificate",
            )
        drawn = self.explorer.particles * self.explorer.ensembles
        if drawn < 2 * self.certificate:
            raise InputError("calibrate(explorer)", f"{drawn} particles", f"{2 * self.certificate} or more")

    def first(self, parameters: int) -> int:
        """Points of the first design.

        Parameters
        ----------
        parameters : int
            Number of the model's parameters.

        Returns
        -------
        int
            `start`, or as many as are usual.
        """
        return START + parameters if self.start is None else self.start

    def rounds(self, parameters: int) -> int:
        """Largest number of rounds between the first design and the last certificate.

        Parameters
        ----------
        parameters : int
            Number of the model's parameters.

        Returns
        -------
        int
            As the budget allows.
        """
        return max(self.true_runs - self.first(parameters) - self.certificate, 0) // self.batch

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
