"""Check an arm at a given posture: occlusion of the target by the arm, and collisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import cv2
import numpy as np

from aras_sim_bridge.description import RobotDescription, world_file
from aras_sim_bridge.description.types import Collision, Geometry, Inertial, Link
from aras_sim_bridge.description.world_file import WorldFile
from aras_sim_bridge.rendering import View, create_renderer
from aras_sim_bridge.world import Pose, World
from aras_sim_bridge.world.overlaps import find_overlaps
from aras_visual_servo_base.poses import relative_pose, skew

from ..errors import OutOfViewError
from ..targets.geometry import PlacedTarget, Target

VIEW_SIZE = 32  # side of the square image in which hidden pixels of the target are counted, px
# A surface counts as part of the target if it is at most this distance in front of the target's
# face, m.
FACE_MARGIN = 5e-3
DEFAULT_NEAR = 0.1  # near clipping distance if the robot description has no camera, m
# Smallest penetration of two bodies that is reported as a collision, m. It is equal to the margin
# of Bullet's collision shapes.
MIN_PENETRATION = 1e-3
PLATE_THICKNESS = 1e-3  # minimum thickness of the collision shape of a flat target, m
# Inertial parameters of links that have none in the robot description. The world is never stepped.
ANY_INERTIAL = Inertial(1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))


class StaticArm:
    """Robot in a static world, for computing occlusions of the target and collisions of the robot.

    The surroundings have collision shapes but no visuals, so only the robot can hide the target.
    """

    def __init__(
        self,
        description: RobotDescription,
        carrier: str = "",
        surroundings: WorldFile | None = None,
        target: PlacedTarget | None = None,
    ) -> None:
        """Spawn the robot and its surroundings.

        Args:
            description: robot description.
            carrier: link that carries the target; '': the target is in the world.
            surroundings: world around the robot; None: the world is empty.
            target: target to add as an obstacle at its initial pose; None if the robot or the world
                already contains the target.

        Raises:
            SimError: the robot or its surroundings cannot be simulated.
        """
        self._near = description.cameras[0].near if description.cameras else DEFAULT_NEAR
        self._world, self._carrier = World(), carrier
        self._model = self._world.spawn(_add_masses(description), "robot")
        if surroundings is not None:
            if surroundings.ground_plane:
                ground = _make_invisible_model("ground_plane", Geometry("plane"))
                self._world.spawn(ground, "ground_plane")
            invisible = tuple(without_visuals(model, *model.links) for model in surroundings.models)
            world_file.populate(self._world.spawn, replace(surroundings, models=invisible))
        if target is not None:
            shape, middle = _make_collision_shape(target.shape)
            pose = Pose.from_matrix(target.world_T_target(0.0))
            self._world.spawn(_make_invisible_model("target", shape, middle), "target", pose)
        self._renderer = create_renderer("auto", self._world)

    def close(self) -> None:
        """Close the world; a second call has no effect."""
        self._renderer.close()
        self._world.close()

    def find_collision(self, joints: Mapping[str, float]) -> str:
        """Describe a collision of the robot; return '' if there is none.

        joints: position of each joint, by name, rad or m."""
        self._model.set_joint_positions(joints)
        for overlap in find_overlaps(self._world, self._model, before_step=True):
            if overlap.depth > MIN_PENETRATION:
                return f"link '{overlap.link}' of the arm is in '{overlap.model}'"
        return ""

    def compute_occlusion(
        self, joints: Mapping[str, float], pose: np.ndarray, target: Target,
        target_pose: np.ndarray, near: float | None = None,
    ) -> float:
        """Compute the fraction of a target, 0 to 1, that the arm hides from a camera.

        Return 0 if the target is behind the camera.

        Args:
            joints: position of each joint, by name, rad or m.
            pose: pose (4, 4) of the camera, in the world or in the link that carries the target.
            target: geometry of the target.
            target_pose: pose (4, 4) of the target, in the same frame as `pose`.
            near: near clipping distance of the camera, m; None: the distance in the description.
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
        """Point a virtual camera at the target, from the position of the real camera.

        Returns:
            Pose (4, 4) of the virtual camera; outline (n, 2) of the target in normalised
            coordinates of this camera; camera matrix K (3, 3) with which the target fills the
            image. None if the target is behind the camera.
        """
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
        except OutOfViewError:
            return None
        focal = 0.5 * (VIEW_SIZE - 2.0) / np.abs(outline).max()
        K = np.diag([focal, focal, 1.0])
        K[:2, 2] = 0.5 * (VIEW_SIZE - 1.0)
        return turned, outline, K


def _add_masses(description: RobotDescription) -> RobotDescription:
    """Return the description with a mass in each link that a joint moves.

    A description for kinematics may have no masses, and the world fixes joints that move no mass.
    """
    moved = {joint.child for joint in description.joints.values() if joint.is_movable}
    links = {
        name: replace(link, inertial=link.inertial or ANY_INERTIAL) if name in moved else link
        for name, link in description.links.items()
    }
    return replace(description, links=MappingProxyType(links))


def _make_invisible_model(
    name: str, shape: Geometry, xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> RobotDescription:
    """Make a fixed model with one collision shape, whose centre is at `xyz` (m), and no visuals."""
    link = Link("link", None, (), (Collision("collision", xyz, (0.0, 0.0, 0.0), shape),))
    return RobotDescription(name, "link", {"link": link}, {})


def without_visuals(model: RobotDescription, *links: str) -> RobotDescription:
    """Return a copy of a model without the visuals of the links `links`."""
    changed = {name: replace(model.links[name], visuals=()) for name in links}
    return replace(model, links={**model.links, **changed})


def _make_collision_shape(target: Target) -> tuple[Geometry, tuple[float, float, float]]:
    """Return the collision shape of a target, and the centre of this shape in the target frame, m.

    For a flat target, the collision shape is a thin box around it.
    """
    if target.is_solid:
        return Geometry("mesh", filename=str(target.path)), (0.0, 0.0, 0.0)
    corners = target.vertices()
    low, high = corners.min(axis=0), corners.max(axis=0)
    low[2] = high[2] - max(high[2] - low[2], PLATE_THICKNESS)
    return (
        Geometry("box", size=tuple((high - low).tolist())), tuple((0.5 * (low + high)).tolist())
    )  # fmt: skip
