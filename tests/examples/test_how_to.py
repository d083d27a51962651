"""The Python of the how-to pages is run, in order, with small data in the place of a reader's."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import structid as si
from structid.study.study_reader import parse_study

HOW_TO = Path(__file__).parents[2] / "docs" / "how_to"

SMALLER = {
    "own_solver": {"sample(500, seed=1)": "sample(6, seed=1)"},
    "choose_a_surrogate": {"sample(500": "sample(30", "true_runs=500": "true_runs=120"},
    "correlated_errors": {"si.SMC()": "si.SMC(particles=60, steps=6, ensembles=2)"},
    "wall": {"sample(2000": "sample(30", "width=5.0": "width=4.9", 'animate("wall.gif")': 'animate("wall.gif", 4)'},
    "hybrid_test": {"trim(4.0, 9.0)": "trim(4.0, 5.0)"},
    "certify_draws": {},
    "shaken_specimen": {
        "[displacement, acceleration]": "measured",
        "si.choose_model(test)": 'si.choose_model(test, ["linear", "bilinear"])',
    },
    "frame": {"particles=200, ensembles=2, steps=150": "particles=30, ensembles=2, steps=5", "[::300": "[::30"},
    "cyclic_test": {
        "choice = si.choose_model(test)  # all laws\n": "",
        'test = si.CyclicTest.read("wall.csv", "mm", "kN", displacement_column=0, force_column=1)\n': "",
        '["bilinear", "masing", "pivot"]': '["bilinear", "masing"]',
    },
}
"""Numbers of each page that are made smaller; a page that is not here is an executed notebook, or has no Python."""


def floors(record):
    """Responses of a frame of two storeys."""
    channels = ("absolute_acceleration_1", "absolute_acceleration_2", "drift_1")
    values = {"stiffness": 7e6, "yield_force_1": 50e3, "hardening_1": 0.1}
    frame = si.HystereticFrame(
        ["bilinear", "linear"], mass=[10e3, 8e3], values=values, damping_ratio=0.02, channels=channels
    )
    responses = frame.simulate(np.zeros((1, 0)), record).values[0]
    noise = 0.02 * responses.std(axis=0) * np.random.default_rng(2).normal(size=responses.shape)
    return [si.Observation(record, (responses + noise)[:, [i]], channels=(c,)) for i, c in enumerate(channels)]


def blocks(page):
    return re.findall(r"^```python\n(.*?)^```", (HOW_TO / f"{page}.md").read_text(encoding="utf-8"), re.S | re.M)


def test_the_study_of_the_frame_page_is_a_study():
    text = re.search(r"^```toml\n(.*?)^```", (HOW_TO / "frame.md").read_text(encoding="utf-8"), re.S | re.M)
    study = parse_study(tomllib.loads(text.group(1)))
    assert study.model.type == "hysteretic_frame"
    assert len(study.observation) == 3


def test_no_page_is_forgotten():
    pages = {page.stem for page in HOW_TO.glob("*.md") if "file_format: mystnb" not in page.read_text(encoding="utf-8")}
    assert {page for page in pages if blocks(page)} - {"cluster"} == set(SMALLER)


@pytest.fixture(scope="module")
def given():
    """What a reader has: a record, a model, priors, a measurement, draws of another program."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
    space = si.ParameterSpace(
        stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )
    model = si.BoucWen(mass=12e3, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names)
    response = model.simulate([[7.2e6, 0.4]], record).values[0, :, 0]
    noise = 0.05 * response.std() * np.random.default_rng(1).normal(size=response.shape)
    measured = si.Observation(record, response + noise)
    posterior = si.Posterior(space, model, measured)
    drawn = si.sample(posterior, si.SMC(particles=200, steps=20), seed=1)
    time = np.linspace(0.0, 20.0, 400)
    return {
        "si": si,
        "record": record,
        "another_record": record.scale(0.8),
        "space": space,
        "model": model,
        "measured": measured,
        "posterior": posterior,
        "draws": drawn.thinned(2000),
        "log_density": posterior.log_density,
        "floors": floors(record),
        "displacement": 0.01 * np.sin(time),
        "force": 4e4 * np.tanh(2.0 * np.sin(time)),
        "my_finite_elements": lambda stiffness, acceleration, dt: np.cumsum(acceleration) * dt * 1e6 / stiffness,
    }


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::structid.StructidWarning")
@pytest.mark.parametrize("page", SMALLER)
def test_the_python_of_a_page_runs(page, given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known = {**given, "__name__": page}
    for block in blocks(page):
        text = block
        for number, smaller in SMALLER[page].items():
            text = text.replace(number, smaller)
        exec(compile(text, f"{page}.md", "exec"), known)
    if page == "certify_draws":
        assert known["certificate"].certified
    if page == "choose_a_surrogate":
        assert known["result"].certificate.certified
