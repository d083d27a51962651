"""Progress bars: one for each step, started anew when the step is."""

import structid as si


def test_every_step_has_a_bar_and_a_round_begins_anew(capsys):
    with si.ProgressBars() as bars:
        for done in (1, 2):
            bars("model runs", done, 2)
        bars("sampling", 50, 100)
        bars("model runs", 1, 4)
        tasks = {task.description: (task.completed, task.total) for task in bars._display.tasks}
        assert tasks == {"model runs": (1, 4), "sampling": (50, 100)}
    shown = capsys.readouterr().err
    assert "model runs" in shown and "1/4" in shown and "sampling" in shown and "50%" in shown


def test_failures_are_counted(capsys):
    with si.ProgressBars() as bars:
        bars(3, 3, 1)
    assert "1 failed" in capsys.readouterr().err


def test_it_is_what_sample_and_campaigns_take(capsys, short_posterior):
    with si.ProgressBars() as bars:
        si.sample(short_posterior, si.AIES(walkers=12, steps=10), seed=1, progress=bars)
    assert "100%" in capsys.readouterr().err
