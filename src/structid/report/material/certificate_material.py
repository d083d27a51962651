"""What a certificate of somebody's draws leaves for its report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.certification.certificate import Certificate


@dataclass(frozen=True, eq=False)
class CertificateMaterial:
    """A certificate, and the units in which it is shown."""

    title: str  # Title, and the study file's text
    settings: str  # Title, and the study file's text
    source: str  # Where the draws came from
    certificate: Certificate  # The verdict and its figures
    names: tuple[str, ...]  # Parameters
    units: tuple[str, ...]  # Display unit of every parameter
    factors: Float[np.ndarray, " parameter"]  # SI value of one display unit
