"""Objects found by their type."""

import pytest

from structid.core.by_type import ByType

pytestmark = pytest.mark.quick


def test_an_object_is_found_under_the_type_it_was_put_in():
    some = ByType({int: 1}).having(object, "text")
    assert some[int] == 1 and some.get(object) == "text" and some.get(str) is None
    assert int in some and str not in some and list(some) == [1, "text"]
    with pytest.raises(KeyError):
        some[str]


def test_one_more_leaves_the_first_as_it_was():
    first = ByType({int: 1})
    more = first.having(int, 2) | ByType({str: "a", float: None})
    assert first[int] == 1 and more[int] == 2 and more[str] == "a" and float not in more
    assert int not in more.having(int, None)
