import ast
import inspect
from hickory_stream.mapping import core
from hickory_stream.mapping.core import MapperCore


def test_the_core_is_a_dispatcher_of_fewer_than_250_lines():
    text = inspect.getsource(core)
    assert len(text.splitlines()) < 250
    numbers = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    assert [value for value in numbers if type(value) in (int, float) and value not in (0, 1, 3)] == []


def test_the_core_holds_its_configuration_and_one_state():
    names = {
        node.attr for node in ast.walk(ast.parse(inspect.getsource(MapperCore))) if isinstance(node, ast.Attribute)
    }
    assert {name for name in names if name.startswith("_") and not hasattr(MapperCore, name)} == {
        "_config",
        "_tracker",
        "_snapshots",
        "_state",
    }
