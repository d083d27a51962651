"""Rendering of figures as SVG in a separate process, while the next ones are computed.

Rendering a page's figures takes half as long as computing them, and matplotlib does both on one core.
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
    drawn = svg(figure)  # which settles where the panels are
    return drawn, panels(figure)


class Renderer:
    """A child process that renders figures one after another; used as a context.

    A figure is sent as a pickle. One that cannot be sent, and all of them if the child has died, are rendered here.
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
        """Wait for a picture."""
        try:
            return begun.result()
        except Exception:  # whatever went wrong there is said again here, if it is the figure's own fault
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
            raise RuntimeError("the figure could not be made into a picture")
        return answer


def _serve(figures: IO[bytes], pictures: IO[bytes]) -> None:
    """Answer every figure with its picture until there are no more; None for one that cannot be rendered."""
    while True:
        answer: Any = None
        try:
            figure = pickle.load(figures)
        except EOFError:
            return
        try:
            answer = rendered(figure)
        except Exception:
            answer = None  # it is tried again where somebody can be told
        pickle.dump(answer, pictures)
        pictures.flush()


if __name__ == "__main__":
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr  # nothing else may get between the answers
    _serve(sys.stdin.buffer, answers)
