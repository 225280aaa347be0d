import re
from functools import cache
from pathlib import Path
import pytest
from hickory_stream import errors
from hickory_stream.errors import EmptyMapError, HickoryError, InputError

ROOT = Path(__file__).resolve().parent.parent
ALL = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, HickoryError)]


@pytest.mark.parametrize("kind", ALL)
def test_an_outside_error_exits_with_2_and_our_failure_with_1(kind):
    expected = 3 if kind is EmptyMapError else 2 if issubclass(kind, InputError) else 1
    assert kind.exit_status == expected


def test_the_tree_in_the_docstring_is_the_tree():
    drawn = re.findall(r"^ *(?:[|`]   )?(?:[|`]-- )?(\w+Error) ", errors.__doc__ or "", flags=re.MULTILINE)
    names = [name for line in (errors.__doc__ or "").splitlines() for name in re.findall(r"\b(\w+Error)\b", line)]
    assert sorted(set(drawn) | set(names)) == sorted(kind.__name__ for kind in ALL)


@cache
def called_names():
    """Return every name that the packages call; the classes' own definitions do not count."""
    sources = (file.read_text() for package in ("hickory_stream", "players") for file in (ROOT / package).rglob("*.py"))
    return {name for source in sources for name in re.findall(r"(?<!class )\b(\w+)\(", source)}


@pytest.mark.parametrize("kind", [kind for kind in ALL if kind not in (HickoryError, InputError)])
def test_every_specific_error_is_raised_somewhere(kind):
    assert kind.__name__ in called_names()
