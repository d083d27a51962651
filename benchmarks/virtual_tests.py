"""Choice of a hysteretic law from virtual cyclic tests: how often the right law is found, and what it says without it.

    python benchmarks/virtual_tests.py [--quick] [--seeds FIRST END]

A virtual specimen is a law with parameters near the middle of its default priors, under two cycles of each of seven growing
amplitudes. The force has noise of 2 % of its standard deviation. Every law is a candidate, and then every law except the right
one and those that contain it. Cases add up: a run appends its own to the results, and writes the page of all.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import common
import numpy as np
import scipy.special

import structid as si
from structid.law_choice.choose_model import LawChoice, choose_among
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import ERROR_MODELS
from structid.law_choice.law_fit import FAST
from structid.mechanics.hysteretic_laws.law_list import INELASTIC, law_of

NAME = "virtual_tests"
SMOOTH = {"giuffre_menegotto_pinto", "voce_chaboche", "bouc_wen", "slip_lock"}
SPECIMENS = {
    "elastic_plastic": {"bilinear", *SMOOTH, "masing", "masing_flag"},
    "bilinear": SMOOTH,
    "giuffre_menegotto_pinto": set(),
    "self_centering": set(),
    "bouc_wen": {"slip_lock"},
    "slip_lock": set(),
    "masing": {"masing_flag"},
    "masing_flag": set(),
    "pivot": set(),
    "ibarra_pinching": set(),
}
"""Laws of the specimens, and the laws that contain each, some in the limit of a sharp bend."""
SEEDS, WITHHELD, LONG, QUICK_SPECIMENS = 14, 2, 1, ("bilinear",)
"""Seeds; those without the right laws, too, and with a long run to check the evidence; specimens of a quick run."""
LONG_RUN = {True: si.SMC(particles=100, ensembles=2), False: si.SMC(particles=2000, ensembles=4, steps=50)}
"""Samplers of the long run, in a quick run and otherwise; they begin at the prior, and do not know the best fit. A slow law has
half the particles."""
NOISE, NEAR = 0.02, 0.6
"""Noise, relative to the standard deviation of the force; spread of the parameters, in standard deviations of their priors."""
AMPLITUDES = np.repeat(np.linspace(1.0 / 7.0, 1.0, 7) ** 1.3, 2) * 0.03  # m
SAMPLES = 30  # per cycle
WEAK, USUAL = 20e3, 0.3
"""Smallest range of the force [N], and smallest correlation of force and displacement, of a usual specimen."""
NEAR_BEST, USUAL_BAND = 1.2, (0.80, 0.98)
"""Error of a good choice over the smallest; usual share of held-out samples in a band of 90 %."""
NO_DOUBT = "nothing against it"


def path() -> np.ndarray:
    """Displacements of the test [m]."""
    phase = np.linspace(0.0, 2.0 * np.pi, SAMPLES, endpoint=False)
    return np.concatenate([*(a * np.sin(phase) for a in AMPLITUDES), [0.0]])


def virtual_test(word: str, seed: int) -> si.CyclicTest:
    """A test of a specimen with the scales 20 kN/mm, 100 kN, 30 mm."""
    rng, u, law = np.random.default_rng([seed, list(SPECIMENS).index(word)]), path(), law_of("specimen", word)
    space = si.CyclicTest(u, 100e3 * np.tanh(u / 0.005) + 1e6 * u, "scales").priors(law)
    model = si.Hysteretic(law, free=space.names, substeps=20)
    while True:
        shares = scipy.special.ndtr(NEAR * rng.normal(size=(1, len(space.names))))
        run = model.simulate(space.from_uniform(shares), si.DisplacementHistory(u, 1.0))
        force = run.values[0, :, 0]
        if run.done[0] and np.ptp(force) > WEAK and np.corrcoef(u, force)[0, 1] > USUAL:
            return si.CyclicTest(u, force + NOISE * force.std() * rng.normal(size=len(u)), f"{word} {seed}")


def verdict_words(choice: LawChoice) -> str:
    """What the verdict says of the chosen law."""
    verdict = choice.result.verdict()
    if not verdict.converged:
        return "not converged"
    if verdict.wrong_model:
        return "wrong"
    if verdict.doubt:
        return "errors contradict the error model"
    return NO_DOUBT if choice.chosen.fit.leaves_noise else "an error of the law"


def case_result(word: str, seed: int, quick: bool) -> dict[str, Any]:
    """Outcome of one virtual test, with all laws and without the right ones; appended to the results."""
    test, right, store = virtual_test(word, seed), {word} | SPECIMENS[word], FitStore(None, {})
    words: Sequence[str] = ("elastic_plastic", "bilinear", "pivot") if quick else INELASTIC
    laws, begin = [law_of("case", law) for law in words], time.perf_counter()
    choice = choose_among(test, laws, ERROR_MODELS["auto"], seed, store)
    seconds = time.perf_counter() - begin
    without = {}
    if seed < WITHHELD:
        # The fits of the other laws are those just made.
        wrong = [law for law in laws if law.word not in right]
        others = choose_among(test, wrong, ERROR_MODELS["auto"], seed, store)
        without = {"without_chosen": others.chosen.name, "without": verdict_words(others)}
    long = beside_long_run(choice, seed, quick) if seed < LONG else {}
    evidence = choice.result.log_evidence
    assert evidence is not None
    result = {
        "law": word,
        "seed": seed,
        "chosen": choice.chosen.name,
        "right": choice.chosen.law.word in right,
        "coverage": choice.held_out.coverage,
        "error": choice.chosen.prediction_error,
        "smallest": min(c.prediction_error for c in choice.candidates),
        "laplace": choice.chosen.fit.log_evidence - evidence.value,
        "laplace_error": evidence.error,
        "verdict": verdict_words(choice),
        "seconds": seconds,
        **without,
        **long,
    }
    common.record_result(NAME, quick=quick, **result)
    return result


def beside_long_run(choice: LawChoice, seed: int, quick: bool) -> dict[str, Any]:
    """Log evidence of the chosen law by a long run from the prior, minus the reported one."""
    sampler = LONG_RUN[quick]
    if choice.chosen.law.accurate_move < FAST:
        # A run takes ten times as long, and particles of 15 parameters move best along differences.
        sampler = replace(sampler, particles=sampler.particles // 2, differential_evolution=0.9)
    run = si.sample(choice.chosen.fit.posterior, sampler, seed)
    long, reported = run.log_evidence, choice.result.log_evidence
    assert long is not None and reported is not None
    return {"long": long.value - reported.value, "long_error": long.error, "long_converged": run.verdict().converged}


def results(quick: bool) -> list[dict[str, Any]]:
    """The last recorded outcome of every virtual test."""
    last = common.last_results(NAME, "law", "seed", quick=quick)
    order = list(SPECIMENS)
    return sorted(last.values(), key=lambda line: (order.index(line["law"]), line["seed"]))


def law_row(word: str, cases: list[dict[str, Any]]) -> list[str]:
    """Outcomes of the specimens of one law."""
    wrong = [f"`{case['chosen']}` ({case['seed']})" for case in cases if not case["right"]]
    coverage = [case["coverage"] for case in cases]
    return [
        f"`{word}`",
        f"{len(cases) - len(wrong)} of {len(cases)}",
        ", ".join(wrong) or "–",
        f"{min(coverage):.0%} to {max(coverage):.0%}",
        f"{max(case['error'] / case['smallest'] for case in cases):.2f}",
        f"{max(abs(case['laplace']) for case in cases):.2f}",
        ", ".join(long_run_words(case) for case in cases if "long" in case) or "–",
        counts(case["verdict"] for case in cases),
        counts(case["without"] for case in cases if "without" in case),
        f"{statistics.median(case['seconds'] for case in cases):.0f}",
    ]


def long_run_words(case: dict[str, Any]) -> str:
    """What the long run of a case says of the reported log evidence."""
    return f"{case['long']:+.2f} ± {case['long_error']:.2f}{'' if case['long_converged'] else ', not converged'}"


def counts(words: Iterable[str]) -> str:
    """How often each word occurs."""
    return ", ".join(f"{number} {word}" for word, number in Counter(words).most_common())


def page_text(cases: list[dict[str, Any]]) -> str:
    """The page of all recorded cases."""
    right = sum(case["right"] for case in cases)
    near = sum(case["error"] <= NEAR_BEST * case["smallest"] for case in cases)
    inside = sum(USUAL_BAND[0] <= case["coverage"] <= USUAL_BAND[1] for case in cases)
    held = statistics.mean(case["coverage"] for case in cases)
    withheld = [case for case in cases if "without" in case]
    silent = [case for case in withheld if case["without"] == NO_DOUBT]
    heads = [
        "specimens",
        "right law",
        "other choices (seed)",
        "held-out samples in the 90 % band",
        "error over the smallest",
    ]
    heads += [
        "log evidence, Laplace minus sampled",
        "log evidence, long run minus sampled",
        "verdict",
        "verdict without the right laws",
        "seconds",
    ]
    rows = [law_row(word, chosen) for word in SPECIMENS if (chosen := [c for c in cases if c["law"] == word])]
    passed = ", ".join(f"`{case['law']}` {case['seed']} by `{case['without_chosen']}`" for case in silent)
    return f"""
