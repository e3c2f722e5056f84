"""Files and folders that the page for contributors names exist."""

from __future__ import annotations

import re
from pathlib import Path

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


def test_what_the_page_names_is_there() -> None:
    # laws/delayed.py is what the reader is to write.
    missing = [path for path in PATHS if not place(path).exists()]
    assert missing == ["controller/laws/delayed.py"] and len(PATHS) > 20
