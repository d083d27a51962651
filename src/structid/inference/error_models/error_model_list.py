"""All error models. A new error model needs a file with its `ErrorModelKind` and a line here."""

from __future__ import annotations

from structid.inference.error_models import drifting, independent, kernels, outliers, proportional, quantised
from structid.inference.error_models.error_model_kind import ErrorModelKind

ERROR_MODELS: tuple[ErrorModelKind, ...] = (
    independent.IID_KIND,
    kernels.AR1_KIND,
    kernels.MATERN32_KIND,
    kernels.DAMPED_COSINE_KIND,
    outliers.STUDENT_KIND,
    outliers.CONTAMINATED_KIND,
    proportional.PROPORTIONAL_KIND,
    quantised.QUANTISED_KIND,
    drifting.DRIFTING_KIND,
)
