#!/usr/bin/python3
"""Show a chessboard to a camera of the running simulator, in a sequence of poses.

For cameras that are fixed in the world. The poses cover the picture up to its edges, as far as
the published lens says that all corners are seen well; so a calibration tool that listens finds
the board in nearly every picture:

    /usr/bin/python3 tests/benchmarks/show_chessboard.py calib [--seconds 1.0] [--poses 160]

Needs the sourced workspace and Debian's python3-opencv. The board has 8 x 6 inner corners 25 mm
apart (`--size 8x6 --square 0.025`).
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator

import cv2
import numpy as np
import rospy
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import GetWorldProperties, SetModelState, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import CameraInfo
from tf.transformations import euler_matrix, quaternion_from_matrix

COLUMNS, ROWS, SQUARE = 8, 6, 0.025  # inner corners, and m
THICK, INK = 0.002, 2e-5  # m, of the plate and of the squares on it
# Axes of an optical frame (right, down, forward) in a frame that looks along x with z up.
LOOKING_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# Inner corners (N, 3) about the board's middle, m: right, down, away from the viewer.
CORNERS = np.array([[c - (COLUMNS - 1) / 2, r - (ROWS - 1) / 2, 0.0]
                    for r in range(ROWS) for c in range(COLUMNS)]) * SQUARE  # fmt: skip

# Where camera_calibration finds every corner to a fraction of a pixel. Measured with its 1.17 and
# OpenCV 4.6 on 320 x 240 pictures of a fisheye: beyond UNEVEN 1.7 its refinement, whose window
# is half the smallest gap that it looks at, puts corners of every third board off by a pixel.
BORDER = 10.0  # px; it refuses corners within 8 px of the picture's border
CLOSEST = 10.0  # px between neighbouring corners
BIGGEST = 32.0  # px to a square where the picture is not stretched
UNEVEN = 1.6  # largest gap between neighbouring corners over the smallest
TILT = math.radians(35.0)  # at most, of the board against the ray to its middle
ROLL = 0.2  # at most, about that ray, rad
STEEPEST = math.radians(50.0)  # between the board's normal and the ray to any of its corners
# OpenCV's fisheye module calibrates with the tangent of the angle from the axis: none from 90 on.
WIDEST = math.radians(84.0)


def board() -> str:
    """URDF of the chessboard: white plate in the y-z plane, black squares on its -x side."""
    wide, high = (COLUMNS + 1) * SQUARE, (ROWS + 1) * SQUARE
    squares = "".join(
        f'<visual><origin xyz="{-(THICK + INK) / 2} {(c + 0.5) * SQUARE - wide / 2} '
        f'{(r + 0.5) * SQUARE - high / 2}"/><geometry><box size="{INK} {SQUARE} {SQUARE}"/>'
        "</geometry></visual>"
        for c in range(COLUMNS + 1)
        for r in range(ROWS + 1)
        if (c + r) % 2 == 0
    )
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    mass = f'<inertial><mass value="1"/>{inertia}</inertial>'
    return f"""<robot name="board">
      <link name="plate">{mass}<visual><geometry>
        <box size="{THICK} {wide + 2 * SQUARE} {high + 2 * SQUARE}"/></geometry></visual></link>
      <link name="squares">{mass}{squares}</link>
      <joint name="glue" type="fixed"><parent link="plate"/><child link="squares"/></joint>
      <gazebo reference="plate"><turnGravityOff>true</turnGravityOff></gazebo>
      <gazebo reference="squares"><turnGravityOff>true</turnGravityOff>
        <material>Gazebo/Black</material></gazebo>
    </robot>"""


def cloth() -> str:
    """SDF of a black sheet on the ground.

    The detector equalises the histogram of the picture. Before a bright ground, the white of a
    board that is turned from the sun would come out as dark as its black.
    """
    return """<sdf version="1.6"><model name="cloth"><static>true</static><link name="link">
      <visual name="sheet"><geometry><box><size>40 40 0.01</size></box></geometry>
        <material><script><name>Gazebo/Black</name></script></material></visual>
    </link></model></sdf>"""


def project(info: CameraInfo, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) in the optical frame, m, by OpenCV from CameraInfo."""
    lens = cv2.fisheye if info.distortion_model == "equidistant" else cv2
    K, D, zero = np.array(info.K).reshape(3, 3), np.array(info.D), np.zeros(3)
    return lens.projectPoints(points.reshape(-1, 1, 3), zero, zero, K, D)[0].reshape(-1, 2)


def ray(info: CameraInfo, u: float, v: float) -> np.ndarray:
    """Unit direction (3,) in the optical frame of a pixel."""
    lens = cv2.fisheye if info.distortion_model == "equidistant" else cv2
    K, D = np.array(info.K).reshape(3, 3), np.array(info.D)
    x, y = lens.undistortPoints(np.array([[[u, v]]]), K, D).ravel()
    return np.array([x, y, 1.0]) / math.sqrt(x * x + y * y + 1.0)


