"""Bayesian structural identification: from a measured response history to a posterior one can trust."""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.2.0"

_PUBLIC = {
    "AIES": "inference.sampling.ensemble",
    "AR1": "inference.likelihood.correlated",
    "Beta": "probability.marginals",
    "BoucWen": "models.bouc_wen",
    "CallableModel": "solvers.callable",
    "Campaign": "campaign.runner",
    "Certificate": "inference.assessment.certificate",
    "CombinedExcitation": "ground_motion.excitation",
    "DampedCosine": "inference.likelihood.correlated",
    "DelayedAcceptance": "inference.sampling.delayed_acceptance",
    "Design": "probability.space",
    "DisplacementHistory": "ground_motion.excitation",
    "ForceHistory": "ground_motion.excitation",
    "Frozen": "probability.marginals",
    "Gamma": "probability.marginals",
    "GroundMotion": "ground_motion.record",
    "Gumbel": "probability.marginals",
    "Histories": "histories",
    "IID": "inference.likelihood.independent",
    "InputError": "errors",
    "LogDensity": "inference.target",
    "LogNormal": "probability.marginals",
    "Normal": "probability.marginals",
    "Observation": "inference.likelihood.observation",
    "OutputFile": "solvers.program",
    "ParameterSpace": "probability.space",
    "Posterior": "inference.likelihood.posterior",
    "ProgramModel": "solvers.program",
    "Runs": "runs",
    "Plan": "calibration.sequential",
    "SMC": "inference.sampling.tempered",
    "SamplingResult": "inference.sampling_result",
    "ShearFrame": "models.shear_frame",
    "SolverError": "solvers.protocol",
    "Status": "errors",
    "StructidError": "errors",
    "UMBridgeModel": "solvers.um_bridge",
    "Uniform": "probability.marginals",
    "Weibull": "probability.marginals",
    "KrigingNARX": "surrogates.narx.kriging_narx",
    "Kriging": "surrogates.kriging.universal_kriging",
    "Matern32": "inference.likelihood.correlated",
    "NARX": "surrogates.narx.narx",
    "NUTS": "inference.sampling.gradient",
    "PCE": "surrogates.chaos.pce",
    "PCNARX": "surrogates.narx.pc_narx",
    "PODKriging": "surrogates.pod.pod_kriging",
    "PODPCE": "surrogates.pod.pod_pce",
    "StructidWarning": "errors",
    "Term": "surrogates.narx.terms",
    "Memory": "surrogates.narx.terms",
    "load_surrogate": "surrogates.registry",
    "open_runs": "campaign.store",
    "calibrate": "calibration.sequential",
    "sample": "inference.sample",
    "sbc": "inference.assessment.simulation_based_calibration",
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
