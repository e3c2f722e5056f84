"""Temporary folders, which are deleted at the end of the process."""

from __future__ import annotations

import atexit
import shutil
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp


def make_scratch_folder() -> Path:
    """Make a temporary folder, which is deleted at the end of the process."""
    return Path(mkdtemp(dir=_make_root()))


@lru_cache(maxsize=1)
def _make_root() -> Path:
    folder = Path(mkdtemp(prefix="aras_targets_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
