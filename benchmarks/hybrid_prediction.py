"""The question: does what a hybrid test has taught of a specimen predict a stronger test on it.

Ten virtual specimens, drawn from the priors of the packaged programme. Each goes through the tests #1a to #5 with noisy sensors and
late actuators; the posterior from #3 and the tests before predicts the largest drift of #5.

Run with ``python benchmarks/hybrid_prediction.py [--quick]``.
"""

from __future__ import annotations

import tempfile
import time
import tomllib
from pathlib import Path

import common

from structid.study.building.priors import parameter_space
from structid.study.packaged import template
from structid.study.programmes.learnt_of_tests import learnt_of
from structid.study.programmes.planned_programme import planned
from structid.study.programmes.programme_file import ProgrammeFile, programme_file

NAME = "hybrid_prediction"
SPECIMENS = 10


def virtual_specimen(number: int, law: str) -> ProgrammeFile:
    """The packaged programme on another specimen, learnt with a law of the errors."""
    content = tomllib.loads(template("hybrid"))
    space = parameter_space(programme_file().model_validate(content))
    truth = space.sample(SPECIMENS, seed=5).values[number]
    content["specimen"]["model"] |= dict(zip(space.names, map(float, truth), strict=True))
    content["structure"]["largest_stiffness"] = 1.3 * float(truth[space.names.index("stiffness")])
    content["seed"] = number
    content["discrepancy"] = {"kind": law}
    return programme_file().model_validate(content)


def predicted(number: int, law: str) -> list[str]:
    """Run the tests, learn from #3, and lay the prediction of #5 beside what happened."""
    programme = planned(virtual_specimen(number, law), Path())
    began = time.perf_counter()
    tests = programme.programme().run()
    tested = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        learnt = learnt_of(programme, tests, Path(folder))
        assert learnt is not None and learnt.prediction is not None
        verdict, seen = learnt.result.verdict(), learnt.prediction
        low, high = (1e3 * edge for edge in seen.band)
        certificate = learnt.calibration.certificate if learnt.calibration is not None else None
        said = (
            "not converged"
            if not verdict.converged
            else "certified"
            if certificate and certificate.certified
            else "refused"
        )
        return [
            str(number + 1), law, f"{low:.4g}–{high:.4g}", f"{1e3 * seen.peak:.4g}", "inside" if seen.covered else "outside",
            said + (", doubted" if verdict.doubt else ""), f"{tested - began:.0f}", f"{time.perf_counter() - tested:.0f}",
        ]  # fmt: skip


HEADS = ["specimen", "law of the errors", "5–95 % [mm]", "happened [mm]", "", "verdict", "tests [s]", "learning [s]"]


def main() -> None:
    quick = common.is_quick(__doc__ or "")
    rows = [predicted(number, "ar1") for number in range(1 if quick else SPECIMENS)]
    beside = [] if quick else [predicted(number, "iid") for number in range(3)]
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=rows, beside=beside)
    inside = sum(row[4] == "inside" for row in rows)
    text = f"""## Hybrid tests: what one teaches of the next

`benchmarks/hybrid_prediction.py`. {common.machine()}.

Virtual specimens drawn from the priors of the packaged programme (`structid new --like hybrid`), sensors with 0.02 mm and 0.5 kN of
noise, actuators 17 ms late. The posterior from test #3 and those before (2 004 values, measured displacements imposed) predicts the
largest drift of #5; a surrogate stands in for the model, and runs of the model certify the posterior. Inside its band of 5 to 95 %:
{inside} of {len(rows)} (limit 8 of 10).

{common.markdown_table(HEADS, rows)}

The same with independent errors. The force at rest is averaged over a second, and what is left of its noise is in every later force
of that test: an error with a memory, which independent errors do not know. Their bands are too narrow; the verdict doubts two of
these three.

{common.markdown_table(HEADS, beside)}

The façade's storey (`structid new --like hybrid_facade`: a masonry wall under a rigid beam, three channels, typical mortar): all
six tests come to their end in half a minute; in #5 the wall cracks through at 2.5 s and keeps a drift of 30 mm. What is not done
yet: the posterior of its joints from #3. A run of the wall along 1 604 measured moves takes 5 ms of one core. By POD-Kriging with
580 runs the certificate refuses it: the posterior is so narrow, and bent over orders of the joints' stiffnesses, that log weights
of the surrogate's draws spread by 1 475. Tempered SMC on the wall itself (400 particles, 25 steps) was at 27 of 100 after nine
minutes beside a running test suite, and was stopped there. Two runs of #5 with the true parameters, one with noise and one without,
end at 30 and 24 mm: which joint cracks first decides, so a prediction of #5 must be that wide, whatever is learnt.
"""
    common.write_section(common.documents(quick) / "benchmarks.md", NAME, text)
    print(text)


if __name__ == "__main__":
    main()
