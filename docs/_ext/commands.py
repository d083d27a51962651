"""A reference page of the command line, written from the commands themselves when the site is built."""

from __future__ import annotations

from pathlib import Path

from page_file import write_page_file
from sphinx.application import Sphinx
from typer.testing import CliRunner

from structid.cli.commands.command_list import COMMANDS
from structid.cli.main import application

PAGE = "reference/names/command_line.md"

HEAD = """# Command line

Every command answers `--help`. Exit codes: 0 done, 1 failed, 2 the input is wrong, 3 done but not converged, or not certified.

"""


def write_page(app: Sphinx) -> None:
    """Write the page.

    Parameters
    ----------
    app : Sphinx
        The application.
    """
    runner = CliRunner(env={"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"})
    program = application()
    parts = [HEAD]
    for command in COMMANDS:
        name = command.__name__
        said = runner.invoke(program, [name, "--help"]).output
        text = "\n".join(line.rstrip() for line in said.strip("\n").splitlines())
        parts.append(f"## structid {name}\n\n```text\n{text}\n```\n\n")
    write_page_file(Path(app.srcdir) / PAGE, "".join(parts))
