"""Elimination order, fill-in and LU operations of a sparse system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True, eq=False)
class Elimination:
    """Positions of the blocks including fill-in, and the operations of an LU factorisation without pivoting."""

    order: Int[np.ndarray, " size"]  # unknowns in the order of elimination
    diagonal: Int[np.ndarray, " size"]  # positions of the diagonal blocks, in the order of elimination
    given: Int[np.ndarray, " block"]  # positions of the pattern's own blocks
    count: int  # number of positions
    below: np.ndarray  # positions of the blocks below each pivot
    # Index in `below` at which the blocks of each pivot start
    first_below: np.ndarray
    row_below: np.ndarray  # unknowns of the blocks below
    beside: np.ndarray  # positions of the blocks to the right of each pivot
    first_beside: np.ndarray  # index in `beside` at which the blocks of each pivot start
    row_beside: np.ndarray  # unknowns of the blocks to the right
    # Position from which the product is subtracted, for every pivot, block below and block to its right
    target: np.ndarray
    first_target: Int[np.ndarray, " below"]  # index in `target` at which the targets of each block below start


def elimination(rows: Int[np.ndarray, " block"], columns: Int[np.ndarray, " block"], size: int) -> Elimination:
    """Plan the elimination of a matrix with a symmetric pattern."""
    order, filled = _minimum_degree(rows, columns, size)
    entry_of = {pair: number for number, pair in enumerate(sorted(filled))}
    position = {int(unknown): number for number, unknown in enumerate(order)}
    lists: dict[str, list[int]] = {n: [] for n in ("below", "row_below", "beside", "row_beside", "target")}
    firsts: dict[str, list[int]] = {n: [0] for n in ("below", "beside", "target")}
    for number, k in enumerate(order):
        later = [int(i) for i in order[number + 1 :] if (int(i), int(k)) in filled]
        later.sort(key=lambda i: position[i])
        for i in later:
            lists["below"].append(entry_of[i, int(k)])
            lists["beside"].append(entry_of[int(k), i])
            lists["row_below"].append(i)
            lists["row_beside"].append(i)
            lists["target"] += [entry_of[i, j] for j in later]
            firsts["target"].append(len(lists["target"]))
        firsts["below"].append(len(lists["below"]))
        firsts["beside"].append(len(lists["beside"]))
    given = [entry_of[int(i), int(j)] for i, j in zip(rows, columns, strict=True)]
    arrays = {name: np.array(values, dtype=np.int64) for name, values in lists.items()}
    return Elimination(
        np.array(order),
        np.array([entry_of[int(k), int(k)] for k in order]),
        np.array(given),
        len(entry_of),
        arrays["below"],
        np.array(firsts["below"]),
        arrays["row_below"],
        arrays["beside"],
        np.array(firsts["beside"]),
        arrays["row_beside"],
        arrays["target"],
        np.array(firsts["target"]),
    )


def _minimum_degree(rows: np.ndarray, columns: np.ndarray, size: int) -> tuple[list[int], set[tuple[int, int]]]:
    """Return the minimum-degree ordering, and all blocks including fill-in."""
    neighbours = {k: set(columns[rows == k].tolist()) - {k} for k in range(size)}
    filled = {(int(i), int(j)) for i, j in zip(rows, columns, strict=True)}
    order = []
    while neighbours:
        k = min(neighbours, key=lambda i: (len(neighbours[i]), i))
        neighbourhood = neighbours.pop(k)
        for i in neighbourhood:
            neighbours[i] = (neighbours[i] | neighbourhood) - {i, k}
        filled |= {(i, j) for i in neighbourhood for j in neighbourhood}
        order.append(k)
    return order, filled
