"""Bayesian structural identification: from a measured response history to a posterior one can trust.

The names below are the public ones. They are loaded when they are first used, so that the command line answers at once. Editors and
type checkers read them from ``__init__.pyi``.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.3.0"

_PUBLIC = {
    "AIES": "inference.sampling.ensemble",
    "AR1": "inference.likelihood.kernels",
    "Actuator": "hybrid.transfer",
    "AdaptiveTimeSeries": "hybrid.compensation",
    "Beta": "probability.marginals",
    "BoucWen": "models.bouc_wen",
    "CallableModel": "solvers.callable",
    "Campaign": "campaign.runner",
    "Certificate": "inference.assessment.certificate",
    "Limits": "inference.assessment.limits",
    "CombinedExcitation": "ground_motion.excitation",
    "CorrectedNARX": "surrogates.narx.corrected_narx",
    "DampedCosine": "inference.likelihood.kernels",
    "DelayedAcceptance": "inference.sampling.delayed_acceptance",
    "Design": "probability.designs",
    "DisplacementField": "fem.displacement_field",
    "DisplacementHistory": "ground_motion.excitation",
    "Drifting": "inference.likelihood.drifting",
    "FloorMasses": "hybrid.facade_parts",
    "ForceHistory": "ground_motion.excitation",
    "Frozen": "probability.marginals",
    "Gamma": "probability.marginals",
    "GravouilCombescure": "hybrid.gravouil_combescure",
    "GroundMotion": "ground_motion.record",
    "Gumbel": "probability.marginals",
    "Histories": "histories",
    "HybridResult": "hybrid.hybrid_result",
    "HybridTest": "hybrid.hybrid_test",
    "IID": "inference.likelihood.independent",
    "ImposedDisplacements": "models.imposed_displacements",
    "InputError": "errors",
    "Kriging": "surrogates.kriging.universal_kriging",
    "KrigingNARX": "surrogates.narx.kriging_narx",
    "LogDensity": "inference.target",
    "LogNormal": "probability.marginals",
    "LoopLines": "models.loop_lines",
    "Masonry": "fem.assembly",
    "MasonryWall": "fem.masonry_wall",
    "Matern32": "inference.likelihood.kernels",
    "Memory": "surrogates.narx.terms",
    "NARX": "surrogates.narx.narx",
    "NUTS": "inference.sampling.gradient",
    "Normal": "probability.marginals",
    "Observation": "observation",
    "OpenFrescoSpecimen": "hybrid.openfresco",
    "Opening": "fem.layout",
    "OutputFile": "solvers.program",
    "PCE": "surrogates.chaos.pce",
    "PCNARX": "surrogates.narx.pc_narx",
    "PODKriging": "surrogates.pod.pod_kriging",
    "PODPCE": "surrogates.pod.pod_pce",
    "ParameterSpace": "probability.space",
    "Passages": "reliability.passages",
    "Plan": "calibration.plan",
    "PolynomialExtrapolation": "hybrid.compensation",
    "Posterior": "inference.likelihood.posterior",
    "PrakashHjelmstad": "hybrid.prakash_hjelmstad",
    "ProgramModel": "solvers.program",
    "Programme": "hybrid.programme",
    "ProgrammeResult": "hybrid.programme",
    "ProgressBars": "progress_bars",
    "RemoteSpecimen": "hybrid.remote",
    "RotationHistory": "ground_motion.excitation",
    "Runs": "runs",
    "SMC": "inference.sampling.tempered",
    "SamplingResult": "inference.sampling_result",
    "Sensor": "hybrid.transfer",
    "ShearFrame": "models.shear_frame",
    "SimulatedSpecimen": "hybrid.simulated_specimen",
    "SolverError": "solvers.protocol",
    "Specimen": "hybrid.specimen",
    "SpecimenError": "hybrid.specimen",
    "SpecimenServer": "hybrid.server",
    "Status": "errors",
    "StructidError": "errors",
    "StructidWarning": "errors",
    "StructureFailedError": "solvers.protocol",
    "Substructure": "hybrid.substructure",
    "Term": "surrogates.narx.terms",
    "UMBridgeModel": "solvers.um_bridge",
    "Uniform": "probability.marginals",
    "UnscentedFilter": "hybrid.unscented_filter",
    "UpdatedSprings": "hybrid.updated_springs",
    "VirtualHybridTest": "hybrid.virtual_test",
    "Wall": "fem.layout",
    "Weibull": "probability.marginals",
    "calibrate": "calibration.sequential",
    "certify": "calibration.certify",
    "choose_law": "inference.law_choice",
    "conformance": "hybrid.conformance",
    "cut_frame": "hybrid.frame_parts",
    "facade_parts": "hybrid.facade_parts",
    "first_passage": "reliability.first_passage",
    "fragility": "reliability.fragility",
    "load_surrogate": "surrogates.registry",
    "open_hybrid": "hybrid.result_file",
    "open_runs": "campaign.store",
    "parameter_study": "reliability.parameter_study",
    "passage_probability": "reliability.passage_probability",
    "passages": "reliability.passages",
    "reduced_by_craig_bampton": "hybrid.reduction",
    "reduced_by_guyan": "hybrid.reduction",
    "sample": "inference.sample",
    "sbc": "inference.assessment.simulation_based_calibration",
    "sensitivity": "reliability.sensitivity",
    "write_report": "report.from_python",
}
"""Public names, and the modules they live in."""

_MODULES = ("optimize",)
"""Public modules."""

__all__ = [*_PUBLIC, *_MODULES, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"structid.{_PUBLIC[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"structid.{name}")
    raise AttributeError(f"module 'structid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
