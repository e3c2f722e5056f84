"""Every declared and documented parameter is used by the code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
SOURCES = ROOT / "src"
SCHEMES_PAGE = ROOT / "docs" / "schemes_page.py"  # the one reader of a case's `elsewhere`
DECLARATIONS = (
    "parameter", "gain", "joint_parameter", "copy_loop_parameter", "copy_parameter",
)  # fmt: skip


def declared(tree: ast.Module) -> Iterator[str]:
    """Names of the parameters that the classes of a module declare."""
    for cls in tree.body:
        for line in cls.body if isinstance(cls, ast.ClassDef) else ():
            call = line.value if isinstance(line, ast.AnnAssign) else None
            if isinstance(call, ast.Call) and ast.unparse(call.func) in DECLARATIONS:
                yield ast.unparse(line.target)


def read(tree: ast.AST) -> Iterator[str]:
    """Names of the attributes that a module reads."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            yield node.attr


def unread(trees: list[ast.AST]) -> set[str]:
    """Parameters that no module reads."""
    return {name for tree in trees for name in declared(tree)} - {
        name for tree in trees for name in read(tree)
    }


def test_every_declared_parameter_is_read() -> None:
    trees = [ast.parse(path.read_text()) for path in SOURCES.glob("*/src/**/*.py")]
    assert sum(1 for tree in trees for _ in declared(tree)) > 200
    page = ast.parse(SCHEMES_PAGE.read_text())
    assert not unread([*trees, page]), "declared, and read by no code"
