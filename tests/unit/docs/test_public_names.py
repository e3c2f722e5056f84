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
MOST, FIRST = 60, 25
SCRIPTS = sorted([*ROOT.glob("docs/examples/*.py"), *ROOT.glob("docs/gallery/*.py")])
NOTEBOOKS = sorted(ROOT.glob("docs/**/*.ipynb"))


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
WRITTEN_OUT = ("four_points.py",)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_imports_public_names(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python":
            assert not private_imports(block.text), block.place


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_imports_public_names(script: Path) -> None:
    if script.name in WRITTEN_OUT:
        pytest.skip("writes out what `run` does with an image")
    assert not private_imports(script.read_text())


def test_a_notebook_imports_public_names() -> None:
    for notebook in NOTEBOOKS:
        cells = json.loads(notebook.read_text())["cells"]
        for cell in (cell for cell in cells if cell["cell_type"] == "code"):
            lines = [line for line in "".join(cell["source"]).splitlines() if line[:1] not in "%!"]
            assert not private_imports("\n".join(lines)), notebook


def test_there_are_few_names_and_fewer_to_begin_with() -> None:
    modules = [importlib.import_module(package) for package in PACKAGES]
    assert sum(len(module.__all__) for module in modules) <= MOST
    assert sum(len(module.FIRST_PROJECT) for module in modules) <= FIRST
    for module in modules:
        assert len(set(module.__all__)) == len(module.__all__)
        assert tuple(module.__all__[: len(module.FIRST_PROJECT)]) == module.FIRST_PROJECT


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
def test_a_wrong_name_gets_the_right_one(package: str) -> None:
    name = importlib.import_module(package).__all__[0]
    wrong = name[:4] + name[5:]
    with pytest.raises(ImportError, match=f"'{wrong}' .* did you mean '{name}'"):
        exec(f"from {package} import {wrong}")


@pytest.mark.parametrize("package", PACKAGES)
def test_public_functions_document_their_arguments(package: str) -> None:
    module = importlib.import_module(package)
    for name in module.__all__:
        found = getattr(module, name)
        text = inspect.getdoc(found) or ""
        assert text, f"{name} has no docstring"
        if inspect.isfunction(found):
            arguments = inspect.signature(found).parameters
            missing = [word for word in arguments if not re.search(rf"\b{word}\b", text)]
            assert not missing, f"{package}.{name} does not say what {missing} is"


@pytest.mark.parametrize("page", sorted(ROOT.glob("docs/api/*.rst")), ids=lambda page: page.stem)
def test_the_reference_heads_each_module_with_its_name(page: Path) -> None:
    found = re.findall(r"``(.+)``\n~+\n\n\.\. automodule:: \w+\.(\S+)", page.read_text())
    assert found
    for heading, module in found:
        assert heading == module
