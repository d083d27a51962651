"""The words of a failed run."""

import pytest

from structid.reasons import general_reason


@pytest.mark.parametrize(
    ("reason", "general"),
    [
        ("not finite from 3.41 s on", "not finite from … s on"),
        ("exit code 3; it last said: zero pivot 1.2e-5 in row 17 [kept: /tmp/x/run-1]", None),
        ("killed by signal 11 (SIGSEGV)", "killed by signal 11 (SIGSEGV)"),
        ("it returned 393 rows; wanted 400 rows of v2", "it returned … rows; wanted 400 rows of v2"),
    ],
)
def test_reasons_are_counted_by_kind(reason, general):
    assert general_reason(reason) == (general or "exit code 3; it last said: zero pivot … in row 17")
