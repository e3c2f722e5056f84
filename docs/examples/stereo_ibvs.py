"""A user's scheme: image-based, of two cameras; the depth is theirs, by triangulation.

    roslaunch ... scheme:=stereo_ibvs:StereoIBVS
"""

from dataclasses import replace

import numpy as np

from aras_visual_servo_base.poses import relative
from aras_visual_servo_controller.features import Stack
from aras_visual_servo_controller.features.of_camera import OfCamera
from aras_visual_servo_controller.features.points import Points, point_interaction
from aras_visual_servo_controller.features.stereo import triangulated


class StereoIBVS(Stack):
    """s = (x_l, y_l, ..., x_r, y_r, ...); neither plane nor model of the target is used in L."""

    def __init__(self):
        super().__init__([OfCamera(Points(), "left"), OfCamera(Points(), "right")])

    def measure(self, observation, goal):
        found = super().measure(observation, goal)  # numbered as in the goal
        left, right = observation.cameras["left"], observation.cameras["right"]
        in_left, in_right = np.split(found.s.reshape(-1, 2), 2)
        right_T_left = relative(right.world_T_camera, left.world_T_camera)
        places = triangulated(in_left, in_right, right_T_left)  # (n, 3), m, in the left
        in_the_right = places @ right_T_left[:3, :3].T + right_T_left[:3, 3]
        # Of each camera for its own twist, brought to the one twist that the loop decides.
        L_left = left.brought(point_interaction(in_left, 1.0 / places[:, 2]))
        L_right = right.brought(point_interaction(in_right, 1.0 / in_the_right[:, 2]))
        return replace(found, L=np.vstack([L_left, L_right]))
