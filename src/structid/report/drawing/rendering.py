"""Rendering of figures as SVG in a separate process, while the next figures are computed.

Rendering takes half as long as computing the figures, and in one process, matplotlib uses only one core.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any

from structid.report.drawing.vector import Panel, panels, svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rendered = tuple[str, list[Panel]]
"""A figure as SVG, and the panels from which values can be read."""


def rendered(figure: Figure) -> Rendered:
    """Render a figure."""
    drawn = svg(figure)  # this also fixes the positions of the panels
    return drawn, panels(figure)


class Renderer:
    """A child process that renders figures one after another; a context manager.

    A figure is sent as a pickle. The parent process renders a figure that cannot be pickled, and all figures if the
    child has died.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="renderer")
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(cancel_futures=True)
        if self._child is not None:
            self._child.kill()
            self._child.communicate()

    def begin(self, figure: Figure) -> Future[Rendered]:
        """Start rendering a figure."""
        try:
            content = pickle.dumps(figure)
        except (pickle.PicklingError, AttributeError, TypeError) as problem:
            failed: Future[Rendered] = Future()
            failed.set_exception(problem)
            return failed
        return self._thread.submit(self._by_the_child, content)

    def end(self, figure: Figure, begun: Future[Rendered]) -> Rendered:
        """Wait for a rendered figure."""
        try:
            return begun.result()
        except Exception:  # an error that the figure itself causes is raised again here
            return rendered(figure)

    def _by_the_child(self, content: bytes) -> Rendered:
        if self._child is None:
            command = [sys.executable, "-m", __name__]
            self._child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._child.stdin is not None and self._child.stdout is not None
        self._child.stdin.write(content)
        self._child.stdin.flush()
        answer: Rendered | None = pickle.load(self._child.stdout)
        if answer is None:
            raise RuntimeError("the figure could not be rendered")
        return answer


def _serve(figures: IO[bytes], pictures: IO[bytes]) -> None:
    """Render each received figure, and send the result back; None for a figure that cannot be rendered."""
    while True:
        answer: Any = None
        try:
            figure = pickle.load(figures)
        except EOFError:
            return
        try:
            answer = rendered(figure)
        except Exception:
            answer = None  # the parent process tries again, and can report the error
        pickle.dump(answer, pictures)
        pictures.flush()


if __name__ == "__main__":
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr  # no other output may mix with the answers
    _serve(sys.stdin.buffer, answers)
