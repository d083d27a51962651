"""All kinds of surrogate. To add a kind, write a file with its `SurrogateKind`, and add a line here."""

from __future__ import annotations

import os

from structid.core.validation import check_arguments
from structid.surrogates import storage
from structid.surrogates.base import Surrogate
from structid.surrogates.narx import corrected_narx, kriging_narx, narx, pc_narx
from structid.surrogates.pod import pod_kriging, pod_pce
from structid.surrogates.surrogate_kind import SurrogateKind

KINDS: tuple[SurrogateKind, ...] = (
    pod_kriging.KIND,
    pod_pce.KIND,
    pc_narx.KIND,
    kriging_narx.KIND,
    corrected_narx.KIND,
    narx.KIND,
)

DEFAULT: SurrogateKind = pod_kriging.KIND
"""Default surrogate of a calibration."""


@check_arguments
def load_surrogate(path: str | os.PathLike[str]) -> Surrogate:
    """Read a surrogate from a file that `Surrogate.save` wrote.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Surrogate
        The surrogate; on the same machine its predictions equal those of the saved surrogate to the last bit.

    Raises
    ------
    InputError
        If the file contains no surrogate, or has another layout.

    Examples
    --------
    >>> import structid as si
    >>> surrogate = si.load_surrogate("surrogate.h5")  # doctest: +SKIP
    """
    stored = storage.read(path)
    readers = {kind.name: kind.fitted for kind in KINDS}
    surrogate = readers[stored.fit.kind].from_plain(stored.fit, stored.plain, stored.arrays)
    surrogate.validation = stored.validation
    return surrogate
