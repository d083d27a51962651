"""Accuracy and cost of surrogates for histories, and of polynomial chaos and Kriging compared with other programs.

Run with ``python benchmarks/surrogates.py [--quick]``. The record and the scripts of other programs are in ``../shared/peers``.
They run if ``PEERS_PYTHON`` (OpenTURNS, SMT, chaospy, scikit-learn) and ``UQPY_PYTHON`` name Python installations with these
programs.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

import common
import numpy as np

import structid as si
from structid.surrogates.narx.narx_fit import NARXFit
from structid.surrogates.narx.structure.candidate_terms import absolute_terms
from structid.surrogates.narx.training.least_squares import refined_coefficients

NAME = "surrogates"
PEERS = common.ROOT.parent / "shared" / "peers"
PGA, DESIGN_RUNS, VALIDATION_RUNS, EVALUATIONS = 3.59, 500, 10_000, 70_000
QUICK_DESIGN_RUNS, QUICK_VALIDATION_RUNS = 100, 500
HALF_ENSEMBLE = 50
"""Number of walkers that are evaluated at once in an ensemble of 100."""

LIMITS = {
    "PC-NARX": "mean 5e-4, largest 1e-2 (1e-4, 1e-3)",
    "Kriging-NARX": "mean 5e-4, largest 1e-2 (1e-4, 1e-3)",
    "POD-Kriging": "mean 5e-5, median 1e-6 (1e-6, 1e-8)",
    "POD-PCE": "mean 5e-4 (1e-5)",
}
TIME_LIMITS = {"PC-NARX": "1.2", "Kriging-NARX": "15 (5)", "POD-Kriging": "1.2", "POD-PCE": "–"}
SETTINGS: dict[str, Any] = {
    "PC-NARX": si.PCNARX(),
    "Kriging-NARX": si.KrigingNARX(),
    "POD-Kriging": si.PODKriging(),
    "POD-PCE": si.PODPCE(),
}


# --- histories ------------------------------------------------------------------------------------------------------


def record() -> si.GroundMotion:
    """The stochastic record of this benchmark: 20 Hz low-pass, first 40 s, PGA 3.59 m/s²."""
    values = np.load(PEERS / "record.npy")
    return si.GroundMotion(values, 0.01, "peers' record").lowpass(20.0).trim(0.0, 40.0).scale_to_pga(PGA)


def problem() -> tuple[si.BoucWen, si.ParameterSpace]:
    space = common.study_space()
    return si.BoucWen(mass=common.MASS, damping_ratio=common.DAMPING_RATIO, free=space.names), space


def accuracy(quick: bool) -> tuple[list[list[str]], dict[str, Any]]:
    """Errors in independent runs, for a design that extends into the tails and for a design drawn from the prior."""
    model, space = problem()
    fitted_on, validated_on = (QUICK_DESIGN_RUNS, QUICK_VALIDATION_RUNS) if quick else (DESIGN_RUNS, VALIDATION_RUNS)
    unseen = si.Campaign(model, record(), space.sample(validated_on, seed=2, method="random")).run()
    designs = {"Sobol', widened by 2": space.sample(fitted_on, 1, "sobol", 2.0)}
    if not quick:
        designs["prior, LHS"] = space.sample(fitted_on, 1)
    rows, fitted = [], {}
    for name, settings in SETTINGS.items():
        for label, design in designs.items():
            runs = si.Campaign(model, record(), design).run()
            began = time.perf_counter()
            surrogate = settings.fit(runs)
            seconds = time.perf_counter() - began
            found = surrogate.validate(unseen)
            fitted.setdefault(name, surrogate)
            errors = [f"{v:.1e}" for v in (found.mean, found.median, found.q95, found.worst)]
            more = [str(found.diverged), f"{found.peak_error:.2%}", f"{found.coverage:.1%}", f"{seconds:.1f}"]
            rows.append([f"{name}, {label}", *errors, *more, LIMITS[name]])
    return rows, fitted


def evaluation(fitted: dict[str, Any], quick: bool) -> list[list[str]]:
    """Seconds of 70 000 log densities, 50 walkers at a time, for the surrogates and the model itself."""
    model, space = problem()
    truth = model.simulate(space.sample(1, seed=3), record()).values[0]
    rows = []
    for name, surrogate in {**fitted, "the model itself": model}.items():
        posterior = si.Posterior(space, surrogate, si.Observation(record(), truth))
        points = posterior.initial(HALF_ENSEMBLE, np.random.default_rng(1))
        calls = 10 if quick else 400
        timing = common.interleaved({name: lambda p=posterior, x=points, n=calls: [p.evaluate(x) for _ in range(n)]}, 4)
        # The first repeat compiles.
        each = float(np.median(timing[name].seconds[1:])) / calls / HALF_ENSEMBLE
        rows.append([name, f"{1e3 * each:.4f}", f"{each * EVALUATIONS:.1f}", TIME_LIMITS.get(name, "–")])
    return rows


def further() -> list[list[str]]:
    """Further results for histories: single experiments, 300 runs, ten records, and the published method."""
    model, space = problem()
    design = space.sample(DESIGN_RUNS, 1, "sobol", 2.0)
    runs = si.Campaign(model, record(), space.sample(DESIGN_RUNS, 1)).run()
    fitting = NARXFit(si.KrigingNARX(), runs, None)
    joint = np.asarray(fitting._joint().predict(runs.design.values[fitting.fitted]))
    data = fitting.data[fitting.fitted]
    own = fitting.free_run.errors(refined_coefficients(fitting.free_run, joint, data, 2), data)
    rows = [["NARX with coefficients for each run: mean over the design", f"{own.mean():.1e}", "5e-4 (1e-4) [7.74e-3]"]]

    began = time.perf_counter()
    si.PCNARX().fit(si.Campaign(model, record(), space.sample(300, 1, "sobol", 2.0)).run())
    rows.append(
        [
            "PC-NARX: training on 300 runs of 4001 samples, with compilation [s]",
            f"{time.perf_counter() - began:.1f}",
            "6",
        ]
    )

    records = [
        dataclasses.replace(
            si.GroundMotion.synthetic(seed=s).lowpass(20.0).trim(0.0, 40.0).scale_to_pga(PGA), name=str(s)
        )
        for s in range(100, 120)
    ]
    ten = si.Campaign(model, records[:10], design, assignment="cycle").run()
    unseen = si.Campaign(model, records[10:], space.sample(2000, 2, "random"), assignment="cycle").run()
    found = si.PCNARX().fit(ten).validate(unseen)
    rows.append(
        [
            "PC-NARX trained on ten records: mean error on ten other records",
            f"{found.mean:.1e}, largest {found.worst:.1e}",
            "1e-2 (2e-3)",
        ]
    )

    few = si.Campaign(model, record(), space.sample(1000, 2, "random")).run()
    published = {"terms": absolute_terms(), "training": "per-experiment", "selection": "lars", "limit": np.inf}
    many = si.Campaign(model, record(), space.sample(2 * DESIGN_RUNS, 1)).run()
    for most, fitted_to in ((10, many), (None, runs)):
        surrogate = si.PCNARX(**published, most_terms=most).fit(fitted_to)
        thesis = surrogate.validate(few)
        lost = f"{thesis.diverged} of 1000 diverged" if thesis.diverged else f"mean {thesis.mean:.2e}, none diverged"
        rows.append(
            [
                f"PC-NARX as published: {len(surrogate.terms)} absolute terms, least squares for each of {len(fitted_to)} runs",
                f"median {thesis.median:.1e}, {lost}",
                "[9.66e-3]",
            ]
        )
    joint_only = si.PCNARX(steps=0).fit(runs).validate(few)
    rows.append(
        [
            "PC-NARX with hysteretic memory, joint regression only",
            f"mean {joint_only.mean:.1e}, largest {joint_only.worst:.1e}",
            "–",
        ]
    )
    return rows


# --- scalar outputs, other programs ---------------------------------------------------------------------------------


def peers_problem(case: str, runs: int) -> tuple[si.Design, np.ndarray, np.ndarray, np.ndarray]:
    """Design with outputs, and validation points with outputs, from `shared/peers/common.py`."""
    code = (
        f"import sys; sys.path.insert(0, {str(PEERS)!r}); import common, numpy; "
        f"numpy.savez(sys.argv[1], *common.problem({case!r}, {runs})[:4])"
    )
    with tempfile.NamedTemporaryFile(suffix=".npz") as file:
        subprocess.run([sys.executable, "-c", code, file.name], check=True)
        x, y, xv, yv = np.load(file.name).values()
    space = si.ParameterSpace(**{f"x{i}": si.Uniform(-1.0, 1.0) for i in range(x.shape[1])})
    return si.Design(x, space), y, xv, yv


def relative(predicted: np.ndarray, true: np.ndarray) -> float:
    return float(np.mean(np.sum((predicted - true) ** 2, axis=0) / np.sum((true - true.mean(axis=0)) ** 2, axis=0)))


def chaos_rows(quick: bool) -> list[list[str]]:
    rows = []
    cases = {
        "p 21, interaction 2 (1345 terms)": (dict(degree=21, hyperbolic_norm=1.0, interaction=2), "5 s, 2.6e-5"),
        "p 15, q 0.5 (263 terms)": (dict(degree=15, hyperbolic_norm=0.5), "1.5 s, 6.5e-5"),
    }
    design, y, xv, yv = peers_problem("kinked", 1000)
    for label, (settings, limit) in cases.items():
        seconds = []
        for _ in range(1 if quick else 3):
            began = time.perf_counter()
            expansion = si.PCE(**settings).fit(design, y)
            seconds.append(time.perf_counter() - began)
        rows.append(
            [
                f"structid PCE, {label}, 10 outputs",
                f"{np.median(seconds):.2f}",
                f"{relative(expansion.predict(xv), yv):.1e}",
                limit,
            ]
        )
    for case, runs, settings in (("ishigami", 200, {}), ("borehole", 300, dict(degree=(2, 3, 4), hyperbolic_norm=1.0))):
        design, y, xv, yv = peers_problem(case, runs)
        began = time.perf_counter()
        expansion = si.PCE(**settings).fit(design, y)
        rows.append(
            [
                f"structid PCE, {case}, N {runs}",
                f"{time.perf_counter() - began:.2f}",
                f"{relative(expansion.predict(xv), yv):.1e}",
                "–",
            ]
        )
    return rows


def kriging_rows(quick: bool) -> tuple[list[list[str]], list[list[str]]]:
    rows, growth = [], []
    sizes = (250, 500) if quick else (250, 500, 1000, 2000, 4000)
    limits = {(1000, False): "5 s, 5.6e-5", (1000, True): "5 s, 4.2e-7", (2000, False): "25 s", (2000, True): "25 s"}
    for separable in (False, True):
        seconds = []
        for runs in sizes:
            design, y, xv, yv = peers_problem("kinked", runs)
            began = time.perf_counter()
            predictor = si.Kriging(separable=separable).fit(design, y[:, 4])
            seconds.append(time.perf_counter() - began)
            form = "separable" if separable else "ellipsoidal"
            error = relative(predictor.predict(xv), yv[:, 4:5])
            rows.append(
                [
                    f"structid Kriging, {form}, N {runs}",
                    f"{seconds[-1]:.1f}",
                    f"{error:.1e}",
                    limits.get((runs, separable), "–"),
                ]
            )
        whole, last = common.growth_exponent(sizes, seconds)
        growth.append([f"structid Kriging, {form}", f"{whole:.2f}", f"{last:.2f}"])
    seconds = []
    for runs in sizes:
        design, y, *_ = peers_problem("kinked", runs)
        began = time.perf_counter()
        si.PCE(degree=15, hyperbolic_norm=0.5).fit(design, y[:, 4])
        seconds.append(time.perf_counter() - began)
    whole, last = common.growth_exponent(sizes, seconds)
    return rows, [*growth, ["structid PCE, p 15, q 0.5", f"{whole:.2f}", f"{last:.2f}"]]


PEER_RUNS = (
    ("UQPY_PYTHON", "t2_uqpy.py kinked 21 maxint2 1000 10 1", "UQpy PCE, p 21, interaction 2"),
    ("PEERS_PYTHON", "t2_openturns_kinked.py low 21 1000 10 1 Cholesky", "OpenTURNS PCE, p 21, interaction 2"),
    ("PEERS_PYTHON", "t2_chaospy.py kinked 15 0.5 1000 10 1", "chaospy + LarsCV, p 15, q 0.5"),
    ("PEERS_PYTHON", "t3_kriging.py sk kinked 1000 1 T3 0 0", "scikit-learn Kriging, ellipsoidal, N 1000"),
    ("PEERS_PYTHON", "t3_kriging.py ot kinked 1000 1 T3 - 0", "OpenTURNS Kriging, ellipsoidal, N 1000"),
    ("PEERS_PYTHON", "t3_kriging.py ot_prod kinked 1000 1 T3 2 0", "OpenTURNS Kriging, separable, N 1000"),
    ("PEERS_PYTHON", "t3_kriging.py smt kinked 1000 1 T3 1 0", "SMT Kriging, separable, N 1000"),
    ("PEERS_PYTHON", "t3_kriging.py sk kinked 2000 1 T3 0 0", "scikit-learn Kriging, ellipsoidal, N 2000"),
)


def peer_rows(quick: bool) -> list[list[str]]:
    """Run copies of the other programs' scripts, since these write into their own folder."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for script in PEERS.glob("*.py"):
            shutil.copy(script, folder)
        for variable, command, label in PEER_RUNS if not quick else ():
            python = os.environ.get(variable)
            if python is None:
                continue
            done = subprocess.run([python, *command.split()], cwd=folder, capture_output=True, text=True, timeout=900)
            lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
            if done.returncode or not lines:
                rows.append([label, "failed", "–", "–"])
                continue
            told = json.loads(lines[-1])
            rows.append([label, f"{told['seconds']:.1f}", f"{told['errors']['rel_val']:.1e}", "–"])
    return rows


