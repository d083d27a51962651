"""In which order the unknowns of a sparse system are eliminated, which places fill in, and the operations of LU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True, eq=False)
class Elimination:
    """Places of the blocks with those that fill in, and the operations of LU without pivoting.

    Parameters
    ----------
    order : ndarray of int, shape (size,)
        Unknowns as they are eliminated.
    diagonal : ndarray of int, shape (size,)
        Place of the diagonal block of each, in that order.
    given : ndarray of int, shape (block,)
        Places of the pattern's own blocks.
    count : int
        Number of places.
    below, first_below : ndarray of int
        Places of the blocks below each pivot, one after the other, and where those of a pivot begin.
    row_below : ndarray of int
        Unknowns of these blocks.
    beside, first_beside, row_beside : ndarray of int
        The same of the blocks to the right.
    target : ndarray of int
        For every pivot, block below and block beside it: the place that their product is subtracted from.
    first_target : ndarray of int, shape (below,)
        Where those of a block below begin.
    """

    order: Int[np.ndarray, " size"]
    diagonal: Int[np.ndarray, " size"]
    given: Int[np.ndarray, " block"]
    count: int
    below: np.ndarray
    first_below: np.ndarray
    row_below: np.ndarray
    beside: np.ndarray
    first_beside: np.ndarray
    row_beside: np.ndarray
    target: np.ndarray
    first_target: Int[np.ndarray, " below"]


def elimination(rows: Int[np.ndarray, " block"], columns: Int[np.ndarray, " block"], size: int) -> Elimination:
    """Plan the elimination of a matrix with a symmetric pattern.

    Parameters
    ----------
    rows, columns : ndarray of int, shape (block,)
        Places of its blocks, those of the diagonal among them.
    size : int
        Number of rows of blocks.

    Returns
    -------
    Elimination
        In the order of minimum degree.
    """
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
