"""A user's scheme: image-based, of two cameras; the depth is theirs, by triangulation.

    roslaunch ... scheme:=stereo_ibvs:StereoIBVS
"""

from dataclasses import replace

import cv2
import numpy as np

from aras_visual_servo_controller import Points, RemoteCameraFeature, Stack, point_interaction


class StereoIBVS(Stack):
    """s = (x_l, y_l, ..., x_r, y_r, ...); neither plane nor model of the target is used in L."""

    def __init__(self):
        super().__init__(
            [RemoteCameraFeature(Points(), "left"), RemoteCameraFeature(Points(), "right")]
        )

    def measure(self, observation, goal):
        found = super().measure(observation, goal)  # numbered as in the goal
        left, right = observation.cameras["left"], observation.cameras["right"]
        in_left, in_right = np.split(found.s.reshape(-1, 2), 2)
        right_T_left = np.linalg.inv(right.world_T_camera) @ left.world_T_camera
        P_left, P_right = np.eye(3, 4), right_T_left[:3]
        X = cv2.triangulatePoints(P_left, P_right, in_left.T, in_right.T)  # (4, n), homogeneous
        places = (X[:3] / X[3]).T  # (n, 3), m, in the left
        in_the_right = places @ right_T_left[:3, :3].T + right_T_left[:3, 3]
        # Of each camera for its own twist, brought to the one twist that the loop decides.
        L_left = left.transform_to_control(point_interaction(in_left, 1.0 / places[:, 2]))
        L_right = right.transform_to_control(point_interaction(in_right, 1.0 / in_the_right[:, 2]))
        return replace(found, L=np.vstack([L_left, L_right]))
