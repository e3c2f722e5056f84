"""The whole loop without ROS: physics, rendered pictures, moments, law, joint commands.

Everything runs in simulated time, so a run is the same on every machine and every time.
"""

from dataclasses import dataclass

import numpy as np
import yaml
from aras_robot import ROBOT, SOURCES, URDF, ArasRobot

from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_visual_servo_camera.images import Image
from aras_visual_servo_camera.pipeline import Pipeline
from aras_visual_servo_camera.pipeline import Settings as VisionSettings
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.before.schemes import Measurement
from aras_visual_servo_controller.before.servo import CONVERGED
from aras_visual_servo_controller.before.settings import Settings
from aras_visual_servo_controller.kinematics import JOINT_NAMES, pose_difference
from aras_visual_servo_controller.mounting import from_description

STREAM = 10  # ticks of 1 ms between commands, as between joint states
LATENCY = 15  # ticks from an exposure to its answer, as on a graph


@dataclass
class Result:
    """How a run went; stamps count from the first image.

    stamp: (n,) s. error: (n, 4) as the law saw it, m and rad. converged: at the end.
    distance, angle: of the camera from its goal at the end, m and rad.
    """

    stamp: np.ndarray
    error: np.ndarray
    converged: bool
    distance: float
    angle: float

    @property
    def settling_time(self) -> float:
        """When the error's norm falls below 2 % of its first value for good, s; inf if never."""
        norm = np.linalg.norm(self.error, axis=1)
        after = np.flatnonzero(norm > 0.02 * norm[0])[-1] + 1
        return float(self.stamp[after]) if after < len(norm) else np.inf


def run(camera: str, start: str, seconds: float = 5.0, urdf: str = URDF) -> Result:
    """Servo with a camera preset from an initial pose, for so long after the first image."""
    preset = yaml.safe_load((ROBOT / "config" / "cameras" / f"{camera}.yaml").read_text())
    robot = ArasRobot(
        Simulation(SimulationConfig(renderer="opengl")), urdf, {"labrob": {"camera": preset}}
    )
    try:
        return _Run(robot, start, urdf).until(seconds)
    finally:
        robot.close()


class _Run:
    def __init__(self, robot: ArasRobot, start: str, urdf: str) -> None:
        settings = Settings(start=start, package=SOURCES / "aras_visual_servo_controller")
        self.robot = robot
        self.servo = settings.build(from_description(urdf))
        self.camera = robot.simulation.cameras[0]
        info = self.camera.sensor.info
        self.pipeline = Pipeline(VisionSettings())
        self.pipeline.set_camera(
            CameraModel(info.width, info.height, tuple(np.ravel(info.K).tolist()),
                        tuple(map(float, info.D)), info.model)
        )  # fmt: skip
        self.pending = []
        self.camera.on_frame = lambda frame: self.pending.append((self.tick + LATENCY, frame))
        self.answers = []
        self.tick = 0

    def joints(self) -> np.ndarray:
        positions = self.robot.positions()
        return np.array([positions[name] for name in JOINT_NAMES])

    def until(self, seconds: float) -> Result:
        while not self.answers or self.answers[-1].stamp - self.answers[0].stamp < seconds:
            assert self.tick < 20_000, "no picture within 20 s"
            self.robot.simulation.step()
            self.tick += 1
            if self.tick % STREAM == 0:
                self.stream()
            if self.pending and self.pending[0][0] <= self.tick:
                self.answer(self.pending.pop(0)[1])
        answers = [a for a in self.answers if a.scheme_result is not None]
        assert len(answers) == len(self.answers), {a.reason for a in self.answers}
        kinematics = self.servo.resolver.kinematics
        goal = self.servo.scheme.desired.camera_pose
        distance, angle = pose_difference(goal, kinematics.pose(self.joints()))
        stamp = np.array([a.stamp for a in answers])
        error = np.array([a.scheme_result.error for a in answers])
        converged = answers[-1].phase == CONVERGED
        return Result(stamp - stamp[0], error, converged, distance, angle)

    def stream(self) -> None:
        now = self.tick * 1e-3
        if self.servo.approaching:
            self.robot.command(self.servo.joints(self.joints(), now).joint_commands)
            self.camera.enabled = not self.servo.approaching
        elif (streamed := self.servo.streamed(now)) is not None:
            self.robot.command(streamed)

    def answer(self, frame) -> None:
        seen = self.pipeline.measure(Image(frame.image, frame.encoding))
        measurement = Measurement(frame.stamp_ns * 1e-9, seen.valid, seen.reason, seen.moments)
        self.answers.append(self.servo.step(measurement, self.joints()))
