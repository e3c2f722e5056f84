"""The interface of all plants: simulated time, commands in, measurements out, and the truth."""

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
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.observation.frame import Frame, to_seconds
from aras_visual_servo_controller.observation.observation import CAMERA

if TYPE_CHECKING:
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

@lru_cache
def _find_rows(names: tuple[str, ...], selected: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(names.index(name) for name in selected)


@dataclass(frozen=True, eq=False)
class JointReading:
    """What the joints' sensors say.

    stamp_ns: simulated time. names: any order. positions, velocities: in that order, rad or m, /s.
    """

    stamp_ns: int
    names: tuple[str, ...]
    positions: Sequence[float]
    velocities: Sequence[float]

    @property
    def stamp(self) -> float:
        """`stamp_ns` in s."""
        return to_seconds(self.stamp_ns)

    def select(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (n,) of the named joints."""
        rows = _find_rows(self.names, tuple(names))
        return (
            np.array([self.positions[i] for i in rows]),
            np.array([self.velocities[i] for i in rows]),
        )


Reading = JointReading | Frame


@dataclass(frozen=True, eq=False)
class CameraPlacement:
    """Where another camera is beside the control camera.

    Each camera's poses are in the frame in which its target stands: the world, or a link.

    pose: (4, 4) of its optical frame: in that of the control camera, with which it moves; or in the
        frame in which the control camera's target stands, where it stands too.
    opposite: (4, 4) of the control camera in the frame in which this camera's target stands, where
        that moves with the control camera; None: the targets of both stand in one frame.
    """

    pose: np.ndarray
    is_fixed: bool = False
    target_T_control: np.ndarray | None = None

    def compute_pose(self, control_pose: np.ndarray) -> np.ndarray:
        """Its pose (4, 4) where the control camera has that one."""
        if self.target_T_control is not None:
            return self.target_T_control @ inverse(control_pose) @ self.pose
        return self.pose if self.is_fixed else control_pose @ self.pose


class JointListener(Protocol):
    """Is told what a plant's joints measured, and what they were commanded."""

    def on_command(self, values: np.ndarray) -> None:
        """(n,) were sent."""

    def on_joints(self, stamp: float, positions: np.ndarray, velocities: np.ndarray) -> None:
        """A joint state, (n,) and (n,), after the command that it brought about."""


class Plant(ABC):
    """An arm or a free camera before its target, in simulated time from 0 on.

    Attributes:
        camera: the true camera; of several the control camera.
        joint_names: those that can be commanded.
        outputs: kinds of command that it takes, of position, velocity and effort.
        control: name of the control camera. vibrations: of the cameras that shake, by name.
        has_exact_plane: whether the plane of the target counts as measured, without error.
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
        """Let time go on until something is measured, at most to `until_ns`; what was measured.

        With physics time goes in steps, so it may end less than a step after `until_ns`.
        """

    @abstractmethod
    def command(self, kind: str, values: Sequence[float]) -> None:
        """Command all joints in the order of `joint_names`; acts from the next step on.

        kind: 'position' (rad, m), 'velocity' (rad/s, m/s) or 'effort' (N m, N).
        """

    def read_pose(self) -> np.ndarray:
        """The truth: world_T_camera (4, 4) of the optical frame now."""
        pose = self.read_rest_pose()
        return self.apply_vibration(pose, self.time_ns) if self.vibrations else pose

    @abstractmethod
    def read_rest_pose(self) -> np.ndarray:
        """`pose` of a camera that does not shake, and about which this one does."""

    @abstractmethod
    def compute_rest_poses(self, positions: np.ndarray) -> np.ndarray:
        """As `read_rest_pose`, (m, 4, 4), where the joints stood at positions (m, n)."""

    def apply_vibration(self, pose: np.ndarray, time_ns: int, camera: str = "") -> np.ndarray:
        """Where a camera with that pose (4, 4) at rest is at a time, ns; '': the control camera."""
        vibration = self.vibrations.get(camera or self.control_camera_name)
        return pose if vibration is None else pose @ vibration.compute_pose(time_ns)

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Places (m, l, 3) in the world of the arm's joints where these stood at positions (m, n);
        l = 0 where no arm carries the camera."""
        return np.zeros((len(positions), 0, 3))

    @abstractmethod
    def read_joints(self) -> tuple[np.ndarray, np.ndarray]:
        """The truth: positions (n,) and velocities (n,) in the order of `joint_names`."""

    def find_collision(self) -> tuple[str, str] | None:
        """The link of the arm that runs into something, and into what; None: none does, or nobody
        knows."""
        return None

    def attach_loop(
        self, driver: LoopRunner, listener: JointListener, read_end_ns: Callable[[], float]
    ) -> None:
        """Up to `read_end_ns`() (ns) joint states may be answered as this driver would and told to
        the listener, and need not be delivered by `advance`."""

    def close(self) -> None:
        """Give back what it holds; safe to call twice."""
        return
