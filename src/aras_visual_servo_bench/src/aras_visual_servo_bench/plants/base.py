"""Interface of all plants: simulated time, commands, measurements and true state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

import numpy as np

from aras_sim_bridge.camera.vibration import Vibration
from aras_visual_servo_base.poses import inverse
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.observation.frame import Frame, to_seconds
from aras_visual_servo_controller.observation.observation import CAMERA

if TYPE_CHECKING:
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

@lru_cache
def _find_rows(names: tuple[str, ...], selected: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(names.index(name) for name in selected)


@dataclass(frozen=True, eq=False)
class JointReading:
    """Joint state measured at one instant.

    stamp_ns: simulated time of the measurement, ns.
    names: names of the joints, in any order.
    positions: position of each joint in the order of `names`, rad or m.
    velocities: velocity of each joint in the order of `names`, rad/s or m/s.
    """

    stamp_ns: int
    names: tuple[str, ...]
    positions: Sequence[float]
    velocities: Sequence[float]

    @property
    def stamp(self) -> float:
        """Simulated time of the measurement, s."""
        return to_seconds(self.stamp_ns)

    def select(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions (n,) and velocities (n,) of the joints `names`, in this order."""
        rows = _find_rows(self.names, tuple(names))
        return (
            np.array([self.positions[i] for i in rows]),
            np.array([self.velocities[i] for i in rows]),
        )


Reading = JointReading | Frame


@dataclass(frozen=True, eq=False)
class CameraPlacement:
    """Placement of another camera relative to the control camera.

    Each camera observes a target. Its target frame is the link that carries this target, or the
    world.

    pose: pose (4, 4) of this camera's optical frame, in the optical frame of the control camera if
        both cameras move together, otherwise in the target frame of the control camera.
    is_fixed: whether this camera is at rest in the control camera's target frame.
    target_T_control: None if both cameras have the same target frame. Otherwise, the target of this
        camera moves with the control camera, and this is the pose (4, 4) of the control camera in
        the target frame of this camera.
    """

    pose: np.ndarray
    is_fixed: bool = False
    target_T_control: np.ndarray | None = None

    def compute_pose(self, control_pose: np.ndarray) -> np.ndarray:
        """Return the pose (4, 4) of this camera when the control camera is at `control_pose`."""
        if self.target_T_control is not None:
            return self.target_T_control @ inverse(control_pose) @ self.pose
        return self.pose if self.is_fixed else control_pose @ self.pose


class JointListener(Protocol):
    """Receiver of the joint states for which a plant itself has updated the control loop."""

    def on_updates(self, stamps: Sequence[float], samples: np.ndarray) -> None:
        """Receive m joint states.

        Args:
            stamps: (m,) stamps of the joint states, s.
            samples: (m, 3, n) positions, velocities, and the resulting commands.
        """


class Plant(ABC):
    """Arm or free camera in front of its target, in simulated time that starts at 0.

    Attributes:
        camera: true intrinsics of the control camera.
        joint_names: names of the joints that can be commanded.
        outputs: kinds of command that the plant accepts: position, velocity, effort or twist.
        control_camera_name: name of the control camera.
        vibrations: vibration of each camera that shakes, by name.
        has_exact_plane: whether the controller is given the exact plane of the target.
    """

    camera: CameraModel
    joint_names: tuple[str, ...]
    outputs: frozenset[str]
    control_camera_name: str = CAMERA
    has_exact_plane: bool = False
    vibrations: Mapping[str, Vibration] = MappingProxyType({})

    @property
    @abstractmethod
    def time_ns(self) -> int:
        """Simulated time, ns."""

    @abstractmethod
    def advance(self, until_ns: int) -> list[Reading]:
        """Advance the simulated time to the next measurement, but not beyond `until_ns`.

        A plant with physics advances in steps, so its time can be up to one step after `until_ns`.

        Returns:
            The measurements at the new time.
        """

    @abstractmethod
    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command all joints; the command takes effect at the next step.

        Args:
            kind: 'position' (rad, m), 'velocity' (rad/s, m/s), 'effort' (N m, N) or 'twist'.
            values: command of each joint, in the order of `joint_names`.
        """

    def read_pose(self) -> np.ndarray:
        """Return the true world_T_camera (4, 4) of the control camera at the current time."""
        pose = self.read_rest_pose()
        return self.apply_vibration(pose, self.time_ns) if self.vibrations else pose

    @abstractmethod
    def read_rest_pose(self) -> np.ndarray:
        """Return the current true world_T_camera (4, 4) of the control camera, without vibration.

        `read_pose` returns the pose with vibration."""

    @abstractmethod
    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute world_T_camera (m, 4, 4) of the control camera, without vibration.

        positions: joint positions (m, n)."""

    def apply_vibration(self, pose: np.ndarray, time_ns: int, camera: str = "") -> np.ndarray:
        """Add the vibration of a camera to its pose (4, 4), and return the result.

        Args:
            pose: pose (4, 4) of the camera without vibration.
            time_ns: simulated time, ns.
            camera: name of the camera; '': the control camera.
        """
        vibration = self.vibrations.get(camera or self.control_camera_name)
        return pose if vibration is None else pose @ vibration.compute_pose(time_ns)

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Compute the origins of the arm's joint frames in the world.

        positions: joint positions (m, n) of m joint states.

        Returns:
            Origins (m, l, 3) of l joint frames, m; a plant without an arm has l = 0.
        """
        return np.zeros((len(positions), 0, 3))

    @abstractmethod
    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the true positions (n,) and velocities (n,), in the order of `joint_names`."""

    def find_collision(self) -> tuple[str, str] | None:
        """Return a link of the arm that is in collision, and the model that it collides with.

        Return None if there is no collision, or if the plant cannot detect collisions.
        """
        return None

    def attach_loop(
        self, driver: LoopRunner, listener: JointListener, read_end_ns: Callable[[], float]
    ) -> None:
        """Allow the plant to update the control loop itself, in compiled code.

        `advance` then need not return the joint states with which the plant has updated the loop.

        Args:
            driver: control loop that the plant updates with each joint state.
            listener: receiver of these joint states and the resulting commands.
            read_end_ns: function that returns the time (ns) until which the plant may update the
                loop.
        """

    def close(self) -> None:
        """Release the resources of the plant; a second call has no effect."""
        return
