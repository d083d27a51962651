"""Rendering is most of the time of a page; tests that do not look at a picture get the smallest one there is in its place."""

import base64
import contextlib
from concurrent.futures import Future
from pathlib import Path

from matplotlib.figure import Figure

from structid.report.drawing import rendering

PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg==")
STAND_INS = {".png": PIXEL, ".pdf": b"%PDF-1.4\n"}
DRAWING = '<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'


class Pictures:
    """Decides for each file whether it is rendered; everything up to there is drawn in any case.

    Figures of a page have no file while they are drawn: where any is wanted, all of a page are rendered.
    """

    def __init__(self, patch):
        self._render, self._wanted = Figure.savefig, None
        patch.setattr(Figure, "savefig", lambda figure, path, **settings: self._save(figure, path, **settings))
        self._begin = rendering.Renderer.begin
        patch.setattr(rendering.Renderer, "begin", lambda renderer, figure: self._begun(renderer, figure))

    @contextlib.contextmanager
    def rendering(self, wanted):
        """Render figures of these names, all of them if there are none, or nothing (``None``)."""
        before, self._wanted = self._wanted, wanted
        try:
            yield
        finally:
            self._wanted = before

    def _save(self, figure, path, **settings):
        if not isinstance(path, (str, Path)):  # a frame of a film, or a figure of a page, which go into memory
            self._render(figure, path, **settings)
        elif self._wanted is None or (self._wanted and Path(path).stem not in self._wanted):
            Path(path).write_bytes(STAND_INS[Path(path).suffix])
        else:
            self._render(figure, path, **settings)

    def _begun(self, renderer, figure):
        if self._wanted is not None:
            return self._begin(renderer, figure)
        done = Future()
        done.set_result((DRAWING, []))
        return done
