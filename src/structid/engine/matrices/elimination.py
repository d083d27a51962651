"""In which order the unknowns of a sparse system are eliminated, which places fill in, and the operations of LU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True, eq=False)
class Elimination:
    """Places of the blocks with those that fill in, and the operations of LU without pivoting."""

    order: Int[np.ndarray, " size"]  # Unknowns as they are eliminated
    diagonal: Int[np.ndarray, " size"]  # Place of the diagonal block of each, in that order
    given: Int[np.ndarray, " block"]  # Places of the pattern's own blocks
    count: int  # Number of places
    below: np.ndarray  # Places of the blocks below each pivot, one after the other, and where those of a pivot begin
    # Places of the blocks below each pivot, one after the other, and where those of a pivot begin
    first_below: np.ndarray
    row_below: np.ndarray  # Unknowns of these blocks
    beside: np.ndarray  # The same of the blocks to the right
    first_beside: np.ndarray  # The same of the blocks to the right
    row_beside: np.ndarray  # The same of the blocks to the right
    # For every pivot, block below and block beside it: the place that their product is subtracted from
    target: np.ndarray
    first_target: Int[np.ndarray, " below"]  # Where those of a block below begin


def elimination(rows: Int[np.ndarray, " block"], columns: Int[np.ndarray, " block"], size: int) -> Elimination:
    """Plan the elimination of a matrix with a symmetric pattern."""
    order, filled = _minimum_degree(rows, columns, size)
    place = {pair: number for number, pair in enumerate(sorted(filled))}
    position = {int(unknown): number for number, unknown in enumerate(order)}
    lists: dict[str, list[int]] = {n: [] for n in ("below", "row_below", "beside", "row_beside", "target")}
    firsts: dict[str, list[int]] = {n: [0] for n in ("below", "beside", "target")}
    for number, k in enumerate(order):
        later = [int(i) for i in order[number + 1 :] if (int(i), int(k)) in filled]
        later.sort(key=lambda i: position[i])
        for i in later:
            lists["below"].append(place[i, int(k)])
            lists["beside"].append(place[int(k), i])
            lists["row_below"].append(i)
            lists["row_beside"].append(i)
            lists["target"] += [place[i, j] for j in later]
            firsts["target"].append(len(lists["target"]))
        firsts["below"].append(len(lists["below"]))
        firsts["beside"].append(len(lists["beside"]))
    given = [place[int(i), int(j)] for i, j in zip(rows, columns, strict=True)]
    arrays = {name: np.array(values, dtype=np.int64) for name, values in lists.items()}
    return Elimination(
        np.array(order),
        np.array([place[int(k), int(k)] for k in order]),
        np.array(given),
        len(place),
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
    """Order of elimination in which each time the unknown with the fewest neighbours goes, and all blocks that are then filled."""
    neighbours = {k: set(columns[rows == k].tolist()) - {k} for k in range(size)}
    filled = {(int(i), int(j)) for i, j in zip(rows, columns, strict=True)}
    order = []
    while neighbours:
        k = min(neighbours, key=lambda i: (len(neighbours[i]), i))
        own = neighbours.pop(k)
        for i in own:
            neighbours[i] = (neighbours[i] | own) - {i, k}
        filled |= {(i, j) for i in own for j in own}
        order.append(k)
    return order, filled
