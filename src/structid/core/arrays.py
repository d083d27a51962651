"""Array type for signatures: a NumPy array outside JAX, a JAX array inside it."""

from __future__ import annotations

from typing import Any

Array = Any
"""A NumPy array outside JAX, a JAX array inside it."""
