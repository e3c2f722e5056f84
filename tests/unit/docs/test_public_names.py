"""Public names are listed once and are imported when they are first used."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from blocks import PAGES, ROOT, blocks

PACKAGES = ("aras_visual_servo_bench", "aras_visual_servo_controller", "aras_sim_bridge")
SCRIPTS = sorted([*ROOT.glob("docs/examples/*.py"), *ROOT.glob("docs/gallery/*.py"),
                  *ROOT.glob("docs/**/*.ipynb")])  # fmt: skip


def private_imports(text: str) -> list[str]:
    """Return the non-public names of the workspace that a Python text imports."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("aras_"):
            public = node.module in PACKAGES and importlib.import_module(node.module).__all__
            found += [f"from {node.module} import {alias.name}" for alias in node.names
                      if not public or alias.name not in public]  # fmt: skip
        elif isinstance(node, ast.Import):
            found += [f"import {alias.name}" for alias in node.names
                      if alias.name.startswith("aras_") and alias.name not in PACKAGES]  # fmt: skip
    return found


def exports_for_types(package: str) -> dict[str, str]:
    """The names that a type checker sees in a package, with the modules that define them."""
    tree = ast.parse((ROOT / "src" / package / "src" / package / "__init__.py").read_text())
    (guard,) = (node for node in tree.body if isinstance(node, ast.If)
                and ast.unparse(node.test) == "TYPE_CHECKING")  # fmt: skip
    found = {}
    for node in guard.body:
        for alias in node.names:
            assert alias.asname == alias.name, f"{alias.name}: a type checker takes it for private"
            found[alias.name] = f"{package}.{node.module}" if node.level else node.module
    return found


# It writes out what `run` does with an image: the four functions and their parts are 13 more names.
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_imports_public_names(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python":
            assert not private_imports(block.text), block.place


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_or_notebook_imports_public_names(script: Path) -> None:
    if script.name == "four_points.py":  # the functions of `run`, and their parts
        pytest.skip("writes out what `run` does with an image")
    text = script.read_text()
    if script.suffix == ".ipynb":
        cells = (cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code")
        lines = [line for cell in cells for line in [*cell["source"], "\n"]]
        text = "".join(line for line in lines if line[:1] not in "%!")
    assert not private_imports(text)


@pytest.mark.parametrize("package", PACKAGES)
def test_type_checkers_see_the_names_that_are_imported(package: str) -> None:
    module, seen = importlib.import_module(package), exports_for_types(package)
    assert set(seen) == set(module.__all__) and dir(module) == sorted(module.__all__)
    for name, place in seen.items():
        assert getattr(module, name) is getattr(importlib.import_module(place), name)


def test_packages_import_their_modules_when_they_are_used() -> None:
    folders = [str(folder) for folder in sorted(ROOT.glob("src/aras_*/src"))]
    code = (f"import sys; sys.path[:0] = {folders}; import {', '.join(PACKAGES)}\n"
            "print(*sorted(name for name in sys.modules if name.startswith('aras_')))\n"
            "print('numpy' in sys.modules)")  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = sorted((*PACKAGES, "aras_visual_servo_base", "aras_visual_servo_base.lazy_imports"))
    assert done.stdout.splitlines() == [" ".join(names), "False"]


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_listed_once_with_documented_arguments(package: str) -> None:
    module = importlib.import_module(package)
    first = module.FIRST_PROJECT
    assert len(module.__all__) == len(set(module.__all__)) <= 60
    assert tuple(module.__all__[: len(first)]) == first and len(first) <= 25
    wrong = module.__all__[0][:4] + module.__all__[0][5:]
    with pytest.raises(ImportError, match=f"'{wrong}' .* did you mean '{module.__all__[0]}'"):
        exec(f"from {package} import {wrong}")
    for name in module.__all__:
        found = getattr(module, name)
        text = inspect.getdoc(found) or ""
        assert text, f"{name} has no docstring"
        if inspect.isfunction(found):
            arguments = inspect.signature(found).parameters
            missing = [word for word in arguments if not re.search(rf"\b{word}\b", text)]
            assert not missing, f"{package}.{name} does not say what {missing} is"
