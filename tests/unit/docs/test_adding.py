"""Files and folders that the page for contributors names exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from blocks import ROOT

PAGE = (ROOT / "docs" / "adding.md").read_text(encoding="utf-8")
PACKAGES = {
    "controller": "aras_visual_servo_controller", "camera": "aras_visual_servo_camera",
    "bridge": "aras_sim_bridge", "bench": "aras_visual_servo_bench",
}  # fmt: skip
PATHS = sorted(set(re.findall(r"`([a-z]\w*/[\w/.]*(?:/|\.py))`", PAGE)))


def place(path: str) -> Path:
    """Return the file or folder that a path in the page denotes."""
    head, _, rest = path.partition("/")
    package = PACKAGES.get(head, head)
    places = (ROOT / "src" / package / "src" / package / rest, ROOT / "tests" / "unit" / path)
    return next((at for at in places if at.exists()), ROOT / path)


@pytest.mark.parametrize("path", PATHS)
def test_what_the_page_names_is_there(path: str) -> None:
    # laws/delayed.py is what the reader is to write.
    assert path == "controller/laws/delayed.py" or place(path).exists()


def test_the_page_names_a_place_for_each_kind() -> None:
    assert len(PATHS) > 20
