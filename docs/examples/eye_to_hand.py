"""Joint controller with a fixed camera and an arm that carries the target (eye-to-hand).

    roslaunch ... scheme:=eye_to_hand:EyeToHand
"""

import numpy as np

from aras_visual_servo_controller import JointController, Need, Points, SchemeOutput

GAIN = 3.0  # 1/s


class EyeToHand(JointController):
    """Image-based control law q_dot = -gain (L J)^+ (s - s*) for the corners in the image.

    J is the Jacobian of the camera's motion relative to the target, whose link is set by
    robot.target_frame or ~target_frame. J has the right sign, because the camera is fixed and the
    target moves.
    """

    needs, output = frozenset((Need.CORNERS,)), "velocity"

    def __init__(self):
        self.corners = Points()
        self._update_names()

    def _update_names(self):
        self.names, self.tolerances = self.corners.names, self.corners.tolerances

    def check(self, goal):
        self.corners.check(goal)
        self._update_names()  # the goal determines the number of corners

    def teach(self, observation):
        return {"points": self.corners.teach(observation)}

    def reset(self, arm):
        super().reset(arm)
        self.velocities = np.zeros(len(arm.names))

    def process_image(self, observation, goal, t):
        measured = self.corners.measure(observation, goal)
        J = self.arm.jacobian(observation.joints.positions)
        self.velocities = -GAIN * np.linalg.pinv(measured.L @ J) @ measured.error
        return SchemeOutput(self.names, measured.s, measured.desired, measured.error, L=measured.L)

    def update(self, t, dt, joints):
        return self.velocities
