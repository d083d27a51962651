"""The sections of a report in their order. A new one is a file with its `Section` and a line here."""

from __future__ import annotations

from typing import Any

from structid.report.section import Section
from structid.report.sections import (
    actuators_followed,
    certificate,
    chain_convergence,
    chance_of_failure,
    compared_evidence,
    compared_parameters,
    compared_records,
    compared_responses,
    deterministic_minima,
    fitted_surrogate,
    followed_online,
    histories_of_floors,
    judged_draws,
    law_of_the_errors,
    loops_of_specimen,
    marginals_and_pairs,
    measured_data,
    measured_response,
    other_records,
    parameters_and_passages,
    structure_in_motion,
    taught_by_tests,
    tests_of_programme,
    true_runs_of_study,
    whitened_residuals,
)

OF_A_CALIBRATION: tuple[Section[Any], ...] = (
    measured_response.SECTION,
    law_of_the_errors.SECTION,
    whitened_residuals.SECTION,
    marginals_and_pairs.SECTION,
    structure_in_motion.SECTION,
    deterministic_minima.SECTION,
    other_records.SECTION,
    chance_of_failure.SECTION,
    certificate.SECTION,
    chain_convergence.SECTION,
    parameters_and_passages.SECTION,
    fitted_surrogate.SECTION,
    true_runs_of_study.SECTION,
    measured_data.SECTION,
)
"""Made of `PosteriorMaterial`."""

OF_RUNS: tuple[Section[Any], ...] = (
    parameters_and_passages.SECTION,
    true_runs_of_study.SECTION,
    fitted_surrogate.SECTION,
)
"""Made of `RunsMaterial`, for a study without a measurement."""

OF_A_PROGRAMME: tuple[Section[Any], ...] = (
    tests_of_programme.SECTION,
    loops_of_specimen.SECTION,
    histories_of_floors.SECTION,
    actuators_followed.SECTION,
    taught_by_tests.SECTION,
    followed_online.SECTION,
)
"""Made of `ProgrammeMaterial`."""

OF_A_CERTIFICATE: tuple[Section[Any], ...] = (judged_draws.SECTION,)
"""Made of `CertificateMaterial`."""

OF_A_COMPARISON: tuple[Section[Any], ...] = (
    compared_evidence.SECTION,
    compared_parameters.SECTION,
    compared_responses.SECTION,
    compared_records.SECTION,
)
"""Made of `ComparisonMaterial`."""
