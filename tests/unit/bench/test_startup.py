"""A command imports the libraries that it uses, and no others."""

import os
import subprocess
import sys
from pathlib import Path

import yaml

from aras_visual_servo_bench import run_study
from aras_visual_servo_bench.cli.arguments import EXAMPLES

SOURCES = Path(__file__).parents[3] / "src"
LIBRARIES = ("numpy", "cv2", "numba", "scipy", "pandas", "pyarrow", "matplotlib")
PROGRAM = """
import sys
from aras_visual_servo_bench.cli import main
for command in sys.argv[1:]:
    try:
        main(command.split())
    except SystemExit:
        pass
print(*sys.modules, file=sys.stderr)
"""


def imported_by(*commands: str) -> set[str]:
    """The modules that a process has imported after some commands."""
    folders = os.pathsep.join(str(folder) for folder in sorted(SOURCES.glob("*/src")))
    search = os.pathsep.join(filter(None, [folders, os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *commands], capture_output=True, text=True, timeout=180,
        env={**os.environ, "PYTHONPATH": search}, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout, done.stderr
    return set(done.stderr.splitlines()[-1].split())


def test_help_imports_no_library():
    found = imported_by("--help", *(f"{name} --help" for name in EXAMPLES))
    assert "argparse" in found
    assert found.isdisjoint(LIBRARIES)


def test_a_run_imports_neither_files_of_studies_nor_figures():
    found = imported_by("run plant=free features=exact duration=0.2")
    assert "numba" in found
    assert found.isdisjoint(("scipy.stats", "scipy.linalg", "pandas", "pyarrow", "matplotlib",
                             "asyncio", "dask"))  # fmt: skip


def test_a_table_imports_neither_compiled_code_nor_what_its_formulas_do_without(tmp_path):
    file = tmp_path / "study.yaml"
    settings = {"plant": "free", "features": "exact", "duration": 0.2}
    file.write_text(yaml.safe_dump({"experiment": settings, "repeats": 3,
                                    "metrics": ["settled", "final_distance"]}))  # fmt: skip
    run_study(file, tmp_path / "out")
    found = imported_by(f"table {tmp_path / 'out'}")
    assert "pyarrow" in found
    assert found.isdisjoint(("numba", "scipy.stats", "pandas", "matplotlib", "dask"))
