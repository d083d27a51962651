"""All kinds of surrogate. A new kind is a file with its `SurrogateKind` and a line here."""

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
    """Read a surrogate that `Surrogate.save` wrote.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Surrogate
        It predicts what it did when it was saved, to the last bit on the same machine.

    Raises
    ------
    InputError
        If the file is none, or of another version.

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
