"""Bayesian structural identification: from a measured response history to a posterior one can trust.

The names below are public. Each name is imported at its first use, so that the command line starts quickly. Editors and type
checkers read the names from ``__init__.pyi``.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.3.0"

_PUBLIC = {
    "AIES": "inference.sampling.aies",
    "AR1": "inference.error_models.kernels",
    "Actuator": "hybrid.control.transfer_system",
    "AdaptiveTimeSeries": "hybrid.control.compensation",
    "Beta": "probability.marginals",
    "BoucWen": "models.hysteretic.bouc_wen",
    "CallableModel": "models.external.callable",
    "Campaign": "campaign.runner",
    "Certificate": "certification.certificate",
    "Limits": "certification.limits",
    "CombinedExcitation": "ground_motion.excitation",
    "Contaminated": "inference.error_models.outliers",
    "CorrectedNARX": "surrogates.narx.corrected_narx",
    "CyclicTest": "law_choice.cyclic_test",
    "DampedCosine": "inference.error_models.kernels",
    "DelayedAcceptance": "inference.sampling.delayed_acceptance",
    "Design": "probability.designs",
    "DisplacementField": "models.masonry.displacement_field",
    "DisplacementHistory": "ground_motion.excitation",
    "Drifting": "inference.error_models.drifting",
    "FloorMasses": "hybrid.substructures.facade_parts",
    "ForceHistory": "ground_motion.excitation",
    "Frozen": "probability.marginals",
    "Gamma": "probability.marginals",
    "GravouilCombescure": "hybrid.coupling.gravouil_combescure",
    "GroundMotion": "ground_motion.record",
    "Gumbel": "probability.marginals",
    "Histories": "histories",
    "Hysteretic": "models.hysteretic.hysteretic",
    "HystereticFrame": "models.hysteretic.hysteretic_frame",
    "HybridResult": "hybrid.hybrid_result",
    "HybridTest": "hybrid.experiment",
    "IID": "inference.error_models.independent",
    "ImposedDisplacements": "models.hysteretic.imposed_displacements",
    "InputError": "core.errors",
    "Kriging": "surrogates.kriging.universal_kriging",
    "KrigingNARX": "surrogates.narx.kriging_narx",
    "LogDensity": "inference.target",
    "LogNormal": "probability.marginals",
    "LoopLines": "models.hysteretic.loop_lines",
    "Masonry": "models.masonry.finite_elements.assembly",
    "MasonryWall": "models.masonry.masonry_wall",
    "Matern32": "inference.error_models.kernels",
    "Memory": "surrogates.narx.structure.terms",
    "MotionTest": "law_choice.motion_test",
    "NARX": "surrogates.narx.narx",
    "NUTS": "inference.sampling.nuts",
    "Normal": "probability.marginals",
    "Observation": "observation",
    "OpenFrescoSpecimen": "hybrid.laboratory.openfresco",
    "Opening": "models.masonry.finite_elements.layout",
    "OutputFile": "models.external.program",
    "PCE": "surrogates.chaos.pce",
    "PCNARX": "surrogates.narx.pc_narx",
    "PODKriging": "surrogates.pod.pod_kriging",
    "PODPCE": "surrogates.pod.pod_pce",
    "ParameterSpace": "probability.space",
    "Passages": "reliability.passages",
    "Plan": "calibration.plan",
    "PolynomialExtrapolation": "hybrid.control.compensation",
    "Posterior": "inference.likelihood.posterior",
    "PrakashHjelmstad": "hybrid.coupling.prakash_hjelmstad",
    "ProgramModel": "models.external.program",
    "Programme": "hybrid.programme",
    "ProgrammeResult": "hybrid.programme",
    "ProgressBars": "core.progress_bars",
    "Proportional": "inference.error_models.proportional",
    "Quantised": "inference.error_models.quantised",
    "RemoteSpecimen": "hybrid.laboratory.remote",
    "RotationHistory": "ground_motion.excitation",
    "Runs": "campaign.runs",
    "SMC": "inference.sampling.smc.smc",
    "SamplingResult": "inference.sampling_result",
    "Sensor": "hybrid.control.transfer_system",
    "ShearFrame": "models.hysteretic.shear_frame",
    "SimulatedSpecimen": "hybrid.laboratory.simulated_specimen",
    "SolverError": "models.external.protocol",
    "Specimen": "hybrid.laboratory.specimen",
    "SpecimenError": "hybrid.laboratory.specimen",
    "SpecimenServer": "hybrid.laboratory.server",
    "Status": "core.errors",
    "StructidError": "core.errors",
    "StructidWarning": "core.errors",
    "StructureFailedError": "models.external.protocol",
    "Student": "inference.error_models.outliers",
    "Substructure": "hybrid.substructures.substructure",
    "Term": "surrogates.narx.structure.terms",
    "UMBridgeModel": "models.external.um_bridge",
    "Uniform": "probability.marginals",
    "UnscentedFilter": "hybrid.online.unscented_filter",
    "UpdatedSprings": "hybrid.online.updated_springs",
    "VirtualHybridTest": "hybrid.virtual_experiment",
    "Wall": "models.masonry.finite_elements.layout",
    "Weibull": "probability.marginals",
    "calibrate": "calibration.sequential",
    "certify": "certification.external.certify",
    "choose_error_model": "inference.error_model_choice",
    "choose_model": "law_choice.choose_model",
    "conformance": "hybrid.laboratory.conformance",
    "cut_frame": "hybrid.substructures.frame_parts",
    "facade_parts": "hybrid.substructures.facade_parts",
    "first_passage": "reliability.first_passage",
    "fragility": "reliability.fragility",
    "load_surrogate": "surrogates.surrogate_list",
    "look": "data_files.overview",
    "open_hybrid": "hybrid.recording.result_file",
    "open_runs": "campaign.store",
    "parameter_study": "reliability.parameter_study",
    "passage_probability": "reliability.passage_probability",
    "passages": "reliability.passages",
    "reduced_by_craig_bampton": "hybrid.substructures.reduction",
    "reduced_by_guyan": "hybrid.substructures.reduction",
    "sample": "inference.sample",
    "sbc": "inference.validation.simulation_based_calibration",
    "sbc_of_calibration": "calibration.simulated_calibrations",
    "sensitivity": "reliability.sensitivity",
    "write_report": "report.from_python",
}
"""Public names and their modules."""

_RENAMED = {"choose_law": "choose_error_model"}
"""Deprecated public names and their replacements, kept for one version."""

_MODULES = ("optimize",)
"""Public modules."""

__all__ = [*_PUBLIC, *_MODULES, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        importlib.import_module("structid.core.renamed").warn_of(f"structid.{name}", f"structid.{_RENAMED[name]}")
        name = _RENAMED[name]
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"structid.{_PUBLIC[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"structid.{name}")
    raise AttributeError(f"module 'structid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
