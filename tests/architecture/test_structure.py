"""The shape of the package: floors, public names, docstrings that agree with signatures, a quick command line."""

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import structid

pytestmark = pytest.mark.quick

ROOT = Path(structid.__file__).parent
REPOSITORY = Path(__file__).parents[2]
MODULES = [m.name for m in pkgutil.walk_packages([str(ROOT)], "structid.")]


def test_every_public_name_resolves_and_is_listed():
    for name in dir(structid):
        assert getattr(structid, name) is not None
    with pytest.raises(AttributeError, match="bananas"):
        _ = structid.bananas


CONTRACT = [
    *(
        "GroundMotion",
        "ForceHistory",
        "DisplacementHistory",
        "ParameterSpace",
        "Uniform",
        "Normal",
        "LogNormal",
        "Gamma",
    ),
    *(
        "Beta",
        "Weibull",
        "Gumbel",
        "Frozen",
        "BoucWen",
        "ShearFrame",
        "Observation",
        "Posterior",
        "IID",
        "AIES",
        "sample",
    ),
    *("Histories", "Status", "LogDensity", "InputError", "optimize"),
]


@pytest.mark.parametrize("name", CONTRACT)
def test_the_contract_stands(name):
    assert hasattr(structid, name)


def public_objects():
    seen = set()
    for module_name in MODULES:
        module = importlib.import_module(module_name)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != module_name or id(thing) in seen:
                continue
            if inspect.isfunction(thing) or inspect.isclass(thing):
                seen.add(id(thing))
                yield f"{module_name}.{name}", thing
                if inspect.isclass(thing):
                    for method_name, method in vars(thing).items():
                        method = getattr(method, "__func__", method)
                        if inspect.isfunction(method) and not method_name.startswith("_"):
                            yield f"{module_name}.{name}.{method_name}", method


OBJECTS = dict(public_objects())


@pytest.mark.parametrize("module", MODULES)
def test_a_file_says_in_its_first_line_what_it_is_for(module):
    doc = importlib.import_module(module).__doc__
    assert doc and doc.strip().splitlines()[0].rstrip().endswith((".", ":"))


def documented_parameters(doc):
    section = re.search(r"Parameters\n\s*-{4,}\n(.*?)(?:\n\s*\n\s*[A-Z][a-z]+\n\s*-{3,}|\Z)", doc, re.S)
    if not section:
        return []
    indent = min(len(line) - len(line.lstrip()) for line in section.group(1).splitlines() if line.strip())
    heads = [
        line.strip()
        for line in section.group(1).splitlines()
        if len(line) - len(line.lstrip()) == indent and line.strip()
    ]
    return [n.strip().lstrip("*") for head in heads for n in head.split(" : ")[0].split(",")]


@pytest.mark.parametrize("name", OBJECTS)
def test_docstrings_agree_with_signatures(name):
    thing = OBJECTS[name]
    doc = inspect.getdoc(thing) or ""
    assert doc.strip(), f"{name} has no docstring"
    if inspect.isclass(thing):
        if (
            thing.__init__ is object.__init__
            or issubclass(thing, (Exception, tuple))
            or "pydantic" in str(thing.__mro__)
        ):
            return
        signature = inspect.signature(thing.__init__)
        if "Enum" in str(thing.__mro__) or "Protocol" in str(thing.__mro__) or inspect.isabstract(thing):
            return
    else:
        signature = inspect.signature(thing)
    hidden = {"self", "cls", "args", "kwargs"}
    expected = [n for n in signature.parameters if n not in hidden and not n.startswith("_")]
    if name == "structid.cli.about" or re.fullmatch(r"structid\.commands\.(\w+)\.\1", name):
        return  # the options document themselves in --help
    documented = documented_parameters(doc)
    missing = [n for n in expected if n not in documented]
    extra = [n for n in documented if n not in expected]
    assert not missing and not extra, f"{name}: not documented {missing}, documented but not there {extra}"


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("structid.cli", ("jax", "numpyro", "arviz", "matplotlib", "scipy")),
        # Every child process of a guarded solver imports it.
        (
            "structid.solvers.external",
            ("jax", "numpyro", "arviz", "matplotlib", "scipy.stats", "scipy.signal", "scipy.special"),
        ),
    ],
)
def test_what_should_start_at_once_loads_no_heavy_library(module, heavy):
    code = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_nothing_prints():
    for file in ROOT.rglob("*.py"):
        assert not re.search(r"^\s*print\(", file.read_text(), re.M), file


def test_the_lock_holds_what_the_project_names():
    """What is missing there is missing on every new machine."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    groups = project["dependency-groups"]
    named = [*project["project"]["dependencies"], *groups["test"], *groups["lint"], *groups["build"]]
    locked = set(re.findall(r"^([\w.-]+)==", (REPOSITORY / "requirements.lock").read_text(), flags=re.MULTILINE))
    assert {re.match(r"[\w-]+", name)[0].lower() for name in named} <= locked
