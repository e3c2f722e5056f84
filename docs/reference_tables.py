"""Generate the tables of READMEs and of docs/ from classes and registries.

    .venv/bin/python docs/reference_tables.py

The text between a pair of comments is replaced:

    <!-- fields module:Class -->      attributes of a class, from its docstring
    <!-- settings module:Class -->    settings with default, unit and meaning
    <!-- registry module:NAME -->     entries with their parameters and the first line of their docs
    <!-- schemes module:NAME -->      features and schemes, their inputs and controlled directions
    <!-- diagnoses module:NAME -->    diagnoses in order: condition, outcomes, inputs
    <!-- metrics module:NAME -->      metrics with unit, meaning and formula
    <!-- exports package:NAMES -->    public names with the first line of their docs
    <!-- loop file:function -->       source of the first loop of a function
    <!-- end -->

Within a line, `<!-- names module:NAME -->` and `<!-- end -->` enclose the names of a registry. In a
launch file, the first comment precedes an argument whose help lists the names: "Control law: pi,
..., or package.module:Class".
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(folder) for folder in sorted(ROOT.glob("src/*/src"))]

from aras_visual_servo_base.registry import Parameter, Registry  # noqa: E402
from aras_visual_servo_base.settings import get_default  # noqa: E402
from aras_visual_servo_controller.diagnosis.base import DIAGNOSES  # noqa: E402

TABLE = re.compile(r"(<!-- (\w+) ([\w.]+):(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
NAMES = re.compile(
    r'(<!-- names ([\w.]+):(\w+) -->\s*<arg [^>]*?doc="[^":]*: )[^"]*?(, or )', re.DOTALL
)
INLINE = re.compile(r"(<!-- names ([\w.]+):(\w+) -->)[^\n]*?(<!-- end -->)")
LOOP = re.compile(r"(<!-- loop ([\w./]+):(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
HEADING = re.compile(r"^Attributes\b.*:$")
ENTRY = re.compile(r"^ {0,4}(\w+(?:, \w+)*): (.*)$")
AXES = ("vx", "vy", "vz", "ωx", "ωy", "ωz")


def read_entries(lines: Iterable[str]) -> list[tuple[str, str]]:
    """Read entries `name: text` or `name, name: text`; return names and texts."""
    found: list[tuple[str, str]] = []
    for line in lines:
        if entry := ENTRY.match(line):
            found.append((entry[1], entry[2]))
        elif found and line.startswith("    "):
            found[-1] = (found[-1][0], f"{found[-1][1]} {line.strip()}")
        elif found:
            break
    return found


def read_attributes(documented: type) -> list[tuple[str, str]]:
    """Read the attributes of a class from the list in its docstring.

    A class without such a list, such as a named tuple, gives one row with its fields and its first
    sentence.
    """
    lines = inspect.getdoc(documented).splitlines()
    begin = next((i for i, line in enumerate(lines) if HEADING.match(line)), None)
    if begin is None:
        return [(", ".join(documented._fields), lines[0])]
    return read_entries(lines[begin + 1 :])


def make_fields_table(documented: type) -> list[str]:
    """Return the table of a class's attributes."""
    rows = [f"| {documented.__name__} | |", "|---|---|"]
    for names, text in read_attributes(documented):
        shown = ", ".join(f"`{name}`" for name in names.split(", "))
        rows.append(f"| {shown} | {escape(text)} |")
    return rows


def make_settings_table(documented: type) -> list[str]:
    """Return the table of a dataclass's settings.

    Their meaning is in the docstring of the dataclass or of a class in its `documented_by`.
    """
    meanings = dict(read_entries(inspect.getdoc(documented).split("\n\n", 1)[-1].splitlines()))
    for base in map(inspect.getdoc, getattr(documented, "documented_by", ())):
        meanings = dict(read_entries(base.splitlines())) | meanings
    rows = ["| name | default | unit | meaning |", "|---|---|---|---|"]
    for field in dataclasses.fields(documented):
        if not field.metadata.get("internal"):
            unit = field.metadata.get("unit", "")
            text = meanings[field.name].removeprefix(unit).lstrip(", ").rstrip(".")
            default = get_default(field)
            shown = "" if default == "" else f"`{default}`"
            rows.append(f"| `{field.name}` | {shown} | {unit} | {escape(text)} |")
    return rows


def make_registry_table(registry: Registry) -> list[str]:
    """Return the table of a registry's entries and their parameters."""
    declared = {name: registry.list_parameters(name) for name in registry}
    more = any(declared.values())
    rows = ["| name | what it is | parameters |" if more else "| name | what it is |"]
    rows.append("|---|---|---|" if more else "|---|---|")
    for name, parameters in declared.items():
        row = f"| `{name}` | {escape(summarise(registry[name]))} |"
        text = escape("; ".join(map(format_parameter, parameters)))
        rows.append(f"{row} {text} |" if more else row)
    return rows


