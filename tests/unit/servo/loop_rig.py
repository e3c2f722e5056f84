"""Closed loop without physics and images: lagging joints and a camera with exact features."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from aras_visual_servo_base.poses import exponential, pose_difference
from aras_visual_servo_controller import CameraModel, Goal, JointSample, Moments, Servo, Task
from aras_visual_servo_controller.kinematics import Arm, CommandLimits, DifferentialIK, PostureTask
from aras_visual_servo_controller.kinematics.elbow import find_elbows
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.laws import Law, Proportional
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.records.state import JointCommand, ServoSettings, ServoState
from aras_visual_servo_controller.schemes import JointController, Scheme, create_scheme
from aras_visual_servo_controller.schemes.base import SchemeOutput

SOURCES = Path(__file__).parents[3] / "src"
URDF = SOURCES / "aras_visual_servo_gazebo" / "robots" / "aras_visual_servo.urdf"
PACKAGE = SOURCES / "aras_visual_servo_controller"
CONFIG = PACKAGE / "config"
CAMERA = CameraModel(320, 240, (102.73, 0, 159.5, 0, 102.73, 119.5, 0, 0, 1))
STARTS = {
    "2015": (0.1, 0.0, *np.radians([10.0, -5.0, -5.0, 0.0]).tolist()),
    "2016": (-0.1, 0.0, *np.radians([20.0, -15.0, -5.0, 10.0]).tolist()),
}
IMAGE_PERIOD = 1.0 / 30.0
TICK = 0.01


@cache
def the_arm() -> Arm:
    return Arm.from_urdf(URDF.read_text())


@cache
def the_goal(year: str) -> Goal:
    return Goal.load(CONFIG / f"goal_{year}.yaml").for_arm(the_arm())


def the_limits(**given) -> CommandLimits:
    return CommandLimits.for_arm(the_arm(), **{"velocity": (1.0, 2.0, 2.0, 2.0, 2.0, 2.0), **given})


def the_servo(
    year: str = "2016",
    scheme: str | Scheme | JointController = "moments",
    law: Law | None = None,
    goal: Goal | None = None,
    limits: CommandLimits | None = None,
    clock: Callable[[], float] | None = None,
    options: dict | None = None,
    ik: type[DifferentialIK] = DifferentialIK,
    **settings,
) -> Servo:
    """Return a loop as the controller node makes it."""
    arm = the_arm()
    if isinstance(scheme, str):
        scheme = create_scheme(scheme, law or Proportional(5.0), **(options or {}))
    limits = limits or the_limits()
    resolver = ik(arm, limits, [PostureTask(arm, {"J1": 0.0})], elbows=find_elbows(arm, {"J3": -1}))
    return Servo(scheme, arm, goal or the_goal(year), resolver, ServoSettings(**settings), clock)


@dataclass
class Rig:
    """Closed loop of joints (6,) with first-order lags and a camera with exact features.

    Attributes:
        servo: the loop. q: joints, rad and m. lag: time constant of every joint, s.
        latency: s from an exposure to when the loop sees it.
        friction: (6,) a joint does not move while its command is nearer than this.
        look: makes an observation at (observer, stamp, joints); replace it to spoil it.
        believe: what the joint sensors report of the true joints (6,).
        target: where the joints are led to, rad and m.
        next_tick, next_image: when the loop is called and the camera exposes next, s.
    """

    servo: Servo
    q: np.ndarray
    lag: float = 0.03
    latency: float = 0.0
    step: float = 1.0 / 600.0
    friction: float | np.ndarray = 0.0
    look: Callable[[FeatureObserver, float, JointSample], Observation] | None = None
    believe: Callable[[float, np.ndarray], np.ndarray] = lambda t, q: q
    image_period: float = IMAGE_PERIOD
    states: list[ServoState] = field(default_factory=list)
    commands: list[JointCommand] = field(default_factory=list)
    joints: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.q = np.array(self.q, float)
        self.observer = FeatureObserver(
            self.servo.arm, self.servo.scheme.needs, compute_plane=self.servo.goal.compute_plane)
        self.now = 0.0
        self.target, self._speed = self.q.copy(), np.zeros(len(self.q))
        self._pending: list[Observation] = []
        self.next_tick = self.next_image = 0.0

    def sample(self, stamp: float, q: np.ndarray | None = None) -> JointSample:
        """Return joints that stand still where they are, or at q (6,)."""
        return JointSample.from_values(stamp, self.servo.arm.names, self.q if q is None else q)

    def exact(self, observer: FeatureObserver, stamp: float, joints: JointSample) -> Observation:
        contour = self.servo.goal.target.compute_outline(self.servo.arm.pose(self.q))
        return observer.observe_exact_features(stamp, CAMERA, joints, contour=contour)

    def show(self, stamp: float, joints: JointSample | None = None, /, **changes) -> ServoState:
        """Process an exact image of this stamp, of which some fields are changed."""
        seen = self.exact(self.observer, stamp, joints or self.sample(stamp))
        return self.servo.process_image(replace(seen, **changes))

    def lose(self, after: float, until: float = np.inf, reason: str = "gone", touches=()) -> None:
        """Lose the target from a time (s) on until another."""
        plain = self.look or self.exact

        def look(observer, t, joints):
            seen = plain(observer, t, joints)
            return lost(seen, reason, touches) if after <= t < until else seen

        self.look = look

    def answer(self, stamp: float) -> ServoState:
        """Call the loop with joints and an image of one stamp."""
        self.servo.update(stamp, self.sample(stamp))
        return self.show(stamp)

    def run(self, seconds: float) -> list[ServoState]:
        """Continue for this time; return all states since the start."""
        end = self.now + seconds
        names = self.servo.arm.names
        look = self.look or self.exact
        while self.now < end - 1e-9:
            ticks, looks = (self.now >= due - 1e-9 for due in (self.next_tick, self.next_image))
            if ticks or looks:
                believed = self.believe(self.now, self.q)
                seen = JointSample.from_values(self.now, names, believed, self._speed)
            if ticks:
                self.next_tick += TICK
                command = self.servo.update(self.now, seen)
                self.commands.append(command)
                self.joints.append(self.q.copy())
                if command.positions is not None:
                    self.target = command.positions
            if looks:
                self.next_image += self.image_period
                self._pending.append(look(self.observer, self.now, seen))
            while self._pending and self._pending[0].stamp + self.latency <= self.now + 1e-9:
                self.states.append(self.servo.process_image(self._pending.pop(0)))
            way = self.target - self.q
            moved = np.where(np.abs(way) > self.friction, way, 0.0)
            step = (1.0 - np.exp(-self.step / self.lag)) * moved
            self.q, self._speed = self.q + step, step / self.step
            self.now += self.step
        return self.states

    @property
    def missed(self) -> tuple[float, float]:
        """Return distance (m) and angle (rad) of the camera from its goal."""
        return pose_difference(self.servo.goal.world_T_camera, self.servo.arm.pose(self.q))


def lost(observation: Observation, reason: str, touches: tuple[str, ...] = ()) -> Observation:
    return replace(observation, valid=False, reason=reason, moments=None, contour=None,
                   corners=None, touched_borders=touches)  # fmt: skip


def scaled(moments: Moments, factor: float) -> Moments:
    """Return moments as measured with a focal length that is wrong by this factor."""
    n = np.add.outer(*(np.arange(moments.order + 1),) * 2) + 2
    centred = moments.centred * factor**n
    return Moments(moments.order, moments.kind, moments.m00 * factor**2, moments.xg * factor,
                   moments.yg * factor, centred)  # fmt: skip


def an_output(error, L=None, modelled=None, **more) -> SchemeOutput:
    """Return a scheme's output with an error (k,) and its L (k, 6), which a task controls in the
    directions `modelled` (6,)."""
    error = np.asarray(error, float)
    L = None if L is None else np.asarray(L, float)
    task = None if modelled is None else Task(L, np.zeros(len(L)), np.array(modelled))
    names = more.pop("names", ("",) * len(error))
    return SchemeOutput(names, error, np.zeros_like(error), error, task, L, **more)


def an_image(stamp, dt, motion=None, **more) -> Observation:
    """Return the observation of a camera that moved by a twist (6,) in one second since the image
    before."""
    previous = None if motion is None else exponential(motion)
    return Observation(stamp, dt, True, "", CAMERA, previous_T_camera=previous, **more)


def a_solution(jacobian) -> IKSolution:
    """Return the joint velocities of an arm at rest, with its jacobian (6, n)."""
    still = np.zeros(np.shape(jacobian)[1])
    return IKSolution(still, still, *np.zeros((3, 6)), 1.0, still, (), "", (), np.eye(6),
                      np.asarray(jacobian), np.full(6, True))


class TolerantScheme(Scheme):
    def __init__(self, tolerances, accuracy=None):
        self.tolerances, self.units = tolerances, ("",) * len(tolerances)
        self.feature_accuracy = accuracy

    def accuracy(self, observation, goal):
        return self.feature_accuracy

    def compute(self, observation, goal):
        raise AssertionError("no image is processed")


CORNERS = np.array([[-0.10, -0.05], [0.12, -0.04], [0.08, 0.06], [-0.03, 0.09]])


def moments_of(corners) -> Moments:
    return Moments.from_polygon(np.asarray(corners), 4)


def picture(outline) -> np.ndarray:
    """Draw a target with soft edges, as CAMERA sees it (240, 320)."""
    pixels = outline * [CAMERA.K[0], CAMERA.K[4]] + [CAMERA.K[2], CAMERA.K[5]]
    fixed = np.round(((pixels + 0.5) * 8 - 0.5) * 256.0).astype(np.int32)
    fine = np.full((240 * 8, 320 * 8), 250, np.uint8)
    cv2.fillPoly(fine, [fixed], 5, shift=8)
    return cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA)
