"""Studies whose priors of stiffness and alpha come from a measured loop."""

import re

import numpy as np
import pytest

import structid as si
from commands import structid
from structid.study.run import load, run_study
from studies import SMALL

LOOP = """
[loop]
file = "loop.csv"
displacement_unit = "mm"
force_unit = "kN"
"""


def _with_priors(text, **tables):
    for name, table in tables.items():
        text = re.sub(rf"\[parameters\.{name}\]\n.*?\n\n", f"[parameters.{name}]\n{table}\n\n", text, flags=re.S)
    return text


STUDY = _with_priors(SMALL, stiffness='distribution = "loop"', alpha='distribution = "loop"') + LOOP


@pytest.fixture
def study(tmp_path):
    """A study, and a cyclic test of a specimen of 7.6 kN/mm and an α of 0.06 beside it."""

    def written(amplitude=0.05, text=STUDY):
        u = np.linspace(0.2, 1.0, 3001) * amplitude * np.sin(np.linspace(0, 8 * np.pi, 3001))
        specimen = si.BoucWen(
            mass=1.0, stiffness=7.6e6, alpha=0.06, beta=63.0, gamma=63.0, substeps=8, channels="restoring_force"
        )
        force = specimen.simulate(np.zeros((1, 0)), si.DisplacementHistory(u, 0.01)).values[0, :, 0]
        np.savetxt(tmp_path / "loop.csv", np.column_stack([u * 1e3, force * 1e-3]), delimiter=",")
        (tmp_path / "study.toml").write_text(text)
        return tmp_path / "study.toml"

    return written


def test_a_loop_gives_priors_that_hold_the_truth(study):
    path = study()
    priors = load(path).space.marginals
    assert priors["stiffness"].unit == "kN/mm"
    for name, true in (("stiffness", 7.6e6), ("alpha", 0.06)):
        assert 0.02 < priors[name].cdf(np.array([true]))[0] < 0.98
    done = structid("check", "study.toml", cwd=path.parent)
    assert "The loop's initial stiffness is" in done.stdout and "Alpha is" in done.stdout, done.stderr


@pytest.mark.slow
def test_the_page_shows_the_loop_and_its_lines(study):
    path = study()
    outcome = run_study(path, path.parent / "out")
    assert "The measured loop from which priors were derived" in outcome.report.read_text()


@pytest.mark.parametrize(
    ("change", "amplitude", "said"),
    [
        (lambda t: t, 0.004, "hardly yielded"),
        (
            lambda t: t.replace(LOOP, ""),
            0.05,
            r"key 'parameters.stiffness.distribution': 'loop'. .*a table \[loop\], and",
        ),
        (lambda t: t.replace('"loop.csv"', '"lop.csv"'), 0.05, "lop.csv: .*no such file"),
        (lambda t: t.replace('force_unit = "kN"', 'force_unit = "mm"'), 0.05, "table 'loop'.*same dimension as 'N'"),
        (lambda t: t.replace("[loop]", "[loop]\nforce_column = 5"), 0.05, "column 5 is missing"),
        (
            lambda t: t.replace('distribution = "loop"', 'distribution = "loop"\nmean = 7.4', 1),
            0.05,
            "the loop determines the prior",
        ),
        (
            lambda t: _with_priors(t, beta='distribution = "loop"'),
            0.05,
            "key 'parameters.beta.distribution'.*stiffness or alpha",
        ),
    ],
)
def test_a_mistake_is_a_paragraph(study, change, amplitude, said):
    with pytest.raises(si.InputError, match=f"(?s){said}"):
        load(study(amplitude, change(STUDY)))
