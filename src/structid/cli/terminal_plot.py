"""A small plot of a signal in characters."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

WIDTH, HEIGHT = 72, 6
"""Size of a plot in characters."""

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""Bits of the dots of a braille character, by column and row."""


def terminal_plot(
    values: Float[np.ndarray, " time"], encoding: str = "utf-8", width: int = WIDTH, height: int = HEIGHT
) -> str:
    """Draw the range of a signal in each of many short intervals; missing samples stay empty.

    Each character has two columns and four rows of dots; a terminal without such characters gets letters.
    """
    unicode = encoding.lower().replace("-", "") in ("utf8", "utf16", "utf32")
    columns, rows = (2 * width, 4 * height) if unicode else (width, height)
    dots = _dots(values, min(columns, max(len(values), 1)), rows)
    if not unicode:
        return "\n".join("".join("#" if dot else " " for dot in row).rstrip() for row in dots)
    padded = np.zeros((rows, columns), dtype=bool)
    padded[:, : dots.shape[1]] = dots
    lines = []
    for row in range(0, rows, 4):
        codes = [
            sum(bit for c, bits in enumerate(_DOTS) for r, bit in enumerate(bits) if padded[row + r, column + c])
            for column in range(0, columns, 2)
        ]
        lines.append("".join(chr(0x2800 + code) for code in codes).rstrip("\u2800"))
    return "\n".join(lines)


def _dots(values: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """Mark the dots between the smallest and the largest value of each interval."""
    dots = np.zeros((rows, columns), dtype=bool)
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) == 0.0:
        dots[rows // 2] = known.size > 0
        return dots
    low, scale = float(known.min()), (rows - 1) / float(np.ptp(known))
    for column, part in enumerate(np.array_split(values, columns)):
        part = part[np.isfinite(part)]
        if part.size:
            bottom, top = (round((float(edge) - low) * scale) for edge in (part.min(), part.max()))
            dots[rows - 1 - top : rows - bottom, column] = True
    return dots
