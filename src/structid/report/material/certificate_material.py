"""Data for the report of a certificate of external draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.certification.certificate import Certificate


@dataclass(frozen=True, eq=False)
class CertificateMaterial:
    """A certificate, and the units for its display."""

    title: str  # title
    settings: str  # text of the study file
    source: str  # source of the draws
    certificate: Certificate  # the certificate
    names: tuple[str, ...]  # parameters
    units: tuple[str, ...]  # display unit of every parameter
    factors: Float[np.ndarray, " parameter"]  # SI value of one display unit
