"""A study whose parameters drift: run, read back, its page without what the parameters are at the knots."""

import re

import numpy as np
import pytest

from structid.study.run import report_again, run_study
from studies import SMALL, without_pages

STUDY = re.sub(r"kind = \"aies\".*?\n#", 'kind = "smc"\nparticles = 60\nsteps = 6\n#', SMALL, flags=re.S).replace(
    '[discrepancy]\nkind = "iid"', '[discrepancy]\nkind = "drifting"\nevery = "3 s"\nerrors = "damped_cosine"\n#'
)


@pytest.mark.slow
def test_a_study_whose_parameters_drift(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    outcome = run_study(tmp_path / "study.toml", tmp_path / "out")
    posterior = outcome.result.target
    assert posterior.error_model.describe()["kind"] == "drifting" and posterior.error_model.every == 3.0
    assert posterior.discrepancy.describe()["kind"] == "damped_cosine"
    page = outcome.report.read_text()
    # What was sampled at the knots is judged with the rest, and shown nowhere else.
    assert "stiffness drift" in page and page.count("stiffness at 1") == 1 and "stiffness_at" not in page
    assert {p.stem for p in (tmp_path / "out" / "figures").glob("*.svg")} >= {"marginals", "loops", "other_1_velocity"}
    with without_pages():
        np.testing.assert_array_equal(report_again(tmp_path / "out").result.history, outcome.result.history)
