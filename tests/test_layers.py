import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
import pytest
from tests.readmes import blocks_of

ROOT = Path(__file__).resolve().parent.parent

# Lowest first; the parts of one layer import nothing of one another, those joined by "+" are one part.
LAYERS = (
    ("hickory_stream.errors",),
    ("hickory_stream.base",),
    ("hickory_stream.geometry",),
    ("hickory_stream.records+hickory_stream.events",),
    ("hickory_stream.ports", "hickory_stream.storeys"),
    ("hickory_stream.textures",),
    (
        "hickory_stream.perception",
        "hickory_stream.mapping",
        "hickory_stream.shapes",
        "hickory_stream.poses",
        "hickory_stream.graph",
        "hickory_stream.navigation",
        "hickory_stream.alignment",
    ),
    ("hickory_stream.merging", "hickory_stream.loops"),
    ("hickory_stream.config+hickory_stream.box_scene+hickory_stream.testing",),
    ("hickory_stream.journal",),
    ("hickory_stream.map_folder",),
    ("hickory_stream.engine",),
    ("players", "hickory_stream.inspection"),
    ("hickory_stream.pictures",),
    ("hickory_stream.sinks", "hickory_stream.evaluation"),
    ("hickory_stream.worlds", "hickory_stream.fleet", "hickory_stream.query", "hickory_stream.changes"),
    ("hickory_stream.batch",),
    (
        "hickory_stream.settings+hickory_stream.progress+hickory_stream.outputs+hickory_stream.cli+hickory_stream.__main__",
    ),
    ("hickory_stream",),
)
PARTS = {name: (rank, part) for rank, parts in enumerate(LAYERS) for part in parts for name in part.split("+")}
FILES = sorted(file for package in ("hickory_stream", "players") for file in (ROOT / package).rglob("*.py"))
OURS = ("hickory_stream", "players")


def module_of(file):
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def place_of(module):
    """Return rank and part of a module: those of its longest prefix that has any, the bare package only as itself."""
    names = module.split(".")
    prefixes = [".".join(names[:i]) for i in range(len(names), 0, -1)]
    found = next((name for name in prefixes if name in PARTS and (name != "hickory_stream" or name == module)), None)
    assert found is not None, f"{module} is in no layer: name it in LAYERS"
    return PARTS[found]


@cache
def facts_of(file):
    """Return what a module imports, its functions that lack type hints and are no kernels, and whether it prints."""
    imports, bare, prints = [], [], False
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imports += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are written in full"
            assert node.module is not None
            submodules = (f"{node.module}.{alias.name}" for alias in node.names)
            imports += (name if is_module(name) else node.module for name in submodules)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            decorators = {ast.unparse(decorator).partition("(")[0] for decorator in node.decorator_list}
            bare += [node.name] * (not decorators & {"kernel", "overload"} and node.returns is None)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            prints |= node.func.id == "print"
    return tuple(imports), bare, prints


def imports_of(file):
    return facts_of(file)[0]


@cache
def is_module(name):
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def picture_of_layers():
    """Return the Mermaid block of the main README: a box for each layer, the highest first."""
    boxes = [", ".join(parts).replace("hickory_stream.", "") for parts in LAYERS]
    lines = [f'    L{rank}["{box}"]' for rank, box in enumerate(boxes)]
    arrows = "-->".join(f"L{rank}" for rank in reversed(range(len(boxes))))
    return "\n".join(["flowchart TB", *reversed(lines), f"    {arrows}", ""])


def test_the_main_readme_shows_the_layers():
    assert blocks_of("mermaid", ROOT / "README.md") == picture_of_layers()


def test_imports_point_down_only():
    up = []
    for file in FILES:
        rank, part = place_of(module_of(file))
        for name in imports_of(file):
            if name.split(".")[0] in OURS and name != "hickory_stream":
                its_rank, its_part = place_of(name)
                up += [f"{module_of(file)} must not import {name}"] * (its_part != part and its_rank >= rank)
    assert up == []


def test_no_module_imports_itself_through_others():
    """Imports for types and those within functions count, too: who reads one file of a circle has to read them all."""
    modules = {module_of(file) for file in FILES} - {"hickory_stream"}
    graph = {
        module_of(file): {name for name in imports_of(file) if name in modules}
        for file in FILES
        if module_of(file) in modules
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("imports go round in a circle: " + " <- ".join(error.args[1]))


def test_importing_the_package_for_its_version_loads_nothing():
    tree = ast.parse((ROOT / "hickory_stream/__init__.py").read_text())
    imported = [node.module or "" for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert [name for name in imported if name.split(".")[0] in OURS] == []


def test_nothing_prints_but_the_command_line():
    printers = {module_of(file) for file in FILES if facts_of(file)[2]}
    assert {name for name in printers if not f"{name}.".startswith("hickory_stream.cli.")} == set()
    assert printers


def users_of(package):
    return [module_of(file) for file in FILES if any(f"{name}.".startswith(f"{package}.") for name in imports_of(file))]


def test_asyncio_is_for_the_engine_and_twins_and_tools_for_none():
    """What a run needs, such as the scene that warms it up, is no twin for tests."""
    assert users_of("asyncio")
    assert [name for name in users_of("asyncio") if not name.startswith("hickory_stream.engine.")] == []
    assert users_of("hickory_stream.testing") == users_of("tools") == []


def test_all_functions_but_kernels_have_type_hints():
    assert {module_of(file): bare for file in FILES if (bare := facts_of(file)[1])} == {}
