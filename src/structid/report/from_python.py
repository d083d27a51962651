"""The report of a calibration in Python, without a study file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from structid.calibration.calibration_result import CalibrationResult
from structid.core.by_type import ByType
from structid.core.errors import InputError
from structid.core.progress import Progress
from structid.core.renamed import renamed_argument
from structid.core.validation import check_arguments
from structid.ground_motion.record import GroundMotion
from structid.inference.error_model_choice import ErrorModelChoice
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.report import section_list
from structid.report.drawing.drawn_sections import draw
from structid.report.material.material import PosteriorMaterial, calibration_results
from structid.report.page import write_posterior_report
from structid.surrogates.base import Surrogate

DRAWS = 400
"""Number of posterior draws for the prediction bands."""


@renamed_argument(law_choice="error_model_choice")
@check_arguments
def write_report(
    result: CalibrationResult | SamplingResult,
    folder: str | os.PathLike[str],
    *,
    title: str = "Calibration",
    other_records: Sequence[GroundMotion] = (),
    channels: Sequence[str] = (),
    true_values: dict[str, float] | None = None,
    error_model_choice: ErrorModelChoice | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write ``report.html`` of a calibration: one file with verdict, numbers and figures, as ``structid run`` does.

    Parameters
    ----------
    result : CalibrationResult or SamplingResult
        Result of `calibrate`, or of `sample` with a `Posterior`.
    folder : path-like
        Folder of the page and the figures; created if necessary. An existing page is replaced.
    title : str
        Heading of the page.
    other_records : sequence of GroundMotion
        Records for which the response is predicted.
    channels : sequence of str
        Channels to predict for these records; default: the measured channels.
    true_values : dict of str to float, optional
        True parameters of a virtual experiment, in SI.
    error_model_choice : ErrorModelChoice, optional
        Result of `choose_error_model`; a `CalibrationResult` already contains it.
    progress : callable, optional
        Called with the number of drawn figures and the total number.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    InputError
        If the draws do not come from the `Posterior` of a model.

    Examples
    --------
    >>> import structid as si
    >>> page = si.write_report(result, "report", title="Specimen 4")  # doctest: +SKIP
    """
    material = _material(result, title, tuple(other_records), tuple(channels), true_values or {}, error_model_choice)
    output_folder = Path(folder)
    output_folder.mkdir(parents=True, exist_ok=True)
    drawn = draw(section_list.OF_A_CALIBRATION, material, output_folder / "figures", progress)
    return write_posterior_report(material, drawn, output_folder, {})


def _material(
    result: CalibrationResult | SamplingResult,
    title: str,
    other_records: tuple[GroundMotion, ...],
    channels: tuple[str, ...],
    true_values: dict[str, float],
    error_model_choice: ErrorModelChoice | None,
) -> PosteriorMaterial:
    calibration = result if isinstance(result, CalibrationResult) else None
    sampling: SamplingResult = result if calibration is None else calibration.sampling  # type: ignore[assignment]
    sampled = getattr(sampling, "target", result)
    if not isinstance(sampled, Posterior):
        raise InputError(
            "write_report(result)",
            f"draws of a {type(sampled).__name__}",
            "draws of a Posterior, which combines a model and a measurement",
        )
    posterior = sampled if calibration is None else calibration.posterior
    record: Any = posterior.observations[0].record
    # Only a surrogate replaces another model.
    surrogate = None if posterior.model.stand_in is None else cast(Surrogate, posterior.model)
    results = (
        ByType({SamplingResult: sampling, Surrogate: surrogate, ErrorModelChoice: error_model_choice})
        if calibration is None
        else calibration_results(calibration)
    )
    return PosteriorMaterial(
        title=title,
        settings=f"{posterior.model}\n\n{posterior.model_space}\n\n{posterior.error_model}",
        results=results,
        true_posterior=posterior,
        raw_record=record,
        record=record,
        truths=(None,) * len(posterior.observations),
        true_values=true_values,
        other_records=other_records,
        predicted_channels=channels,
        prediction_draws=DRAWS,
        left_to_the_data=ErrorModelChoice in results,
    )
