"""Root of a decreasing function, for functions that a library's root finder refuses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def root_of_falling(function: Callable[[float], float], start: float, tolerance: float) -> float:
    """Find where a decreasing function changes its sign, by steps from a start that double, and bisection of the last step.

    Log densities of diverging runs span 1e300. The last step is as long as the distance from the start, so that its bisection ends
    after about fifty calls, whatever the span. A function that does not change its sign, or is not a number, gives an end of the
    search, and no error.
    """
    above = function(start) > 0.0
    inner, step = start, 1.0
    outer = start + step if above else start - step
    while np.isfinite(outer) and (function(outer) > 0.0) == above:
        inner, step = outer, 2.0 * step
        outer = inner + step if above else inner - step
    low, high = (inner, outer) if above else (outer, inner)
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if function(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)
