"""Standard names of response channels and their units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from structid.core.errors import InputError, check_choice
from structid.core.units import factor_of, si_unit


class ChannelUnit(NamedTuple):
    """SI unit and display unit of a channel."""

    si: str  # SI unit of the values; empty for an unknown dimension
    display: str  # unit in tables and figures


UNKNOWN = ChannelUnit("", "")
"""Units of a channel if neither its name nor its model defines them."""

STANDARD_CHANNELS = {
    "displacement": ChannelUnit("m", "mm"),
    "velocity": ChannelUnit("m/s", "mm/s"),
    "relative_acceleration": ChannelUnit("m/s^2", "m/s^2"),
    "absolute_acceleration": ChannelUnit("m/s^2", "m/s^2"),
    "restoring_force": ChannelUnit("N", "kN"),
    "moment": ChannelUnit("N*m", "kN*m"),
    "hysteretic_displacement": ChannelUnit("m", "mm"),
    "hysteretic_energy": ChannelUnit("J", "J"),
    "elastic_energy": ChannelUnit("J", "J"),
    "absorbed_energy": ChannelUnit("J", "J"),
    "drift": ChannelUnit("m", "mm"),
    "base_shear": ChannelUnit("N", "kN"),
    "largest_opening": ChannelUnit("m", "mm"),
    "largest_slip": ChannelUnit("m", "mm"),
    "largest_penetration": ChannelUnit("m", "mm"),
    "support_lost": ChannelUnit("", ""),
    "weakest_joint": ChannelUnit("", ""),
    "kinetic_energy": ChannelUnit("J", "J"),
    "strain_energy": ChannelUnit("J", "J"),
    "joint_energy": ChannelUnit("J", "J"),
    "damping_energy": ChannelUnit("J", "J"),
    "input_energy": ChannelUnit("J", "J"),
    "load_energy": ChannelUnit("J", "J"),
}
"""Units of the channels of built-in models. A model with other channels declares their units itself."""

OF_A_POINT = ("ux_", "uy_")
"""Prefixes of channels for the displacement of a point: ``"ux_top_left"`` is a horizontal displacement."""


def base_channel(channel: str) -> str:
    """Remove the storey number from a channel name."""
    head, _, tail = channel.rpartition("_")
    return head if tail.isdigit() else channel


def standard_unit(channel: str) -> ChannelUnit:
    """Return the units that a channel name implies."""
    of_a_point = STANDARD_CHANNELS["displacement"] if channel.startswith(OF_A_POINT) else UNKNOWN
    return STANDARD_CHANNELS.get(base_channel(channel), of_a_point)


def declared_unit(channel: str, unit: str) -> ChannelUnit:
    """Return the units of a channel for a declared display unit."""
    standard = standard_unit(channel)
    if standard.si:
        factor_of(unit, standard.si, f"unit of the channel '{channel}'")
        return standard
    return ChannelUnit(si_unit(unit), unit)


def check_channels(where: str, channels: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Return `channels` as a tuple; refuse unknown and repeated names."""
    names: tuple[Any, ...] = (channels,) if isinstance(channels, str) else tuple(channels)
    for name in names:
        if name not in known and f"absolute_{name}" in known:
            cure = f"A sensor on the structure measures 'absolute_{name}'; 'relative_{name}' is relative to the base."
            raise InputError(where, f"'{name}'", ", ".join(known), cure)
        check_choice(where, name, known)
    if not names or len(set(names)) < len(names):
        raise InputError(where, f"{list(names)}", f"one or more of {', '.join(known)}, each once")
    return names
