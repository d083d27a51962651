"""The type of arrays that may be NumPy's or JAX's, for signatures that give their shape."""

from __future__ import annotations

from typing import Any

Array = Any
"""An array of NumPy outside JAX, of JAX inside it."""
