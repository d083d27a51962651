"""What commands print where there is no terminal: a line for each stage and each round, and a sign of life in long ones."""

import logging

import pytest

from structid.cli import screen as screens
from structid.cli.screen import findings_on_screen, stage


@pytest.fixture
def seconds(monkeypatch):
    """A clock that a test sets."""
    now = [0.0]
    monkeypatch.setattr(screens.time, "monotonic", lambda: now[0])
    return now


def test_a_stage_is_one_line(capsys, seconds):
    with stage("model runs") as told:
        for done in range(1, 4):
            seconds[0] += 5.0
            told(done, 3, failed=1)
    assert capsys.readouterr().out.split() == ["model", "runs", "3/3,", "1", "failed", "15", "s"]


def test_a_stage_that_ends_early_has_ended(capsys, seconds):
    with stage("interior point") as told:
        told(7, 10)
    assert "10/10" in capsys.readouterr().out


def test_a_long_stage_gives_a_sign_of_life_every_half_minute(capsys, seconds):
    with stage("sampling") as told:
        for done in range(1, 101):
            seconds[0] += 1.0
            told(done, 100)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ["31/100", "62/100", "93/100", "100/100"]
    assert all(line.endswith("continuing") for line in lines[:-1]) and lines[-1].endswith("100 s")


def test_a_passing_stage_leaves_nothing(capsys, seconds):
    with stage("drawing", passing=True) as told:
        seconds[0] += 100.0
        told(1, 2)
    assert capsys.readouterr().out == ""


def test_rounds_are_printed_while_a_command_runs(capsys):
    log = logging.getLogger("structid.calibration.sequential")
    with findings_on_screen():
        log.info("%s", "round 1")
    log.info("%s", "round 2")
    assert capsys.readouterr().out == "round 1\n"
