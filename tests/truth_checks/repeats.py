"""Determinism: two processes must give bit-identical runs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from .check import Row, check

_RUN = """
import hashlib
import sys
sys.path[:0] = {paths!r}
from truth_checks.joints import ArasRobot
from aras_sim_bridge.simulation import Simulation, SimulationConfig
robot = ArasRobot(Simulation(SimulationConfig(seed=3)),
                  cameras={{"labrob": {{"camera": {{"effects": {{"noise_stddev": 3.0}}}}}}}})
digest = hashlib.sha256()
pictures = []
for camera in robot.simulation.cameras:
    camera.enabled = True
    camera.on_frame = lambda frame: pictures.append(frame.image.tobytes())
for k in range(400):
    if k == 50:
        robot.command((0.1, 0.1, 0.2, -0.1, -0.1, 0.3))
    robot.steps(1)
    digest.update(repr(robot.model.read_joints()[:2]).encode())
assert len(set(pictures)) > 8, len(pictures)
for picture in pictures:
    digest.update(picture)
print("digest", digest.hexdigest())
"""


@check("another process")
def determinism() -> Iterator[Row]:
    """Compare hashes of 400 steps with controllers, images and noise from two processes."""
    tests = Path(__file__).parents[1]
    paths = [str(tests), *map(str, tests.parent.glob("src/*/src"))]
    digests = set()
    for _ in range(2):
        out = subprocess.run([sys.executable, "-c", _RUN.format(paths=paths)], check=True,
                             capture_output=True, text=True, timeout=120).stdout
        digests.add(out.split("digest ")[-1].strip())
    yield Row("joints and images", "bit-identical", len(digests) - 1.0, 0.0, "differences")
