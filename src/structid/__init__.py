"""Bayesian structural identification: from a measured response history to a posterior one can trust."""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "AIES": "inference.ensemble",
    "AR1": "inference.correlated",
    "Beta": "probability.marginals",
    "BoucWen": "models.bouc_wen",
    "CallableModel": "models.external",
    "Campaign": "campaign.runner",
    "Certificate": "inference.certificate",
    "CombinedExcitation": "ground_motion.excitation",
    "DampedCosine": "inference.correlated",
    "DelayedAcceptance": "inference.delayed_acceptance",
    "Design": "probability.space",
    "DisplacementHistory": "ground_motion.excitation",
    "ForceHistory": "ground_motion.excitation",
    "Frozen": "probability.marginals",
    "Gamma": "probability.marginals",
    "GroundMotion": "ground_motion.record",
    "Gumbel": "probability.marginals",
    "Histories": "histories",
    "IID": "inference.discrepancy",
    "InputError": "errors",
    "LogDensity": "inference.target",
    "LogNormal": "probability.marginals",
    "Normal": "probability.marginals",
    "Observation": "inference.posterior",
    "OutputFile": "models.program",
    "ParameterSpace": "probability.space",
    "Posterior": "inference.posterior",
    "ProgramModel": "models.program",
    "Runs": "runs",
    "Plan": "calibration.sequential",
    "SMC": "inference.tempered",
    "SamplingResult": "inference.result",
    "ShearFrame": "models.shear_frame",
    "SolverError": "models.external",
    "Status": "errors",
    "StructidError": "errors",
    "UMBridgeModel": "models.um_bridge",
    "Uniform": "probability.marginals",
    "Weibull": "probability.marginals",
    "KrigingNARX": "surrogates.narx",
    "Kriging": "surrogates.kriging",
    "Matern32": "inference.correlated",
    "NARX": "surrogates.narx",
    "NUTS": "inference.gradient",
    "PCE": "surrogates.pce",
    "PCNARX": "surrogates.narx",
    "PODKriging": "surrogates.response_space",
    "PODPCE": "surrogates.response_space",
    "StructidWarning": "errors",
    "Term": "surrogates.terms",
    "Memory": "surrogates.terms",
    "load_surrogate": "surrogates.storage",
    "open_runs": "campaign.store",
    "calibrate": "calibration.sequential",
    "sample": "inference.sampling",
    "sbc": "inference.replicas",
}


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"structid.{_PUBLIC[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"structid.{name}")
    raise AttributeError(f"module 'structid' has no attribute '{name}'")


_MODULES = ("optimize",)


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, *_MODULES, "__version__"])
