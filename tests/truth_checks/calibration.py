"""Hand-eye calibration from joint positions and images, compared with the true mounting."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pinocchio
from scenes import Bench, chessboard
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from aras_sim_bridge.camera import CameraConfig, CameraIntrinsics, CameraSensor
from aras_sim_bridge.rendering import create_renderer

from .check import Row, check
from .robots import Robot

HAND, LINK = "link6", "camera_link"
PICTURES = 20
_INNER, _SQUARE = (6, 5), 0.025  # inner corners of a board of 7 x 6 squares; square size, m
_BESIDE = {"xyz": (0.02, -0.03, 0.01), "rpy": (0.1, -0.2, 0.3)}  # pose of the sensor in its link
_CAMERAS = {
    "pinhole": {"horizontal_fov": 1.0},
    "plumb_bob": {"camera_matrix": {"fx": 560.0, "fy": 572.0, "cx": 331.3, "cy": 227.8},
                  "distortion_coefficients": [-0.25, 0.09, 0.001, -0.002, 0.0]},
}


def _transform(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = turn if np.ndim(turn) == 2 else Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = place
    return T


def _twelve(*poses: np.ndarray) -> np.ndarray:
    """Return rotation vector and position of each pose (4, 4), concatenated."""
    return np.concatenate([part for T in poses for part in (
        Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3])])  # fmt: skip


def _placement(robot: Robot, joints: np.ndarray, link: str) -> np.ndarray:
    pinocchio.framesForwardKinematics(robot.pin, robot.data, robot.pin_state(joints))
    return robot.data.oMf[robot.pin.getFrameId(link)].homogeneous


def _mounting(robot: Robot) -> np.ndarray:
    """Return the true hand_T_camera (4, 4) of the optical frame, from URDF and settings."""
    rest = np.zeros(len(robot.names))
    hand_T_link = np.linalg.inv(_placement(robot, rest, HAND)) @ _placement(robot, rest, LINK)
    seat = _transform(Rotation.from_euler("xyz", _BESIDE["rpy"]).as_matrix(), _BESIDE["xyz"])
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return hand_T_link @ seat @ _transform(optical, np.zeros(3))


def _corners(image: np.ndarray, board: np.ndarray) -> np.ndarray | None:
    """Detect the inner corners (30, 2), px, of a board (30, 3); None if it is not fully visible."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, _INNER, flags=cv2.CALIB_CB_ACCURACY)
    if not found:
        return None
    columns, rows = np.meshgrid(np.arange(_INNER[0] + 1), np.arange(_INNER[1] + 1))
    white = (columns + rows) % 2 == 0
    middles = _SQUARE * (np.stack([columns, rows], axis=-1) - 0.5)
    to_picture = cv2.findHomography(board[:, :2], corners)[0]
    u, v = np.moveaxis(cv2.perspectiveTransform(middles, to_picture), -1, 0).astype(np.float32)
    seen = cv2.remap(grey, u, v, cv2.INTER_NEAREST, borderValue=128)
    # Both detectors are accurate, but only this one has no systematic error over the whole image.
    corners = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2).astype(np.float32), (5, 5), (-1, -1),
                               (3, 100, 1e-5)).reshape(-1, 2).astype(float)  # fmt: skip
    if ((seen > 192) == white).all() and ((seen < 64) != white).all():
        return corners
    if ((seen > 192) != white).all() and ((seen < 64) == white).all():
        return corners[::-1]
    return None


def _pose(board: np.ndarray, corners: np.ndarray, info: CameraIntrinsics) -> np.ndarray:
    K, D = np.array(info.K, float), np.array(info.D, float)
    _, turn, place = cv2.solvePnP(board, corners, K, D)
    return _transform(turn.ravel(), place.ravel())


