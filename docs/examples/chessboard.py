"""Calibration of the camera in a hand with a chessboard, as in a laboratory.

`record` moves the arm of docs/my_robot.md through a number of views of a chessboard, and stores the
images and the joint positions. `calibrate` reads only this recording and the robot's description.
It estimates the intrinsics of the camera with OpenCV, and then its pose on the flange.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml

from aras_sim_bridge import Pose, Simulation, load_description, load_world, populate
from aras_visual_servo_controller import Arm

HERE = Path(__file__).resolve().parent
URDF, CONTROLLERS = HERE / "my_arm.urdf", HERE / "my_arm_controllers.yaml"
CAMERA = {"width": 640, "height": 480, "horizontal_fov": 1.0}  # without distortion
LINK = "flange"  # link that carries the camera
INNER, SQUARE = (6, 5), 0.02  # inner corners of a board of 7 x 6 squares; side of a square, m
BOARD = (0.45, 0.05, 0.0505)  # centre of the board on the table, m
BLACK = "<material><ambient>0 0 0 1</ambient><diffuse>0 0 0 1</diffuse></material>"
BOX = ("<visual name='{}'><pose>{} {} 0 0 0 0</pose><geometry><box><size>{} {} 0.0004</size></box>"
       f"</geometry>{BLACK}</visual>")  # fmt: skip


def make_board() -> str:
    """Return a world file with a chessboard; the white table shows between its black squares."""
    columns, rows = INNER[0] + 1, INNER[1] + 1
    squares = [BOX.format(f"s{i}_{j}", (i - (columns - 1) / 2) * SQUARE,
                          (j - (rows - 1) / 2) * SQUARE, SQUARE, SQUARE)
               for i in range(columns) for j in range(rows) if (i + j) % 2 == 0]  # fmt: skip
    x, y, z = BOARD
    return (f"<sdf version='1.6'><world name='w'><model name='board'><static>1</static><pose>{x} "
            f"{y} {z} 0 0 0</pose><link name='l'>{''.join(squares)}</link></model></world></sdf>")


def record(folder: Path, views: int = 15) -> None:
    """Write images of the board and joints.csv, with the joints (rad) of each image, to a folder.

    The views are random: 0.2 to 0.28 m from the board, tilted by up to 0.3 rad.
    """
    (folder / "board.world").write_text(make_board())
    simulation, frames = Simulation(), []
    populate(simulation.spawn, load_world(folder / "board.world"))
    parameters = yaml.safe_load(CONTROLLERS.read_text())["aras_visual_servo"]
    simulation.spawn(load_description(URDF), "arm", namespace="/aras_visual_servo",
                     parameters=parameters, cameras={"labrob": {"camera": CAMERA}})  # fmt: skip
    robot, camera = simulation.robots["arm"], simulation.camera("/labrob/camera")
    robot.start(name for name in parameters if name != "joint_state_controller")
    simulation.step()  # the controllers start, and accept commands
    camera.on_frame = frames.append
    arm, draw, joints = Arm.from_urdf(URDF.read_text()), np.random.default_rng(5), []
    q = np.zeros(len(arm.names))
    for k in range(views):
        tilt = Pose.from_rpy(BOARD, draw.uniform(-0.3, 0.3, 2).tolist() + [draw.uniform(-0.5, 0.5)])
        above = Pose.from_rpy((*draw.uniform(-0.01, 0.01, 2), draw.uniform(0.2, 0.28)),
                              (np.pi, 0.0, 0.0))  # fmt: skip
        q = arm.inverse_kinematics(tilt.matrix() @ above.matrix(), q)
        for name, position in zip(arm.names, q, strict=True):
            robot.command(f"{name}_position_controller", position)
        for _ in range(700):  # the arm moves to the view and stops
            simulation.step()
        frames.clear()
        camera.enabled = True
        while not frames:
            simulation.step()
        camera.enabled = False
        cv2.imwrite(str(folder / f"view_{k:02}.png"), frames[0].image[..., ::-1])
        measured = dict(zip(robot.model.joint_names, robot.model.read_joints()[0], strict=True))
        joints.append([measured[name] for name in arm.names])
    simulation.close()
    np.savetxt(folder / "joints.csv", joints, delimiter=",", header=",".join(arm.names))


def to_pose(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of a rotation vector, rad, and a position, m."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(place)
    return pose


def solve_hand_eye(hands: np.ndarray, boards: np.ndarray) -> np.ndarray:
    """Compute hand_T_camera (4, 4) from base_T_hand and camera_T_board (n, 4, 4).

    It solves A X = X B for the motions A of the hand and B of the camera between two views: first
    the rotation, which turns the axes of B into those of A, then the translation, both with least
    squares (F. Park and B. Martin, Robot sensor calibration: solving AX = XB on the Euclidean
    group, IEEE Transactions on Robotics and Automation 10(5), 1994).
    """
    A = np.linalg.inv(hands[1:]) @ hands[:-1]
    B = boards[1:] @ np.linalg.inv(boards[:-1])
    a, b = (np.array([cv2.Rodrigues(T[:3, :3])[0].ravel() for T in motions]) for motions in (A, B))
    U, _, V = np.linalg.svd(a.T @ b)
    X = np.eye(4)
    X[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
    right = B[:, :3, 3] @ X[:3, :3].T - A[:, :3, 3]
    left = (A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    X[:3, 3] = np.linalg.lstsq(left, right.ravel(), rcond=None)[0]
    return X


def calibrate(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the camera from the recording in a folder, and write hand_eye.yaml there.

    Returns:
        K (3, 3), px, and flange_T_camera (4, 4), m.
    """
    board = np.array([(i * SQUARE, j * SQUARE, 0.0) for j in range(INNER[1])
                      for i in range(INNER[0])], np.float32)  # fmt: skip
    hand, hands, seen = Arm.from_urdf(URDF.read_text(), LINK), [], []
    for k, q in enumerate(np.loadtxt(folder / "joints.csv", delimiter=",")):
        grey = cv2.imread(str(folder / f"view_{k:02}.png"), cv2.IMREAD_GRAYSCALE)
        found, corners = cv2.findChessboardCorners(grey, INNER)
        if not found:
            continue
        corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), (3, 100, 1e-5)).reshape(-1, 2)
        # Turned by half a turn, the board has the same corners: its first row points to the right.
        seen.append(corners if corners[1, 0] > corners[0, 0] else corners[::-1].copy())
        hands.append(hand.pose(q))
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    size = (CAMERA["width"], CAMERA["height"])
    rms, K, _, turns, places = cv2.calibrateCamera([board] * len(seen), seen, size, None, None,
                                                   flags=flags)  # fmt: skip
    boards = [to_pose(*view) for view in zip(turns, places, strict=True)]  # camera_T_board
    flange_T_camera = solve_hand_eye(np.array(hands), np.array(boards))
    R, t = flange_T_camera[:3, :3], flange_T_camera[:3, 3]
    (folder / "hand_eye.yaml").write_text(
        yaml.safe_dump({"R_cam2gripper": R.tolist(), "t_cam2gripper": t.tolist()})
    )
    print(f"{len(seen)} views with the board, {rms:.3f} px RMS")
    return K, flange_T_camera
