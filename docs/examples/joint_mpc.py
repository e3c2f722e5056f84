"""Joint controller: model predictive control with the joint limits as constraints.

The error after k images is predicted as e(k) = e(0) + k T L J q_dot. The joint velocity q_dot is
constant over the horizon of N images and minimises sum |e(k)|^2 + r |q_dot|^2 within the limits of
velocity and position.
"""

import numpy as np
from scipy.optimize import lsq_linear

from aras_visual_servo_controller import FEATURES, JointController, MeasurementError, SchemeOutput

HORIZON, PERIOD, SPEED, EFFORT = 12, 1.0 / 30.0, 1.0, 1e-4


class JointMPC(JointController):
    """Predictive control of image moments and of the tilt of the camera."""

    output = "velocity"

    def __init__(self):
        self.feature = FEATURES.create("moments")
        self.needs, self.names = self.feature.needs, self.feature.names
        self.tolerances, self.units = self.feature.tolerances, self.feature.units

    def check(self, goal):
        self.feature.check(goal)
        self.up = goal.world_T_camera[2, :3]

    def reset(self, arm):
        super().reset(arm)
        self.velocities = np.zeros(len(arm.names))

    def process_image(self, observation, goal, t):
        if not observation.valid:
            raise MeasurementError(observation.reason)
        measured = self.feature.measure(observation, goal)
        q = observation.joints.positions
        tilt = np.cross(self.arm.pose(q)[2, :3], self.up)[:2]
        S = np.vstack([measured.L, 0.1 * np.eye(6)[3:5]]) @ self.arm.jacobian(q)
        error = np.concatenate([measured.error, 0.1 * tilt])
        steps = PERIOD * np.arange(1, HORIZON + 1)
        A = np.vstack([np.kron(steps[:, None], S), EFFORT * np.eye(len(q))])
        b = -np.concatenate([np.tile(error, HORIZON), np.zeros(len(q))])
        room = HORIZON * PERIOD
        low = np.maximum(np.minimum((self.arm.lower - q) / room, 0.0), -SPEED) - 1e-9
        high = np.minimum(np.maximum((self.arm.upper - q) / room, 0.0), SPEED) + 1e-9
        self.velocities = lsq_linear(A, b, (low, high)).x
        return SchemeOutput(self.names, measured.s, measured.desired, measured.error,
                        L=measured.L, ambiguity=measured.ambiguity)  # fmt: skip

    def update(self, t, dt, joints):
        return self.velocities
