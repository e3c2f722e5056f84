"""Fill the tables of docs/scheme_interface.md from the docstrings of what they show.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/scheme_interface.py

Between `<!-- fields module:Class -->` and `<!-- /fields -->` stands what the class's docstring says
of its attributes.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
from pathlib import Path

PAGE = Path(__file__).with_suffix(".md")
TABLE = re.compile(r"(<!-- fields ([\w.]+):(\w+) -->\n).*?(<!-- /fields -->)", re.DOTALL)
HEADING = re.compile(r"^Attributes\b.*:$")
ENTRY = re.compile(r"^    (\w+(?:, \w+)*): (.*)$")


def attributes(documented: type) -> list[tuple[str, str]]:
    """Names, with commas, and what is said of them, from the docstring's list of attributes.

    One without such a list, as a named tuple's, is a row: its fields, and its first sentence.
    """
    lines = inspect.getdoc(documented).splitlines()
    begin = next((i for i, line in enumerate(lines) if HEADING.match(line)), None)
    if begin is None:
        return [(", ".join(documented._fields), lines[0])]
    found: list[tuple[str, str]] = []
    for line in lines[begin + 1 :]:
        entry = ENTRY.match(line)
        if entry:
            found.append((entry[1], entry[2]))
        elif line.startswith("     "):
            found[-1] = (found[-1][0], f"{found[-1][1]} {line.strip()}")
        else:
            break
    return found


def filled(page: str) -> str:
    """The page with its tables as the classes say now."""

    def table(match: re.Match[str]) -> str:
        documented = getattr(importlib.import_module(match[2]), match[3])
        rows = ["", f"| {match[3]} | |", "|---|---|"]
        for names, text in attributes(documented):
            shown = ", ".join(f"`{name}`" for name in names.split(", "))
            rows.append(f"| {shown} | {text.replace('|', chr(92) + '|')} |")
        return match[1] + "\n".join(rows) + "\n\n" + match[4]

    return TABLE.sub(table, page)


def main() -> None:
    """Write the page anew."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0],
                            epilog="example: docs/scheme_interface.py").parse_args()
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
