"""Random streams: one registry, and no two purposes share one."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

import structid
from structid.core.streams import Purpose, derived_seed, stream

pytestmark = pytest.mark.quick


def first_draws(*arguments):
    return tuple(stream(*arguments).integers(2**63, size=2).tolist())


def test_no_two_purposes_share_a_stream():
    seeds, indices = (0, 1, 2, 11, 12, 2**32, 2**32 + 1, 2**40 + 12), range(4)
    found = [first_draws(*key) for key in itertools.product(seeds, Purpose, indices)]
    assert len(set(found)) == len(found) == len(seeds) * len(Purpose) * len(indices)


def test_numbers_that_numpy_pads_would_be_found_out():
    """What went wrong before: a stream without an index was that of index 0."""
    short = np.random.default_rng(np.random.SeedSequence([1, Purpose.SOBOL])).integers(2**63, size=2)
    assert tuple(short.tolist()) == first_draws(1, Purpose.SOBOL, 0)


def test_derived_seeds_differ():
    found = [derived_seed(seed, purpose, index) for seed in range(3) for purpose in Purpose for index in range(3)]
    assert len(set(found)) == len(found) and max(found) < 2**32


def test_random_numbers_are_drawn_through_the_registry_alone():
    for file in Path(structid.__file__).parent.rglob("*.py"):
        if file.name != "streams.py":
            assert not re.search(r"SeedSequence\(|default_rng\(|np\.random\.seed|RandomState", file.read_text()), file
