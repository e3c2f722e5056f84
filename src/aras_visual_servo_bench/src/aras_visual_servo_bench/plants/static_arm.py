"""The arm at any posture: how much of a target it hides, and what it runs into."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from aras_sim_bridge.description import RobotDescription, world_file
from aras_sim_bridge.description.types import Collision, Geometry, Link
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.rendering import View, create_renderer
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.overlaps import find_overlaps
from aras_visual_servo_base.poses import relative_pose, skew

from ..errors import ViewError
from ..targets.geometry import PlacedTarget, Target

VIEW_SIZE = 32  # px of the view that the target just fills
# m before the target's face within which something is taken for the target itself
FACE_MARGIN = 5e-3
DEFAULT_NEAR = 0.1  # m, where the description has no camera
# m from which on links are in each other: Bullet's own margin about a link's shapes
MIN_PENETRATION = 1e-3
PLATE_THICKNESS = 1e-3  # m, of a flat target that is run into


class StaticArm:
    """The robot in a world in which no time goes by: what its visuals cover, and what its links run
    into. Of all else in that world only what can be touched is there."""

    def __init__(
        self,
        description: RobotDescription,
        carrier: str = "",
        surroundings: WorldFile | None = None,
        target: PlacedTarget | None = None,
    ) -> None:
        """Put the robot there.

        Args:
            carrier: the link that carries the target; '': the target stands in the world.
            around: what stands around the robot; None: nothing.
            target: what it must not run into, unless it is of the robot or the world; where it is
                at first.

        Raises:
            SimError: the robot, or what stands around it, cannot be put there.
        """
        self._near = description.cameras[0].near if description.cameras else DEFAULT_NEAR
        self._world, self._carrier = World(), carrier
        self._model = self._world.spawn(description, "robot")
        if surroundings is not None:
            if surroundings.ground_plane:
                ground = _make_invisible_model("ground_plane", Geometry("plane"))
                self._world.spawn(ground, "ground_plane")
            unseen = tuple(without_visuals(model, *model.links) for model in surroundings.models)
            world_file.populate(self._world.spawn, replace(surroundings, models=unseen))
        if target is not None:
            shape, middle = _make_collision_shape(target.shape)
            pose = Pose.from_matrix(target.world_T_target(0.0))
            self._world.spawn(_make_invisible_model("target", shape, middle), "target", pose)
        self._renderer = create_renderer("auto", self._world)

    def close(self) -> None:
        """Give the world back; safe to call twice."""
        self._renderer.close()
        self._world.close()

    def find_collision(self, joints: Mapping[str, float]) -> str:
        """What the arm runs into at these positions (rad or m, by name), in words; '': nothing."""
        self._model.set_joint_positions(joints)
        for found in find_overlaps(self._world, self._model, before_step=True):
            if found.depth > MIN_PENETRATION:
                return f"its link '{found.link}' is in '{found.model}'"
        return ""

    def compute_occlusion(
        self, joints: Mapping[str, float], pose: np.ndarray, target: Target,
        target_pose: np.ndarray, near: float | None = None,
    ) -> float:
        """Part of a target that the arm hides, 0 to 1; 0 where the target is behind the camera.

        Args:
            joints: positions by name, rad or m.
            pose: of the camera (4, 4), in the world, or in the link that carries the target.
            placed: of the target (4, 4), in the same frame. near: m before the camera within which
                nothing is drawn; None: as the description has it.
        """
        aimed = self._aim_at_target(pose, target, target_pose)
        if aimed is None:
            return 0.0
        pose, outline, K = aimed
        pixels = np.rint(outline * K[0, 0] + K[0, 2]).astype(np.int32)
        rows, columns = np.nonzero(
            cv2.fillPoly(np.zeros((VIEW_SIZE, VIEW_SIZE), np.uint8), [pixels], 1)
        )
        rays = np.column_stack([
            (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones(len(rows))
        ])  # fmt: skip
        face = 1.0 / (rays @ np.array(target.plane(relative_pose(target_pose, pose))))
        self._model.set_joint_positions(joints)
        if self._carrier:
            pose = self._model.link_pose(self._carrier).matrix() @ pose
        depth, _ = self._renderer.measure(View(VIEW_SIZE, VIEW_SIZE, pose, K, near or self._near))
        return float(np.mean(depth[rows, columns] < face - FACE_MARGIN)) if len(rows) else 0.0

    @staticmethod
    def _aim_at_target(
        pose: np.ndarray, target: Target, target_pose: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """A camera at the same place that looks at the target, whatever the lens: its pose (4, 4),
        the outline (n, 2), normalised, and K (3, 3) with which that fills the view; None: the
        target is behind the camera."""
        try:
            outline = target.outline(relative_pose(target_pose, pose))
            middle = np.append(0.5 * (outline.min(axis=0) + outline.max(axis=0)), 1.0)
            forward = middle / np.linalg.norm(middle)
            right = np.array([forward[2], 0.0, -forward[0]])
            right /= np.linalg.norm(right)
            turned = np.array(pose)
            turned[:3, :3] = pose[:3, :3] @ np.stack(
                [right, skew(forward) @ right, forward], axis=1
            )
            outline = target.outline(relative_pose(target_pose, turned))
        except ViewError:
            return None
        focal = 0.5 * (VIEW_SIZE - 2.0) / np.abs(outline).max()
        K = np.diag([focal, focal, 1.0])
        K[:2, 2] = 0.5 * (VIEW_SIZE - 1.0)
        return turned, outline, K


def _make_invisible_model(
    name: str, shape: Geometry, xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> RobotDescription:
    """A model without mass, which stands still, of one shape that is not seen; xyz: its middle,
    m."""
    link = Link("link", None, (), (Collision("collision", xyz, (0.0, 0.0, 0.0), shape),))
    return RobotDescription(name, "link", {"link": link}, {})


def without_visuals(model: RobotDescription, *links: str) -> RobotDescription:
    """The same model, of some of whose links nothing is drawn."""
    bare = {name: replace(model.links[name], visuals=()) for name in links}
    return replace(model, links={**model.links, **bare})


def _make_collision_shape(target: Target) -> tuple[Geometry, tuple[float, float, float]]:
    """The shape of a target, and its middle in the target's frame, m; of a flat one the thin box
    about it."""
    if target.is_solid:
        return Geometry("mesh", filename=str(target.path)), (0.0, 0.0, 0.0)
    corners = target.vertices()
    low, high = corners.min(axis=0), corners.max(axis=0)
    low[2] = high[2] - max(high[2] - low[2], PLATE_THICKNESS)
    return (
        Geometry("box", size=tuple((high - low).tolist())), tuple((0.5 * (low + high)).tolist())
    )  # fmt: skip
