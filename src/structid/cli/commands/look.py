"""structid look: what data files hold, before any study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import print_plainly, screen
from structid.core.errors import check_choice

if TYPE_CHECKING:
    from structid.data_files.overview import FileOverview

FIGURE_FORMATS = (".png", ".svg", ".pdf")
"""Formats of the figure, by the suffix of its file."""

PLOTTED = 4
"""Number of channels of a file that are drawn in the terminal."""


def look(
    files: Annotated[
        list[Path], typer.Argument(help="Files of measurements: records, loggers, laboratory data.", metavar="FILE…")
    ],
    figure: Annotated[Path | None, typer.Option(help="Draw all channels into this file, PNG, SVG or PDF.")] = None,
    plot: Annotated[bool, typer.Option(help="Draw the channels in the terminal.")] = True,
) -> None:
    """Show format, channels, rates, peaks, offsets, gaps and faults of data files, and the lines for a study."""
    from structid.cli.terminal_plot import terminal_plot
    from structid.data_files.overview import look as look_at
    from structid.data_files.overview import relations
    from structid.study.lines_for_files import cyclic_lines, observation_lines, record_lines

    overviews = [look_at(file) for file in files]
    for overview in overviews:
        print_plainly(str(overview))
        if plot:
            drawn = [
                facts for facts in overview.channels if facts.channel.quantity == overview.channels[0].channel.quantity
            ]
            for facts in drawn[:PLOTTED]:
                title = f"{facts.channel.number} '{facts.channel.name}'"
                print_plainly(f"\n{title}\n{terminal_plot(facts.channel.values, screen.encoding)}")
            if more := len(overview.channels) - min(len(drawn), PLOTTED):
                print_plainly(f"\n… and {more} more channels: draw them with --figure FILE.png.")
        print_plainly("")
    for sentence in relations(overviews):
        print_plainly(sentence)
    print_plainly("\nFor a study file, as the excitation:\n")
    print_plainly("\n\n".join(record_lines(overview) for overview in overviews))
    print_plainly("\nor as a measured response (check the name of the channel):\n")
    print_plainly("\n\n".join(observation_lines(overview) for overview in overviews))
    if tests := [lines for overview in overviews if (lines := cyclic_lines(overview)) is not None]:
        print_plainly("\nor as a cyclic test (structid new NAME --like cyclic --from FILE writes its study):\n")
        print_plainly("\n\n".join(tests))
    if figure is not None:
        _draw(overviews, figure)
        print_plainly(f"\nDrawn: {figure}")


def _draw(overviews: list[FileOverview], figure: Path) -> None:
    """Draw all channels into a file whose suffix names its format."""
    from structid.figures.data_files import draw_files

    check_choice("--figure: suffix", figure.suffix.lower(), FIGURE_FORMATS)
    figure.parent.mkdir(parents=True, exist_ok=True)
    draw_files(overviews).savefig(figure)
