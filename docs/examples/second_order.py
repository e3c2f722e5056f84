"""Joint controller: second-order law that computes joint accelerations at every control cycle.

    e_ddot = -2 d w e_dot - w^2 e,   q_ddot = (S J)^+ (e_ddot of features and attitude)
"""

import numpy as np

from aras_visual_servo_controller import FEATURES, JointController, MeasurementError, SchemeOutput

FREQUENCY, DAMPING = 6.0, 1.0  # rad/s, critical


class SecondOrder(JointController):
    """Second-order control of image moments and of the tilt of the camera."""

    output = "acceleration"

    def __init__(self):
        self.feature = FEATURES.create("moments")
        self.needs, self.names = self.feature.needs, self.feature.names
        self.tolerances, self.units = self.feature.tolerances, self.feature.units

    def check(self, goal):
        self.feature.check(goal)
        self.up = goal.world_T_camera[2, :3]  # the vertical, in the camera's frame at the goal

    def reset(self, arm):
        super().reset(arm)
        self.error = None

    def process_image(self, observation, goal, t):
        if not observation.valid:
            raise MeasurementError(observation.reason)
        measured = self.feature.measure(observation, goal)
        self.error, self.L = measured.error.copy(), measured.L
        return SchemeOutput(self.names, measured.s, measured.desired, measured.error,
                        L=measured.L, ambiguity=measured.ambiguity)  # fmt: skip

    def update(self, t, dt, joints):
        q, q_dot = joints.positions, joints.velocities
        twist = self.arm.jacobian(q) @ q_dot
        self.error = self.error + self.L @ twist * dt  # prediction between images
        tilt = np.cross(self.arm.pose(q)[2, :3], self.up)[:2]  # tilt about x and y
        S = np.vstack([self.L, 0.1 * np.eye(6)[3:5]])
        error = np.concatenate([self.error, 0.1 * tilt])
        desired_rate = -2.0 * DAMPING * FREQUENCY * (S @ twist) - FREQUENCY**2 * error
        task = np.linalg.pinv(S @ self.arm.jacobian(q), rcond=0.002)
        idle = np.eye(len(q)) - task @ (S @ self.arm.jacobian(q))
        return task @ desired_rate - idle @ (2.0 * DAMPING * FREQUENCY * q_dot)
