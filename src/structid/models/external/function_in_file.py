"""A user's function, imported by every process from the file in which it is defined."""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
from pathlib import Path
from typing import Any

from structid.core.errors import InputError
from structid.core.hashing import digest


class FunctionInFile:
    """A function that another process imports from its file instead of receiving it by pickle."""

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self.__wrapped__ = getattr(imported(path), name)
        self.__name__ = name

    def __reduce__(self) -> Any:
        return (FunctionInFile, (self.path, self.name))

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function."""
        return self.__wrapped__(*arguments, **keywords)

    @property
    def identity(self) -> str:
        """Hash of the code of the file and of the files it imports from its folder, without comments and layout."""
        folder = self.path.parent
        files = {self.path}
        for module in list(sys.modules.values()):
            file = getattr(module, "__file__", None)
            if file and file.endswith(".py") and Path(file).is_relative_to(folder) and "site-packages" not in file:
                files.add(Path(file))
        texts = {str(f.relative_to(folder)): ast.dump(ast.parse(f.read_text(encoding="utf-8"))) for f in sorted(files)}
        return digest(self.name, texts)


@functools.cache
def imported(path: Path) -> Any:
    """Import a file as a module; the file may import other files in its folder."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    specification = importlib.util.spec_from_file_location(f"structid_study_{path.stem}", path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    try:
        specification.loader.exec_module(module)
    except Exception as problem:
        raise InputError(
            "key 'model.source'",
            f"{path.name} cannot be imported: {type(problem).__name__}: {problem}",
            "a Python file that can be imported",
        ) from problem
    return module
