"""A user's controller: a camera that stands, an arm that carries the target before it.

    roslaunch ... scheme:=eye_to_hand:EyeToHand
"""

import numpy as np

from aras_visual_servo_controller import JointController, Need, Points, SchemeOutput

GAIN = 3.0  # 1/s


class EyeToHand(JointController):
    """q_dot = -gain (L J)^+ (s - s*), of the corners in the picture.

    J is the arm's Jacobian of the camera's motion before the target (robot.target_frame, or
    ~target_frame): it has the sign, for the target moves and the camera does not.
    """

    needs, output = frozenset((Need.CORNERS,)), "velocity"

    def __init__(self):
        self.corners = Points()
        self._describe()

    def _describe(self):
        self.names, self.tolerances = self.corners.names, self.corners.tolerances

    def check(self, goal):
        self.corners.check(goal)
        self._describe()  # as many corners as the goal has

    def teach(self, observation):
        return {"points": self.corners.teach(observation)}

    def reset(self, arm):
        super().reset(arm)
        self.velocities = np.zeros(len(arm.names))

    def process_image(self, observation, goal, t):
        found = self.corners.measure(observation, goal)
        J = self.arm.jacobian(observation.joints.positions)
        self.velocities = -GAIN * np.linalg.pinv(found.L @ J) @ found.error
        return SchemeOutput(self.names, found.s, found.desired, found.error, L=found.L)

    def update(self, t, dt, joints):
        return self.velocities
