"""The command line as a user calls it, in this process: what it prints, and its exit code, without the seconds of a new start."""

import contextlib
import io
import signal
import sys
from dataclasses import dataclass

from structid.cli import screen
from structid.cli.main import main as cli


@dataclass(frozen=True)
class Called:
    """What a command has said."""

    returncode: int
    stdout: str
    stderr: str


def structid(*arguments, cwd):
    """Call ``structid ARGUMENT…`` in a folder, on a terminal 200 characters wide."""
    said, complained, before = io.StringIO(), io.StringIO(), (sys.argv, screen.screen.width, screen.errors.width)
    on_kill = signal.getsignal(signal.SIGTERM)
    sys.argv = ["structid", *map(str, arguments)]
    screen.screen.width = screen.errors.width = 200
    code = 0
    try:
        with contextlib.chdir(cwd), contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            cli()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    finally:
        sys.argv, screen.screen.width, screen.errors.width = before
        signal.signal(signal.SIGTERM, on_kill)
    return Called(code, said.getvalue(), complained.getvalue())
