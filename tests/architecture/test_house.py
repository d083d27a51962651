"""The house: sizes of files and functions, names of files, and that nobody outside a room names what is in it."""

import ast
import io
import re
import statistics
import tokenize
from pathlib import Path

import pytest

import structid

pytestmark = pytest.mark.quick
ROOT = Path(structid.__file__).parent
FILES = sorted(f for f in ROOT.rglob("*.py") if "templates" not in f.parts)
TREES = {f: ast.parse(f.read_text()) for f in FILES}

SAME_MEANING = ("__init__.py", "__main__.py", "face.py", "kind.py")
"""Files that mean the same in every room: what its things look like from outside, and what a kind of them says of itself."""

VIEWS = ("figures", "commands", "sections")
"""Rooms whose files are called by what they show or run."""


def name_of(file):
    return str(file.relative_to(ROOT))


def docstrings(tree):
    """Lines of all docstrings, those under attributes included."""
    lines = set()
    for node in ast.walk(tree):
        for child in getattr(node, "body", []) if isinstance(getattr(node, "body", None), list) else []:
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                lines |= set(range(child.lineno, child.end_lineno + 1))
    return lines


def code_lines(file):
    """Lines that are neither blank, nor comment, nor docstring."""
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    found = set()
    for token in tokenize.generate_tokens(io.StringIO(file.read_text()).readline):
        if token.type not in skipped:
            found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - docstrings(TREES[file]))


def functions():
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                own = docstrings(node)
                lines = {n for n in range(node.lineno, node.end_lineno + 1) if n not in own}
                yield f"{name_of(file)}: {node.name}", len(lines)


@pytest.mark.parametrize("file", FILES, ids=name_of)
def test_a_file_can_be_read_in_one_sitting(file):
    assert len(file.read_text().splitlines()) <= 450
    assert code_lines(file) <= 300


def test_functions_are_small():
    sizes = dict(functions())
    assert {name: size for name, size in sizes.items() if size > 60} == {}
    assert statistics.median(sizes.values()) <= 8


def test_no_two_files_share_a_name():
    seen = {}
    for file in FILES:
        if file.name not in SAME_MEANING and not set(VIEWS) & set(file.parts):
            seen.setdefault(file.name, []).append(name_of(file))
    assert {name: files for name, files in seen.items() if len(files) > 1} == {}


CONCRETE = {
    "models": ("BoucWen", "ShearFrame"),
    "solvers": ("ExternalModel", "CallableModel", "ProgramModel", "UMBridgeModel"),
    "surrogates": (
        *(
            "Surrogate",
            "ResponseSpaceSurrogate",
            "ParametricNARX",
            "NARXWithRest",
            "PODKriging",
            "PODPCE",
            "PCNARX",
            "KrigingNARX",
            "CorrectedNARX",
            "NARX",
        ),
        *("KrigingPredictor", "ChaosExpansion"),
    ),
    "inference": ("AIES", "SMC", "NUTS", "DelayedAcceptance", "IID", "AR1", "Matern32", "DampedCosine"),
}
"""Concrete models, solvers, surrogates, samplers and laws, by the room in which their names belong."""


def test_nobody_outside_a_room_tests_for_what_is_in_it():
    """A test on a concrete class is a capability that is missing."""
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
                tested = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
                for room, names in CONCRETE.items():
                    if room not in file.relative_to(ROOT).parts:
                        assert not tested & set(names), f"{name_of(file)}, line {node.lineno}: {tested & set(names)}"


def test_the_loop_calibration_and_files_of_a_study_name_no_kind_of_surrogate():
    words = re.compile(r"\b(pod_kriging|pod_pce|pc_narx|kriging_narx|PODPCE|PCNARX|KrigingNARX|startswith\(\"pod\"\))")
    for file in (
        *ROOT.glob("study/**/*.py"), ROOT / "surrogates" / "storage.py", ROOT / "surrogates" / "face.py",
        ROOT / "calibration" / "sequential.py",
    ):  # fmt: skip
        code = re.sub(r'"""[\s\S]*?"""|#[^\n]*', "", file.read_text())
        assert not words.search(code), name_of(file)
