"""The loop without physics and without pixels: a robot that lags, a camera that sees exactly.

Every joint follows its command as a first-order lag; the camera reports the exact moments of the
target's outline, late by a given time. Good for the unit tests and for trying a scheme or a gain
in milliseconds; what the simulator adds is the arm's dynamics and the camera's pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from aras_visual_servo_camera.moments import Moments

from .before.schemes.base import Measurement
from .before.servo import Servo, ServoCommand
from .kinematics import Kinematics
from .target import outline


@dataclass
class VirtualRobot:
    """Joints (6,) behind first-order lags, stepped at a fixed rate.

    Attributes:
        q: joint positions, m and rad.
        lag: time constant of every joint, s.
        step: of the simulation, s.
        image_period: s between exposures.
        stream_period: s between commands.
        latency: s by which commands are late.
    """

    q: np.ndarray
    lag: float = 0.04
    step: float = 1.0 / 600.0
    image_period: float = 1.0 / 30.0
    stream_period: float = 0.01
    latency: float = 0.01
    order: int = 3
    kinematics: Kinematics = field(default_factory=Kinematics)

    def measure(self, stamp: float) -> Measurement:
        """What an exact camera reports at the present joints."""
        view = outline(self.kinematics.pose(self.q))
        return Measurement(stamp, moments=Moments.from_polygon(view, self.order))

    def run(
        self,
        servo: Servo,
        duration: float,
        measure: Callable[[float], Measurement] | None = None,
        positions: Callable[[float, np.ndarray], np.ndarray | None] = lambda stamp, q: q,
    ) -> list[ServoCommand]:
        """Close the loop for duration (s) and return every command, one an image.

        Args:
            servo: the loop; its commands are streamed to the joints.
            duration: s to simulate, beginning at stamp 0.
            measure: replaces `self.measure`, to lose the target or to add noise.
            positions: what the joint sensors report, from the stamp and the true joints.
        """
        measure = measure if measure is not None else self.measure
        target = np.array(self.q, float)
        history: list[ServoCommand] = []
        decay = 1.0 - np.exp(-self.step / self.lag)
        every = max(1, round(self.image_period / self.step))
        stream = max(1, round(self.stream_period / self.step))
        for tick in range(round(duration / self.step)):
            now = tick * self.step
            if tick % stream == 0 and (streamed := servo.streamed(now - self.latency)) is not None:
                target = streamed
            if tick % every == 0:
                command = servo.step(measure(now), positions(now, self.q.copy()))
                history.append(command)
            self.q = self.q + decay * (target - self.q)
        return history
