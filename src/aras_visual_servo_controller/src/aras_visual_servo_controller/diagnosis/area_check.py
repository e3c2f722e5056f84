"""Check of the visible area of the target: occlusions, jumps of its centre, and its distance."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..goals.goal import Goal
from ..observation.observation import Observation


class AreaCheck:
    """Check of the target's visible area and centre from image to image.

    The area is corrected for the distance of the camera from the target, which follows from
    kinematics.

    Attributes:
        occluded_since: time at which a part of the target inside the image became invisible, s;
            None if no part is hidden.
    """

    # Smallest motion between two images that is a jump of the target's centre, normalised.
    MIN_CENTRE_JUMP = 0.02
    # Something covers the target if at least this fraction of its area disappears between two
    # images and stays invisible for HIDDEN_IMAGES images. The fraction also has to exceed
    # DEVIATION_FACTOR times the usual change of the area.
    MIN_HIDDEN_PART, HIDDEN_IMAGES, DEVIATION_FACTOR = 0.06, 5, 8.0
    MEMORY = 0.9  # weight of the old value in the running means of the area and its change
    # The areas of the target in two images are compared only if the squared distance between camera
    # and target changes by less than this fraction between the images.
    MAX_DISTANCE_CHANGE = 0.2
    # An occlusion is not searched for if the target's predicted area, relative to the area at the
    # goal, is below this. The camera is then more than 100 times as far from the target as at the
    # goal.
    MIN_PREDICTED_AREA = 1e-4
    # The centre jumps if it did so in MIN_CENTRE_JUMPS more of the latest images than it did not.
    # The difference is limited to MAX_CENTRE_JUMPS.
    MIN_CENTRE_JUMPS, MAX_CENTRE_JUMPS = 2, 4

    def __init__(self, goal: Goal | None) -> None:
        """Create the check for the goal of a run; None if no image will be added."""
        self.goal = goal
        # Area of a small patch of the target in the image at the goal; 0 if it is unknown.
        self._goal_patch = 0.0
        if goal is not None and goal.plane is not None and goal.moments is not None:
            self._goal_patch = _compute_patch_area(goal.plane, goal.moments)
        self.occluded_since: float | None = None
        # Predicted squared distance of the camera from the target in the last image, relative to
        # that at the goal.
        self._scale = 1.0
        # Area of the target in the last image and its running mean, relative to the goal's, after
        # the effect of the distance has been removed; 0 before the first image.
        self._last_area = self._mean_area = 0.0
        self._area_deviation = 0.0  # running mean of the relative change of the area
        # Number of images since a part of the target disappeared, and the stamp (s) of the first of
        # these images.
        self._hidden_count, self._hidden_stamp = 0, 0.0
        self._whole_area = 0.0  # target's corrected area before a part disappeared
        # Moments of the target in the last image and in the image before it.
        self._last_moments: Moments | None = None
        self._earlier_moments: Moments | None = None
        self._centre_jumps = 0

    @property
    def visible_part(self) -> float:
        """Return the fraction of a covered target that is still visible, 0 to 1."""
        return self._last_area / self._whole_area if self._whole_area else 1.0

    @property
    def is_centre_jumping(self) -> bool:
        """Return whether the target's centre has jumped in many of the latest images."""
        return self._centre_jumps >= self.MIN_CENTRE_JUMPS

    @property
    def next_region(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Return the ranges of x and y, normalised, in which the target may be in the next image.

        Return None if the target has not been visible.
        """
        last, earlier = self._last_moments, self._earlier_moments
        if last is None:
            return None
        # The target's centre is extrapolated by twice its last displacement. In the next image, the
        # target should be within one target size of this point.
        x, y = last.xg + 2.0 * (last.xg - earlier.xg), last.yg + 2.0 * (last.yg - earlier.yg)
        size = sqrt(last.m00)
        return (x - size, x + size), (y - size, y + size)

    def add(self, observation: Observation) -> None:
        """Update the visible area of the target; detect occlusions and jumps of the centre."""
        moments, desired = observation.moments, self.goal.moments
        if not observation.valid or moments is None or desired is None or moments.m00 <= 0.0:
            return
        earlier, self._last_moments = self._last_moments or moments, moments
        self._earlier_moments, jump = earlier, self.MIN_CENTRE_JUMP
        dx, dy = moments.xg - earlier.xg, moments.yg - earlier.yg
        if not (-jump <= dx <= jump and -jump <= dy <= jump):
            self._centre_jumps = min(self._centre_jumps + 1, self.MAX_CENTRE_JUMPS)
        elif self._centre_jumps:
            self._centre_jumps -= 1
        # The image area of a small patch at depth Z, in a plane at the distance d from the camera,
        # is d / Z^3 times the area of the patch. Both d and Z follow from the estimated plane.
        # Without a plane, the area is assumed to be inversely proportional to the squared distance.
        if observation.plane is None or not self._goal_patch:
            predicted = predict_distance(observation.world_T_camera, self.goal) ** -2
        else:
            predicted = _compute_patch_area(observation.plane, moments) / self._goal_patch
        if predicted < self.MIN_PREDICTED_AREA:
            return
        scale = 1.0 / predicted
        area, scale_change = moments.m00 / desired.m00 * scale, abs(scale / self._scale - 1.0)
        last, self._last_area, self._scale = self._last_area or area, area, scale
        before = self._mean_area or area
        if (
            observation.touched_borders
            or moments.kind != desired.kind
            or scale_change > self.MAX_DISTANCE_CHANGE
        ):
            return
        hidden = max(self.MIN_HIDDEN_PART, self.DEVIATION_FACTOR * self._area_deviation)
        if self._hidden_count:
            if area > (1.0 - 0.5 * self.MIN_HIDDEN_PART) * self._whole_area:
                self._hidden_count, self.occluded_since = 0, None
                return
            self._hidden_count += 1
            if self._hidden_count == self.HIDDEN_IMAGES:
                self.occluded_since = self._hidden_stamp
        elif area / before < 1.0 - hidden and area / last < 1.0 - hidden:
            self._hidden_count, self._hidden_stamp, self._whole_area = 1, observation.stamp, before
        else:
            change = abs(area / before - 1.0)
            self._area_deviation = (
                self.MEMORY * self._area_deviation + (1.0 - self.MEMORY) * change
            )
            self._mean_area = self.MEMORY * before + (1.0 - self.MEMORY) * area


def _compute_patch_area(plane: Plane, moments: Moments) -> float:
    """Return d / Z^3 of a plane at the target's centre; see `AreaCheck.add`."""
    A, B, C = plane
    return max(A * moments.xg + B * moments.yg + C, 1e-9) ** 3 / hypot(A, B, C)


def predict_distance(world_T_camera: np.ndarray | None, goal: Goal) -> float:
    """Return the target's depth that follows from the joints, relative to the goal's depth.

    Return 1 if the goal has no pose.
    """
    if world_T_camera is None or goal.world_T_camera is None:
        return 1.0
    goal_pose = goal.world_T_camera
    target = goal_pose[:3, 3] + goal.distance * goal_pose[:3, 2]
    depth = float(world_T_camera[:3, 2] @ (target - world_T_camera[:3, 3]))
    return max(depth / goal.distance, 1e-3)
