"""The laws of two real masonry walls, without the draws of their posteriors."""

import pytest

import structid as si
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import ERROR_MODELS, compare_laws
from structid.mechanics.hysteretic_laws.law_list import law_of


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "laws", "unexplained", "error"),
    [
        ("FD_PG1_Almeida2012.csv", ("bilinear", "masing", "masing_flag"), 0.040, 0.18),
        ("FD_T11_Faella1992.csv", ("bilinear", "slip_lock"), 0.008, 0.056),
    ],
)
def test_a_law_follows_a_wall_and_predicts_its_later_cycles(shared_data, name, laws, unexplained, error):
    test = si.CyclicTest.read(shared_data / "hysteresis" / name, "mm", "kN")
    compared = compare_laws(test, [law_of("laws", law) for law in laws], ERROR_MODELS["auto"], 1, FitStore(None, {}))
    assert compared.least_squares < unexplained
    assert min(candidate.prediction_error for candidate in compared.candidates) < error
    assert compared.chosen.law.word in laws[1:]
