"""Memory that a compiler has freed, returned to the operating system."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable


def return_freed_memory() -> None:
    """Return freed memory to the operating system, if the C library can (glibc).

    LLVM and XLA free most of the hundred megabytes that a compilation takes, but in pieces between others that stay: without this
    call the process keeps all of it.
    """
    _trim()(0)


@functools.cache
def _trim() -> Callable[[int], object]:
    try:
        trim: Callable[[int], object] = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # macOS, musl, Windows
        return lambda _: None
    return trim
