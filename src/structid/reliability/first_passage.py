"""Time of the first passage of a limit by a response."""

from __future__ import annotations

import numpy as np

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.histories import Histories


@check_arguments
def first_passage(histories: Histories, channel: str, limit: float) -> np.ndarray:
    """Time at which the absolute value of a channel first exceeds a limit, interpolated linearly between samples.

    Parameters
    ----------
    histories : Histories
        Response histories of the runs.
    channel : str
        Name of the channel, such as ``"drift"``.
    limit : float
        Limit in the channel's SI unit.

    Returns
    -------
    ndarray, shape (run,)
        Times [s]; NaN for a run that stays within the limit until its end.

    Raises
    ------
    InputError
        If a run starts beyond the limit.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> law = {"alpha": 0.05, "beta": 63.0, "gamma": 63.0}
    >>> model = si.BoucWen(mass=12e3, stiffness=7.4e6, damping_ratio=0.03, channels=("displacement",), **law)
    >>> histories = model.simulate(np.empty((1, 0)), si.GroundMotion.synthetic(seed=7))
    >>> si.first_passage(histories, "displacement", 10.0)  # 10 m: never
    array([nan])
    """
    values = np.abs(histories.channel(channel))
    if not limit > 0.0 or (values[:, 0] >= limit).any():
        cure = f"Choose a limit above {values[:, 0].max():g}."
        raise InputError("first_passage(limit)", f"{limit:g}", "a positive limit above every run's initial value", cure)
    beyond = values > limit
    at = beyond.argmax(axis=1)
    runs = np.arange(len(values))
    before, after = values[runs, np.maximum(at - 1, 0)], values[runs, at]
    passed = beyond[runs, at]
    share = np.where(passed, (limit - before) / np.where(passed, after - before, 1.0), np.nan)
    return np.asarray(histories.dt * (at - 1 + share))
