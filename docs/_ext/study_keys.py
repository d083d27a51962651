"""The reference of study files: the schema says what every key may be, and annotated examples say what it means.

Each file of ``reference/keys`` is one table of a study, of a cyclic test, or of a programme of hybrid tests. A first comment says
what the table is for, and every key has a line with a value and a sentence. A key of the schema that has no such line, and a line
that the schema does not know, stop the building.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import pydantic
from page_file import write_page_file
from pydantic_core import PydanticUndefined

from structid.core.keys import FileTable
from structid.study.cyclic_tests.cyclic_test_file import CyclicTestFile
from structid.study.programmes.programme_file import programme_file
from structid.study.schema.problems import _tables
from structid.study.study_reader import study_file

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOMS: dict[str, Callable[[], type[FileTable]]] = {
    "study": study_file,
    "cyclic_test": lambda: CyclicTestFile,
    "programme": programme_file,
}
"""Folders of examples, and the schema of each."""

TITLES = {"study": "A study", "cyclic_test": "A cyclic test", "programme": "A programme of hybrid tests"}

PAGE = "reference/names/study_keys.md"

_LINE = re.compile(r"^([a-z_0-9]+) = (.*?)\s+# (.+)$")
_HEAD = re.compile(r"^\[+([a-z_.]+)\]+$")


@dataclass(frozen=True)
class Example:
    """A table with an example of each of its keys.

    Parameters
    ----------
    name : str
        Of its file, without number and ending.
    about : str
        What the table is for.
    head : str
        Its head in a study file, such as ``record.synthetic``; empty for the study itself.
    text : str
        The example.
    said : dict of str to str
        A sentence for every key.
    values : dict
        What the example says.
    """

    name: str
    about: str
    head: str
    text: str
    said: dict[str, str]
    values: dict[str, Any]


def examples(folder: Path) -> list[Example]:
    """Read the examples of a folder.

    Parameters
    ----------
    folder : Path
        With a file for each table.

    Returns
    -------
    list of Example
        In the order of their numbers.
    """
    return [_read(path) for path in sorted(folder.glob("*.toml"))]


def _read(path: Path) -> Example:
    first, *lines = path.read_text(encoding="utf-8").splitlines()
    found = [_LINE.match(line) for line in lines]
    heads = [_HEAD.match(line) for line in lines]
    head = next((match[1] for match in heads if match), "")
    values: Any = tomllib.loads("\n".join(lines))
    for part in head.split(".") if head else ():
        values = values[part]
        values = values[0] if isinstance(values, list) else values
    said = {match[1]: match[2 + 1] for match in found if match}
    return Example(path.stem.split("_", 1)[1], first.removeprefix("# "), head, "\n".join(lines), said, values)


def tables(file: type[FileTable]) -> dict[tuple[str, str], type[FileTable]]:
    """Every table of a kind of file, by its head and, where it has several forms, its ``type``.

    Parameters
    ----------
    file : type
        The schema.

    Returns
    -------
    dict of tuple to type
        Tables that stand at several places are there at the first.
    """
    found: dict[tuple[str, str], type[FileTable]] = {("", ""): file}
    for head, form, section in _below(file, ""):
        found.setdefault((head, form), section)
    return found


def _below(section: type[FileTable], head: str) -> Iterator[tuple[str, str, type[FileTable]]]:
    for name, field in section.model_fields.items():
        for table in _tables(field.annotation):
            form = _form(table)
            place = f"{head}.{name}" if head else name
            yield place, form, table
            yield from _below(table, place)


def _form(table: type[FileTable]) -> str:
    tag = table.model_fields.get("type")
    options = get_args(tag.annotation) if tag is not None else ()
    return str(options[0]) if len(options) == 1 else ""


def problems(keys: Path) -> list[str]:
    """Say which keys lack a sentence, and which examples the schema does not take.

    Parameters
    ----------
    keys : Path
        The folder of examples.

    Returns
    -------
    list of str
        One sentence each; empty if all is well.
    """
    found: list[str] = []
    said: dict[str, set[str]] = {}
    for room, file in ROOMS.items():
        schema = tables(file())
        for example in examples(keys / room):
            section = _section(schema, example)
            if section is None:
                found.append(f"{example.name}: the schema has no table [{example.head}]")
                continue
            said.setdefault(section.__name__, set()).update(example.said)
            found += [
                wrong for key, value in example.values.items() for wrong in _judged(example.name, section, key, value)
            ]
            found += [
                f"{example.name}: {key} has no sentence" for key in sorted(set(example.values) - set(example.said))
            ]
        # A programme has tables of a study: what is said of them there is not said again.
        of_a_file = set().union(*(said.get(each().__name__, set()) for each in ROOMS.values()))
        for name, section in {section.__name__: section for section in schema.values()}.items():
            known = said.get(name, set()) | (of_a_file if section is schema["", ""] else set())
            wanted = {key for key, field in section.model_fields.items() if not _tables(field.annotation)}
            found += [f"{name}: {key} has no example" for key in sorted(wanted - known)]
    return found


def _section(schema: dict[tuple[str, str], type[FileTable]], example: Example) -> type[FileTable] | None:
    form = str(example.values.get("type", ""))
    head = "parameters" if example.head.startswith("parameters.") else example.head
    return schema.get((head, form), schema.get((head, "")))


def _judged(name: str, section: type[FileTable], key: str, value: Any) -> list[str]:
    field = section.model_fields.get(key)
    if field is None:
        return [f"{name}: the schema does not know {key}"]
    try:
        # With something beside the type, for a field without constraints has none.
        pydantic.TypeAdapter(Annotated[field.annotation, *field.metadata, "as in the schema"]).validate_python(value)
    except pydantic.ValidationError as mistake:
        return [f"{name}: {key} = {value!r} is refused: {mistake.errors()[0]['msg']}"]
    return []


def write_page(app: Sphinx) -> None:
    """Write the page.

    Parameters
    ----------
    app : Sphinx
        The application.

    Raises
    ------
    ValueError
        If a key lacks its sentence or example.
    """
    folder = Path(app.srcdir) / "reference" / "keys"
    wrong = problems(folder)
    if wrong:
        raise ValueError("reference/keys: " + "; ".join(wrong))
    write_page_file(Path(app.srcdir) / PAGE, "".join(_parts(folder)))


def _parts(folder: Path) -> Iterator[str]:
    yield "# Keys of a study file\n\n"
    yield (
        "Every table with an example of each of its keys. No study has all of them: some stand in another's place. A number "
        "without a unit is in SI (a prior's number is in the prior's `unit`); a text carries its own unit.\n\n"
    )
    for room, file in ROOMS.items():
        schema = tables(file())
        yield f"## {TITLES[room]}\n\n"
        for example in examples(folder / room):
            section = _section(schema, example)
            assert section is not None
            form = example.values.get("type", "")
            head = f"`[{example.head}]`" if example.head else "Beside the tables"
            yield f"### {head}{f' {form}' if form and example.head in ('model', 'structure') else ''}\n\n{example.about}.\n\n"
            yield f":::{{container}} keys\n```toml\n{example.text}\n```\n:::\n\n"
            yield f"{_defaults(section, example)}\n\n"


def _defaults(section: type[FileTable], example: Example) -> str:
    """Which keys of a table must be there, and the defaults of the others, in a line."""
    needed, left_out = [], []
    for key in example.said:
        field = section.model_fields[key]
        if field.is_required():
            needed.append(f"`{key}`")
        elif field.default not in (None, PydanticUndefined, (), ""):
            left_out.append(f"`{key}` {_in_words(field.default)}")
    said = [f"Must be there: {', '.join(needed)}."] if needed else []
    return " ".join([*said, *([f"Defaults: {', '.join(left_out)}."] if left_out else [])]) or "All may be left out."


def _in_words(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return ", ".join(map(_in_words, value))
    return f"{value:g}" if isinstance(value, float) else "as a table" if isinstance(value, FileTable) else str(value)
