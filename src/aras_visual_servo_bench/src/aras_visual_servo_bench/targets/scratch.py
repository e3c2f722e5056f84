"""Folders for files that are made for one process alone."""

from __future__ import annotations

import atexit
import shutil
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp


def make_scratch_folder() -> Path:
    """A new folder, which goes with the process."""
    return Path(mkdtemp(dir=_make_root()))


@lru_cache(maxsize=1)
def _make_root() -> Path:
    folder = Path(mkdtemp(prefix="aras_targets_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
