"""Progress bars for whoever calls structid from a notebook or a script; the command line has its own."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from structid.core.validation import check_arguments


@check_arguments
class ProgressBars:
    """Bars for what takes long, in a notebook or a terminal; to be given as ``progress``, and used as a context.

    Every step that reports itself has a bar of its own, with its rate and the time left::

        with si.ProgressBars() as bars:
            result = si.calibrate(model, space, measured, progress=bars)
    """

    def __init__(self) -> None:
        self._bars: dict[str, Any] = {}

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for bar in self._bars.values():
            bar.close()
        self._bars.clear()

    def __call__(self, *told: Any) -> None:
        """Take what a step reports.

        Parameters
        ----------
        *told : str, int
            Its name, where there are several; the amount done and the total; and how many have failed, of the runs of a campaign.
        """
        name, numbers = (told[0], told[1:]) if isinstance(told[0], str) else ("", told)
        done, total, *failed = numbers
        bar = self._bar(name, total)
        if done < bar.n:  # the step begins anew, in the next round
            bar.reset(total=total)
        bar.total = total
        bar.update(done - bar.n)
        if failed and failed[0]:
            bar.set_postfix_str(f"{failed[0]} failed", refresh=False)
        if done >= total:
            bar.refresh()

    def _bar(self, name: str, total: int) -> Any:
        if name not in self._bars:
            from tqdm.std import tqdm  # text, which notebooks show with and without widgets

            self._bars[name] = tqdm(total=total, desc=name or None, dynamic_ncols=True)
        return self._bars[name]
