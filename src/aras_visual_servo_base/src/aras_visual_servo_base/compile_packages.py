"""Compile packages' loops (Numba) now, which their first start would do otherwise.

    python -m aras_visual_servo_base.compile_packages [--from FOLDER] [--processes N] PACKAGE...

What set-up calls for the sources, and installing for the copies that it has made of them. There,
`--from` names the folder with the packages' sources: what was compiled for those is taken over.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import importlib.util
import multiprocessing
import os
import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from .compiled import compile_all

IMPORTS_JIT = re.compile(r"^from .*compiled import .*\bjit\b", re.MULTILINE)


def find_sources(package: str) -> list[Path]:
    """Files of a package that import the decorator of its loops; relative to its parent folder.

    Raises:
        ModuleNotFoundError: there is no such package.
    """
    parent = _find_folder(package)
    files = sorted((parent / package).rglob("*.py"))
    return [path.relative_to(parent) for path in files if IMPORTS_JIT.search(path.read_text())]


def _find_folder(package: str) -> Path:
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError(f"no package {package} on PYTHONPATH")
    return Path(found.submodule_search_locations[0]).parent


def copy_cache(package: str, folder: Path) -> None:
    """Copy what was compiled for the package's sources in `folder`, where they are the same text:
    Numba takes what it kept for the same text, wherever that stands.
    """
    parent = _find_folder(package)
    for path in find_sources(package):
        source, copy = folder / path, parent / path
        if source == copy or not source.exists() or source.read_bytes() != copy.read_bytes():
            continue
        for kept in sorted((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ic]")):
            (copy.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy2(kept, copy.parent / "__pycache__")


def find_missing(packages: Sequence[str]) -> list[str]:
    """Those of the packages with loops for which nothing is kept beside their sources, though it
    could be: what starts next would compile them."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return []
    found = []
    for package in packages:
        parent = _find_folder(package)
        paths = [parent / path for path in find_sources(package)]
        if any(
            os.access(path.parent, os.W_OK)
            and not any((path.parent / "__pycache__").glob(f"{path.stem}.*.nbi"))
            for path in paths
        ):
            found.append(package)
    return found


def split_packages(packages: Sequence[str], count: int) -> list[list[str]]:
    """The packages in at most `count` parts that take about as long: packages of one process
    compile the parts of Numba that they have in common once."""
    files = {package: len(find_sources(package)) for package in packages}
    parts: list[list[str]] = [[] for _ in range(min(count, len(files)))]
    for package in sorted(files, key=files.get, reverse=True):
        min(parts, key=lambda part: sum(files[one] for one in part)).append(package)
    return [part for part in parts if part]


def main(argv: list[str] | None = None) -> int:
    """Compile the packages' loops, with a process for each core; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="loops", description=__doc__.splitlines()[0],
        epilog=f"example: python -m {__name__} aras_visual_servo_camera",
    )  # fmt: skip
    parser.add_argument("packages", nargs="+", metavar="PACKAGE")
    parser.add_argument("--from", dest="folder", type=Path, help="where the sources are")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), metavar="N",
                        help="at most so many side by side (as there are cores)")  # fmt: skip
    given = parser.parse_args(argv)
    found = [package for package in given.packages if _import_modules(package, given.folder)]
    # Forked, so that what all of them need is imported once.
    fork = multiprocessing.get_context("fork")
    processes = [fork.Process(target=_compile, args=(part,))
                 for part in split_packages(found, max(given.processes, 1))]  # fmt: skip
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    failed = any(process.exitcode for process in processes)
    return int(failed or len(found) < len(given.packages))


def _import_modules(package: str, folder: Path | None) -> bool:
    """Import a package's modules with loops, compiling nothing yet; False, and told, where it or
    something that it imports is not there. folder: as `copy_cache` has it."""
    try:
        if folder:
            copy_cache(package, folder)
        for path in find_sources(package):
            importlib.import_module(".".join(path.with_suffix("").parts))
    except ModuleNotFoundError as error:
        print(f"loops: {error}", file=sys.stderr)
        return False
    return True


def _compile(packages: Sequence[str]) -> None:
    # An eighth of the time went into looking for garbage among Numba's many objects.
    gc.disable()
    for package in packages:
        compile_all(package)


if __name__ == "__main__":
    sys.exit(main())
