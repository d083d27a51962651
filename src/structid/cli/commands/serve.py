"""structid serve: serve the model and the posterior of a study over UM-Bridge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import screen


def serve(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    port: Annotated[int, typer.Option(help="Port to listen on.", min=1, max=65535)] = 4242,
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; 0.0.0.0 accepts connections from every network, without a password."),
    ] = "127.0.0.1",
) -> None:
    """Serve the model and the posterior of a study over UM-Bridge (HTTP)."""
    from structid.models.external.um_bridge import check_address, is_this_machine
    from structid.models.external.um_bridge import serve as serve_models
    from structid.study.run import load_of_one_law
    from structid.study.serve import offered

    check_address(host, port)
    models = offered(load_of_one_law(study))
    if not is_this_machine(host):
        screen.print(
            f"There is no password: anyone who reaches {host}:{port} can run the model. Use --host 127.0.0.1 to prevent this.",
            style="bold red",
        )
    screen.print(f"Serving {', '.join(m.name for m in models)} at http://{host}:{port} (Ctrl-C stops)")
    serve_models(models, port, host)
