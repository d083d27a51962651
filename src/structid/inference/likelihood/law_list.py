"""Every law of the discrepancy there is. A new one is a file with its `LawKind` and a line here."""

from __future__ import annotations

from structid.inference.likelihood import independent, kernels
from structid.inference.likelihood.law_kind import LawKind

LAWS: tuple[LawKind, ...] = (
    independent.IID_KIND,
    kernels.AR1_KIND,
    kernels.MATERN32_KIND,
    kernels.DAMPED_COSINE_KIND,
)


def law_by_word() -> dict[str, LawKind]:
    """Laws that a study file can name.

    Returns
    -------
    dict of str to LawKind
        By their words.
    """
    return {kind.word: kind for kind in LAWS}
