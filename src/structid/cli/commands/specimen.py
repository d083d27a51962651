"""structid specimen: serve a simulated specimen from a separate process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import print_plainly, screen
from structid.cli.specimen_secret import SecretFile, secret_of


def specimen(
    study: Annotated[Path, typer.Argument(help="The programme file (TOML), which describes the specimen.")],
    secret_file: SecretFile = None,
    port: Annotated[int, typer.Option(help="Port to listen on; 0 selects a free port.", min=0, max=65535)] = 7700,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 127.0.0.1 accepts connections from this machine only.")
    ] = "127.0.0.1",
    hold: Annotated[
        bool, typer.Option("--hold", help="Hold position after a test; do not unload the specimen for the next test.")
    ] = False,
) -> None:
    """Serve the simulated specimen of a programme to hybrid tests (Ctrl-C stops)."""
    from structid.hybrid.laboratory.server import SpecimenServer
    from structid.study.programmes.run_programme import load_programme

    served = load_programme(study).specimen()
    server = SpecimenServer(
        served,
        secret_of(secret_file),
        host=host,
        port=port,
        releases=not hold,
        log=lambda line: print_plainly(line),
    )
    if host not in ("127.0.0.1", "localhost", "::1"):
        screen.print(
            f"Anyone with the secret can move this specimen from any machine that reaches {host}. Messages are signed, "
            "not encrypted.",
            style="bold red",
            soft_wrap=True,
        )
    print_plainly(f"Serving {served.describe().name} at {server.address} (Ctrl-C stops)")
    try:
        server.serve()
    except KeyboardInterrupt:
        server.stop()
        screen.print("Stopped; the specimen holds its position.")
