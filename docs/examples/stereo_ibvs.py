"""Image-based scheme with two cameras, which triangulate the depth.

    roslaunch ... scheme:=stereo_ibvs:StereoIBVS
"""

from dataclasses import replace

import cv2
import numpy as np

from aras_visual_servo_controller import Points, RemoteCameraFeature, Stack, point_interaction


class StereoIBVS(Stack):
    """Points s = (x_l, y_l, ..., x_r, y_r, ...) with L from triangulated depths."""

    def __init__(self):
        super().__init__(
            [RemoteCameraFeature(Points(), "left"), RemoteCameraFeature(Points(), "right")]
        )

    def measure(self, observation, goal):
        measured = super().measure(observation, goal)  # in the order of the goal's points
        left, right = observation.cameras["left"], observation.cameras["right"]
        in_left, in_right = np.split(measured.s.reshape(-1, 2), 2)
        right_T_left = np.linalg.inv(right.world_T_camera) @ left.world_T_camera
        P_left, P_right = np.eye(3, 4), right_T_left[:3]
        X = cv2.triangulatePoints(P_left, P_right, in_left.T, in_right.T)  # (4, n), homogeneous
        points = (X[:3] / X[3]).T  # (n, 3) in the left camera, m
        in_the_right = points @ right_T_left[:3, :3].T + right_T_left[:3, 3]
        # Transform the L of each camera to the twist of the control camera.
        L_left = left.transform_to_control(point_interaction(in_left, 1.0 / points[:, 2]))
        L_right = right.transform_to_control(point_interaction(in_right, 1.0 / in_the_right[:, 2]))
        return replace(measured, L=np.vstack([L_left, L_right]))
