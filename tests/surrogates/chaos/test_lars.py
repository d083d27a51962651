"""Nested least squares and the order of terms."""

import numpy as np

from structid.surrogates.chaos.lars import nested_least_squares, orthogonal_order


def test_nested_leave_one_out_is_that_of_refitting():
    rng = np.random.default_rng(1)
    columns, response = rng.normal(size=(30, 6)), rng.normal(size=30)
    fits = nested_least_squares(columns, response)
    for size in (1, 3, 6):
        some = columns[:, :size]
        left_out = []
        for i in range(30):
            keep = np.arange(30) != i
            found = np.linalg.lstsq(some[keep], response[keep], rcond=None)[0]
            left_out.append(response[i] - some[i] @ found)
        np.testing.assert_allclose(fits.leave_one_out[size - 1], np.mean(np.square(left_out)), rtol=1e-10)
        trace = np.trace(np.linalg.inv(some.T @ some))
        np.testing.assert_allclose(fits.correction[size - 1], 30 / (30 - size) * (1 + trace), rtol=1e-10)


def test_orthogonal_order_takes_what_lowers_the_residual_most():
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(200, 12))
    response = 5 * columns[:, 7] + 2 * columns[:, 3] + 0.1 * rng.normal(size=200)
    order = orthogonal_order(columns.T @ columns, columns.T @ response, 4)
    residuals = []
    for size in (1, 2):
        best = [
            np.sum((response - c @ np.linalg.lstsq(c, response, rcond=None)[0]) ** 2)
            for j in range(12)
            for c in [columns[:, [*order[: size - 1], j]]]
        ]
        residuals.append(int(np.argmin(best)))
    assert list(order[:2]) == [7, 3] == residuals
