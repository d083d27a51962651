"""A study that is right is in order; one with a likely mistake is asked about, before anything is sampled."""

import re

import numpy as np
import pytest

from commands import structid
from structid.study.run import load
from studies import SMALL

PLAIN = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S).replace(
    'channels = ["velocity"]', 'channels = ["velocity"]\nfile = "measured.csv"\nunit = "m/s"'
)


@pytest.fixture
def study(tmp_path):
    """A study whose measurement is in a file, and the measurement."""
    (tmp_path / "small.toml").write_text(SMALL)
    observation = load(tmp_path / "small.toml").posterior.observations[0]

    def written(change=lambda values: values, text=PLAIN):
        np.savetxt(
            tmp_path / "measured.csv", np.stack([observation.record.time, change(observation.values[:, 0])], axis=1)
        )
        (tmp_path / "study.toml").write_text(text)
        return structid("check", "study.toml", cwd=tmp_path)

    return written


def test_what_is_right_is_in_order_and_every_quantity_is_echoed(study):
    done = study()
    assert done.returncode == 0 and "in order" in done.stdout, done.stderr
    assert re.search(r"model.mass +12 t = 12000 kg", done.stdout)
    assert "pga" in done.stdout and "1.8 m/s^2 = 1.8 m/s^2" in done.stdout
    assert "12 short_ton = 10886.2 kg" in study(text=PLAIN.replace('mass = "12 t"', 'mass = "12 short_ton"')).stdout


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: 100.0 * v, "times the measured peak. Are all units right"),
        (lambda v: v + 5.0 * np.abs(v).max(), "Is it an offset of the instrument"),
        (
            lambda v: np.interp(np.arange(len(v)) / 6.0, np.arange(len(v)), v),
            "Are mass and stiffness in the intended units",
        ),
    ],
)
def test_a_likely_mistake_in_the_measurement(study, change, words):
    done = study(change)
    assert done.returncode == 2 and words in done.stdout and "in order" not in done.stdout, done.stdout


def test_a_stiffness_whose_unit_was_forgotten(study):
    """7.4 N/m in place of 7.4 kN/mm: the mass follows the ground, at about the measured size and frequencies."""
    text = re.sub(r'unit = "kN/mm".*\n', "", PLAIN, count=1)
    assert text != PLAIN
    done = study(text=text)
    assert done.returncode == 2 and re.search(
        r"lowest natural frequency is 0\.00\d+ Hz, outside the usual range", done.stdout
    )


def test_a_dead_sensor_is_one_question(study):
    done = study(lambda v: np.full_like(v, 0.0125))
    asked = [line for line in done.stdout.splitlines() if line.startswith("?")]
    assert len(asked) == 1 and "throughout. Did the sensor fail?" in asked[0], asked


def test_a_channel_with_the_sign_reversed(study, tmp_path):
    """Seen where the model at the priors' medians is near the structure."""
    model = load(tmp_path / "small.toml")
    response = model.model.simulate(model.space.from_uniform(np.full((1, 4), 0.5)), model.record).values[0, :, 0]
    done = study(lambda v: -response)
    assert done.returncode == 2 and "sign reversed" in done.stdout, done.stdout


def test_a_model_that_may_not_stay_bounded(study):
    done = study(text=PLAIN.replace("low = -1\nhigh = 1", "low = -1\nhigh = 2"))
    assert done.returncode == 2 and "|gamma| exceeds beta" in done.stdout, done.stdout + done.stderr


def test_a_text_without_a_unit_is_asked_for_one(study):
    done = study(text=PLAIN.replace('pga = "1.8 m/s^2"', 'pga = "0.28"'))
    assert done.returncode == 2 and "record.pga" in done.stderr and "'0.28', a string without a unit" in done.stderr


def test_a_clock_that_begins_before_the_record(study):
    """Forty samples late: seen, and in order once the study says so."""
    late = 40
    done = study(lambda v: np.concatenate([np.zeros(late), v[:-late]]))
    assert done.returncode == 2 and re.search(r"0\.4\d? s back", done.stdout) and "time_shift" in done.stdout, (
        done.stdout
    )


def test_measurement_and_model_are_drawn_on_the_record(study, tmp_path):
    study()
    done = structid("check", "study.toml", "--plot", "figures", cwd=tmp_path)
    assert done.returncode == 0 and "measurement_1.png" in done.stdout, done.stdout
    assert {f.name for f in (tmp_path / "figures").iterdir()} == {"measurement_1.png", "measurement_1.pdf"}


def test_exact_data_of_a_model_that_can_be_right_are_refused(tmp_path):
    """The variance of errors that are zero has no posterior; given as a number, the study is one."""
    noiseless = re.sub(r"delta_\w+ = [\d.]+", "", SMALL.replace('noise = "2 %"', "noise = 0"))
    (tmp_path / "study.toml").write_text(noiseless)
    done = structid("check", "study.toml", cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "key 'observation.virtual.noise': 0, but the model can fit the data exactly" in done.stderr, done.stderr
    (tmp_path / "study.toml").write_text(
        re.sub(r"\[discrepancy\]\n", '[discrepancy]\nvariance = "1e-6 m^2/s^2"\n', noiseless)
    )
    done = structid("check", "study.toml", cwd=tmp_path)
    assert "fit the data exactly" not in done.stderr + done.stdout, done.stderr


def test_a_pga_that_no_ground_has_shown(tmp_path):
    first, second = SMALL.split("[[prediction.records]]")
    text = "[[prediction.records]]".join([first, second.replace('pga = "1.8 m/s^2"', 'pga = "45 g"', 1)])
    (tmp_path / "study.toml").write_text(text)
    done = structid("check", "study.toml", cwd=tmp_path)
    assert done.returncode == 2 and "has a PGA of 45 g, above the largest ever recorded" in done.stdout, done.stdout