# --- the page -------------------------------------------------------------------------------------------------------


def section(accurate: Any, evaluated: Any, more: Any, scalar: Any, growth: Any) -> str:
    heads = [
        "surrogate, design",
        "mean error",
        "median",
        "95 %",
        "largest",
        "diverged",
        "error of the peak",
        "coverage",
        "fit [s]",
        "limits (stretch goals)",
    ]
    return f"""# Surrogates

`benchmarks/surrogates.py`. {common.machine("scikit-learn")}.

Prior and model of the `bouc_wen` study, stochastic record of `shared/peers` at PGA {PGA} m/s², {DESIGN_RUNS} runs in the design,
and {VALIDATION_RUNS:,} independent validation runs drawn from the prior. The error of a free run is ε = Σ(y − ŷ)²/Σ(y − ȳ)². The
published means are 9.66e-3 (PC-NARX) and 9.00e-3 (Kriging-NARX), for a milder problem.

{common.markdown_table(heads, accurate)}

{EVALUATIONS:,} log densities, {HALF_ENSEMBLE} at a time as in an ensemble of 100 walkers. The published inversions took 55 minutes
(PC-NARX) and 18 hours (Kriging-NARX).

{common.markdown_table(["log density by", "ms each", f"{EVALUATIONS:,} [s]", "limit (stretch goal) [s]"], evaluated)}

{common.markdown_table(["quantity", "result", "limit (stretch goal) [published]"], more)}

Polynomial chaos and Kriging of scalar outputs: a kinked function of four inputs, with the error over 10⁴ points. All programs run
in the same session with one thread.

{common.markdown_table(["program", "seconds", "error", "limit"], scalar)}

Growth of the cost over N = 250 … 4000: exponent by least squares, and in the last doubling. Exponents of other programs
(`shared/peers`, N up to 2000): 2.4 for Kriging by scikit-learn, 3.0 by OpenTURNS and 2.2 by SMT; 1.7 for polynomial chaos by
OpenTURNS and 0.9 by UQpy.

{common.markdown_table(["program", "exponent", "last doubling"], growth)}
"""


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    accurate, fitted = accuracy(quick)
    evaluated = evaluation(fitted, quick)
    more = [] if quick else further()
    kriged, growth = kriging_rows(quick)
    scalar = [*chaos_rows(quick), *kriged, *peer_rows(quick)]
    text = section(accurate, evaluated, more, scalar, growth)
    common.record_result(
        NAME,
        quick=quick,
        machine=common.machine(),
        accuracy=accurate,
        evaluation=evaluated,
        further=more,
        scalar=scalar,
        growth=growth,
    )
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
