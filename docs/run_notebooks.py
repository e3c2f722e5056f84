"""Execute the notebooks of docs/notebooks and store their outputs in them.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/run_notebooks.py
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).resolve().parent / "notebooks"
TIMEOUT = 600  # s for one cell
ERASE = "\x1b[K"  # erases the rest of a line on a terminal


def read(path: Path, replaced: Mapping[str, str] | None = None) -> nbformat.NotebookNode:
    """Read a notebook.

    Args:
        path: the notebook.
        replaced: texts of code cells, with what replaces them, such as fewer repeats.

    Raises:
        ValueError: a text to be replaced is in no cell.
    """
    notebook = nbformat.read(path, as_version=4)
    for old, new in (replaced or {}).items():
        cells = [cell for cell in notebook.cells
                 if cell.cell_type == "code" and old in cell.source]  # fmt: skip
        if not cells:
            raise ValueError(f"{path}: no code cell contains {old!r}")
        for cell in cells:
            cell.source = cell.source.replace(old, new)
    return notebook


def execute(notebook: nbformat.NotebookNode, folder: Path) -> None:
    """Execute a notebook in a folder, and store its outputs in it, without times.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell failed; the message has its traceback.
    """
    NotebookClient(
        notebook, timeout=TIMEOUT, kernel_name="python3", record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    ).execute()  # fmt: skip


def reduce_progress(notebook: nbformat.NotebookNode) -> None:
    """Join the texts of each stream of a cell, and leave only the last line of a progress bar."""
    for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
        joined: dict[str, nbformat.NotebookNode] = {}
        others = [output for output in cell.outputs if output.output_type != "stream"]
        for output in (output for output in cell.outputs if output.output_type == "stream"):
            first = joined.setdefault(output.name, output)
            if first is not output:
                first.text += output.text
        for output in joined.values():
            lines = output.text.replace("\r\n", "\n").replace(f"\r{ERASE}", "").split("\n")
            output.text = "\n".join(line.split("\r")[-1].replace(ERASE, "") for line in lines)
        cell.outputs = [output for output in joined.values() if output.text] + others


def main(argv: list[str] | None = None) -> int:
    """Execute the notebooks and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/run_notebooks.py my_study")
    parser.add_argument("names", nargs="*", help="names of notebooks (default: all)")
    names = parser.parse_args(argv).names
    paths = sorted(NOTEBOOKS.glob("*.ipynb"))
    unknown = set(names) - {path.stem for path in paths}
    if unknown:
        known = ", ".join(path.stem for path in paths)
        sys.exit(f"there is no notebook {', '.join(sorted(unknown))}; there are: {known}")
    for path in paths:
        if not names or path.stem in names:
            notebook = read(path)
            with tempfile.TemporaryDirectory() as folder:
                execute(notebook, Path(folder))
            reduce_progress(notebook)
            nbformat.write(notebook, path)
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
