"""Every kind of model that a study file can name. A new one is a file with its `ModelKind` and a line here."""

from __future__ import annotations

from structid.models import bouc_wen, shear_frame
from structid.models.kind import ModelKind
from structid.study.kinds import external_models

MODELS: tuple[ModelKind, ...] = (
    bouc_wen.KIND,
    shear_frame.KIND,
    external_models.PYTHON,
    external_models.PROGRAM,
    external_models.UMBRIDGE,
)


def model_by_word() -> dict[str, ModelKind]:
    """Kinds of model by what a study file calls them.

    Returns
    -------
    dict of str to ModelKind
        By their words.
    """
    return {kind.word: kind for kind in MODELS}
