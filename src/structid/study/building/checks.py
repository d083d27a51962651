"""Checks that the parts of a study fit together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.calibration.plan import Plan
from structid.core.errors import InputError, within
from structid.ground_motion.excitation import Excitation
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sample import check_memory
from structid.optimize.region import region
from structid.probability.designs import Design
from structid.study.building.built_study import BuiltStudy
from structid.study.building.surrogates import surrogate_settings
from structid.study.schema.study_file import StudyFile
from structid.surrogates.surrogate_list import DEFAULT

EXACT = 1e-9
"""Largest difference between response and measurement, relative to the peak, that rounding can cause."""


def check_before_anything_is_written(study: BuiltStudy) -> None:
    """Reject settings that the sampler, the searches or the surrogate would reject, before a folder is created."""
    check_tables(study.file)
    if study.sampler.exact and not study.has_surrogate:
        raise InputError(
            "key 'sampler.kind'",
            "'delayed_acceptance' without a [surrogate]",
            "a kind of surrogate that makes proposals",
        )
    if study.posterior is not None:
        _check_noise(study, study.posterior)
    if study.plan is not None:
        _check_calibration(study, study.plan)
    if study.campaign is not None and study.has_surrogate:
        _check_surrogate(study, study.campaign, study.campaign_records)
    if study.posterior is None:
        return
    if study.has_surrogate and study.posterior.error_model.inside:
        raise InputError(
            "key 'discrepancy.kind'",
            f"'{study.file.discrepancy.kind}' with a [surrogate]",
            "errors that are added to the response (iid, ar1, matern32, damped_cosine), or no [surrogate]",
            "Remove [surrogate] to use drifting parameters: a built-in model is sampled in seconds.",
        )
    with within("table 'sampler'"):
        check_memory(study.posterior, study.sampler)
    dimension = study.posterior.dimension
    if study.sampler.needs_derivatives:
        if not (study.has_surrogate or study.model.traceable):
            raise InputError(
                "key 'sampler.kind'",
                "'nuts' for an external model, which has no derivatives",
                "'aies' or 'smc', or a [surrogate]",
            )
    elif study.sampler.interacting and study.sampler.walkers < 2 * dimension:
        raise InputError(
            "key 'sampler.walkers'", f"{study.sampler.walkers} for {dimension} parameters", f"{2 * dimension} or more"
        )
    if study.search_methods:
        region(study.posterior.misfit, study.search_bounds, study.file.deterministic.constraints)


def check_tables(file: StudyFile) -> None:
    """Reject tables that exclude each other."""
    surrogate, calibrated = file.surrogate, file.calibration is not None
    unused = surrogate.model_fields_set - {"kind"} if surrogate.kind == "none" else set()
    keys_given = surrogate.model_fields_set & {"validation", "limit", "trust", "model_error"}
    advice_on_campaign = "only one of the two: a calibration plans its own runs"
    advice_on_keys = "no such key: the certificate assesses the surrogate"
    refusals = (
        (
            bool(unused),
            f"key 'surrogate.{min(unused, default='')}'",
            "it has no effect with kind = 'none'",
            "a surrogate kind; with kind = 'none', no other key",
        ),
        (
            calibrated and surrogate.kind == "none",
            "table 'calibration'",
            "no kind of [surrogate]",
            f"a surrogate such as '{DEFAULT.word}', or no [calibration] to sample the model itself",
        ),
        (
            calibrated and not file.observation,
            "table 'calibration'",
            "no [observation]",
            "a measurement for the calibration",
        ),
        (
            calibrated and file.campaign is not None,
            "table 'campaign'",
            "a campaign together with [calibration]",
            advice_on_campaign,
        ),
        (
            calibrated and bool(keys_given),
            f"key 'surrogate.{min(keys_given, default='')}'",
            "it is given together with [calibration]",
            advice_on_keys,
        ),
    )
    for wrong, where, came, allowed in refusals:
        if wrong:
            raise InputError(where, came, allowed)


def _check_calibration(study: BuiltStudy, plan: Plan) -> None:
    """Reject settings with which the surrogate cannot be fitted to the first design."""
    assert study.posterior is not None
    records = tuple({o.record.content_hash: o.record for o in study.posterior.observations}.values())
    points = np.repeat(study.space.sample(plan.sizes[0], 0, "sobol").values, len(records), axis=0)
    _check_surrogate(study, Design(points, study.space), records)


def _check_surrogate(study: BuiltStudy, design: Design, records: Sequence[Excitation]) -> None:
    """Reject settings that the surrogate fit would reject, before hours are spent on model runs."""
    settings = surrogate_settings(study.file.surrogate)
    with within("tables 'surrogate' and 'campaign'"):
        settings.check(design, records, study.model.channels)


def _check_noise(study: BuiltStudy, posterior: Posterior) -> None:
    """Reject noise-free data for a model that can fit them exactly: the error variance then has no proper posterior."""
    without = [o.virtual is not None and o.virtual.noise == 0.0 for o in study.file.observation]
    true = study.true_values
    if not (any(without) and posterior.variances and study.model.batched and set(study.space.names) <= set(true)):
        return
    medians = posterior.space.quantile(np.full((1, posterior.dimension), 0.5))
    theta = np.where(
        np.arange(posterior.dimension) < study.space.dimension,
        np.array([true.get(name, 0.0) for name in posterior.names]),
        medians,
    )
    for index in np.flatnonzero(without):
        values = posterior.observations[index].values
        if np.abs(values - posterior.predict(theta, int(index))[0]).max() < EXACT * np.abs(values).max():
            raise InputError(
                "key 'observation.virtual.noise'",
                "0, but the model can fit the data exactly: the unknown error variance is then zero",
                "more than 0, such as noise = 0.02",
                "Add noise, or give the error variance in [discrepancy].",
            )
