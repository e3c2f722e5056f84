"""The arm's bodies as a camera sees them at any posture: how much of a target they hide."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from aras_sim_bridge.description import RobotDescription
from aras_sim_bridge.rendering import View, create_renderer
from aras_sim_bridge.world import World
from aras_visual_servo_base.poses import relative, skew

from ..errors import ViewError
from ..targets.geometry import Target

SIDE = 32  # px of the view that the target just fills
MARGIN = 5e-3  # m before the target's face within which something is taken for the target itself
NEAR = 0.1  # m, where the description has no camera


class DrawnArm:
    """The robot alone in a world, without physics: what its visuals cover."""

    def __init__(self, description: RobotDescription, carrier: str = "") -> None:
        """`carrier`: the link that carries the target; '': the target stands in the world.

        Raises:
            SimError: the robot cannot be drawn.
        """
        self._near = description.cameras[0].near if description.cameras else NEAR
        self._world, self._carrier = World(), carrier
        self._model = self._world.spawn(description, "robot")
        self._renderer = create_renderer("auto", self._world)

    def hidden(
        self, joints: Mapping[str, float], pose: np.ndarray, target: Target,
        placed: np.ndarray, near: float | None = None,
    ) -> float:
        """Part of a target that the arm hides, 0 to 1; 0 where the target is behind the camera.

        Args:
            joints: positions by name, rad or m.
            pose: of the camera (4, 4), in the world, or in the link that carries the target.
            placed: of the target (4, 4), in the same frame. near: m before the camera within which
                nothing is drawn; None: as the description has it.
        """
        aimed = self._aimed(pose, target, placed)
        if aimed is None:
            return 0.0
        pose, outline, K = aimed
        pixels = np.rint(outline * K[0, 0] + K[0, 2]).astype(np.int32)
        rows, columns = np.nonzero(cv2.fillPoly(np.zeros((SIDE, SIDE), np.uint8), [pixels], 1))
        rays = np.column_stack([
            (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones(len(rows))
        ])  # fmt: skip
        face = 1.0 / (rays @ np.array(target.plane(relative(placed, pose))))
        self._model.set_joint_positions(joints)
        if self._carrier:
            pose = self._model.link_pose(self._carrier).matrix() @ pose
        depth, _ = self._renderer.measure(View(SIDE, SIDE, pose, K, near or self._near))
        return float(np.mean(depth[rows, columns] < face - MARGIN)) if len(rows) else 0.0

    @staticmethod
    def _aimed(
        pose: np.ndarray, target: Target, placed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """A camera at the same place that looks at the target, whatever the lens: its pose (4, 4),
        the outline (n, 2), normalised, and K (3, 3) with which that fills the view; None: the
        target is behind the camera."""
        try:
            outline = target.outline(relative(placed, pose))
            middle = np.append(0.5 * (outline.min(axis=0) + outline.max(axis=0)), 1.0)
            forward = middle / np.linalg.norm(middle)
            right = np.array([forward[2], 0.0, -forward[0]])
            right /= np.linalg.norm(right)
            turned = np.array(pose)
            turned[:3, :3] = pose[:3, :3] @ np.stack(
                [right, skew(forward) @ right, forward], axis=1
            )
            outline = target.outline(relative(placed, turned))
        except ViewError:
            return None
        focal = 0.5 * (SIDE - 2.0) / np.abs(outline).max()
        centre = 0.5 * (SIDE - 1.0)
        return turned, outline, np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1.0]])
