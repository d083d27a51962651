"""Certification of external draws of a study's posterior, by runs of the study's model."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from structid.campaign.executors import kept_open
from structid.certification.certificate import Certificate
from structid.certification.external.certify import certify
from structid.core.errors import InputError
from structid.core.journal import write_then_rename
from structid.report.material.certificate_material import CertificateMaterial
from structid.report.page import write_certificate_report
from structid.study.folder_layout import TIMINGS
from structid.study.run import load_of_one_law
from structid.study.schema.study_file import study_text
from structid.study.timings import Stage, StepProgress, Timings, silent

CERTIFICATE = "certificate.json"
"""File with all numbers of the certificate."""


def certify_draws(
    path: str | Path,
    draws: str | Path,
    out: str | Path,
    true_runs: int | None = None,
    look: int = 1,
    stage: Stage = silent,
    executor: Any = None,
) -> tuple[Certificate, Path]:
    """Certify draws in a file as draws from the posterior of a study."""
    began = time.perf_counter()
    study, folder = load_of_one_law(path), Path(out)
    if study.posterior is None:
        raise InputError("structid certify", f"a study without [observation]: {path}", "a study with a measurement")
    folder.mkdir(parents=True, exist_ok=True)
    posterior = study.posterior
    with kept_open(study.model, executor) as workers, StepProgress(stage, Timings(folder / TIMINGS)) as report:
        certificate = certify(
            posterior,
            draws,
            true_runs=true_runs,
            look=look,
            seed=study.file.seed,
            store=folder,
            executor=workers,
            progress=report,
        )
    write_then_rename(folder / CERTIFICATE, json.dumps(certificate.to_plain(), indent=2).encode())
    material = CertificateMaterial(
        f"Certificate of a posterior: {study.file.title or study.file.name}",
        study_text(Path(path)),
        Path(draws).name,
        certificate,
        posterior.names,
        tuple(posterior.units.values()),
        posterior.factors,
    )
    return certificate, write_certificate_report(material, folder, {"total": time.perf_counter() - began})
