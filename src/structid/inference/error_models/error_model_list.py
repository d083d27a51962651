"""All error models. A new error model needs a file with its `ErrorModelKind` and a line here."""

from __future__ import annotations

from structid.inference.error_models import drifting, independent, kernels, uncorrelated
from structid.inference.error_models.error_model_kind import ErrorModelKind

ERROR_MODELS: tuple[ErrorModelKind, ...] = (
    independent.IID_KIND,
    kernels.AR1_KIND,
    kernels.MATERN32_KIND,
    kernels.DAMPED_COSINE_KIND,
    uncorrelated.STUDENT_KIND,
    uncorrelated.PROPORTIONAL_KIND,
    uncorrelated.QUANTISED_KIND,
    drifting.DRIFTING_KIND,
)
