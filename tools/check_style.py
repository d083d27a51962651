#!/usr/bin/env python3
"""Check the repository's text: names of files, what a room may name, docstrings, citations, pages, where tests lie.

`make lint` runs it beside ruff, mypy and import-linter. Each rule is a generator of complaints; `RULES` lists them. No test of
behaviour is here: what a program does belongs to `tests`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import io
import pkgutil
import re
import shlex
import sys
import tokenize
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FunctionType

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src" / "structid"
DOCS = ROOT / "docs"
TESTS = ROOT / "tests"

Rule = Callable[[], Iterator[str]]


# --- files of the package -------------------------------------------------------------------------------------------

SAME_MEANING = ("__init__.py", "__main__.py", "base.py")
"""Files that mean the same in every room: the interface of its things."""

VIEWS = ("figures", "commands", "sections")
"""Rooms whose files are called by what they show or run."""

CONCRETE = {
    "models": {"BoucWen", "ShearFrame"},
    "external": {"ExternalModel", "CallableModel", "ProgramModel", "UMBridgeModel"},
    "surrogates": {
        "Surrogate", "ResponseSpaceSurrogate", "ParametricNARX", "NARXBesideKriging", "PODKriging", "PODPCE", "PCNARX",
        "KrigingNARX", "CorrectedNARX", "NARX", "KrigingPredictor", "ChaosExpansion",
    },
    "inference": {"AIES", "SMC", "NUTS", "DelayedAcceptance", "IID", "AR1", "Matern32", "DampedCosine"},
}  # fmt: skip
"""Concrete models, solvers, surrogates, samplers and error models, by the room in which their names belong."""

SURROGATE_KINDS = re.compile(
    r"\b(pod_kriging|pod_pce|pc_narx|kriging_narx|PODPCE|PCNARX|KrigingNARX|startswith\(\"pod\"\))"
)


@cache
def package_files() -> dict[Path, ast.Module]:
    """Every file of the package with its syntax tree; a user's solver among the templates is none."""
    files = sorted(file for file in SRC.rglob("*.py") if "templates" not in file.parts)
    return {file: ast.parse(file.read_text(encoding="utf-8")) for file in files}


def name_of(file: Path) -> str:
    """Path in the repository, or as it is where the file lies elsewhere."""
    return str(file.relative_to(ROOT)) if file.is_relative_to(ROOT) else str(file)


def unique_file_names() -> Iterator[str]:
    """A newcomer who searches for a file name gets one answer."""
    seen: dict[str, Path] = {}
    for file in package_files():
        if file.name in SAME_MEANING or set(VIEWS) & set(file.parts):
            continue
        if file.name in seen:
            yield f"{name_of(file)}: {name_of(seen[file.name])} has the same name"
        seen[file.name] = file


def rooms_keep_their_classes() -> Iterator[str]:
    """A test on a concrete class outside its room is a capability that is missing."""
    for file, tree in package_files().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
                tested = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
                for room, names in CONCRETE.items():
                    if room not in file.parts and tested & names:
                        yield f"{name_of(file)}:{node.lineno}: tests for {', '.join(tested & names)} of {room}"


def studies_name_no_surrogate() -> Iterator[str]:
    """A kind of surrogate says what it can; the loop, a study and its files do not ask for its name."""
    listed = (SRC / "surrogates" / "storage.py", SRC / "surrogates" / "base.py", SRC / "calibration" / "sequential.py")
    for file in (*SRC.glob("study/**/*.py"), *listed):
        code = re.sub(r'"""[\s\S]*?"""|#[^\n]*', "", file.read_text(encoding="utf-8"))
        if found := SURROGATE_KINDS.search(code):
            yield f"{name_of(file)}: names {found[1]}"


def nothing_prints() -> Iterator[str]:
    """The command line owns the screen."""
    for file in SRC.rglob("*.py"):
        if re.search(r"^\s*print\(", file.read_text(encoding="utf-8"), re.M):
            yield f"{name_of(file)}: prints"


# --- docstrings -----------------------------------------------------------------------------------------------------