def make_schemes_table(registry: Registry) -> list[str]:
    """Return the table of features and schemes."""
    rows = ["| name | what it is | needs | moves |", "|---|---|---|---|"]
    for name in registry:
        made = registry.create(name)
        needs = ", ".join(sorted(need.value for need in made.needs))
        directions = getattr(made, "directions", None)
        moves = "" if directions is None else " ".join(
            axis for axis, modelled in zip(AXES, directions, strict=True) if modelled
        )
        moves = "all six" if directions is not None and all(directions) else moves
        rows.append(f"| `{name}` | {escape(summarise(registry[name]))} | {needs} | {moves} |")
    return rows


def make_diagnoses_table(order: Iterable[str]) -> list[str]:
    """Return the table of the diagnoses, in the order in which they run."""
    rows = ["| name | when | outcomes | what it reads |", "|---|---|---|---|"]
    for name in order:
        found = DIAGNOSES[name]
        kinds = ", ".join(f"`{kind}`" for kind in found.kinds)
        rows.append(f"| `{name}` | {escape(found.help)} | {kinds} | {escape(found.reads)} |")
    return rows


def make_metrics_table(metrics: Mapping[str, Any]) -> list[str]:
    """Return the table of metrics."""
    rows = ["| name | unit | better | what it is | default |", "|---|---|---|---|---|"]
    for name, metric in metrics.items():
        default = "x" if metric.default else ""
        rows.append(
            f"| `{name}` | {metric.unit} | {metric.better} | {escape(metric.text.rstrip('.'))} "
            f"| {default} |"
        )
    return rows


def make_exports_table(exported: Mapping[str, Any]) -> list[str]:
    """Return the table of the objects that a package exports, by name."""
    rows = ["| name | what it is |", "|---|---|"]
    rows += [f"| `{name}` | {escape(summarise(shown))} |" for name, shown in exported.items()]
    return rows


KINDS: Mapping[str, Callable[[Any], list[str]]] = {
    "fields": make_fields_table, "settings": make_settings_table, "registry": make_registry_table,
    "schemes": make_schemes_table, "diagnoses": make_diagnoses_table, "metrics": make_metrics_table,
    "exports": make_exports_table,
}  # fmt: skip


def make_loop_block(path: Path, function: str) -> str:
    """Return the first loop of a function as a code block, which tests execute."""
    text = path.read_text(encoding="utf-8")
    (found,) = (node for node in ast.parse(text).body
                if isinstance(node, ast.FunctionDef) and node.name == function)  # fmt: skip
    loop = next(node for node in found.body if isinstance(node, ast.For))
    lines = text.splitlines()[loop.lineno - 1 : loop.end_lineno]
    code = textwrap.dedent("\n".join(lines))
    return f"<!-- test: given {path.stem} -->\n```python\n{code}\n```\n"


def format_parameter(parameter: Parameter) -> str:
    """Format a parameter as `name` = default unit, help."""
    default = parameter.default
    shown = f" = {default:g} {parameter.unit}" if isinstance(default, int | float) else ""
    return f"`{parameter.name}`{shown.rstrip()}, {parameter.help}"


def summarise(documented: type) -> str:
    """Return the first line of a docstring, without its full stop."""
    return inspect.getdoc(documented).splitlines()[0].rstrip(".")


def escape(text: str) -> str:
    """Escape a text for a cell of a table."""
    return text.replace("|", "\\|")


def fill_tables(page: str) -> str:
    """Return a page with updated tables."""

    def table(match: re.Match[str]) -> str:
        module = importlib.import_module(match[3])
        shown = getattr(module, match[4])
        if match[2] == "exports":
            shown = {name: getattr(module, name) for name in shown}
        return "\n".join([match[1], *KINDS[match[2]](shown), "", match[5]])

    def names(match: re.Match[str], quote: str = "") -> str:
        registry = getattr(importlib.import_module(match[2]), match[3])
        return match[1] + ", ".join(f"{quote}{name}{quote}" for name in registry) + match[4]

    def loop(match: re.Match[str]) -> str:
        return match[1] + make_loop_block(ROOT / match[2], match[3]) + match[4]

    page = LOOP.sub(loop, page)
    page = INLINE.sub(lambda match: names(match, "`"), TABLE.sub(table, page))
    return NAMES.sub(names, page)


def find_pages() -> list[Path]:
    """Return the pages that contain generated tables."""
    kinds = ("*.md", "docs/*.md", "src/*/*.md", "src/*/launch/*.launch")
    every = {path: path.read_text(encoding="utf-8") for kind in kinds for path in ROOT.glob(kind)}
    blocks = (TABLE, LOOP, INLINE, NAMES)
    return sorted(p for p, text in every.items() if any(block.search(text) for block in blocks))


def main() -> None:
    """Update the tables of all pages."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0],
                            epilog="example: docs/reference_tables.py").parse_args()
    for path in find_pages():
        path.write_text(fill_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
