"""Kinematics of any joint chain that moves a camera, from the URDF of the robot."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.urdf import Joint, parse_tree

from ..errors import ConfigurationError, MeasurementError
from .chain import Chain, compute_pose_and_jacobian
from .joint_paths import check_joint, find_camera_path, read_limits, select_joints
from .joint_sample import JointSample

# A measured position is implausible if it is outside the joint's limits by more than the span
# between the limits. A joint without limits is assumed to have this span, rad or m.
UNLIMITED_SPAN = 1e4
# A measured speed is implausible if it exceeds the joint's maximum speed by this factor.
IMPLAUSIBLE_SPEED = 100.0


class Arm:
    """Pose and Jacobian of a camera as functions of the joints that move it.

    For joints q (n,), in rad or m, `pose(q)` is base_T_camera (4, 4) and `jacobian(q)` is J (6, n)
    with v = J q_dot, the twist of the camera in its own optical frame, m/s and rad/s. `from_urdf`
    constructs an arm from a robot description.

    The base is the root link of the robot, or a named link. The controller does not know where the
    base is, so in this package "world" means the base: `world_T_camera` is `base_T_camera`.

    With a `target_frame` the camera need not be on the arm (eye-to-hand: the camera is fixed and
    the arm moves the target). Pose and Jacobian are then those of the camera relative to that link,
    and "world" means that link.

    Attributes:
        names: (n,) names of the joints: first those from the base to the camera, then those from
            the base to the target.
        lower, upper: (n,) position limits, rad or m; infinite for continuous joints.
        velocity: (n,) maximum speeds, rad/s or m/s; infinite if not specified.
        effort: (n,) maximum efforts, N m or N; infinite if not specified.
        is_prismatic: (n,) whether each joint is prismatic.
        camera_frame, base_frame: links of the camera and the base.
        target_frame: link that carries the target; '' if no joint moves the target.
        chain: the same joints as arrays, for the compiled code.
        plausible_bounds: (3, n) lowest position, highest position and highest speed of each joint;
            a measured value beyond them is implausible.
    """

    def __init__(
        self,
        camera_path: Sequence[Joint],
        target_path: Sequence[Joint] = (),
        joints: Sequence[str] | None = None,
        locked: Mapping[str, float] | None = None,
    ) -> None:
        """Construct the arm from the joints on the paths to the camera and the target."""
        moving = [joint for joint in camera_path if joint.kind != "fixed"]
        shared = {joint.name for joint in camera_path}
        moving += [j for j in target_path if j.kind != "fixed" and j.name not in shared]
        moving = select_joints(moving, joints)
        if not moving:
            raise ConfigurationError(
                "robot description: no joint moves the camera; check camera_frame and joints"
            )
        limits = np.array(list(zip(*map(read_limits, moving), strict=True)))
        self.lower, self.upper, self.velocity, self.effort = map(_make_read_only, limits)
        span = np.where(np.isfinite(self.upper - self.lower), self.upper - self.lower, np.nan)
        self.plausible_bounds = np.array([
            np.nan_to_num(self.lower - span, nan=-UNLIMITED_SPAN),
            np.nan_to_num(self.upper + span, nan=UNLIMITED_SPAN),
            IMPLAUSIBLE_SPEED * np.clip(self.velocity, 1.0, UNLIMITED_SPAN),
        ])  # fmt: skip
        self._zero_velocities = _make_read_only(np.zeros(len(moving)))
        # Joint names of the latest joint state, and the indices of this arm's joints among them.
        self._row_cache: tuple[tuple[str, ...], list[int]] = ((), [])
        self.names = tuple(joint.name for joint in moving)
        self.is_prismatic = np.array([joint.kind == "prismatic" for joint in moving])
        self.is_prismatic.setflags(write=False)
        self.camera_frame, self.base_frame = camera_path[-1].child, camera_path[0].parent
        self.target_frame = target_path[-1].child if target_path else ""

        self.chain = Chain.from_paths(camera_path, target_path, self.names, locked or {})
        # Latest joint positions that were passed to `pose_and_jacobian`, and its result for them.
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
        """Construct the arm that moves the camera in a robot description.

        Args:
            urdf: text of the description.
            camera_frame: optical frame (z forward, x right, y down), or a link with a camera
                sensor; see `find_camera_path`.
            base_frame: base link; '' for the root of the description.
            joints: names of the joints to use, in this order; None for all joints that move the
                camera, starting from the base. The other joints are at rest.
            target_frame: link that carries the target, if the arm moves the target.
            locked: positions of the joints at rest, rad or m; 0 by default.

        Raises:
            ConfigurationError: the description cannot be used; the message says what is missing and
                suggests the nearest name.
        """
        try:
            tree = parse_tree(urdf)
            path = find_camera_path(tree, base_frame, camera_frame)
            target_path = tree.find_path(base_frame, target_frame) if target_frame else []
            for joint in [*path, *target_path]:
                check_joint(joint)
        except DescriptionError as error:
            raise ConfigurationError(f"robot description: {error}") from None
        if not path:
            raise ConfigurationError(
                f"robot description: {camera_frame} is the base itself, which no joint moves; name "
                "a link that a joint moves as camera_frame"
            )
        return cls(path, target_path, joints, locked)

    @staticmethod
    def find_fixed_pose(urdf: str, camera_frame: str, base_frame: str = "") -> np.ndarray | None:
        """Return base_T_camera (4, 4) of a camera that no joint moves.

        Return None if a joint moves the camera.

        Raises:
            ConfigurationError: see `from_urdf`.
        """
        try:
            path = find_camera_path(parse_tree(urdf), base_frame, camera_frame)
        except DescriptionError as error:
            raise ConfigurationError(f"robot description: {error}") from None
        if any(joint.kind != "fixed" for joint in path):
            return None
        return Chain.from_paths(path, (), (), {}).tip_frames[0]

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.names)

    @property
    def is_compiled(self) -> bool:
        """Return whether compiled code may compute pose and Jacobian instead of the methods.

        It may not if a subclass overrides these methods.
        """
        return type(self) is Arm

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Compute `world_T_camera` (4, 4) for joints q (n,); the array is read-only.

        The world is the frame in which the target is at rest: the base, or the target's own frame
        if the arm moves the target.
        """
        return self.pose_and_jacobian(q)[0]

    def poses(self, positions: np.ndarray) -> np.ndarray:
        """Compute `world_T_camera` for m joint positions (m, n); return an array (m, 4, 4)."""
        return self.chain.compute_poses(positions)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Compute the geometric Jacobian (6, n) of the camera, expressed in the optical frame.

        twist = jacobian(q) @ q_dot, with twist = (vx, vy, vz, wx, wy, wz) of the camera in its
        own frame, m/s and rad/s; relative to the target's frame if the arm moves the target.
        """
        return self.pose_and_jacobian(q)[1]

    def pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute pose (4, 4) and Jacobian (6, n) for joints q (n,) together; the arrays are
        read-only.
        """
        q = np.asarray(q, float)
        if q.shape != self.lower.shape:
            raise ValueError(
                f"joints have the shape {q.shape}, must have ({len(self.names)},) for this arm"
            )
        key, cached = q.tobytes(), self._pose_cache
        if cached is not None and key == cached[0]:
            # The result is cached, because several parts of the loop need it for the same joints.
            return cached[1]
        result = np.empty((4, 4)), np.empty((6, len(q)))
        compute_pose_and_jacobian(*self.chain, q, *result)
        for array in result:
            array.setflags(write=False)
        self._pose_cache = key, result
        return result

    def joint_frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the origins (n, 3) and unit axes (n, 3) of the joints in the base frame."""
        frames = self.chain.compute_frames(q)
        return frames[:, 9:12], frames[:, 12:]

    def joint_origins(self, positions: np.ndarray) -> np.ndarray:
        """Compute the joint origins from base to camera in the base frame, as an array (m, n, 3).

        `positions` are joints (m, n). If the arm moves the target, the camera is fixed and there
        are no such joints; the result then has the shape (m, 0, 3).
        """
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
        """Extract the arm's joints from a joint state, by name.

        If the joint state has no velocities, they are set to 0.

        Raises:
            MeasurementError: a joint is missing, the numbers of names and values differ, or a value
                is implausible: not finite, or too far outside its limits.
        """
        if len(names) != len(positions):
            raise MeasurementError(
                f"a joint state has {len(names)} joint names but {len(positions)} positions"
            )
        if len(velocities) not in (0, len(names)):
            raise MeasurementError(
                f"a joint state has {len(names)} joint names but {len(velocities)} velocities"
            )
        rows = self._find_rows(names)
        q = np.array([positions[i] for i in rows], float)
        speed = self._zero_velocities
        if len(velocities):
            speed = np.array([velocities[i] for i in rows], float)
        self.check(q, speed)
        return JointSample(float(stamp), self.names, _make_read_only(q), _make_read_only(speed))

    def _find_rows(self, names: Sequence[str]) -> list[int]:
        """Return the indices of the arm's joints among these names.

        The result is cached for the next joint state.
        """
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
        """Check that positions and velocities (n,) are plausible for the joints of this arm.

        Raises:
            MeasurementError: a value is not finite or implausibly large, or the number of values is
                not n.
        """
        q = np.asarray(q, float)
        speeds = self._zero_velocities if velocities is None else np.asarray(velocities, float)
        if not q.shape == speeds.shape == self.lower.shape:
            raise MeasurementError(
                f"joint positions and velocities have the shapes {q.shape} and {speeds.shape}, "
                f"must have ({len(self.names)},) for this arm"
            )
        joint, is_speed = find_implausible_joint(q, speeds, *self.plausible_bounds)
        if joint >= 0 and not is_speed:
            raise MeasurementError(
                f"the measured position {q[joint]:g} of {self.names[joint]} is impossible (limits "
                f"{self.lower[joint]:g} to {self.upper[joint]:g})"
            )
        if joint >= 0:
            raise MeasurementError(
                f"the measured speed {speeds[joint]:g} of {self.names[joint]} is impossible (limit "
                f"{self.velocity[joint]:g})"
            )

    def inverse_kinematics(
        self, world_T_camera: np.ndarray, q0: np.ndarray, tolerance: float = 1e-7,
        cost: Callable[[np.ndarray], float] | None = None,
    ) -> np.ndarray:
        """Find joints (n,) within the limits that move the camera to a pose (4, 4).

        Args:
            world_T_camera: (4, 4) desired pose of the camera.
            q0: (n,) joints from which the search starts.
            tolerance: largest pose error, m, in which a rotation error of 1 rad counts as 0.1 m.
                Most solutions are exact to 1e-12; near a singularity of the arm, an error of up to
                1e-8 remains.
            cost: function that returns the cost >= 0 of joints (n,). The first solution with the
                cost 0 is returned; if there is none, the solution with the lowest cost. None to
                return the first solution.

        Raises:
            UnreachableError: no solution was found. The error contains the remaining distance.
        """
        # Imported here, because the import of SciPy's optimisers takes a third of a second.
        from .inverse_kinematics import solve_inverse_kinematics

        return solve_inverse_kinematics(
            self.pose_and_jacobian, self.lower, self.upper, world_T_camera, q0, tolerance, cost
        )


@jit("f8[:], f8[:], f8[:], f8[:], f8[:]")
def find_implausible_joint(q, velocities, lower, upper, max_speeds):
    """Return the index of the first joint with an implausible value, and whether it is a velocity.

    Positions are checked before velocities. Values that are not finite are implausible. The index
    is -1 if all values are plausible.
    """
    for i in range(len(q)):
        if not lower[i] <= q[i] <= upper[i]:
            return i, False
    for i in range(len(q)):
        if not abs(velocities[i]) <= max_speeds[i]:
            return i, True
    return -1, False


def _make_read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def is_free_camera(arm: Arm) -> bool:
    """Return whether this is a free-flying camera without an arm."""
    return getattr(arm, "is_free", False)