def is_seen_well(info: CameraInfo, R: np.ndarray, middle: np.ndarray) -> bool:
    """Whether the detector should find a board at `middle` (3,), m, with axes R (3, 3)."""
    points = CORNERS @ R.T + middle
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    if directions[:, 2].min() < math.cos(WIDEST):
        return False
    if (directions @ R[:, 2]).min() < math.cos(STEEPEST):
        return False
    pixels = project(info, points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    if low.min() < BORDER or (high > np.array([info.width, info.height]) - 1 - BORDER).any():
        return False
    grid = pixels.reshape(ROWS, COLUMNS, 2)
    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).ravel() for axis in (0, 1)]
    gaps = np.concatenate(gaps)
    return gaps.min() >= CLOSEST and gaps.max() <= UNEVEN * gaps.min()


def poses(info: CameraInfo, count: int, seed: int = 1) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield axes (3, 3) and middle (3,), m, of `count` boards in the optical frame, all seen well.
    """
    random = np.random.default_rng(seed)
    found = tries = 0
    while found < count:
        if tries == 1000 * (found + 1):
            raise RuntimeError("this camera sees no pose of the board well: is it too coarse?")
        u, v = random.uniform(0.0, 1.0, 2) * [info.width, info.height]
        # Many sizes and tilts at one place, or the middle, where all fit, would get them all.
        for _ in range(50):
            tries += 1
            R, middle = _pose_at(ray(info, u, v), info.K[0], random)
            if is_seen_well(info, R, middle):
                found += 1
                yield R, middle
                break


def _pose_at(
    forward: np.ndarray, focal: float, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) and middle (3,), m, of a board about the unit direction `forward`."""
    around = random.uniform(0.0, 2.0 * math.pi)
    tilt = random.uniform(0.0, TILT)
    turns = (
        _turn_to(forward),
        np.array([math.cos(around), math.sin(around), 0.0]) * tilt,
        np.array([0.0, 0.0, random.uniform(-ROLL, ROLL)]),
    )
    facing, tilted, turned = (cv2.Rodrigues(turn)[0] for turn in turns)
    # so many pixels to a square
    return facing @ tilted @ turned, forward * SQUARE * focal / random.uniform(CLOSEST, BIGGEST)


def _turn_to(direction: np.ndarray) -> np.ndarray:
    """Rotation vector (3,), rad, that takes the optical axis to a unit direction (3,)."""
    axis = np.array([-direction[1], direction[0], 0.0])
    sine = np.linalg.norm(axis)
    return axis * (math.atan2(sine, direction[2]) / sine) if sine > 0.0 else axis


class Board:
    """The chessboard in the running simulator, before a camera that is fixed in the world."""

    def __init__(self, camera: str) -> None:
        """Spawn the board (or take over the one that is there) for the camera of this name."""
        pose = rospy.get_param(f"/gazebo/cameras/{camera}/pose", None)
        if pose is None:
            raise RuntimeError(
                f"/gazebo/cameras/{camera}/pose is not set: '{camera}' is no camera of the world"
            )
        self._world_T_camera = euler_matrix(*pose[3:])
        self._world_T_camera[:3, 3] = pose[:3]
        rospy.wait_for_service("/gazebo/spawn_urdf_model", 30.0)
        world = rospy.ServiceProxy("/gazebo/get_world_properties", GetWorldProperties)
        present = world().model_names
        for name, kind, text in (("board", "urdf", board()), ("cloth", "sdf", cloth())):
            if name not in present:
                spawn = rospy.ServiceProxy(f"/gazebo/spawn_{kind}_model", SpawnModel)
                _check(spawn(name, text, "", Pose(), ""))
        self._move = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)

    def hold(self, R: np.ndarray, middle: np.ndarray) -> None:
        """Hold the board's printed face at `middle` (3,), m, with axes R (3, 3), optical frame."""
        optical_T_plate = np.eye(4)
        optical_T_plate[:3, :3] = R @ LOOKING_R_OPTICAL.T
        optical_T_plate[:3, 3] = middle + R[:, 2] * (THICK / 2 + INK)
        camera_T_optical = np.eye(4)
        camera_T_optical[:3, :3] = LOOKING_R_OPTICAL
        T = self._world_T_camera @ camera_T_optical @ optical_T_plate
        pose = Pose(Point(*T[:3, 3]), Quaternion(*quaternion_from_matrix(T)))
        _check(self._move(ModelState(model_name="board", pose=pose)))


def _check(reply: object) -> None:
    if not reply.success:
        raise RuntimeError(reply.status_message)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("camera", help="name of a camera below /gazebo/cameras")
    parser.add_argument("--poses", type=int, default=160, help="how many (default 160)")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each (default 1)")
    arguments = parser.parse_args()
    rospy.init_node("show_chessboard", disable_rostime=True)
    try:
        held = Board(arguments.camera)
        info = rospy.wait_for_message(f"/{arguments.camera}/camera_info", CameraInfo, 30.0)
    except (RuntimeError, rospy.ROSException) as error:
        print(f"show_chessboard: {error}", file=sys.stderr)
        return 1
    for R, middle in poses(info, arguments.poses):
        if rospy.is_shutdown():
            break
        held.hold(R, middle)
        time.sleep(arguments.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
