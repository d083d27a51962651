"""structid look and structid new --from, in a folder of files as a laboratory has them."""

import time

import numpy as np
import pytest

import structid as si
from commands import structid
from format_writers import csmip_v2, knet

TIMES = 0.005 * np.arange(2000)


def logger(folder, name="floors.csv"):
    """A logger's table: a drift in mm and a force in kN."""
    drift, force = 4.0 * np.sin(3.0 * TIMES), 12.0 * np.cos(2.0 * TIMES)
    rows = "\n".join(f"{t:.3f};{a:.5f};{b:.5f}" for t, a, b in zip(TIMES, drift, force, strict=True))
    (folder / name).write_text(f"Time;Drift;Force\ns;mm;kN\n{rows}\n")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "AOM001.EW").write_text(knet()[0])
    (tmp_path / "site.V2").write_text(csmip_v2()[0])
    logger(tmp_path)
    return tmp_path


def test_look_shows_formats_channels_and_lines_for_a_study(folder):
    shown = structid("look", "AOM001.EW", "site.V2", "floors.csv", cwd=folder)
    assert shown.returncode == 0, shown.stderr
    for words in (
        "AOM001.EW: K-NET or KiK-net, 1 channel",
        "1 'EW': acceleration in cm/s^2, 100 Hz, 1600 samples",
        "site.V2: CSMIP V1 or V2, 6 channels",
        "2 'Up': velocity in cm/s, 80 Hz, 641 samples",
        "floors.csv: text columns, 2 channels",
        "2 'Force': kN, 200 Hz, 2000 samples, 0 to 9.995 s, peak 12 at 0 s",
        'component = "90 Deg"',
        'channels = ["restoring_force"]',
    ):
        assert words in shown.stdout, words
    assert "\u28ff" in shown.stdout or "#" in shown.stdout  # the plot


@pytest.mark.rendered
@pytest.mark.parametrize("form", ["png", "svg"])
def test_look_draws_a_figure(folder, form):
    shown = structid("look", "floors.csv", "--no-plot", "--figure", f"look.{form}", cwd=folder)
    assert shown.returncode == 0 and (folder / f"look.{form}").stat().st_size > 5000
    refused = structid("look", "floors.csv", "--no-plot", "--figure", "look.gif", cwd=folder)
    assert refused.returncode == 2 and ".png" in refused.stderr


def test_look_at_what_cannot_be_read_is_one_paragraph(folder):
    (folder / "a.bin").write_bytes(bytes(range(256)))
    for name, words in (("a.bin", "a binary file of a format"), ("none.csv", "there is no such file")):
        refused = structid("look", name, cwd=folder)
        assert refused.returncode == 2 and words in refused.stderr and "Traceback" not in refused.stderr


def test_a_new_study_from_files_reads_them(folder):
    """Record and observations are those of the files; what a user must still give is in capitals."""
    made = structid("new", "mine", "--from", "site.V2", "--from", "floors.csv", cwd=folder)
    assert made.returncode == 0, made.stderr
    text = (folder / "mine.toml").read_text()
    assert 'file = "site.V2"' in text and text.count("[[observation]]") == 2 and "MY_RECORD" not in text
    assert 'column = 1\nchannels = ["displacement"]' in text and 'column = 2\nchannels = ["restoring_force"]' in text
    checked = structid("check", "mine.toml", cwd=folder)
    assert checked.returncode == 2 and "lasts 10 s, the record 8 s" in checked.stderr + checked.stdout
    refused = structid("new", "other", "--like", "hybrid", "--from", "site.V2", cwd=folder)
    assert refused.returncode == 2 and "--like measured" in refused.stderr
    refused = structid("new", "other", "--from", "floors.csv", cwd=folder)
    assert refused.returncode == 2 and "no file holds an acceleration" in refused.stderr


def test_a_new_cyclic_study_from_a_file_has_its_columns(folder):
    """Displacement and force of a table, for `structid look` and for a new study."""
    made = structid("new", "wall", "--like", "cyclic", "--from", "floors.csv", cwd=folder)
    assert made.returncode == 0, made.stderr
    columns = 'displacement_column = 1\ndisplacement_unit = "mm"\nforce_column = 2\nforce_unit = "kN"'
    assert columns in (folder / "wall.toml").read_text()
    assert columns in structid("look", "floors.csv", cwd=folder).stdout
    refused = structid("new", "other", "--like", "cyclic", "--from", "site.V2", cwd=folder)
    assert refused.returncode == 2 and "no columns of a displacement and a force" in refused.stderr
    refused = structid("new", "other", "--like", "cyclic", "--from", "site.V2", "--from", "floors.csv", cwd=folder)
    assert refused.returncode == 2 and "2 files" in refused.stderr


def test_keys_of_a_study_name_component_and_columns(folder):
    """A record and a measurement of one file, and of a table by the titles of its columns."""
    record = si.GroundMotion.read(folder / "site.V2", component="Up")
    (folder / "a.toml").write_text(
        'name = "a"\nrecord = { file = "site.V2", component = "Up" }\n'
        'model = { type = "bouc_wen", mass = "12 t", damping_ratio = "3 %", alpha = 0.06 }\n'
        '[observation]\nfile = "site.V2"\ncomponent = "Up"\nchannels = ["velocity"]\n'
        '[parameters.stiffness]\ndistribution = "normal"\nunit = "kN/mm"\nmean = 6.0\nsd = 1.0\nlow = 0.5\n'
        '[parameters.beta]\ndistribution = "uniform"\nunit = "1/m"\nlow = 30\nhigh = 300\n'
        '[parameters.gamma_ratio]\ndistribution = "uniform"\nlow = -1\nhigh = 1\n[surrogate]\nkind = "none"\n'
    )
    checked = structid("check", "a.toml", cwd=folder)
    assert checked.returncode == 0, checked.stderr + checked.stdout
    assert f"{len(record)} samples" in checked.stdout


@pytest.mark.slow
def test_look_answers_soon(folder):
    """Median of five, relative to the help text: imports and reading take less than eight times as long."""

    def seconds(*words):
        begin = time.perf_counter()
        assert structid(*words, cwd=folder).returncode == 0
        return time.perf_counter() - begin

    looks, helps = ([seconds(*words) for _ in range(5)] for words in (("look", "site.V2"), ("--help",)))
    assert np.median(looks) < 8.0 * np.median(helps)
