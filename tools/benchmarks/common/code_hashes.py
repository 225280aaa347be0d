"""Hashes of code by its definitions: a moved definition, a comment, docstring or import changes none."""

import ast
import functools
import hashlib
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tools.benchmarks.common.processes import ROOT

_DATA = (".toml", ".json", ".npz", ".onnx", ".lock")
_MODULE = re.compile(r"(?:hickory_stream|players|tools)(?:\.\w+)*\.(\w+)")
_MODULES = ("config.py", "events.py", "ports.py", "records.py", "base", "engine", "evaluation", "geometry", "graph")
_MODULES += ("journal", "loops", "map_folder", "mapping", "perception", "poses", "shapes")
PLAYERS = ("players",)
MAPS = (*PLAYERS, *(f"hickory_stream/{name}" for name in _MODULES))
"""The code that a map and its figures depend on; the command line, sinks, paths and alignment are not in it."""


@functools.cache
def code_hash(*names: str) -> str:
    """Return the sha256 of the definitions in files and folders of the checkout, wherever in these they stand."""
    # Top-level statements are hashed as a sorted set, without docstrings and imports; data files count by their bytes.
    # Raises FileNotFoundError: a name is no file or folder.
    found = {one for path in _files(names) for one in _definitions(path)}
    return hashlib.sha256("".join(sorted(found)).encode()).hexdigest()


def definitions_of(source: str) -> list[str]:
    """Return the hashes of the top-level statements of a module."""
    tree = _Bare().visit(ast.parse(source))
    return [hashlib.sha256(ast.dump(node).encode()).hexdigest() for node in tree.body]


@functools.cache
def _definitions(path: Path) -> list[str]:
    if path.suffix == ".py":
        return definitions_of(path.read_text(encoding="utf-8"))
    return [hashlib.sha256(path.read_bytes()).hexdigest()]


class _Bare(ast.NodeTransformer):
    def visit_Import(self, _node: ast.Import) -> None:
        pass

    def visit_ImportFrom(self, _node: ast.ImportFrom) -> None:
        pass

    def visit_Expr(self, node: ast.Expr) -> Any:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        module = _MODULE.fullmatch(node.value) if isinstance(node.value, str) else None
        return ast.Constant(value=module[1]) if module else node


def _files(names: tuple[str, ...]) -> Iterator[Path]:
    for root in (ROOT / name for name in names):
        if not root.exists():
            raise FileNotFoundError(f"{root}: code that figures depend on has moved; correct code_hashes.py")
        yield from [root] if root.is_file() else sorted(p for p in root.rglob("*") if p.suffix in (".py", *_DATA))


def commit_of_the_code() -> str:
    """Return the commit that is checked out, marked where code differs from it; "unknown" without git."""
    try:
        commit, changed = (
            subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
            for command in (("rev-parse", "--short", "HEAD"), ("status", "--porcelain", "--", "*.py"))
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return commit + ("-dirty" if changed else "")
