"""Compile the Numba functions of packages before the first start needs them.

    python -m aras_visual_servo_base.compile_packages [--from FOLDER] [--processes N] PACKAGE...

The set-up calls this for the source packages. The installation calls it for the installed packages,
with the folder of the source packages as `--from`. If an installed file is equal to its source
file, the compiled functions of the source file are copied instead of compiled again.
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
    """Return the files of a package that define compiled functions.

    The paths are relative to the folder that contains the package.

    Raises:
        ModuleNotFoundError: the package does not exist.
    """
    parent = _find_folder(package)
    files = sorted((parent / package).rglob("*.py"))
    return [path.relative_to(parent) for path in files if IMPORTS_JIT.search(path.read_text())]


def _find_folder(package: str) -> Path:
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError(
            f"there is no package {package} on PYTHONPATH; build and source the workspace"
        )
    return Path(found.submodule_search_locations[0]).parent


def copy_cache(package: str, folder: Path) -> None:
    """Copy compiled functions from the sources below `folder` to the caches of a package.

    This is done for each file of the package that is equal to its source, because Numba accepts
    the cached functions of a file with the same text in any folder.
    """
    parent = _find_folder(package)
    for path in find_sources(package):
        source, copy = folder / path, parent / path
        if source == copy or not source.exists() or source.read_bytes() != copy.read_bytes():
            continue
        for cache_file in sorted((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ic]")):
            (copy.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy2(cache_file, copy.parent / "__pycache__")


def find_missing(packages: Sequence[str]) -> list[str]:
    """Return the packages of which some compiled functions are not in the cache yet.

    The next program that needs the missing functions would compile them. Packages in read-only
    folders are ignored.
    """
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
    """Split the packages into at most `count` groups of similar compilation time.

    If packages are compiled in the same process, the parts of Numba that all of them use are
    compiled only once.
    """
    files = {package: len(find_sources(package)) for package in packages}
    parts: list[list[str]] = [[] for _ in range(min(count, len(files)))]
    for package in sorted(files, key=files.get, reverse=True):
        min(parts, key=lambda part: sum(files[one] for one in part)).append(package)
    return [part for part in parts if part]


def main(argv: list[str] | None = None) -> int:
    """Compile the functions of packages, with one process per core; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="loops", description=__doc__.splitlines()[0],
        epilog=f"example: python -m {__name__} aras_visual_servo_camera",
    )  # fmt: skip
    parser.add_argument("packages", nargs="+", metavar="PACKAGE")
    parser.add_argument("--from", dest="folder", type=Path,
                        help="folder of the source packages from which compiled functions are "
                             "copied")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), metavar="N",
                        help="largest number of parallel processes (default: number of cores)")
    given = parser.parse_args(argv)
    found = [package for package in given.packages if _import_modules(package, given.folder)]
    # Forked processes share the modules that are already imported.
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
    """Import the modules of a package that define compiled functions, without compiling them.

    If there is a `folder`, `copy_cache` first copies compiled functions from it. If the package or
    one of its imports is missing, print the error and return False.
    """
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
    # Numba creates many objects. Garbage collection would take one eighth of the compilation time.
    gc.disable()
    for package in packages:
        compile_all(package)


if __name__ == "__main__":
    sys.exit(main())
