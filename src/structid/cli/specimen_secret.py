"""The shared secret of a specimen's server and its clients: from a file or the environment, never on the command line."""

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
    typer.Option(help=f"A file with the secret that both sides share, 16 characters or more; or set {VARIABLE}."),
]


def secret_of(path: Path | None) -> str:
    """Read the secret."""
    if path is not None:
        if not path.is_file():
            cure = f'Make one: python -c "import secrets; print(secrets.token_hex(32))" > {path}'
            raise InputError("--secret-file", f"{path}, which does not exist", "a file with a secret", cure)
        return path.read_text(encoding="utf-8").strip()
    if secret := os.environ.get(VARIABLE, ""):
        return secret.strip()
    raise InputError("--secret-file", "nothing", f"a file with a secret, or {VARIABLE} in the environment")
