"""The sections of the reports, in order. To add a section, add a file with a `Section`, and a line here."""

from __future__ import annotations

from typing import Any

from structid.report.section import Section
from structid.report.sections.calibration import (
    certificate_section,
    chain_convergence,
    deterministic_minima,
    error_model_section,
    external_draws_certificate,
    fragility_section,
    law_section,
    marginals_and_pairs,
    measured_data,
    measured_response,
    model_runs_section,
    other_records,
    parameters_and_passages,
    structure_in_motion,
    surrogate_section,
    whitened_residuals,
)
from structid.report.sections.comparison import (
    compared_evidence,
    compared_parameters,
    compared_records,
    compared_responses,
)
from structid.report.sections.cyclic_test import (
    compared_laws,
    dynamic_use,
    further_paths,
    held_out_half_cycles,
    measured_loops,
    measures_of_cycles,
    parameters_of_law,
    what_is_missing,
)
from structid.report.sections.programme import (
    actuator_tracking,
    floor_histories,
    learnt_from_tests,
    online_filter,
    specimen_loops,
    test_table,
)

OF_A_CALIBRATION: tuple[Section[Any], ...] = (
    measured_response.SECTION,
    law_section.SECTION,
    error_model_section.SECTION,
    whitened_residuals.SECTION,
    marginals_and_pairs.SECTION,
    structure_in_motion.SECTION,
    deterministic_minima.SECTION,
    other_records.SECTION,
    fragility_section.SECTION,
    certificate_section.SECTION,
    chain_convergence.SECTION,
    parameters_and_passages.SECTION,
    surrogate_section.SECTION,
    model_runs_section.SECTION,
    measured_data.SECTION,
)
"""Sections of a calibration, from `PosteriorMaterial`."""

OF_RUNS: tuple[Section[Any], ...] = (
    parameters_and_passages.SECTION,
    model_runs_section.SECTION,
    surrogate_section.SECTION,
)
"""Sections of a study without a measurement, from `RunsMaterial`."""

OF_A_PROGRAMME: tuple[Section[Any], ...] = (
    test_table.SECTION,
    specimen_loops.SECTION,
    floor_histories.SECTION,
    actuator_tracking.SECTION,
    learnt_from_tests.SECTION,
    online_filter.SECTION,
)
"""Sections of a programme of hybrid tests, from `ProgrammeMaterial`."""

OF_A_CYCLIC_TEST: tuple[Section[Any], ...] = (
    measured_loops.SECTION,
    compared_laws.SECTION,
    measures_of_cycles.SECTION,
    held_out_half_cycles.SECTION,
    what_is_missing.SECTION,
    parameters_of_law.SECTION,
    further_paths.SECTION,
    dynamic_use.SECTION,
)
"""Sections of a cyclic test, from `CyclicMaterial`."""

OF_A_CERTIFICATE: tuple[Section[Any], ...] = (external_draws_certificate.SECTION,)
"""Sections of a certificate of external draws, from `CertificateMaterial`."""

OF_A_COMPARISON: tuple[Section[Any], ...] = (
    compared_evidence.SECTION,
    compared_parameters.SECTION,
    compared_responses.SECTION,
    compared_records.SECTION,
)
"""Sections of a comparison of model classes, from `ComparisonMaterial`."""
