"""Closed-form kinematics of the gantry arm.

Joint order everywhere in this package: gantry (m), J1, J2, J3, J5, J6 (rad).

Two angles describe the arm's vertical plane: a = J2 and b = J2 + J3, both from the downward
vertical, and c = J2 + J3 + J5 is the pitch of the camera. With the distances of `Geometry`

    r     = upper sin a + fore sin b + wrist sin c          (away from the shoulder axis)
    depth = shoulder + upper cos a + fore cos b + wrist cos c       (below the carriage)

and the camera sits, in the world (z up, the gantry runs along x), at

    (gantry + r sin J1,  r cos J1,  carriage_height - depth).

This is the kinematics of the laboratory's own controller with its axes named as the URDF has
them: its y is the world's x, its x the world's y, its z points down.

Frames: `world`; `optical`, the camera's optical frame (x right, y down, z forward, REP 103).
`world_T_optical` maps optical coordinates to world coordinates.
"""

from dataclasses import dataclass

import numpy as np

from .errors import UnreachableError

JOINT_NAMES = ("gantry", "J1", "J2", "J3", "J5", "J6")
GANTRY, J1, J2, J3, J5, J6 = range(6)

# Axes of the arm's base (link0) in the world: x along the world's y, z downwards.
_WORLD_R_ARM = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Gazebo's camera link looks along +x with z up; the optical frame looks along +z with y down.
_LINK_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def rotation_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation matrix (3, 3) of fixed-axis roll, pitch, yaw (rad), as URDF writes them."""
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


@dataclass(frozen=True)
class Geometry:
    """Distances of the arm, m, and the mounting of the camera; defaults are the ARAS robot's."""

    carriage_height: float = 1.6263 - 0.02888
    shoulder: float = 0.168 + 0.132
    upper: float = 0.25
    fore: float = 0.16
    wrist: float = 0.0718 + 0.0334
    # Written 3.14 and -1.57 in the robot's URDF, so the camera really is tilted by 1.8 mrad.
    camera_rpy: tuple[float, float, float] = (3.14, -1.57, 0.0)


