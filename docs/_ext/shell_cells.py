"""A cell magic for pages that call commands: ``%%sh`` shows what they say, without colours and in one piece."""

from __future__ import annotations

import os
import subprocess
from typing import Any


def sh(line: str, cell: str) -> None:
    """Run the lines of a cell by bash, and show what they print.

    Parameters
    ----------
    line : str
        Of the magic; not used.
    cell : str
        The lines.

    Raises
    ------
    RuntimeError
        If a command fails, so that the page is not built.
    """
    # The kernel asks programs for colours, which a page cannot show.
    environment = {name: value for name, value in os.environ.items() if name not in ("FORCE_COLOR", "CLICOLOR_FORCE")}
    done = subprocess.run(
        ["bash", "-e", "-c", cell], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment
    )
    print(done.stdout.strip("\n"))
    if done.returncode:
        raise RuntimeError(f"exit code {done.returncode}")


def load_ipython_extension(shell: Any) -> None:
    """Register the magic.

    Parameters
    ----------
    shell : InteractiveShell
        The kernel's.
    """
    shell.register_magic_function(sh, "cell")
