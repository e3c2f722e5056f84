"""A restarted loop behaves bit-identically to a new loop.

What a run's plant answers is kept on a tape and played to a loop again: everything that it sends,
reports and says is compared with a new loop's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from recorded_values import values

from aras_visual_servo_base.poses import exponential, matrix_from_xyz_rpy, xyz_rpy_from_matrix
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import Assembly, assemble
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.runner.loop_runner import LoopRunner

SHAPE = [[-0.025, -0.03], [0.03, -0.025], [0.025, 0.02], [-0.015, 0.025]]
LEFT = {"width": 160, "height": 120, "update_rate": 30.0,
        "camera_matrix": {"fx": 150.0, "fy": 140.0, "cx": 83.0, "cy": 57.5}}  # fmt: skip
RIGHT = {"width": 168, "height": 128, "update_rate": 20.0,
         "camera_matrix": {"fx": 130.0, "fy": 145.0, "cx": 75.0, "cy": 62.5}}  # fmt: skip
CAMERAS = {"left": {"model": LEFT, "xyz": [0.01, 0.02, 0.0]},
           "right": {"model": RIGHT, "xyz": [0.02, -0.03, 0.0], "rpy": [0.1, -0.03, 0.12]}}
GOAL = matrix_from_xyz_rpy((0.01, -0.02, -0.2), (0.05, -0.08, 0.3))
JOINTS, START = [0.05, 0.0, -0.09, 0.045, 0.045, 0.0], [0.03, 0.0, -0.05, 0.03, 0.03, 0.15]


def posed(pose):
    xyz, rpy = xyz_rpy_from_matrix(pose)
    return {"pose": [*xyz, *rpy]}


ARM = {"plant": "chain", "goal": JOINTS, "start": START, "duration": 0.8, "gain": 2.0}
NEAR = posed(GOAL @ exponential((0.01, 0.005, -0.03, 0.02, 0.03, 0.2)))
TWO = {"plant": "free", "features": "exact", "target": {"shape": SHAPE}, "cameras": CAMERAS,
       "goal": posed(GOAL), "start": NEAR, "duration": 0.8, "gain": 2.0}  # fmt: skip
SOLID = {"shape": "block.obj", "pose": [0, 0, 0.5905, 0, 0, 0.3]}
CASES: dict[str, dict[str, Any]] = {
    "moments, late": {**ARM, "scheme": "moments", "delay": 0.05},
    "points, PI law, ramp, smoothing": {
        **ARM, "scheme": "points", "law": "pi",
        "controller_parameters": {"ramp": 0.3, "smoothing": 0.1}},
    "kernel, PI law, continuous start": {
        **ARM, "scheme": "kernel", "features": "images", "law": "pi",
        "controller_parameters": {"continuous_start": 4.0}},
    "numbered points, estimated L": {
        **ARM, "scheme": "numbered_points", "controller_parameters": {"interaction": "estimated"}},
    "predictive": {**ARM, "scheme": "predictive"},
    "laboratory's": {**ARM, "scheme": "moments_2016"},
    "partitioned": {**ARM, "scheme": "partitioned"},
    "pose, from a start": {**ARM, "scheme": "pose", "controller_parameters": {
        "start": "2016", "singularity_avoidance": True}},
    "luminance": {**ARM, "scheme": "luminance", "features": "images"},
    "two cameras": {**TWO, "scheme": "moments@left+points@right"},
    "stereo": {**TWO, "scheme": "stereo_points@left,right"},
    "answers joints": {**ARM, "scheme": "joint_mpc:JointMPC"},
    "a known mesh": {**ARM, "scheme": "model", "target": SOLID},
}  # fmt: skip


@dataclass
class Tape:
    """A world that answers what it answered once: joint states and images in their order, by a
    clock (s); and what the loop sent and reported of it."""

    readings: list[Any]
    time: float = 0.0
    trace: list[Any] = field(default_factory=list)

    def send(self, command) -> None:
        self.trace.append(("sent", command))

    def report(self, state) -> None:
        self.trace.append(("reported", state))

    def log(self, text) -> None:
        if "restarting the loop" not in text:
            self.trace.append(("said", text))

    def play(self, parts: Assembly, driver: LoopRunner, readings=None) -> list[Any]:
        """Process all readings with the driver, and return its outputs."""
        self.trace = []
        for reading in self.readings if readings is None else readings:
            self.time = max(self.time, reading.stamp)
            if isinstance(reading, Frame):
                look = partial(parts.observe, reading)
                driver.add_image(reading.stamp, look, reading.name)
            else:
                driver.add_joint_state(
                    reading.names, reading.positions, reading.velocities, reading.stamp)
        return self.trace


def experiment_of(name: str, folder: Path) -> Experiment:
    given = dict(CASES[name])
    if given.get("target") is SOLID:
        path = folder / "block.obj"
        corners = [(x, y, z) for z in (0, 0.06) for y in (-0.025, 0.025) for x in (-0.04, 0.04)]
        sides = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "2 4 8 6", "4 3 7 8", "3 1 5 7"]
        path.write_text("\n".join(
            [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {side}" for side in sides]) + "\n")
        given["target"] = {**SOLID, "shape": str(path)}
    return Experiment.from_mapping(given)


@pytest.fixture(scope="module", params=list(CASES))
def recorded(request, tmp_path_factory):
    """An experiment, and the readings of a run of it."""
    experiment = experiment_of(request.param, tmp_path_factory.mktemp("solid"))
    made = assemble(experiment)
    readings: list[Any] = []
    advance = made.plant.advance

    def kept(until_ns):
        for reading in advance(until_ns):
            readings.append(reading)
            yield reading

    made.plant.advance, made.plant.attach_loop = kept, lambda *given: None
    loop = Loop(experiment, made)
    loop.run_to_end()
    loop.close()
    assert sum(isinstance(r, Frame) for r in readings) > 20
    return experiment, sorted(readings, key=lambda reading: reading.stamp)


def new(recorded) -> tuple[Assembly, Tape, LoopRunner]:
    experiment, readings = recorded
    made, tape = assemble(experiment), Tape(readings)
    made.plant.close()
    return made, tape, LoopRunner(made.servo, made.rig, made.settings, tape,
                                  clock=lambda: tape.time, wall_clock=lambda: 0.0)  # fmt: skip


def busy(made: Assembly, tape: Tape, driver: LoopRunner) -> None:
    """Stopped and started, starved, jumped, held, stopped in an emergency, late."""
    half = len(tape.readings) // 2
    first, second = tape.readings[:half], tape.readings[half:]
    tape.play(made, driver, first)
    driver.stop("for a while")
    tape.play(made, driver, second[:9])
    driver.start()
    made.servo.mark_joint_jump()
    tape.play(made, driver, second[9:30])
    driver.hold("held")
    tape.time += 1.5
    driver.check_timeouts()
    driver.emergency_stop(True)
    driver.start()
    tape.play(made, driver, second[30:])
    tape.time += 3.0
    driver.check_timeouts()
    driver.start()  # one that was stopped stays so when time goes back


def test_after_the_clock_has_gone_back(recorded):
    made, tape, driver = new(recorded)
    busy(made, tape, driver)
    tape.time = 0.0
    driver.check_timeouts()  # finds that the clock went back
    other, blank, fresh = new(recorded)
    fresh.check_timeouts()
    again, first = tape.play(made, driver), blank.play(other, fresh)
    assert len(first) > 20
    for mine, expected in zip(again, first, strict=True):
        assert values(mine) == values(expected)
