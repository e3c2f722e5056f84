"""Compile the Numba functions of packages before the first start of a program needs them.

    python -m aras_visual_servo_base.compile_packages [--from FOLDER] [--processes N] PACKAGE...

With `--from`, compiled functions are copied from the packages in FOLDER instead of compiled, if the
file that defines them is the same there. The installation of the workspace uses this to copy the
functions that were compiled for the source packages.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import importlib
import importlib.util
import logging
import multiprocessing
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Sequence
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple

from .compiled import import_numba, list_functions, uncached_reasons, warn_uncached
from .errors import NumbaUnavailableError

IMPORTS_JIT = re.compile(r"^from .*compiled import .*\bjit\b", re.MULTILINE)


def find_sources(package: str) -> list[Path]:
    """Return the files of a package that define compiled functions.

    The paths are relative to the folder that contains the package.

    Raises:
        ModuleNotFoundError: the package does not exist.
    """
    parent = find_folder(package)
    files = sorted((parent / package).rglob("*.py"))
    return [path.relative_to(parent) for path in files if IMPORTS_JIT.search(path.read_text())]


def find_folder(package: str) -> Path:
    """Return the folder that contains a package.

    Raises:
        ModuleNotFoundError: the package does not exist.
    """
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError(
            f"there is no package {package} on PYTHONPATH; build and source the workspace"
        )
    return Path(found.submodule_search_locations[0]).parent


def copy_cache(package: str, folder: Path) -> None:
    """Copy compiled functions of a package from another copy of the package.

    A file is skipped if its text differs between the two copies. For equal files, Numba accepts the
    compiled functions in any folder.

    Args:
        package: name of the package to whose caches the functions are copied.
        folder: folder that contains the other copy.
    """
    parent = find_folder(package)
    for path in find_sources(package):
        source, copy = folder / path, parent / path
        if source == copy or not source.exists() or source.read_bytes() != copy.read_bytes():
            continue
        for cache_file in sorted((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ic]")):
            (copy.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy2(cache_file, copy.parent / "__pycache__")


def find_missing(packages: Sequence[str]) -> list[str]:
    """Return the packages of which some compiled functions are not in the cache yet.

    The next program that needs the missing functions would compile them. Packages whose functions
    cannot be cached are ignored.
    """
    missing = []
    for package in packages:
        for path in find_sources(package):
            folder = find_cache_folder((find_folder(package) / path).parent)
            if folder is not None and not any(folder.glob(f"{path.stem}.*.nbi")):
                missing.append(package)
                break
    return missing


def find_cache_folder(sources: Path) -> Path | None:
    """Return the folder in which Numba caches the functions of the files in `sources`.

    It is the first writable folder of these: a folder in NUMBA_CACHE_DIR, __pycache__ next to the
    files, and a folder in the user's cache. The result is None if none of them is writable.
    """
    name = f"{sources.name}_{hashlib.sha1(str(sources).encode()).hexdigest()}"
    user_cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folders = [sources / "__pycache__", Path(user_cache, "numba", name)]
    if os.environ.get("NUMBA_CACHE_DIR"):
        folders.insert(0, Path(os.environ["NUMBA_CACHE_DIR"], name))
    return next((folder for folder in folders if _can_write(folder)), None)


def _can_write(folder: Path) -> bool:
    """Return whether files can be created in a folder, which need not exist yet."""
    existing = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    return existing.is_dir() and os.access(existing, os.W_OK)


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
        prog="compile_packages", description=__doc__.splitlines()[0],
        epilog=f"example: python -m {__name__} aras_visual_servo_camera",
    )  # fmt: skip
    parser.add_argument("packages", nargs="+", metavar="PACKAGE")
    parser.add_argument("--from", dest="folder", type=Path,
                        help="folder of the source packages from which compiled functions are "
                             "copied")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), metavar="N",
                        help="largest number of parallel processes (default: number of cores)")
    given = parser.parse_args(argv)
    if given.processes < 1:
        parser.error(f"--processes is {given.processes}, must be 1 or more")
    faults, uncached = compile_packages(given.packages, given.processes, given.folder)
    for fault in faults:
        print(f"{parser.prog}: {fault}", file=sys.stderr)
    if uncached:
        warn_uncached(uncached)
    return int(bool(faults or uncached))


class CompilationResult(NamedTuple):
    """Result of a compilation: what has failed.

    Attributes:
        faults: one line of text for each missing package and each failed process.
        uncached: reason why compiled functions cannot be cached; '' if they are cached. The
            compilation ends at the first function that cannot be cached.
    """

    faults: list[str]
    uncached: str


def compile_packages(
    packages: Sequence[str], processes: int, folder: Path | None = None,
    report: Callable[[float], None] = lambda fraction: None,
) -> CompilationResult:  # fmt: skip
    """Compile all functions of packages in parallel processes, or load them from the cache.

    Args:
        processes: largest number of processes.
        folder: folder of the source packages, whose compiled functions are copied first.
        report: function that is called with the compiled fraction, 0 to 1.
    """
    try:
        import_numba()  # import Numba before the fork, so that the processes share it
        missing = {package: _import_modules(package, folder) for package in packages}
    except NumbaUnavailableError as error:
        return CompilationResult([str(error)], "")
    faults = [fault for fault in missing.values() if fault]
    found = [package for package, fault in missing.items() if not fault]
    count = sum(len(list_functions(package)) for package in found)
    fork = multiprocessing.get_context("fork")
    running: dict[Connection, tuple[BaseProcess, list[str]]] = {}
    done, uncached = 0, ""
    try:
        for part in split_packages(found, processes):
            receiver, sender = fork.Pipe(duplex=False)
            process = fork.Process(target=_compile, args=(part, sender))
            process.start()
            sender.close()
            running[receiver] = process, part
        while running:
            for receiver in connection.wait(list(running)):
                try:
                    uncached = receiver.recv() or uncached
                    done += 1
                    report(done / count)
                except EOFError:
                    process, part = running.pop(receiver)
                    process.join()
                    if process.exitcode:
                        faults.append(f"compiling {', '.join(part)} failed")
                    if process.exitcode == -signal.SIGKILL:
                        faults[-1] += (
                            ": the process was killed, probably because of too little memory"
                        )
    finally:
        # After an exception, some processes are still running and must be ended.
        for process, _ in running.values():
            process.terminate()
    return CompilationResult(faults, uncached)


def _import_modules(package: str, folder: Path | None) -> str:
    """Import the modules of a package that define compiled functions, without compiling them.

    If there is a `folder`, `copy_cache` first copies compiled functions from it. Return a message
    if the package or one of its imports is missing, otherwise ''.
    """
    try:
        if folder:
            copy_cache(package, folder)
        for path in find_sources(package):
            importlib.import_module(".".join(path.with_suffix("").parts))
    except ModuleNotFoundError as error:
        return str(error)
    return ""


def _compile(packages: Sequence[str], sender: Connection) -> None:
    """Compile packages; for each function, send a text through `sender`.

    The text is '', or the reason why the function cannot be cached.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the process without a traceback
    # the parent process already reports functions that cannot be cached
    logging.disable(logging.WARNING)
    # Discard reasons that this process has inherited from its parent by the fork.
    uncached_reasons.clear()
    # Numba creates many objects, and garbage collection would take one eighth of the compilation
    # time.
    gc.disable()
    for package in packages:
        for function in list_functions(package):
            function.compile()
            sender.send("; ".join(uncached_reasons))
            if uncached_reasons:
                return


if __name__ == "__main__":
    sys.exit(main())
