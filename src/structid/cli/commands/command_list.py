"""The commands in order. To add a command, add a file with a function of the same name, and a line here."""

from __future__ import annotations

from collections.abc import Callable

from structid.cli.commands import (
    certify,
    check,
    compare,
    conformance,
    demo,
    doctor,
    hybrid,
    look,
    new,
    report,
    run,
    runs,
    sbc,
    serve,
    specimen,
)

COMMANDS: tuple[Callable[..., None], ...] = (
    demo.demo,
    run.run,
    look.look,
    check.check,
    report.report,
    compare.compare,
    sbc.sbc,
    certify.certify,
    runs.runs,
    serve.serve,
    hybrid.hybrid,
    specimen.specimen,
    conformance.conformance,
    new.new,
    doctor.doctor,
)
"""The name, signature and docstring of a function are the name, options and help text of its command."""