# Virtual cyclic tests

`benchmarks/virtual_tests.py`. {common.machine()}.

{len(cases)} tests of {len(rows)} laws, {len(path())} samples each, noise of 2 % of the force's standard deviation. A seed gives
the parameters and the noise.

* The right law, or one that contains it, is chosen in {right} of {len(cases)} tests.
* The error of the prediction is within 20 % of the smallest in {near}. It is that of the last 30 % of the half-cycles, predicted
  from the others.
* The 90 % band holds {held:.0%} of the held-out samples of all tests together, and 80 to 98 % in {inside} tests.
* Without the right laws, nothing speaks against the chosen law in {len(silent)} of
  {len(withheld)}{": " if silent else ""}{passed}.

{common.markdown_table(heads, rows)}
"""


def main() -> None:
    """Run the cases, and write the page of all recorded ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one case; does not write to docs/")
    parser.add_argument(
        "--seeds", type=int, nargs=2, default=(0, SEEDS), metavar=("FIRST", "END"), help="seeds of this run"
    )
    asked = parser.parse_args()
    seeds, specimens = (range(1), QUICK_SPECIMENS) if asked.quick else (range(*asked.seeds), tuple(SPECIMENS))
    for seed in seeds:
        for word in specimens:
            print(case_result(word, seed, asked.quick), flush=True)
    text = page_text(results(asked.quick))
    common.write_page(asked.quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
