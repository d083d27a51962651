"""The words of a failed run."""

import pytest

from structid.core.reasons import counted_reasons, general_reason, grouped_reasons, short_reason, with_words


@pytest.mark.parametrize(
    ("reason", "general"),
    [
        ("not finite from 3.41 s on", "not finite from … s on"),
        ("exit code 3; it last said: zero pivot 1.2e-5 in row 17 [kept: /tmp/x/run-1]", None),
        ("killed by signal 11 (SIGSEGV)", "killed by signal 11 (SIGSEGV)"),
        ("it returned 393 rows; expected 400 rows of v2", "it returned … rows; expected 400 rows of v2"),
    ],
)
def test_reasons_are_counted_by_kind(reason, general):
    assert general_reason(reason) == (general or "exit code 3; it last said: zero pivot … in row 17")


def test_the_last_three_lines_of_a_program_are_shown():
    """Not what OpenSees says at its end whatever has happened; as many as fit."""
    said = "step 3\nWARNING: no convergence\nnorm 1.2e-3\nanalysis failed at 0.42 s\n\nProcess 0 Terminating\n"
    reason = with_words("exit code 1", said)
    assert short_reason(reason) == (
        "exit code 1; it last said: WARNING: no convergence | norm 1.2e-3 | analysis failed at 0.42 s"
    )
    assert short_reason(with_words("exit code 1", "Process 0 Terminating")) == "exit code 1"
    assert (
        short_reason(with_words("exit code 1", f"{'x' * 150}\n{'y' * 150}"))
        == f"exit code 1; it last said: {'y' * 150}"
    )


def test_reasons_beyond_the_first_ten_are_counted():
    failures = [(f"reason {i}", 20 - i) for i in range(13)]
    lines = counted_reasons(failures)
    assert lines[0].split() == ["20", "x", "reason", "0"] and len(lines) == 11
    assert "27 runs, for 3 more reasons" in lines[-1] and "--failed" in lines[-1]
    assert len(counted_reasons(failures[:10])) == 10


def test_what_all_say_alike_is_said_in_full():
    alike = [
        "it returned 393 rows; expected 400 rows of v2 [kept: /tmp/x/run-1]",
        "it returned 393 rows; expected 400 rows of v2",
    ]
    apart = [f"not finite from {t} s on" for t in (1.2, 3.4, 5.6)]
    assert grouped_reasons([*alike, "", *apart]) == [("not finite from … s on", 3), (alike[1], 2)]
