"""All kinds of model that a study file can name. To add a kind, write a file with its `ModelKind`, and add a line here."""

from __future__ import annotations

from structid.models.external import external_kinds as external_models
from structid.models.hysteretic import bouc_wen, hysteretic, hysteretic_frame, shear_frame
from structid.models.masonry import wall_kind
from structid.models.model_kind import ModelKind

MODELS: tuple[ModelKind, ...] = (
    bouc_wen.KIND,
    shear_frame.KIND,
    hysteretic.KIND,
    hysteretic_frame.KIND,
    wall_kind.KIND,
    external_models.PYTHON,
    external_models.PROGRAM,
    external_models.UMBRIDGE,
)
