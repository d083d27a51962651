"""A live page of running hybrid tests, served by a separate process that reads their recordings."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from structid.core.errors import InputError
from structid.hybrid.programme import store_of, tests_in
from structid.hybrid.recording.live_points import LivePoints
from structid.hybrid.recording.recorder import JOURNAL
from structid.report.page import PAGE, template

LOOPBACK = "127.0.0.1"
NICENESS = 10
"""Nice value of the page's process, so that the test has priority."""


class LiveFolder:
    """The tests in the folder of a programme."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._points: dict[str, LivePoints] = {}

    def state(self, test: str, moves: int, steps: int) -> dict[str, Any]:
        """Return the current state of the tests."""
        ended, running = tests_in(self.folder), tests_in(self.folder, JOURNAL)
        report = (self.folder / PAGE).exists()
        if not running:
            return {"ended": ended, "running": None, "report": report}
        name = running[-1]
        if name not in self._points:
            self._points = {name: LivePoints(store_of(self.folder, name))}
        points = self._points[name]
        with contextlib.suppress(FileNotFoundError):
            points.read()
        new = points.since(*((moves, steps) if test == name else (0, 0)))
        return {"ended": ended, "running": name, "report": report, **new}


def application(folder: Path) -> Any:
    """Build the web application."""
    try:
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import HTMLResponse, JSONResponse
        from starlette.routing import Route
    except ImportError:
        raise InputError(
            "the live view", "Starlette is not installed", "the extra 'live'", 'Run: pip install "structid[live]"'
        ) from None
    tests = LiveFolder(folder)
    page = template("live.html").render(title=folder.name)

    async def shown(request: Any) -> Any:
        return HTMLResponse(page)

    async def state(request: Any) -> Any:
        query = request.query_params
        counts = [int(query[key]) if query.get(key, "").isdigit() else 0 for key in ("moves", "steps")]
        return JSONResponse(tests.state(query.get("test", ""), *counts))

    return Starlette(
        routes=[Route("/", shown), Route("/state", state)],
        # Protection against DNS rebinding: a foreign page must not read this page through its own host name.
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[LOOPBACK, "localhost"])],
    )


def serve(folder: Path, port: int) -> None:
    """Serve the page until killed."""
    app = application(folder)
    import uvicorn

    os.nice(NICENESS)
    uvicorn.run(app, host=LOOPBACK, port=port, log_level="warning")


@contextlib.contextmanager
def live(folder: Path, port: int) -> Iterator[str]:
    """Serve the page from a separate process inside a ``with`` block."""
    application(folder)
    child = subprocess.Popen([sys.executable, "-m", __name__, str(folder), str(port)])
    try:
        yield f"http://{LOOPBACK}:{port}"
    finally:
        child.terminate()
        child.wait()


if __name__ == "__main__":
    serve(Path(sys.argv[1]), int(sys.argv[2]))
