"""Any chain of joints that moves a camera, from the robot's URDF: names, limits, kinematics."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import optical_pose, xyz_rpy_from_matrix
from aras_visual_servo_base.urdf import (
    LINK,
    MOVING_KINDS,
    OPTICAL,
    Joint,
    UrdfTree,
    parse_tree,
)

from ..errors import ConfigurationError, MeasurementError
from .chain import Chain
from .joint_sample import JointSample

# A measured position further outside its limits than their span, or a speed so many times the
# joint's greatest, is no measurement. A joint without limits may have turned this far, rad or m.
UNLIMITED_SPAN, IMPLAUSIBLE_SPEED = 1e4, 100.0


class Arm:
    """Pose and Jacobian of a camera as functions of the joints that move it.

    For joints q (n,), in rad or m, `pose(q)` is base_T_camera (4, 4) and `jacobian(q)` is J (6, n)
    with v = J q_dot, the twist of the camera in its own optical frame, m/s and rad/s.
    `from_urdf` makes an arm from a robot's description.

    The base is the robot's root link, or the link named. Where the base is in the world is not
    known to the controller: `world_T_camera` in this package is `base_T_camera`.

    With a `target_frame` the camera need not be on the arm (eye-to-hand: the camera is fixed and
    the arm moves the target). Pose and Jacobian are then those of the camera's motion relative to
    that link, and `world` is that link.

    Attributes:
        names: (n,) of the joints, from the base to the camera, then those to the target.
        lower, upper: (n,) limits of position, rad or m; infinite for continuous joints.
        velocity, effort: (n,) greatest, rad/s or m/s and N m or N; infinite where none is said.
        prismatic: (n,) bool.
        camera_frame, base_frame, target_frame: links; target_frame '': the target stands still.
        chain: of the joints, in arrays.
        plausible: (3, n) least and greatest positions that can be measured, and greatest speeds.
    """

    def __init__(
        self,
        camera_path: Sequence[Joint],
        target_path: Sequence[Joint] = (),
        joints: Sequence[str] | None = None,
        locked: Mapping[str, float] | None = None,
    ) -> None:
        """Build from the joints on the paths to the camera and to the target; see `from_urdf`."""
        moving = [joint for joint in camera_path if joint.kind != "fixed"]
        shared = {joint.name for joint in camera_path}
        moving += [j for j in target_path if j.kind != "fixed" and j.name not in shared]
        moving = _select_joints(moving, joints)
        if not moving:
            raise ConfigurationError("robot description: no joint moves the camera")
        limits = np.array(list(zip(*map(_read_limits, moving), strict=True)))
        self.lower, self.upper, self.velocity, self.effort = map(_make_read_only, limits)
        span = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, np.nan)
        self.plausible_bounds = np.array([
            np.nan_to_num(self.lower - span, nan=-UNLIMITED_SPAN),
            np.nan_to_num(self.upper + span, nan=UNLIMITED_SPAN),
            IMPLAUSIBLE_SPEED * np.clip(self.velocity, 1.0, UNLIMITED_SPAN),
        ])  # fmt: skip
        self._zero_velocities = _make_read_only(np.zeros(len(moving)))
        # names of a message, our rows
        self._row_cache: tuple[tuple[str, ...], list[int]] = ((), [])
        self.names = tuple(joint.name for joint in moving)
        self.is_prismatic = np.array([joint.kind == "prismatic" for joint in moving])
        self.is_prismatic.setflags(write=False)
        self.camera_frame, self.base_frame = camera_path[-1].child, camera_path[0].parent
        self.target_frame = target_path[-1].child if target_path else ""

        self.chain = Chain.from_paths(camera_path, target_path, self.names, locked or {})
        # The posture that `view` answered last, and its answer.
        self._pose_cache: tuple[bytes, tuple[np.ndarray, np.ndarray]] | None = None

    @classmethod
    def from_urdf(
        cls,
        urdf: str,
        camera_frame: str = "camera_optical_frame",
        base_frame: str = "",
        joints: Sequence[str] | None = None,
        target_frame: str = "",
        locked: Mapping[str, float] | None = None,
    ) -> "Arm":
        """The arm that a robot's description says moves the camera.

        Args:
            urdf: text of the description.
            camera_frame: optical frame (z forward, x right, y down), or a link with a camera
                sensor; see `camera_path`.
            base_frame: '' for the description's root.
            joints: names of the joints to use, in the order wanted; None: all that move the
                camera, from the base on. The others stand still.
            target_frame: a link that carries the target, where the arm moves it.
            locked: positions of the joints that stand still, rad or m; 0 where not given.

        Raises:
            ConfigurationError: the description cannot be used, with what is missing and the
                nearest name.
        """
        try:
            tree = parse_tree(urdf)
            path = find_camera_path(tree, base_frame, camera_frame)
            target_path = tree.find_path(base_frame, target_frame) if target_frame else []
            for joint in [*path, *target_path]:
                _check_joint(joint)
        except DescriptionError as error:
            raise ConfigurationError(f"robot description: {error}") from None
        if not path:
            raise ConfigurationError(
                f"robot description: {camera_frame} is the base itself, no joint moves it"
            )
        return cls(path, target_path, joints, locked)

    @staticmethod
    def find_fixed_pose(urdf: str, camera_frame: str, base_frame: str = "") -> np.ndarray | None:
        """base_T_camera (4, 4) of a camera that no joint moves; None where one does.

        Raises:
            ConfigurationError: as `from_urdf`.
        """
        try:
            path = find_camera_path(parse_tree(urdf), base_frame, camera_frame)
        except DescriptionError as error:
            raise ConfigurationError(f"robot description: {error}") from None
        if any(joint.kind != "fixed" for joint in path):
            return None
        return Chain.from_paths(path, (), (), {}).tip_frames[0]

    def __len__(self) -> int:
        """Number of joints."""
        return len(self.names)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Compute `world_T_camera` (4, 4) for joints q (n,), read-only.

        The world is the frame in which the target is at rest: the base, or the target's own frame
        where the arm moves it.
        """
        return self.pose_and_jacobian(q)[0]

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """The same (m, 4, 4) for joints (m, n)."""
        return self.chain.compute_poses(positions)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Geometric Jacobian (6, n) of the camera, expressed in the optical frame.

        twist = jacobian(q) @ q_dot, with twist = (vx, vy, vz, wx, wy, wz) of the camera in its
        own frame, m/s and rad/s; relative to the target's frame where the arm moves that.
        """
        return self.pose_and_jacobian(q)[1]

    def pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute pose (4, 4) and Jacobian (6, n) of one posture together; both read-only."""
        q = np.asarray(q, float)
        if q.shape != self.lower.shape:
            raise ValueError(f"an arm of {len(self.names)} joints was given joints {q.shape}")
        asked, viewed = q.tobytes(), self._pose_cache
        if viewed is not None and asked == viewed[0]:
            return viewed[1]  # an image's observation, scheme and resolver ask alike
        pose, jacobian = self.chain.compute_pose_and_jacobian(q)
        view = _make_read_only(pose), _make_read_only(jacobian)
        self._pose_cache = asked, view
        return view

    def joint_frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 3) and unit axes (n, 3) of the joints in the base's frame."""
        frames = self.chain.compute_frames(q)
        return frames[:, 9:12], frames[:, 12:]

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Places (m, n, 3) of the joints from the base to the camera, in the base's frame, for
        joints (m, n); (m, 0, 3) where the arm moves the target, not the camera."""
        count = 0 if self.target_frame else len(self)
        found = np.zeros((len(positions), count, 3))
        for row, q in zip(found, positions if count else (), strict=False):
            row[:] = self.joint_frames(q)[0][self.chain.order]
        return found

    def read_joints(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float] = (),
        stamp: float = 0.0,
    ) -> JointSample:
        """The arm's joints out of a message's, found by name; velocities are 0 where none came.

        Raises:
            MeasurementError: a joint is missing, lengths differ, or a value is not plausible: not
                finite, or further outside its limits than a joint can stand.
        """
        if len(names) != len(positions):
            raise MeasurementError(f"{len(names)} joint names but {len(positions)} positions")
        if len(velocities) not in (0, len(names)):
            raise MeasurementError(f"{len(names)} joint names but {len(velocities)} velocities")
        rows = self._find_rows(names)
        q = np.array([positions[i] for i in rows], float)
        speed = self._zero_velocities
        if len(velocities):
            speed = np.array([velocities[i] for i in rows], float)
        self.check(q, speed)
        return JointSample(float(stamp), self.names, _make_read_only(q), _make_read_only(speed))

    def _find_rows(self, names: Sequence[str]) -> list[int]:
        """Where our joints stand among these names; the same come again and again."""
        names = tuple(names)
        if names != self._row_cache[0]:
            index = {name: i for i, name in enumerate(names)}
            missing = [name for name in self.names if name not in index]
            if missing:
                raise MeasurementError(
                    f"joint states lack {', '.join(missing)}; {suggest(missing[0], names)}"
                )
            self._row_cache = names, [index[name] for name in self.names]
        return self._row_cache[1]

    def check(self, q: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Refuse positions and velocities (n,) that no joint of this arm can have.

        Raises:
            MeasurementError: one is not finite, or implausibly large, or there are too many or few.
        """
        q = np.asarray(q, float)
        speeds = self._zero_velocities if velocities is None else np.asarray(velocities, float)
        if not q.shape == speeds.shape == self.lower.shape:
            raise MeasurementError(
                f"joint positions {q.shape} and velocities {speeds.shape} for an arm of "
                f"{len(self.names)} joints"
            )
        joint, speeding = find_implausible_joint(q, speeds, *self.plausible_bounds)
        if joint >= 0 and not speeding:
            raise MeasurementError(
                f"{self.names[joint]} measured at {q[joint]:g}: no position that it can have "
                f"({self.lower[joint]:g} to {self.upper[joint]:g})"
            )
        if joint >= 0:
            raise MeasurementError(
                f"{self.names[joint]} measured at a speed of {speeds[joint]:g}: no speed that "
                f"it can have (limit {self.velocity[joint]:g})"
            )

    def inverse_kinematics(
        self, world_T_camera: np.ndarray, q0: np.ndarray, tolerance: float = 1e-7,
        cost: Callable[[np.ndarray], float] | None = None,
    ) -> np.ndarray:
        """Joints (n,) within the limits that put the camera at a pose (4, 4), found from q0 (n,).

        tolerance: m, and 0.1 m x rad, to which the pose has to be met. Most are met to 1e-12; where
            the arm is singular, a few iterations leave up to 1e-8.
        cost: what speaks against joints (n,), from 0 on. The first that are found without any are
            taken, or the cheapest of several; None: the first.

        Raises:
            UnreachableError: no such joints were found; with how far the nearest is.
        """
        from .inverse_kinematics import (
            solve_inverse_kinematics,  # here, because SciPy's optimisers take a third of a second
        )

        return solve_inverse_kinematics(
            self.pose_and_jacobian, self.lower, self.upper, world_T_camera, q0, tolerance, cost
        )