class Kinematics:
    """Pose and Jacobian of the camera as functions of the six joints."""

    def __init__(self, geometry: Geometry | None = None) -> None:
        self.geometry = geometry if geometry is not None else Geometry()
        self._flange_R_optical = rotation_rpy(*self.geometry.camera_rpy) @ _LINK_R_OPTICAL

    def pitch(self, q: np.ndarray) -> float:
        """Pitch J2 + J3 + J5 of the camera, rad; 0 looks straight down."""
        return float(q[J2] + q[J3] + q[J5])

    def yaw(self, q: np.ndarray) -> float:
        """Yaw J1 + J6 of a level camera about the downward vertical, rad."""
        return float(q[J1] + q[J6])

    def pose(self, q: np.ndarray) -> np.ndarray:
        """`world_T_optical` (4, 4) for joints q (6,)."""
        r, depth = self._plane(q)
        world_T_optical = np.eye(4)
        world_T_optical[:3, :3] = self._rotation(q)
        world_T_optical[:3, 3] = (
            q[GANTRY] + r * np.sin(q[J1]),
            r * np.cos(q[J1]),
            self.geometry.carriage_height - depth,
        )
        return world_T_optical

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Geometric Jacobian (6, 6) of the camera, expressed in the optical frame.

        twist = jacobian(q) @ q_dot, with twist = (vx, vy, vz, wx, wy, wz) of the optical
        frame in itself, m/s and rad/s.
        """
        g = self.geometry
        a, b, c = q[J2], q[J2] + q[J3], self.pitch(q)
        s1, c1 = np.sin(q[J1]), np.cos(q[J1])
        r, _ = self._plane(q)
        radial = np.array([c1, s1, 0.0])
        tangential = np.array([-s1, c1, 0.0])
        down = np.array([0.0, 0.0, 1.0])

        # Lever arms of the three pitch joints: each turns everything below it.
        wrist = g.wrist * (np.cos(c) * radial - np.sin(c) * down)
        fore = g.fore * (np.cos(b) * radial - np.sin(b) * down)
        upper = g.upper * (np.cos(a) * radial - np.sin(a) * down)

        in_arm = np.zeros((6, 6))
        in_arm[:3, GANTRY] = (0.0, 1.0, 0.0)
        in_arm[:3, J1] = r * tangential
        in_arm[3:, J1] = down
        in_arm[:3, J2] = upper + fore + wrist
        in_arm[:3, J3] = fore + wrist
        in_arm[:3, J5] = wrist
        in_arm[3:, [J2, J3, J5]] = tangential[:, None]
        in_arm[3:, J6] = np.cos(c) * down + np.sin(c) * radial

        optical_R_arm = self._rotation(q).T @ _WORLD_R_ARM
        return np.vstack([optical_R_arm @ in_arm[:3], optical_R_arm @ in_arm[3:]])

    def pitch_axis(self, q: np.ndarray) -> np.ndarray:
        """Unit axis (3,) of the pitch joints in the optical frame."""
        in_arm = np.array([-np.sin(q[J1]), np.cos(q[J1]), 0.0])
        return self._rotation(q).T @ _WORLD_R_ARM @ in_arm

    def inverse(
        self,
        position: np.ndarray,
        yaw: float,
        pitch: float = 0.0,
        shoulder_angle: float = 0.0,
        elbow: int = -1,
    ) -> np.ndarray:
        """Joints (6,) that put the camera at a place, in closed form.

        Args:
            position: of the optical frame's origin in the world, m, shape (3,).
            yaw: J1 + J6, rad.
            pitch: J2 + J3 + J5, rad.
            shoulder_angle: J1, rad: the choice that the redundant gantry leaves.
            elbow: sign of J3; the laboratory's poses start with -1.

        Raises:
            UnreachableError: the place is beyond the stretched arm. The original's inverse
                kinematics answers NaN here, and sends it to the motors.
        """
        g = self.geometry
        if abs(np.cos(shoulder_angle)) < 1e-6:
            raise UnreachableError(
                f"J1 = {shoulder_angle:.4f} rad points the arm along the gantry, where it cannot "
                "choose its y: take a J1 nearer to 0",
                excess=float("inf"),
            )
        x, y, z = (float(value) for value in position)
        r = y / np.cos(shoulder_angle)
        along = r - g.wrist * np.sin(pitch)
        below = g.carriage_height - z - g.shoulder - g.wrist * np.cos(pitch)
        distance = float(np.hypot(along, below))
        reach, fold = g.upper + g.fore, abs(g.upper - g.fore)
        # A rounding error must not turn the stretched pose itself into an unreachable one.
        if not fold - 1e-12 <= distance <= reach + 1e-12:
            excess = distance - reach if distance > reach else fold - distance
            raise UnreachableError(
                f"camera position ({x:.4f}, {y:.4f}, {z:.4f}) m is {excess * 1e3:.2f} mm outside "
                f"the reach of J2 and J3 ({fold:.2f} to {reach:.2f} m from the shoulder)",
                excess=float(excess),
            )
        cosine = (distance**2 - g.upper**2 - g.fore**2) / (2.0 * g.upper * g.fore)
        q3 = np.sign(elbow) * np.arccos(np.clip(cosine, -1.0, 1.0))
        q2 = np.arctan2(along, below) - np.arctan2(
            g.fore * np.sin(q3), g.upper + g.fore * np.cos(q3)
        )
        return np.array(
            [
                x - r * np.sin(shoulder_angle),
                shoulder_angle,
                q2,
                q3,
                pitch - q2 - q3,
                yaw - shoulder_angle,
            ]
        )

    def _plane(self, q: np.ndarray) -> tuple[float, float]:
        """Distance from the shoulder axis and depth below the carriage, m."""
        g = self.geometry
        a, b, c = q[J2], q[J2] + q[J3], self.pitch(q)
        r = g.upper * np.sin(a) + g.fore * np.sin(b) + g.wrist * np.sin(c)
        depth = g.shoulder + g.upper * np.cos(a) + g.fore * np.cos(b) + g.wrist * np.cos(c)
        return float(r), float(depth)

    def _rotation(self, q: np.ndarray) -> np.ndarray:
        """`world_R_optical` (3, 3): yaw J1, pitch, yaw J6, then the mounting."""
        arm_R_flange = (
            rotation_rpy(0.0, 0.0, q[J1])
            @ rotation_rpy(0.0, self.pitch(q), 0.0)
            @ rotation_rpy(0.0, 0.0, q[J6])
        )
        return _WORLD_R_ARM @ arm_R_flange @ self._flange_R_optical


def pose_difference(a_T_b: np.ndarray, a_T_c: np.ndarray) -> tuple[float, float]:
    """Distance (m) and rotation angle (rad) between two poses (4, 4) in one frame."""
    distance = float(np.linalg.norm(a_T_b[:3, 3] - a_T_c[:3, 3]))
    b_R_c = a_T_b[:3, :3].T @ a_T_c[:3, :3]
    # The antisymmetric part keeps its precision where arccos of the trace loses it.
    sine = 0.5 * np.linalg.norm(
        [b_R_c[2, 1] - b_R_c[1, 2], b_R_c[0, 2] - b_R_c[2, 0], b_R_c[1, 0] - b_R_c[0, 1]]
    )
    return distance, float(np.arctan2(sine, 0.5 * (np.trace(b_R_c) - 1.0)))
