"""Hashes of arrays: whole, in pieces, and in another order in memory."""

import numpy as np
import pytest

from structid.core.hashing import Pieces, digest

ARRAYS = [np.arange(24.0).reshape(6, 2, 2), np.arange(6), np.array(["a", "bc", ""]), np.zeros((0, 3)), np.eye(3) > 0.0]


@pytest.mark.parametrize("array", ARRAYS, ids=lambda a: f"{a.dtype}{a.shape}")
def test_the_bytes_in_c_order_make_the_hash(array):
    same = [np.asfortranarray(array), np.repeat(array, 2, axis=0)[::2], Pieces([array[:2], array[2:]])]
    assert {digest(one) for one in same} == {digest(array)}
    assert digest(array) != digest(array.reshape(*array.shape, 1))


def test_pieces_in_another_order_are_another_array():
    first, second = ARRAYS[0][:2], ARRAYS[0][2:]
    assert digest(Pieces([second, first])) != digest(ARRAYS[0])
