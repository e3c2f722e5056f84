"""World file of the workbench is equal to the output of its script."""

import sys
from pathlib import Path

import cv2
import make_workbench
import numpy as np
from robot_figures import PACKAGE

WORLD = PACKAGE / "world"


def names(folder: Path) -> list[str]:
    found = [folder / "workbench.world", *(folder / "workbench").iterdir()]
    return sorted(str(path.relative_to(folder)) for path in found)


def test_files_are_what_the_script_draws(tmp_path, monkeypatch):
    """Pictures to two grey levels: a sine's last digit is the processor's."""
    monkeypatch.setattr(sys, "argv", ["make_workbench.py", "--out", str(tmp_path)])
    kept = cv2.imwrite  # as small as can be takes two seconds, and tells nothing here
    monkeypatch.setattr(cv2, "imwrite", lambda path, picture, how: kept(
        path, picture, how if path.endswith("jpg") else [cv2.IMWRITE_PNG_COMPRESSION, 0]))
    make_workbench.main()
    assert names(tmp_path) == names(WORLD)
    for name in names(WORLD):
        drawn, shipped = tmp_path / name, WORLD / name
        if drawn.suffix in (".png", ".jpg"):
            one, other = (cv2.imread(str(path)).astype(int) for path in (drawn, shipped))
            assert one.shape == other.shape and np.abs(one - other).max() <= 2, name
        else:
            assert drawn.read_bytes() == shipped.read_bytes(), name
