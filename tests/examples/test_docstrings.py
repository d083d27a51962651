"""Every public name shows its use, and what the example prints is right."""

import doctest

import pytest

import structid as si

OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


@pytest.mark.parametrize("name", [name for name in si.__all__ if name not in ("__version__", "optimize")])
def test_the_example_of_a_public_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    thing = getattr(si, name)
    examples = doctest.DocTestParser().get_doctest(thing.__doc__, {}, name, None, None)
    assert examples.examples, f"{name} has no example"
    printed = []
    result = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(examples, out=printed.append)
    assert result.failed == 0, "".join(printed)
