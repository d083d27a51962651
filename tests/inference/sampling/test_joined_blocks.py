"""Blocks of draws become one array, without a copy if they are parts of one."""

import numpy as np
import pytest

from structid.inference.sampling.base import joined

ARRAY = np.arange(20.0).reshape(10, 2).copy()


@pytest.mark.parametrize("steps", [10, 7])
def test_consecutive_parts_of_one_array_are_not_copied(steps):
    blocks = [{"phi": ARRAY[:4]}, {"phi": ARRAY[4:8]}, {"phi": ARRAY[8:]}]
    phi = joined(blocks, steps)["phi"]
    assert np.shares_memory(phi, ARRAY)
    np.testing.assert_array_equal(phi, ARRAY[:steps])


@pytest.mark.parametrize("parts", [(slice(4, 10), slice(0, 4)), (slice(0, 4), slice(4, 8)), (slice(0, 5), slice(0, 5))])
def test_other_parts_are_concatenated(parts):
    expected = np.concatenate([ARRAY[part] for part in parts])
    np.testing.assert_array_equal(joined([{"phi": ARRAY[part]} for part in parts], 10)["phi"], expected)
