"""Thousands of small systems are solved by one thread of BLAS, and the threads that were there are there again."""

import numpy as np
import threadpoolctl

import structid as si

SPACE = si.ParameterSpace(x=si.Uniform(-1.0, 1.0), y=si.Uniform(-1.0, 1.0))


def threads():
    return {pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"}


def test_a_fit_has_one_thread():
    design = SPACE.sample(20, seed=1)
    seen = set()
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = threads()
        si.Kriging(starts=1).fit(
            design, np.sin(design.values.sum(axis=1, keepdims=True)), progress=lambda *_: seen.update(threads())
        )
        assert threads() == before
    assert seen == {1}
