"""The shared secret of a specimen server and its clients: from a file or the environment, never from the command line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from structid.core.errors import InputError

VARIABLE = "STRUCTID_SPECIMEN_SECRET"
"""Environment variable with the secret."""

SecretFile = Annotated[
    Path | None,
    typer.Option(help=f"File with the shared secret, 16 characters or more; or set {VARIABLE}."),
]


def secret_of(path: Path | None) -> str:
    """Read the secret from the file, or from the environment."""
    if path is not None:
        if not path.is_file():
            cure = f'Create the file: python -c "import secrets; print(secrets.token_hex(32))" > {path}'
            raise InputError("--secret-file", f"{path} does not exist", "a file with the secret", cure)
        return path.read_text(encoding="utf-8").strip()
    if secret := os.environ.get(VARIABLE, ""):
        return secret.strip()
    raise InputError(
        "--secret-file", "no secret given", f"a file with the secret, or the environment variable {VARIABLE}"
    )