def _pictures(
    robot: Robot, sensor: CameraSensor, board: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return base_T_hand (n, 4, 4) from Pinocchio, camera_T_board (n, 4, 4), corners (n, 30, 2)."""
    random = np.random.default_rng(11)
    hands, boards, seen = [], [], []
    for _ in range(40 * PICTURES):
        joints = random.uniform(-1.0, 1.0, 6) * (0.15, 0.35, 0.3, 0.4, 0.5, 1.5)
        robot.model.set_joint_positions(dict(zip(robot.names, joints.tolist(), strict=True)))
        image = sensor.capture(robot.model.link_pose(LINK).matrix(), sensor.due_ns).image
        corners = _corners(image, board)
        if corners is not None:
            hands.append(_placement(robot, joints, HAND))
            boards.append(_pose(board, corners, sensor.info))
            seen.append(corners)
        if len(seen) == PICTURES:
            return np.array(hands), np.array(boards), np.array(seen)
    raise RuntimeError(f"the board was found in {len(seen)} pictures")


def _closed_form(hands: np.ndarray, boards: np.ndarray) -> np.ndarray:
    """Compute hand_T_camera (4, 4) from base_T_hand and camera_T_board (n, 4, 4).

    F. Park and B. Martin, Robot sensor calibration: solving AX = XB on the Euclidean group, IEEE
    Transactions on Robotics and Automation 10(5), 1994.
    """
    A = np.linalg.inv(hands[1:]) @ hands[:-1]
    B = boards[1:] @ np.linalg.inv(boards[:-1])
    a, b = (Rotation.from_matrix(T[:, :3, :3]).as_rotvec() for T in (A, B))
    turn = Rotation.align_vectors(a, b)[0].as_matrix()
    rows = np.vstack([T[:3, :3] - np.eye(3) for T in A])
    right = np.concatenate([turn @ T[:3, 3] - S[:3, 3] for S, T in zip(A, B, strict=True)])
    return _transform(turn, np.linalg.lstsq(rows, right, rcond=None)[0])


def _calibrated(
    board: np.ndarray, hands: np.ndarray, boards: np.ndarray, seen: np.ndarray,
    info: CameraIntrinsics,
) -> tuple[np.ndarray, np.ndarray]:
    """Return hand_T_camera (4, 4) with the least reprojection error, and its covariance."""
    K, D = np.array(info.K, float), np.array(info.D, float)
    first = _closed_form(hands, boards)

    def missed(x: np.ndarray) -> np.ndarray:
        mounting, base_T_board = _transform(x[:3], x[3:6]), _transform(x[6:9], x[9:])
        errors = []
        for hand, corners in zip(hands, seen, strict=True):
            camera_T_board = np.linalg.inv(hand @ mounting) @ base_T_board
            turn, place = np.split(_twelve(camera_T_board), 2)
            errors.append(cv2.projectPoints(board, turn, place, K, D)[0][:, 0] - corners)
        return np.ravel(errors)

    fit = least_squares(missed, _twelve(first, hands[0] @ first @ boards[0]), x_scale="jac",
                        xtol=1e-14, ftol=1e-14)  # fmt: skip
    inverse = np.linalg.inv(fit.jac.T @ fit.jac)
    pulls = [J.T @ e for J, e in zip(
        np.split(fit.jac, len(seen)), np.split(fit.fun, len(seen)), strict=True)]  # fmt: skip
    spread = np.transpose(pulls) @ pulls * len(seen) / (len(seen) - 2)
    return _transform(fit.x[:3], fit.x[3:6]), (inverse @ spread @ inverse)[:6, :6]


@check("OpenCV, Pinocchio, SciPy")
def hand_eye_calibration() -> Iterator[Row]:
    """Calibrate a camera that is mounted at an angle, from 20 images of a board and joints."""
    board = np.array([(i * _SQUARE, j * _SQUARE, 0.0) for j in range(_INNER[1])
                      for i in range(_INNER[0])])  # fmt: skip
    for name, lens in _CAMERAS.items():
        config = CameraConfig.from_mapping({"width": 640, "height": 480, **_BESIDE, **lens})
        with Robot("shipped arm") as robot:
            chessboard(Bench(robot.world, (0.01, 0.03, 0.37)), square=_SQUARE)
            sensor = CameraSensor(config, create_renderer("exact", robot.world))
            views = _pictures(robot, sensor, board)
            true = _mounting(robot)
        found, covariance = _calibrated(board, *views, sensor.info)
        turn = Rotation.from_matrix(true[:3, :3].T @ found[:3, :3]).as_rotvec()
        away = found[:3, 3] - true[:3, 3]
        off = _twelve(found) - _twelve(true)
        yield Row(f"{name}, position", "the URDF's mounting",
                  1e3 * float(np.linalg.norm(away)), 0.1, "mm")  # fmt: skip
        yield Row(f"{name}, attitude", "the URDF's mounting",
                  float(np.degrees(np.linalg.norm(turn))), 0.02, "°")  # fmt: skip
        stated = float(np.sqrt(off @ np.linalg.solve(covariance, off) / 6.0))
        yield Row(f"{name}, error relative to its stated deviation", "1", stated, 2.0)
