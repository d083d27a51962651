"""Journals: what was finished comes back, torn ends go, another's is refused; functions are known by what they do."""

import errno

import numpy as np
import pytest

from structid.core.errors import InputError, StoreMismatchError
from structid.core.journal import Journal

pytestmark = pytest.mark.quick


def entries(journal):
    return [int(e["x"][0]) for e in journal]


def test_entries_come_back(tmp_path):
    journal = Journal(tmp_path / "j", {"seed": 1})
    for i in range(5):
        journal.append({"x": np.array([i])})
    assert entries(Journal(tmp_path / "j", {"seed": 1})) == [0, 1, 2, 3, 4]


def test_torn_at_every_byte_keeps_what_was_finished(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"seed": 1})
    sizes = []
    for i in range(3):
        journal.append({"x": np.array([i])})
        sizes.append(path.stat().st_size)
    whole = path.read_bytes()
    header = 2 * sizes[0] - sizes[1]  # the entries are alike
    for length in range(header, len(whole), 7):
        path.write_bytes(whole[:length])
        again = Journal(path, {"seed": 1})
        finished = sum(size <= length for size in sizes)
        assert entries(again) == list(range(finished))
        again.append({"x": np.array([99])})
        assert entries(Journal(path, {"seed": 1})) == [*range(finished), 99]


def test_a_second_writer_is_refused_and_nothing_is_lost(tmp_path):
    path = tmp_path / "j"
    first, second = Journal(path, {}), Journal(path, {})
    first.append({"x": np.array([1])})
    with pytest.raises(InputError, match=r"another process has written .* one writer at a time"):
        second.append({"x": np.array([2])})
    third = Journal(path, {})
    first.append({"x": np.array([3])})
    with pytest.raises(InputError, match="another process"):
        third.append({"x": np.array([4])})
    assert entries(Journal(path, {})) == [1, 3]
    first.remove()  # as at the end of a run
    with pytest.raises(InputError, match="another process"):
        third.append({"x": np.array([4])})


def test_an_entry_that_the_disk_did_not_take_is_written_again(tmp_path, monkeypatch):
    journal = Journal(tmp_path / "j", {})
    journal.append({"x": np.array([1])})

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", full)
        with pytest.raises(OSError, match="No space"):
            journal.append({"x": np.array([2])})
    journal.append({"x": np.array([3])})
    assert entries(Journal(tmp_path / "j", {})) == [1, 3]


def test_a_flipped_bit_is_found(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"seed": 1})
    journal.append({"x": np.array([1])})
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    assert entries(Journal(path, {"seed": 1})) == []


def test_another_identity_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "j"
    Journal(path, {"seed": 1}).append({"x": np.array([1])})
    before = path.read_bytes()
    with pytest.raises(StoreMismatchError, match="seed is 1 in the store, 2 here"):
        Journal(path, {"seed": 2})
    assert path.read_bytes() == before


def test_a_foreign_file_is_refused(tmp_path):
    (tmp_path / "j").write_text("my thesis")
    with pytest.raises(InputError, match="not a structid journal"):
        Journal(tmp_path / "j", {})
    assert (tmp_path / "j").read_text() == "my thesis"


def test_a_functions_identity_knows_what_it_uses_of_its_module(tmp_path):
    import importlib.util

    from structid.core.hashing import function_identity

    def loaded(text):
        path = tmp_path / "solver.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location("solver", path)
        module = importlib.util.module_from_spec(spec)
        exec(compile(text, str(path), "exec"), module.__dict__)
        return function_identity(module.respond)

    text = (
        "import numpy as np\nMASS = 3.0\nTABLE = np.arange(4.0)\nclass Law:\n    k = 2\n    def f(self, x): return self.k * x\n"
        "def helper(x):\n    return MASS * x + recurse(0)\ndef recurse(n):\n    return 0 if n < 1 else helper(n)\n"
        "def respond(p, r):\n    return [Law().f(helper(TABLE[0])) for _ in range(3)]\n"
    )
    same = loaded(text)
    assert loaded("# a comment\n" + text + "UNUSED = 1\n") == same
    for old, new in (
        ("3.0", "3.5"),
        ("4.0", "5.0"),
        ("k = 2", "k = 4"),
        ("n < 1", "n < 2"),
        ("self.k * x", "self.k + x"),
        ("range(3)", "range(4)"),
    ):
        assert old in text and loaded(text.replace(old, new, 1)) != same, old


def test_an_identity_does_not_depend_on_what_was_asked_before():
    from functools import cached_property

    from structid.core.hashing import function_identity

    class Law:
        k = 3.0

        @cached_property
        def table(self):
            return [1, 2, 3]

        def __call__(self, p, r):
            return self.table

    law = Law()
    before = function_identity(law)
    assert law.table and function_identity(law) == before
    law.k = 4.0
    assert function_identity(law) != before


def test_objects_with_many_paths_between_them_are_described_once():
    """Each of 40 functions uses the one before twice: 2⁴⁰ paths lead to the first."""
    from structid.core.hashing import function_identity

    def chain(leaf):
        def first(x):
            return leaf * x

        for _ in range(40):
            first = (lambda below, same: lambda x: below(x) + same(x))(first, first)
        return first

    assert function_identity(chain(2.0)) == function_identity(chain(2.0)) != function_identity(chain(3.0))


def test_an_identity_says_what_arrays_of_jax_hold():
    """A log density of JAX closes over its data; ``__slots__`` of compiled classes name what cannot be asked for."""
    import jax.numpy as jnp

    from structid.core.hashing import function_identity

    def density_of(data):
        return lambda theta: -((theta - data) ** 2).sum()

    one, same, other = (function_identity(density_of(jnp.asarray(d))) for d in ([1, 2], [1, 2], [1, 3]))
    assert one == same != other


def test_functions_are_known_by_what_they_do():
    from structid.core.hashing import function_identity

    def factory(k):
        return lambda p, j=2: [k * v**j for v in p]

    assert function_identity(factory(1)) == function_identity(factory(1))
    assert function_identity(factory(1)) != function_identity(factory(2))
    assert function_identity(lambda x, k=2: k * x) != function_identity(lambda x, k=3: k * x)
