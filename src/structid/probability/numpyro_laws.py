"""NumPyro's distributions, imported late, and without what its progress bars say of a notebook that lacks widgets."""

from __future__ import annotations

import functools
import warnings
from typing import Any


@functools.cache
def distributions() -> Any:
    """Import NumPyro's distributions.

    Returns
    -------
    module
        ``numpyro.distributions``.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="IProgress not found")
        import numpyro.distributions

    return numpyro.distributions
