"""structid demo: one virtual experiment, two models of the structure, and a comparison of the models."""

from __future__ import annotations

from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.commands.run import worked_on_screen
from structid.cli.screen import NOT_CONVERGED, print_plainly, screen, stage

if TYPE_CHECKING:
    from structid.study.run import StudyOutcome

ACTS = {
    "no_degradation": "The structure degrades during the earthquake. The calibrated model does not degrade.",
    "degradation": "The same measurement is used to calibrate a model that degrades.",
}
"""Studies of the demo, with a description of each."""

_PASSING = partial(stage, passing=True)


def demo(
    out: Annotated[Path, typer.Option(help="Output folder of the demo.")] = Path("demo"),
) -> None:
    """Calibrate a wrong and a right model to one virtual experiment, and compare them (about two minutes)."""
    from structid.study.compare import compare_outcomes

    outcomes = [_act(number, name, out / name) for number, name in enumerate(ACTS, start=1)]
    screen.print("\n[bold]3[/] Which model do the data favour?")
    comparison, page = compare_outcomes([out / name for name in ACTS], outcomes, out, _PASSING)
    assert page is not None
    trusted = all(outcome.trusted for outcome in outcomes)
    print_plainly(f"\n{comparison.verdict}", style="green" if trusted else "bold red")
    print_plainly(f"\nStart with: {page.resolve()}", style="bold")
    for outcome in outcomes:
        print_plainly(f"Report:     {outcome.report.resolve()}")
    screen.print("Your study: structid new my_structure", markup=False)
    if not trusted:
        raise typer.Exit(NOT_CONVERGED)


def _act(number: int, name: str, folder: Path) -> StudyOutcome:
    """Run one of the studies and print a summary of its result."""
    from structid.report.page_summary import page_summary

    screen.print(f"\n[bold]{number}[/] {ACTS[name]}")
    packaged = resources.files("structid") / "study" / "templates" / "demo" / f"{name}.toml"
    with resources.as_file(packaged) as study:
        outcome = worked_on_screen(study, folder, resume=(folder / "identity.json").is_file(), shown=_PASSING)
    assert outcome.material is not None
    print_plainly(f"\n{page_summary(outcome.material)}")
    return outcome