@cache
def documented_objects() -> dict[str, type | FunctionType]:
    """Classes, functions and methods of the package whose names are not private."""
    sys.path.insert(0, str(SRC.parent))
    found: dict[str, type | FunctionType] = {}
    seen: set[int] = set()
    for module_name in (m.name for m in pkgutil.walk_packages([str(SRC)], "structid.")):
        module = importlib.import_module(module_name)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != module_name or id(thing) in seen:
                continue
            if inspect.isfunction(thing) or inspect.isclass(thing):
                seen.add(id(thing))
                found[f"{module_name}.{name}"] = thing
                found |= public_methods(f"{module_name}.{name}", thing)
    return found


def public_methods(name: str, thing: object) -> dict[str, FunctionType]:
    """Methods of a class, as functions; none of anything else."""
    if not inspect.isclass(thing):
        return {}
    functions = {n: getattr(method, "__func__", method) for n, method in vars(thing).items() if not n.startswith("_")}
    return {
        f"{name}.{n}": method
        for n, method in functions.items()
        if inspect.isfunction(method) and "." in method.__qualname__  # not a function that is the default of a field
    }


def documented_parameters(doc: str) -> list[str] | None:
    """Names under "Parameters" of a numpydoc docstring; None where there is no such section."""
    section = re.search(r"Parameters\n\s*-{4,}\n(.*?)(?:\n\s*\n\s*[A-Z][a-z]+\n\s*-{3,}|\Z)", doc, re.S)
    if not section:
        return None
    lines = [line for line in section.group(1).splitlines() if line.strip()]
    indent = min(len(line) - len(line.lstrip()) for line in lines)
    heads = [line.strip() for line in lines if len(line) - len(line.lstrip()) == indent]
    return [n.strip().lstrip("*") for head in heads for n in head.split(" : ")[0].split(",")]


def parameters_of(name: str, thing: type | FunctionType) -> list[str] | None:
    """Names of the arguments that a docstring should describe; None where it need not describe them."""
    if name == "structid.cli.main.about" or re.fullmatch(r"structid\.cli\.commands\.(\w+)\.\1", name):
        return None  # the options document themselves in --help
    if inspect.isclass(thing):
        if thing.__init__ is object.__init__ or issubclass(thing, (Exception, tuple)) or inspect.isabstract(thing):
            return None
        if any(word in str(thing.__mro__) for word in ("pydantic", "Enum", "Protocol")):
            return None
        thing = thing.__init__
    return [
        n for n in inspect.signature(thing).parameters if n not in ("self", "cls", "args", "kwargs") and n[0] != "_"
    ]


def docstrings_agree_with_signatures() -> Iterator[str]:
    """Everything that is not private has a docstring; one that describes arguments describes those that are there."""
    for name, thing in documented_objects().items():
        doc = inspect.getdoc(thing) or ""
        if not doc.strip():
            yield f"{name}: no docstring"
            continue
        described, expected = documented_parameters(doc), parameters_of(name, thing)
        if described is None or expected is None:
            continue
        if missing := [n for n in expected if n not in described]:
            yield f"{name}: does not describe {', '.join(missing)}"
        if extra := [n for n in described if n not in expected]:
            yield f"{name}: describes {', '.join(extra)}, which it does not have"


EXTENDED = (
    *("models.base.Model", "models.traceable.TraceableModel", "models.model_kind.ModelKind"),
    *("surrogates.base.Surrogate", "surrogates.surrogate_kind.SurrogateKind"),
    *("inference.error_models.base.ErrorModel", "inference.error_models.base.Discrepancy"),
    *("inference.error_models.error_model_kind.ErrorModelKind", "inference.sampling.base.Sampler"),
    *("inference.sampling.sampler_list.SamplerKind", "report.section.Section", "study.stages.stage.StudyStage"),
)
"""What a user extends, besides the public names."""


