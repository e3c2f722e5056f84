"""The notebooks of the documentation run from the first to the last cell, and are short."""

import io
import os
import re
import sys
import types
from contextlib import redirect_stderr, redirect_stdout

import nbformat
import pytest
from blocks import ROOT
from IPython.core.displayhook import CapturingDisplayHook
from IPython.core.interactiveshell import InteractiveShell
from IPython.core.pylabtools import select_figure_formats
from traitlets.config import Config

sys.path.append(str(ROOT / "docs"))

import run_notebooks  # noqa: E402

# Each notebook, with what makes it shorter than what it shows.
SHORTER = {
    "first_servo": {"duration=5.0": "duration=0.4"},
    "my_scheme": {'Experiment(plant="chain"': 'Experiment(duration=0.2, plant="chain"'},
    "my_study": {"repeats: 10": "repeats: 2", "duration: 5.0": "duration: 0.3"},
}
NAMES = tuple(SHORTER)
MOST_BYTES = 250_000  # of a notebook with its outputs; the largest has 220 kB
MOST_LINES = 35  # of output in one cell


def streams(cell, name):
    """Text that a cell has written to a stream."""
    return "".join(output.text for output in cell.outputs
                   if output.output_type == "stream" and output.name == name)  # fmt: skip


def kinds(cell):
    """Kinds of the outputs of a cell, without texts on the standard error."""
    return [sorted(output.get("data", {output.get("name"): ""})) for output in cell.outputs
            if output.get("name") != "stderr"]  # fmt: skip


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_stored_with_small_outputs(name):
    assert len(list(run_notebooks.NOTEBOOKS.glob("*.ipynb"))) == len(NAMES)
    path = run_notebooks.NOTEBOOKS / f"{name}.ipynb"
    stored = nbformat.read(path, as_version=4)
    nbformat.validate(stored)
    assert path.stat().st_size < MOST_BYTES
    for number, cell in enumerate(code_cells(stored), 1):
        assert cell.execution_count == number
        assert cell.outputs, f"run docs/run_notebooks.py {name}: no output of\n{cell.source}"
        assert len(streams(cell, "stdout").splitlines()) <= MOST_LINES
        assert "\x1b" not in streams(cell, "stderr") + streams(cell, "stdout")


class Terminal(io.StringIO):
    def isatty(self):
        return True


def execute_here(notebook, folder, monkeypatch):
    """Execute a notebook in this process, which has already imported most of what it needs.

    Commands of the bench run here, too, which are processes of their own in the notebook.
    """
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("IPYTHONDIR", str(folder))
    monkeypatch.setitem(sys.modules, "notebook", module := types.ModuleType("notebook"))
    shell = InteractiveShell.instance(config=Config(HistoryManager={"enabled": False}),
                                      user_module=module)  # fmt: skip
    try:
        select_figure_formats(shell, {"png"})
        shell.run_cell("from aras_visual_servo_bench.cli import main")
        for cell in code_cells(notebook):
            text = re.sub(r"(?m)^!{bench} (.*)$", r"assert main('\1'.split()) == 0", cell.source)
            shell.display_trap.hook = CapturingDisplayHook(shell, shown := [])
            with redirect_stdout(io.StringIO()) as out, redirect_stderr(Terminal()) as error:
                shell.run_cell(text).raise_error()
            cell.outputs = [nbformat.v4.new_output("stream", name=stream, text=file.getvalue())
                            for stream, file in (("stdout", out), ("stderr", error))
                            if file.getvalue()]  # fmt: skip
            cell.outputs += [nbformat.v4.new_output("display_data", one["data"]) for one in shown]
    finally:
        InteractiveShell.clear_instance()
        sys.modules.pop("centre_and_size", None)  # made by a notebook


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs(name, tmp_path, monkeypatch):
    """The first one in a process of Jupyter."""
    path = run_notebooks.NOTEBOOKS / f"{name}.ipynb"
    stored, made = run_notebooks.read(path), run_notebooks.read(path, SHORTER[name])
    if name == NAMES[0]:
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))  # of the kernel
        run_notebooks.execute(made, tmp_path)
    else:
        execute_here(made, tmp_path, monkeypatch)
    for cell in code_cells(made):
        if "progress=True" in cell.source or "study.run(" in cell.source:
            assert "\r[#" in streams(cell, "stderr"), "the progress bar is not visible"
    run_notebooks.reduce_progress(made)
    for cell, before in zip(code_cells(made), code_cells(stored), strict=True):
        assert kinds(cell) == kinds(before), f"run docs/run_notebooks.py {name}: {cell.source}"
    if name == "my_study":
        assert "\\toprule" in (tmp_path / "table.tex").read_text()
        assert (tmp_path / "figures" / "success.pdf").stat().st_size > 1000


def test_what_is_in_no_cell_cannot_be_replaced_nor_an_unknown_notebook_run():
    path = run_notebooks.NOTEBOOKS / "my_study.ipynb"
    with pytest.raises(ValueError, match="no code cell contains 'repeats: 11'"):
        run_notebooks.read(path, {"repeats: 11": ""})
    with pytest.raises(SystemExit, match="no notebook my_studdy; there are: first_servo, my_sch"):
        run_notebooks.main(["my_studdy"])
