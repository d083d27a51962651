"""Limits of a channel."""

from __future__ import annotations

from structid.core.units import to_si
from structid.models.base import Model


def limit_of(limit: float | str, channel: str, model: Model, where: str) -> float:
    """Convert a limit of a channel to SI."""
    return to_si(limit, model.channel_units[channel].si, f"key '{where}'")
