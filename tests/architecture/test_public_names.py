"""The public names: the same for Python, for an editor, for a type checker and for ``help``."""

import ast
import pydoc
import re
from pathlib import Path

import pytest

import structid

pytestmark = pytest.mark.quick
STUB = Path(structid.__file__).with_suffix(".pyi")


def test_the_stub_says_what_the_package_loads():
    found = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for name in node.names:
                assert name.name == name.asname, "without 'as' a type checker takes the name for a private one"
                found[name.name] = node.module.removeprefix("structid").removeprefix(".")
    for module in structid._MODULES:
        assert found.pop(module) == ""
    assert found == structid._PUBLIC


def test_a_public_name_is_loaded_from_where_it_is_defined():
    loaded = {name: getattr(structid, name).__module__.removeprefix("structid.") for name in structid._PUBLIC}
    assert loaded == structid._PUBLIC


def test_help_lists_them():
    text = pydoc.render_doc(structid, renderer=pydoc.plaintext)
    assert all(re.search(rf"\b{name}\b", text) for name in structid._PUBLIC)


def test_the_package_says_that_it_is_typed():
    """`make lint` checks the stub itself against the modules."""
    assert STUB.with_name("py.typed").is_file()


def test_every_public_name_has_a_topic_on_the_site():
    """The site is built late and elsewhere; a room without a topic stops it."""
    source = (Path(__file__).parents[2] / "docs" / "_ext" / "public_names.py").read_text()
    assigned = {node.targets[0].id: node.value for node in ast.parse(source).body if isinstance(node, ast.Assign)}
    topics = ast.literal_eval(assigned["TOPICS"])
    for name, module in structid._PUBLIC.items():
        rooms = [module.rsplit(".", n)[0] for n in range(module.count(".") + 1)]
        assert set(rooms) & set(topics), f"{name}: no room of {module} is in TOPICS"