def public_names_are_documented() -> Iterator[str]:
    """Public names, and what a user extends, describe all their arguments; an override says only what differs."""
    import structid

    things = {f"structid.{name}": getattr(structid, name) for name in structid._PUBLIC}
    for name in EXTENDED:
        module, _, last = name.rpartition(".")
        things[f"structid.{name}"] = getattr(importlib.import_module(f"structid.{module}"), last)
    for name, thing in things.items():
        if not (inspect.isclass(thing) or inspect.isfunction(thing)):
            continue
        for member, value in {name: thing, **public_methods(name, thing)}.items():
            expected = parameters_of(member, value)
            described = documented_parameters(inspect.getdoc(value) or "") is not None
            if expected and not described and not is_override(thing, value):
                yield f"{member}: describes none of its arguments ({', '.join(expected)})"


def is_override(owner: object, method: object) -> bool:
    """Whether a base class of the package has a method of this name, whose docstring describes the arguments."""
    bases = owner.__mro__[1:] if inspect.isclass(owner) and owner is not method else ()
    return any(method.__name__ in vars(base) for base in bases if base.__module__.startswith("structid"))


def modules_say_what_they_are_for() -> Iterator[str]:
    """The first line of a file is a sentence."""
    for file, tree in package_files().items():
        lines = (ast.get_docstring(tree) or "").strip().splitlines()
        if not lines or not lines[0].rstrip().endswith((".", ":")):
            yield f"{name_of(file)}: the first line of its docstring is no sentence"


# --- citations ------------------------------------------------------------------------------------------------------

DOI = re.compile(r"\b10\.\d{4,9}/[^\s\"`\],;]+")
ARXIV = re.compile(r"\b\d{4}\.\d{4,5}(?:v\d+)?\b")
EQUATION = re.compile(r"\[[2-5]\.[1-9]\d?[a-z]?(?:, [2-5]\.[1-9]\d?[a-z]?)*\]")


def dois(text: str) -> set[str]:
    """Dois of a text, without the full stop or the brackets of the sentence around them."""
    found = {match.rstrip(".:") for match in DOI.findall(text)}
    return {doi[:-1] if doi.endswith(")") and doi.count(")") > doi.count("(") else doi for doi in found}


def arxiv_numbers(text: str) -> set[str]:
    """Numbers after the word arXiv, however a line is broken between them."""
    return {number for group in re.findall(r"arXiv[:\s]+(\S+)", text) for number in ARXIV.findall(group)}


def prose(file: Path) -> str:
    """Comments and strings of a file: an equation number there is a citation, an index in the code is not."""
    tokens = tokenize.generate_tokens(io.StringIO(file.read_text(encoding="utf-8")).readline)
    return "\n".join(t.string for t in tokens if t.type in (tokenize.COMMENT, tokenize.STRING))


def citations_are_listed() -> Iterator[str]:
    """Every doi and arXiv number of code and pages stands in the bibliography."""
    listed = (DOCS / "bibliography.md").read_text(encoding="utf-8")
    for file in sorted([*SRC.rglob("*.py"), *DOCS.rglob("*.md"), *SRC.rglob("*.html")]):
        text = file.read_text(encoding="utf-8")
        for found in sorted((dois(text) - dois(listed)) | (arxiv_numbers(text) - arxiv_numbers(listed))):
            yield f"{name_of(file)}: {found} is not in docs/bibliography.md"


def equation_numbers_say_whose_they_are() -> Iterator[str]:
    """A file with bare numbers of equations names the thesis, and where its reference is, in its docstring."""
    for file, tree in package_files().items():
        text, opening = prose(file), ast.get_docstring(tree) or ""
        cites = EQUATION.search(text) or re.search(r"\bthesis eqs?\. \d", text)
        if cites and not ("thesis" in opening and "docs/bibliography.md" in opening):
            yield f"{name_of(file)}: cites {cites[0]} and does not say whose it is"
        if re.search(r"\b[Tt]he source('s (figure|table)| prints| calls)", text):
            yield f"{name_of(file)}: says 'the source'; say whose: the thesis's"


# --- pages ----------------------------------------------------------------------------------------------------------

WRITTEN_BY_THE_BUILD = ("names/", "../reference/names/", "../project/")