@jit("f8[:], f8[:], f8[:], f8[:], f8[:]")
def find_implausible_joint(q, velocities, lower, upper, max_speeds):
    """The first joint whose position, or else speed, is none; and whether it is the speed. -1: all
    are plausible. Numbers that are not finite fail every comparison."""
    for i in range(len(q)):
        if not lower[i] <= q[i] <= upper[i]:
            return i, False
    for i in range(len(q)):
        if not abs(velocities[i]) <= max_speeds[i]:
            return i, True
    return -1, False


def find_camera_path(tree: UrdfTree, base: str, camera_frame: str) -> list[Joint]:
    """The joints from the base to the camera's optical frame (z forward, x right, y down).

    A described frame is the optical one, unless it carries a camera sensor, whose pose then says
    along which axis it looks, and its name does not end in `_optical_frame`. A frame
    `x_optical_frame` that is not described is that of the sensor on the link `x_link`.

    Raises:
        DescriptionError: no such frame, or nothing says along which axis it looks.
    """
    link = camera_frame
    if camera_frame.endswith(OPTICAL):
        link = camera_frame.removesuffix(OPTICAL) + LINK
        if camera_frame in tree.links or link not in tree.links:
            return tree.find_path(base, camera_frame)
    path = tree.find_path(base, link)
    if link not in tree.cameras:
        if link == camera_frame:
            return path
        raise DescriptionError(
            f"link '{link}' carries no camera sensor that would say along which axis it looks: "
            f"describe '{camera_frame}' in it, z forward, x right and y down, or name as "
            "camera_frame a link that looks along its z axis"
        )
    xyz, rpy = xyz_rpy_from_matrix(optical_pose(tree.cameras[link].matrix()))
    frame = camera_frame if camera_frame != link else f"{link}{OPTICAL}"
    return [*path, Joint(f"{link}_to_{frame}", "fixed", link, frame, tuple(xyz), tuple(rpy))]


