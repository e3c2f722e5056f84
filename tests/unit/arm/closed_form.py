"""Closed-form kinematics of the gantry arm.

Joint order everywhere in this package: gantry (m), J1, J2, J3, J5, J6 (rad).

Two angles describe the arm's vertical plane: a = J2 and b = J2 + J3, both from the downward
vertical, and c = J2 + J3 + J5 is the pitch of the flange. With the distances of `Geometry`

    r     = upper sin a + fore sin b + wrist sin c          (away from the shoulder axis)
    depth = shoulder + upper cos a + fore cos b + wrist cos c       (below the carriage)

and the flange sits, in the world (z up, the gantry runs along x), at

    (gantry + r sin J1,  r cos J1,  carriage_height - depth).

This is the kinematics of the laboratory's own controller with its axes named as the URDF has
them: its y is the world's x, its x the world's y, its z points down. The camera's mounting on the
flange may be any; the laboratory's controller counts its distance to the wrist's.

Frames: `world`; `flange`, the URDF's link6 (z away from the wrist, downwards at zero joints);
`optical`, the camera's optical frame (x right, y down, z forward, REP 103). `world_T_optical` maps
optical coordinates to world coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_controller.errors import UnreachableError

JOINT_NAMES = ("gantry", "J1", "J2", "J3", "J5", "J6")
GANTRY, J1, J2, J3, J5, J6 = range(6)

# Axes of the arm's base (link0) in the world: x along the world's y, z downwards.
_WORLD_R_ARM = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Gazebo's camera link looks along +x with z up; the optical frame looks along +z with y down.
LINK_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


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


def transform(xyz: Sequence[float], rpy: Sequence[float]) -> np.ndarray:
    """Pose (4, 4) of a URDF `<origin>`: xyz in m, fixed-axis roll, pitch, yaw in rad."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = rotation_rpy(*rpy)
    a_T_b[:3, 3] = xyz
    return a_T_b


def link_mounting(flange_T_link: np.ndarray) -> np.ndarray:
    """`flange_T_optical` (4, 4) of a camera that looks along its link's +x, z up."""
    flange_T_optical = flange_T_link.copy()
    flange_T_optical[:3, :3] = flange_T_link[:3, :3] @ LINK_R_OPTICAL
    return flange_T_optical


# `flange_T_optical` of the ARAS robot. Its URDF says 3.14 and -1.57, so the camera really is tilted
# by 1.8 mrad.
MOUNTING = link_mounting(transform((0.0, 0.0, 0.0334), (3.14, -1.57, 0.0)))
MOUNTING.setflags(write=False)


@dataclass(frozen=True)
class Geometry:
    """Distances of the arm, m; defaults are the ARAS robot's. wrist: from J5 to the flange."""

    carriage_height: float = 1.6263 - 0.02888
    shoulder: float = 0.168 + 0.132
    upper: float = 0.25
    fore: float = 0.16
    wrist: float = 0.0718


class Kinematics:
    """Pose and Jacobian of the camera as functions of the six joints."""

    def __init__(
        self, geometry: Geometry | None = None, mounting: np.ndarray | None = None
    ) -> None:
        """`mounting`: `flange_T_optical` (4, 4); the robot's own where it is left out."""
        self.geometry = geometry if geometry is not None else Geometry()
        self.mounting = np.array(MOUNTING if mounting is None else mounting, float)
        self.mounting.setflags(write=False)

    def pitch(self, q: np.ndarray) -> float:
        """Pitch J2 + J3 + J5 of the flange, rad; at 0 its axis points straight down."""
        return float(q[J2] + q[J3] + q[J5])

    def yaw(self, q: np.ndarray) -> float:
        """Yaw J1 + J6 of a level flange about the downward vertical, rad."""
        return float(q[J1] + q[J6])

    def pose(self, q: np.ndarray) -> np.ndarray:
        """`world_T_optical` (4, 4) for joints q (6,)."""
        r, depth = self._plane(q)
        arm_R_flange = self._flange(q)
        camera = np.array([r * np.cos(q[J1]), r * np.sin(q[J1]), depth])
        camera += arm_R_flange @ self.mounting[:3, 3]
        world_T_optical = np.eye(4)
        world_T_optical[:3, :3] = _WORLD_R_ARM @ arm_R_flange @ self.mounting[:3, :3]
        world_T_optical[:3, 3] = _WORLD_R_ARM @ camera
        world_T_optical[:3, 3] += (q[GANTRY], 0.0, self.geometry.carriage_height)
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
        # That was the flange; what turns it swings the camera about it.
        arm_R_flange = self._flange(q)
        in_arm[:3] += np.cross(in_arm[3:].T, arm_R_flange @ self.mounting[:3, 3]).T

        optical_R_arm = (arm_R_flange @ self.mounting[:3, :3]).T
        return np.vstack([optical_R_arm @ in_arm[:3], optical_R_arm @ in_arm[3:]])

    def pitch_axis(self, q: np.ndarray) -> np.ndarray:
        """Unit axis (3,) of the pitch joints in the optical frame."""
        in_arm = np.array([-np.sin(q[J1]), np.cos(q[J1]), 0.0])
        return (self._flange(q) @ self.mounting[:3, :3]).T @ in_arm

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
        joints = np.array([0.0, shoulder_angle, 0.0, 0.0, pitch, yaw - shoulder_angle])
        swing = _WORLD_R_ARM @ self._flange(joints) @ self.mounting[:3, 3]
        x, y, z = (float(value) for value in np.asarray(position) - swing)
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

    def _flange(self, q: np.ndarray) -> np.ndarray:
        """`arm_R_flange` (3, 3): yaw J1, pitch, yaw J6."""
        return (
            rotation_rpy(0.0, 0.0, q[J1])
            @ rotation_rpy(0.0, self.pitch(q), 0.0)
            @ rotation_rpy(0.0, 0.0, q[J6])
        )


def pose_difference(a_T_b: np.ndarray, a_T_c: np.ndarray) -> tuple[float, float]:
    """Distance (m) and rotation angle (rad) between two poses (4, 4) in one frame."""
    distance = float(np.linalg.norm(a_T_b[:3, 3] - a_T_c[:3, 3]))
    b_R_c = a_T_b[:3, :3].T @ a_T_c[:3, :3]
    # The antisymmetric part keeps its precision where arccos of the trace loses it.
    sine = 0.5 * np.linalg.norm(
        [b_R_c[2, 1] - b_R_c[1, 2], b_R_c[0, 2] - b_R_c[2, 0], b_R_c[1, 0] - b_R_c[0, 1]]
    )
    return distance, float(np.arctan2(sine, 0.5 * (np.trace(b_R_c) - 1.0)))
