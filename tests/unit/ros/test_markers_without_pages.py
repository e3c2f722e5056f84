"""The markers for rviz do not need the web pages; their folder may be deleted."""

from __future__ import annotations

import json
import subprocess
import sys

SCRIPT = """
import importlib, json, sys
given = json.loads(sys.argv[1])
sys.path = given["search"]
for name, folders in given["packages"].items():
    importlib.import_module(name).__path__[:] = folders
sys.modules["aras_visual_servo_bench.web"] = None  # cannot be imported, nor what is below it
import numpy as np
from aras_visual_servo_bench.visualization.drawing_shapes import make_axes
from aras_visual_servo_bench.ros.rviz_markers import make_markers
shapes = make_axes("camera", np.eye(4), 0.1)
print(sorted(marker.ns for marker in make_markers(shapes, "base", set()).markers))
"""


def test_rviz_markers_are_made_without_pages() -> None:
    packages = {name: list(module.__path__) for name, module in sys.modules.items()
                if name.startswith("aras_") and "." not in name
                and hasattr(module, "__path__")}  # with generated messages
    given = json.dumps({"search": sys.path, "packages": packages})
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, given], capture_output=True, text=True, timeout=60
    )
    assert done.stdout == "['camera x', 'camera y', 'camera z']\n", done.stderr