@cache
def pages() -> dict[Path, str]:
    """Pages of the site that are written by hand, with their text."""
    written = {"_build", "names", "project"}
    files = sorted(page for page in DOCS.rglob("*.md") if not written & set(page.relative_to(DOCS).parts))
    return {file: file.read_text(encoding="utf-8") for file in files}


def blocks(text: str, language: str) -> list[str]:
    """Code of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.S | re.M)


def examples_parse() -> Iterator[str]:
    """Python of a page compiles, and its study files are TOML."""
    for page, text in pages().items():
        for block in blocks(text, "python"):
            try:
                compile(block, str(page), "exec")
            except SyntaxError as problem:
                yield f"{name_of(page)}: Python that does not compile: {problem}"
        for block in blocks(text, "toml"):
            try:
                tomllib.loads(block.replace("…", ""))
            except tomllib.TOMLDecodeError as problem:
                yield f"{name_of(page)}: TOML that does not parse: {problem}"


def options(command: Callable[..., object]) -> set[str]:
    """Options of a command, from its signature."""
    found = {"--help"}
    for name, parameter in command.__annotations__.items():
        given = re.findall(r"'(--[a-z-]+)'", str(parameter))
        found |= set(given) or {f"--{name.replace('_', '-')}"}
    return found


def shell_lines_exist() -> Iterator[str]:
    """Commands on a page, and their options, are there."""
    from structid.cli.commands.command_list import COMMANDS

    known = {command.__name__: command for command in COMMANDS}
    for page, text in pages().items():
        cells = re.findall(r"^%%sh\n(.*?)^```", text, re.S | re.M)
        for line in "\n".join([*blocks(text, "sh"), *cells]).splitlines():
            found = re.match(r"\s*structid (\w+)(.*)", line.split("  #")[0])
            if not found:
                continue
            if found[1] not in known:
                yield f"{name_of(page)}: no command {found[1]}: {line}"
                continue
            words = shlex.split(re.split(r"[|>&]", found[2])[0])
            unknown = {word for word in words if word.startswith("--")} - options(known[found[1]])
            if unknown:
                yield f"{name_of(page)}: {found[1]} has no {', '.join(unknown)}: {line}"


def links_lead_somewhere() -> Iterator[str]:
    """Links between pages; `make docs` checks every link of what it has built."""
    for page, text in pages().items():
        for link in re.findall(r"(?<!\!)\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.S)):
            target = link.split("#")[0]
            if re.match(r"[a-z]+:", link) or not target or target.startswith(WRITTEN_BY_THE_BUILD):
                continue
            if not any((page.parent / f"{target}{ending}").exists() for ending in ("", ".md")):
                yield f"{name_of(page)}: {link} leads nowhere"


# --- tests ----------------------------------------------------------------------------------------------------------

TEST_FOLDERS = {"architecture", "examples", "helpers", "resume", "seams", "statistical", "verification"}
"""Folders of tests that are about more than one folder of the package."""


def tests_lie_where_the_code_lies() -> Iterator[str]:
    """A folder of tests is called as the folder that it tests, and no two files of tests have the same name."""
    files = sorted(TESTS.rglob("*.py"))
    for folder in sorted({file.parent.relative_to(TESTS) for file in files}):
        if folder.parts and folder.parts[0] not in TEST_FOLDERS and not (SRC / folder).is_dir():
            yield f"tests/{folder}: the package has no folder of this name"
    names = [file.name for file in files if file.name.startswith("test_")]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"tests: {name} is there {names.count(name)} times"


RULES: tuple[Rule, ...] = (
    unique_file_names,
    rooms_keep_their_classes,
    studies_name_no_surrogate,
    nothing_prints,
    modules_say_what_they_are_for,
    docstrings_agree_with_signatures,
    public_names_are_documented,
    citations_are_listed,
    equation_numbers_say_whose_they_are,
    examples_parse,
    shell_lines_exist,
    links_lead_somewhere,
    tests_lie_where_the_code_lies,
)


def main() -> int:
    """Print every complaint; 1 if there is one."""
    complaints = [complaint for rule in RULES for complaint in rule()]
    print("\n".join(complaints) or f"Style: {len(RULES)} rules hold.")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
