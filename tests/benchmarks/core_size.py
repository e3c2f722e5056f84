#!/usr/bin/env python3
"""Count how much code one run of a free camera with exact features needs.

    python3 tests/benchmarks/core_size.py [--images N] [--list]

Counts project modules that are imported, lines of the modules of which a function runs, and the
functions that run: in set-up (from the experiment to the first image), in one image while the
camera moves, and in the whole run. Lines of code of `src` are counted without blank lines,
comments and docstrings. Prints a table and, as its last line, JSON.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import checkout

SOURCES = checkout.ROOT / "src"
LIMITS = {
    "imported modules": 130,
    "lines of executed modules": 10_000,
    "functions per image": 120,
    "functions in set-up": 230,
}
LONGEST = 60  # statements of a function
PAGES = (".js", ".html", ".css")


class ExecutedFunctions:
    def __init__(self) -> None:
        self.codes: set[CodeType] = set()

    def __enter__(self) -> ExecutedFunctions:
        sys.setprofile(self._on_event)
        return self

    def __exit__(self, *raised: object) -> None:
        sys.setprofile(None)
        self.codes = {code for code in self.codes if code.co_flags & inspect.CO_OPTIMIZED
                      and not code.co_name.startswith("<") and is_project(code.co_filename)}

    def _on_event(self, frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            self.codes.add(frame.f_code)


def is_project(file: str) -> bool:
    return file.startswith(str(SOURCES))


def count_code_lines(text: str) -> int:
    """Count lines of Python that are not blank, comment or docstring."""
    numbered = enumerate(text.splitlines(), 1)
    lines = {number for number, line in numbered if line.strip() and line.lstrip()[0] != "#"}
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            docstrings.update(range(docstring.lineno, docstring.end_lineno + 1))
        elif isinstance(node, ast.Constant | ast.JoinedStr):  # blank lines of a text count
            lines.update(range(node.lineno, node.end_lineno + 1))
    return len(lines - docstrings)


def source_lines() -> dict[str, int]:
    """Count lines of code of `src`: Python, and the lines of web pages that are not blank."""
    python = [p for p in SOURCES.rglob("*") if p.suffix == ".py" or _is_script(p)]
    pages = [p for p in SOURCES.rglob("*") if p.suffix in PAGES and ".min." not in p.name]
    return {
        "Python": sum(count_code_lines(p.read_text()) for p in python),
        "pages": sum(bool(line.strip()) for p in pages for line in p.read_text().splitlines()),
    }


def _is_script(path: Path) -> bool:
    if path.suffix or not path.is_file():
        return False
    with path.open("rb") as file:
        return b"python" in file.readline()


def count_statements(code: CodeType) -> int:
    """Count the statements of a function, without its docstring and nested functions."""
    for node in _find_functions(code.co_filename):
        named = node.name == code.co_name
        first = min([node.lineno, *(d.lineno for d in node.decorator_list)]) if named else 0
        if named and first == code.co_firstlineno:
            return sum(1 for _ in _statements(node)) - (ast.get_docstring(node) is not None)
    raise ValueError(f"{code.co_filename} has no function {code.co_name}")


@cache
def _find_functions(file: str) -> list[ast.FunctionDef]:
    nodes = ast.walk(ast.parse(Path(file).read_text()))
    return [node for node in nodes if isinstance(node, ast.FunctionDef)]


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            continue
        if isinstance(child, ast.stmt):
            yield child
        yield from _statements(child)


def measure(images: int) -> tuple[dict[str, int], dict[str, set[CodeType]]]:
    """Run the experiment for some images."""
    from aras_visual_servo_bench.experiment.experiment import Experiment
    from aras_visual_servo_bench.runner.loop import Loop
    from aras_visual_servo_bench.setup.assembly import assemble

    with ExecutedFunctions() as setup:
        experiment = Experiment(plant="free", features="exact")
        loop = Loop(experiment, assemble(experiment))
    per_image: list[set[CodeType]] = []
    with ExecutedFunctions() as rest:
        loop.run_to_image()
    for _ in range(images):
        with ExecutedFunctions() as image:
            loop.run_to_image()
        per_image.append(image.codes)
    with ExecutedFunctions() as end:
        loop.make_run()
        loop.close()
    middle = sorted(per_image, key=len)[len(per_image) // 2]
    whole = set().union(setup.codes, rest.codes, end.codes, *per_image)
    files = {code.co_filename for code in whole}
    lines = {file: len(Path(file).read_text().splitlines()) for file in files}
    loaded = [getattr(module, "__file__", None) or "" for module in list(sys.modules.values())]
    counts = {
        "imported modules": sum(map(is_project, loaded)),
        "executed modules": len(files),
        "lines of executed modules": sum(lines.values()),
        "longest executed module": max(lines.values()),
        "functions in set-up": len(setup.codes),
        "functions per image": len(middle),
        "functions in the run": len(whole),
        "longest function": max(map(count_statements, whole)),
    }
    return counts, {"set-up": setup.codes, "image": middle, "run": whole}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=30, help="images after the first")
    parser.add_argument("--list", action="store_true", help="print modules and functions by phase")
    given = parser.parse_args()
    counts, functions = measure(given.images)
    if given.list:
        for phase, codes in functions.items():
            print(f"\n{phase}")
            for name in sorted(f"{Path(c.co_filename).relative_to(SOURCES)}:{c.co_firstlineno} "
                               f"{c.co_qualname} {count_statements(c)}" for c in codes):
                print(f"  {name}")
    counts |= {f"lines of code, {kind}": n for kind, n in source_lines().items()}
    for name, count in counts.items():
        limit = f"  (at most {LIMITS[name]})" if name in LIMITS else ""
        print(f"{name:28} {count:7}{limit}")
    print(json.dumps(counts))
    return 0


if __name__ == "__main__":
    sys.exit(main())
