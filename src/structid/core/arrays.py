"""The type of arrays that are NumPy's outside JAX and JAX's inside it, for signatures."""

from __future__ import annotations

from typing import Any

Array = Any
"""An array of NumPy outside JAX, of JAX inside it."""
