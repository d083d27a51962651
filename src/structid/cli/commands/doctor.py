"""structid doctor: capabilities of this machine and of this installation."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from structid.cli.screen import print_plainly
from structid.core.cores import available_cores, cache_folder, cores_to_use

OPTIONAL = {
    "distributed": ("dask", "runs on a Dask cluster"),
    "umbridge": ("umbridge", "models on a UM-Bridge server"),
    "openseespy": ("opensees", "OpenSees models"),
    "uvicorn": ("live", "the live view of a hybrid test"),
}
"""Optional packages: the extra that installs the package, and the feature that it adds."""

LETTERS = "αβγδζηνψλσ²³⁻ⁿ√±−"
"""Special characters in figures and tables."""


def doctor() -> None:
    """Show the versions, cores, engine, caches, font and optional packages of this installation."""
    lines = {
        "structid": f"{version('structid')}, Python {platform.python_version()}",
        "cores": f"{cores_to_use()} of {available_cores()} used (set another number with JAX_NUM_CPU_DEVICES)",
        "engine": _engine(),
        "derivatives": _jax(),
        "caches": ", ".join(_cache(name) for name in ("lanes", "jax")),
        "font": _font(),
        **{package: f"{_installed(package, extra)} ({adds})" for package, (extra, adds) in OPTIONAL.items()},
    }
    for name, result in lines.items():
        print_plainly(f"{name:<12} {result}")


def _engine() -> str:
    from structid.engine.lanes.machine import lanes, processor, why_not

    if why_not():
        return f"JAX runs the time integration, several times slower than compiled vector code: {why_not()}"
    return f"vector code compiled by LLVM for {processor()}, {lanes()} runs computed at once"


def _jax() -> str:
    from structid.engine.device import mesh

    devices = mesh().devices
    return f"JAX {version('jax')} on {devices.size} {devices[0].device_kind} device{'s' * (devices.size > 1)}"


def _cache(name: str) -> str:
    folder = cache_folder(name)
    there = next(f for f in (folder, *folder.parents) if f.exists())
    note = (
        ""
        if there.is_dir() and os.access(there, os.W_OK)
        else " is not writable: every process compiles everything again"
    )
    return f"{_short(folder)}{note}"


def _short(folder: Path) -> str:
    return str(folder).replace(str(Path.home()), "~", 1)


def _font() -> str:
    """The font of figures, and the special characters that the font lacks."""
    from matplotlib import font_manager

    path = font_manager.findfont(font_manager.FontProperties(family=["sans-serif"]))
    characters = font_manager.get_font(path).get_charmap()
    lacking = "".join(letter for letter in LETTERS if ord(letter) not in characters)
    return Path(path).stem + (f", which lacks {lacking}" if lacking else "")


def _installed(package: str, extra: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return f"not installed: pip install 'structid[{extra}]'"
