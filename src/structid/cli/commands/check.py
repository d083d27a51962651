"""structid check: all problems in a study file, and the expected cost of the study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.commands.hybrid import print_checks
from structid.cli.screen import WRONG_INPUT, print_plainly, screen

if TYPE_CHECKING:
    from structid.study.building.built_study import BuiltStudy


def check(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    plot: Annotated[
        Path | None, typer.Option(help="Folder for figures of each measurement, the model response and the record.")
    ] = None,
) -> None:
    """List all problems in a study file, and estimate the cost of the study from a few model runs."""
    from structid.study.cost import estimate
    from structid.study.cyclic_tests.cyclic_test_file import is_cyclic_test
    from structid.study.echo import quantities_in_si
    from structid.study.plausibility import plausibility
    from structid.study.programmes.programme_file import is_programme
    from structid.study.programmes.run_programme import check_programme
    from structid.study.run import load
    from structid.study.schema.study_file import study_content

    content = study_content(study)
    if is_programme(content):
        print_checks(check_programme(study), quantities_in_si(study))
        return
    if is_cyclic_test(content):
        _check_cyclic_test(study)
        return
    built = load(study)
    _describe(built)
    for line in quantities_in_si(study):
        print_plainly(line)
    with screen.status("running the model a few times"):
        sizes = plausibility(built, print_plainly)
        cost = estimate(built, print_plainly)
    print_plainly(cost.conclusion)
    if plot is not None:
        for figure in sizes.plot(plot):
            print_plainly(f"Figure: {figure}")
    _conclude(study, (*sizes.questions, *(() if built.motion_test is None else built.motion_test.questions)))


def _conclude(study: Path, questions: Sequence[str]) -> None:
    """Print the doubts about a study, and exit with `WRONG_INPUT` if there are any."""
    if not questions:
        screen.print(f"[bold green]{study} is in order.[/]")
        return
    for question in questions:
        print_plainly(f"? {question}", style="bold red")
    raise typer.Exit(WRONG_INPUT)


def _check_cyclic_test(study: Path) -> None:
    """Print the scales of a cyclic test and the doubts about it."""
    from structid.study.cyclic_tests.planned_cyclic_test import load_cyclic_test
    from structid.study.echo import quantities_in_si

    planned = load_cyclic_test(study)
    print_plainly(str(planned.test))
    print_plainly(f"Laws to choose among: {', '.join(planned.laws)}")
    for line in quantities_in_si(study):
        print_plainly(line)
    _conclude(study, planned.test.questions)


def _describe(built: BuiltStudy) -> None:
    for what in (str(built.record), str(built.model), repr(built.space)):
        print_plainly(what)
    if built.motion_test is not None:
        print_plainly(f"{built.motion_test}")
        print_plainly(
            "The data choose the hysteretic law when the study runs. Until then, the law above stands in for it."
        )
