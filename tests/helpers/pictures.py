"""Rendering is most of the time of a page; tests that do not look at a picture get the smallest one there is in its place."""

import base64
import contextlib
from pathlib import Path

from matplotlib.figure import Figure

PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg==")
STAND_INS = {".png": PIXEL, ".pdf": b"%PDF-1.4\n"}


class Pictures:
    """Decides for each file whether it is rendered; everything up to there is drawn in any case."""

    def __init__(self, patch):
        self._render, self._wanted = Figure.savefig, None
        patch.setattr(Figure, "savefig", lambda figure, path, **settings: self._save(figure, path, **settings))

    @contextlib.contextmanager
    def rendering(self, wanted):
        """Render figures of these names, all of them if there are none, or nothing (``None``)."""
        before, self._wanted = self._wanted, wanted
        try:
            yield
        finally:
            self._wanted = before

    def _save(self, figure, path, **settings):
        if not isinstance(path, (str, Path)):  # a frame of a film, which goes into memory
            self._render(figure, path, **settings)
        elif self._wanted is None or (self._wanted and Path(path).stem not in self._wanted):
            Path(path).write_bytes(STAND_INS[Path(path).suffix])
        else:
            self._render(figure, path, **settings)
