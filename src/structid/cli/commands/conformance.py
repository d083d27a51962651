"""structid conformance: thirty checks of a specimen server."""

from __future__ import annotations

from typing import Annotated

import typer

from structid.cli.screen import FAILED, screen
from structid.cli.specimen_secret import SecretFile, secret_of


def conformance(
    address: Annotated[str, typer.Argument(help="Host and port of the server, for example 127.0.0.1:7700.")],
    secret_file: SecretFile = None,
) -> None:
    """Check a specimen server. The specimen is commanded to stay in place; afterwards, it holds its position permanently."""
    from structid.hybrid.laboratory.conformance import conformance as checked

    with screen.status("checking"):
        findings = checked(address, secret_of(secret_file))
    for number, finding in enumerate(findings, start=1):
        word, style = ("passed", "green") if finding.passed else ("FAILED", "bold red")
        tail = "" if finding.passed else f": {finding.came}"
        screen.print(f"[{style}]{word}[/] {number:2d} {finding.what}{tail}", soft_wrap=True)
    passed = sum(finding.passed for finding in findings)
    screen.print(f"{passed} of {len(findings)} passed.")
    if passed < len(findings):
        raise typer.Exit(FAILED)