def _check_joint(joint: Joint) -> None:
    """DescriptionError for a joint that moves the camera or the target and cannot be used."""
    if not joint.is_movable and joint.kind != "fixed":
        raise DescriptionError(
            f"joint '{joint.name}' on the path to the camera is '{joint.kind}': "
            f"{', '.join(MOVING_KINDS)} and fixed are known"
        )
    if joint.is_movable and joint.mimic is not None:
        raise DescriptionError(
            f"joint '{joint.name}' mimics another and moves the camera: chains with such joints "
            "are not supported"
        )
    lower, upper, _, _ = _read_limits(joint)
    if not lower < upper:
        raise DescriptionError(
            f"joint '{joint.name}': lower limit {lower:g} must be below the upper {upper:g}"
        )


def _read_limits(joint: Joint) -> tuple[float, float, float, float]:
    """lower, upper, velocity, effort of a joint; infinite where there is no limit."""
    if joint.limits is None:
        return -np.inf, np.inf, np.inf, np.inf
    lower, upper = joint.limits.lower, joint.limits.upper
    return (
        -np.inf if lower is None else lower, np.inf if upper is None else upper,
        joint.limits.velocity, joint.limits.effort,
    )  # fmt: skip


def _select_joints(
    moving: list[Joint], joints: Sequence[str] | None
) -> list[Joint]:
    """The joints asked for, in the order asked for."""
    if joints is None:
        return moving
    by_name = {joint.name: joint for joint in moving}
    for name in joints:
        if name not in by_name:
            raise ConfigurationError(
                f"no joint {name} moves the camera; {suggest(name, by_name)}"
            )
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f"joints {', '.join(joints)}: one is named twice")
    return [by_name[name] for name in joints]


def _make_read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def is_free_camera(arm: Arm) -> bool:
    """Whether it is a camera that flies, without joints of an arm."""
    return getattr(arm, "is_free", False)
