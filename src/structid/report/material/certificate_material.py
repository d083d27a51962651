"""What a certificate of somebody's draws leaves for its report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.certification.certificate import Certificate


@dataclass(frozen=True, eq=False)
class CertificateMaterial:
    """A certificate, and the units in which it is shown.

    Parameters
    ----------
    title, settings : str
        Title, and the study file's text.
    source : str
        Where the draws came from.
    certificate : Certificate
        The verdict and its figures.
    names : tuple of str
        Parameters.
    units : tuple of str
        Display unit of every parameter.
    factors : ndarray, shape (parameter,)
        SI value of one display unit.
    """

    title: str
    settings: str
    source: str
    certificate: Certificate
    names: tuple[str, ...]
    units: tuple[str, ...]
    factors: Float[np.ndarray, " parameter"]
