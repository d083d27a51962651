"""Choice of a hysteretic law from virtual cyclic tests: how often the right law is found, and what it says without it.

    python benchmarks/virtual_tests.py [--quick]

A virtual specimen is a law with parameters near the middle of its default priors, under two cycles of each of seven growing
amplitudes. The force has noise of 2 % of its standard deviation. Every law is a candidate, and then every law except the right
one and those that contain it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import common
import numpy as np
import scipy.special

import structid as si
from structid.law_choice.choose_model import LawChoice
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of

NAME = "virtual_tests"
SPECIMENS = {
    "elastic_plastic": {"bilinear", "self_centering", "giuffre_menegotto_pinto", "voce_chaboche"},
    "bilinear": {"self_centering"},
    "giuffre_menegotto_pinto": set(),
    "self_centering": set(),
    "bouc_wen": {"slip_lock"},
    "slip_lock": set(),
    "masing": {"masing_flag"},
    "masing_flag": set(),
    "pivot": set(),
    "ibarra_pinching": set(),
}
"""Laws of the specimens, and the laws that contain each."""
SEEDS, QUICK_SPECIMENS = 1, ("bilinear",)
NOISE, NEAR = 0.02, 0.6
"""Noise, relative to the standard deviation of the force; spread of the parameters, in standard deviations of their priors."""
AMPLITUDES = np.repeat(np.linspace(1.0 / 7.0, 1.0, 7) ** 1.3, 2) * 0.03  # m
SAMPLES = 30  # per cycle
WEAK, USUAL = 20e3, 0.3
"""Smallest range of the force [N], and smallest correlation of force and displacement, of a usual specimen."""


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
    return "errors contradict the error model" if verdict.doubt else "nothing against it"


def case_row(word: str, seed: int, quick: bool) -> list[str]:
    """Outcome of one virtual test, with all laws and without the right ones."""
    test, right, begin = virtual_test(word, seed), {word} | SPECIMENS[word], time.perf_counter()
    everything: Sequence[str] = ("elastic_plastic", "bilinear", "pivot") if quick else tuple(LAWS)[1:]
    choice = si.choose_model(test, everything, seed=seed)
    seconds = time.perf_counter() - begin
    others = si.choose_model(test, [law for law in everything if law not in right], seed=seed)
    evidence = choice.result.log_evidence
    assert evidence is not None
    best = min(c.prediction_error for c in choice.candidates)
    values = {
        "right": choice.chosen.law.word in right,
        "coverage": choice.held_out.coverage,
        "error": choice.chosen.prediction_error,
        "smallest": best,
        "laplace": choice.chosen.fit.log_evidence - evidence.value,
        "seconds": seconds,
        "without": verdict_words(others),
        "verdict": verdict_words(choice),
    }
    common.record_result(NAME, quick=quick, law=word, seed=seed, chosen=choice.chosen.name, **values)
    return [
        f"`{word}` {seed}",
        f"`{choice.chosen.law.word}`",
        values["verdict"],
        f"{values['coverage']:.0%}",
        f"{values['error']:.1%}",
        f"{best:.1%}",
        f"{values['laplace']:+.2f} (± {evidence.error:.2f})",
        f"`{others.chosen.law.word}`: {values['without']}",
        f"{seconds:.0f}",
    ]


def main() -> None:
    """Run the cases, and write the page."""
    quick = common.is_quick(__doc__ or "")
    seeds, specimens = (1, QUICK_SPECIMENS) if quick else (SEEDS, tuple(SPECIMENS))
    rows = [case_row(word, seed, quick) for seed in range(seeds) for word in specimens]
    right = sum(row[1].strip("`") in {row[0].split("`")[1]} | SPECIMENS[row[0].split("`")[1]] for row in rows)
    heads = ["specimen", "chosen", "verdict", "held-out samples in the 90 % band", "error", "smallest"]
    heads += ["log evidence, Laplace minus sampled", "without the right laws", "seconds"]
    text = f"""
# Virtual cyclic tests

`benchmarks/virtual_tests.py`. {common.machine()}.

{len(specimens)} laws, specimens of each: {seeds}, {len(path())} samples, noise of 2 % of the force's standard deviation.
The right law, or one that contains it, is chosen in {right} of {len(rows)} tests. The error and the band are those of the
last 30 % of the half-cycles, predicted from the others.

{common.markdown_table(heads, rows)}
"""
    common.write_page(quick, NAME, text)
    print(text)


if __name__ == "__main__":
    main()
