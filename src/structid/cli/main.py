"""The command line: `structid COMMAND`, and the handling of errors."""

from __future__ import annotations

import importlib.metadata
import signal
import sys
from typing import Annotated, Any

import typer

from structid.cli.commands import command_list
from structid.cli.screen import DONE, FAILED, WRONG_INPUT, errors, screen
from structid.core.errors import InputError, StructidError


def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version.", is_eager=True)] = False,
) -> None:
    """Bayesian structural identification: from a measured response history to a posterior one can trust."""
    if version:
        screen.print(importlib.metadata.version("structid"))
        raise typer.Exit(DONE)


def application() -> typer.Typer:
    """Build the application from the registered commands."""
    app = typer.Typer(
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        help="Bayesian structural identification: from a measured response history to a posterior one can trust.",
    )
    app.callback(invoke_without_command=True)(about)
    for command in command_list.COMMANDS:
        app.command()(command)
    return app


def _stopped_by_the_system(number: int, frame: Any) -> None:
    """Treat the termination signal of a batch system like Ctrl-C."""
    raise KeyboardInterrupt


def main() -> None:
    """Run the command line; a user's mistake prints one paragraph and gives exit code 2."""
    signal.signal(signal.SIGTERM, _stopped_by_the_system)
    try:
        # Outside its standalone mode, typer returns the exit code and passes errors on.
        sys.exit(application()(standalone_mode=False) or DONE)
    except InputError as mistake:
        errors.print(str(mistake), style="red", markup=False, soft_wrap=True)
        sys.exit(WRONG_INPUT)
    except StructidError as failure:
        errors.print(str(failure), style="red", markup=False, soft_wrap=True)
        sys.exit(FAILED)
    except OSError as failure:
        errors.print(f"{failure.filename or 'a file'}: {failure.strerror or failure}.", style="red", markup=False)
        sys.exit(FAILED)
    except Exception as problem:
        if hasattr(problem, "show") and hasattr(problem, "exit_code"):  # an error in the command line itself
            problem.show()
            sys.exit(WRONG_INPUT)
        raise
