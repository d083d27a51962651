"""Prediction of a stronger hybrid test from a calibration on earlier tests of the same specimen.

Ten virtual specimens are drawn from the priors of the packaged programme. Each undergoes tests #1a to #5 with noisy sensors and
delayed actuators. The posterior after test #3 predicts the largest drift of #5.

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


def virtual_specimen(number: int, law: str, quick: bool) -> ProgrammeFile:
    """The packaged programme with another specimen and error model; a quick programme has three tests and few runs."""
    content = tomllib.loads(template("hybrid"))
    space = parameter_space(programme_file().model_validate(content))
    truth = space.sample(SPECIMENS, seed=5).values[number]
    content["specimen"]["model"] |= dict(zip(space.names, map(float, truth), strict=True))
    content["structure"]["largest_stiffness"] = 1.3 * float(truth[space.names.index("stiffness")])
    content["seed"] = number
    content["discrepancy"] = {"kind": law}
    if quick:
        content["test"] = [test for test in content["test"] if test["name"] in ("1a", "3", "5")]
        content["calibration"]["true_runs"] = 100
    return programme_file().model_validate(content)


def predicted(number: int, law: str, quick: bool = False) -> list[str]:
    """Run the tests, calibrate on the tests up to #3, and compare the prediction of #5 with its result."""
    programme = planned(virtual_specimen(number, law, quick), Path())
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
            str(number + 1),
            law,
            f"{low:.4g}–{high:.4g}",
            f"{1e3 * seen.peak:.4g}",
            "inside" if seen.covered else "outside",
            said + (", with doubt" if verdict.doubt else ""),
            f"{tested - began:.0f}",
            f"{time.perf_counter() - tested:.0f}",
        ]


HEADS = ["specimen", "error model", "5–95 % [mm]", "result [mm]", "result is", "verdict", "tests [s]", "learning [s]"]


def main() -> None:
    quick = common.is_quick(__doc__ or "")
    rows = [predicted(0, "iid", quick)] if quick else [predicted(number, "ar1") for number in range(SPECIMENS)]
    beside = [] if quick else [predicted(number, "iid") for number in range(3)]
    common.record_result(NAME, quick=quick, machine=common.machine(), rows=rows, beside=beside)
    inside = sum(row[4] == "inside" for row in rows)
    text = f"""# Hybrid tests: prediction of the next test

`benchmarks/hybrid_prediction.py`. {common.machine()}.

Virtual specimens are drawn from the priors of the packaged programme (`structid new --like hybrid`). Sensors have 0.02 mm and
0.5 kN of noise, and actuators a delay of 17 ms. The posterior after test #3 (2 004 values, measured displacements imposed)
predicts the largest drift of #5. A surrogate replaces the model, and model runs certify the posterior. The 5 to 95 % interval
contains the result in {inside} of {len(rows)} specimens (limit 8 of 10).

{common.markdown_table(HEADS, rows)}

The next predictions assume independent errors. The force at rest is averaged over one second, and the remaining noise of this
average is in every later force of the test. Independent errors ignore this correlation, so that the intervals are too narrow. The
verdict expresses doubt in two of the three cases.

{common.markdown_table(HEADS, beside)}

One run of the façade's storey on two cores (`structid new --like hybrid_facade`: a masonry wall under a rigid beam, three
channels, typical mortar): the six tests take 14 s. In test #5, a crack passes through the whole wall at 2.5 s, and a residual
drift of 20 mm remains. The posterior after #3 (4 812 values) is sampled by tempered SMC on the wall itself, with 4 × 150
particles and 150 moves. A run of 1 604 moves takes 5 ms of one core. The sampler converged after 14 minutes, while other jobs ran
(R-hat 1.002, 1 740 effective draws).

| joints | true | posterior mean | posterior sd |
| --- | ---: | ---: | ---: |
| normal energy [N/m] | 12 | 12.10 | 0.87 |
| normal strength [MPa] | 0.180 | 0.1806 | 0.0065 |
| tangential energy [N/m] | 130 | 130.6 | 1.6 |
| tangential strength [MPa] | 0.270 | 0.2707 | 0.0017 |

These draws come from the model itself, without a surrogate, and need no certificate. The verdict correctly reports doubt about
the error model: the residuals are smaller than 0.5 kN and correlated (0.60 between successive moves). The predicted largest drift
of #5 is 21.7 to 39.9 mm (5 to 95 %); the test gave 30.1 mm.

The calibration needs a realistic accuracy of the forces, `sd = ["0.5 kN", "0.5 kN", "0.8 kN*m"]` (1 % of their peaks). Differences
of micrometres decide which joint cracks first. With the true parameters and sensors ten times as accurate, the forces of the model
still have errors of 0.4 kN for some dozens of moves. The residual jumps from 0.04 to 0.1 kN if a parameter changes by 0.5 %. Three
other settings fail:

* AR(1) errors of unknown size. The posterior gives them 30 N and splits into islands: acceptance is 3 %, a tempering step of 40
  moves leaves a correlation of 0.7, and an exponent of 0.02 takes 22 minutes.
* 1 % of the peak of each channel (0.17 kN for the vertical force). The true parameters are 8 standard deviations away, since the
  model receives measured displacements.
* POD-Kriging. With 580 runs the certificate fails (log weights spread by 1 475). With logarithms of stiffnesses and strengths, 500
  runs give no prospect of a certificate either. A smooth surrogate cannot represent forces that jump.
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
