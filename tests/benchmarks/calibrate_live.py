#!/usr/bin/env python3
"""Debian's camera_calibration on a live topic: does it find the intrinsics that are published?

Starts the simulator with a camera fixed in the world, holds a chessboard before it in many poses,
and gives the images of the topic to camera_calibration's calibrator. Needs the sourced workspace
and `apt install python3-camera-calibration`:

    . devel/setup.bash && python tests/benchmarks/calibrate_live.py [--camera wide] [--views 40]

The last line is JSON with published and found intrinsics; the status is 0 if focal lengths agree
within 0.2 % and the centre within 0.3 px.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

import cv2
import numpy as np
import rospy
import yaml
from camera_calibration.calibrator import CAMERA_MODEL, ChessboardInfo, MonoCalibrator
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import SetModelState, SpawnModel
from geometry_msgs.msg import Pose
from ros_graph import Collector, Launch, RosMaster, wait_for_message
from sensor_msgs.msg import CameraInfo, Image

PRESETS = Path(__file__).parents[2] / "src/aras_visual_servo_gazebo/config/cameras"
COLUMNS, ROWS, SQUARE = 8, 6, 0.025  # inner corners, and m
HEIGHT = 1.0  # m, of the camera; it looks along world x


def board() -> str:
    """URDF of the chessboard: white plate in the y-z plane, squares on its -x side."""
    wide, high = (COLUMNS + 1) * SQUARE, (ROWS + 1) * SQUARE
    squares = "".join(
        f'<visual><origin xyz="-0.0011 {(c + 0.5) * SQUARE - wide / 2} '
        f'{(r + 0.5) * SQUARE - high / 2}"/><geometry><box size="0.0002 {SQUARE} {SQUARE}"/>'
        "</geometry></visual>"
        for c in range(COLUMNS + 1)
        for r in range(ROWS + 1)
        if (c + r) % 2 == 0
    )
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    mass = f'<inertial><mass value="1"/>{inertia}</inertial>'
    return f"""<robot name="board">
      <link name="plate">{mass}<visual><geometry>
        <box size="0.002 {wide + 2 * SQUARE} {high + 2 * SQUARE}"/></geometry></visual></link>
      <link name="squares">{mass}{squares}</link>
      <joint name="glue" type="fixed"><parent link="plate"/><child link="squares"/></joint>
      <gazebo reference="plate"><turnGravityOff>true</turnGravityOff></gazebo>
      <gazebo reference="squares"><turnGravityOff>true</turnGravityOff>
        <material>Gazebo/Black</material></gazebo>
    </robot>"""


def pose(random: np.random.Generator, info: CameraInfo) -> Pose:
    """Somewhere in view, near or far, tilted up to 35 degrees."""
    u, v = random.uniform(0.2, 0.8, 2) * [info.width, info.height]
    distance = random.uniform(1.2, 2.4) * COLUMNS * SQUARE * info.K[0] / info.width * 1.3
    right = (u - info.K[2]) / info.K[0] * distance
    down = (v - info.K[5]) / info.K[4] * distance
    roll, pitch, yaw = random.uniform(-0.6, 0.6, 3)
    found = Pose()
    found.position.x, found.position.y, found.position.z = distance, -right, HEIGHT - down
    (cr, cp, cy), (sr, sp, sy) = (f(np.array([roll, pitch, yaw]) / 2) for f in (np.cos, np.sin))
    q = found.orientation
    q.x, q.y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    q.z, q.w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    return found


def views(count: int) -> tuple[CameraInfo, list[np.ndarray]]:
    """Images of the topic, one a pose, and what CameraInfo says."""
    info = wait_for_message("/calib/camera_info", CameraInfo, timeout=30.0)
    rospy.wait_for_service("/gazebo/spawn_urdf_model", 30.0)
    spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
    reply = spawn("board", board(), "", Pose(), "")
    if not reply.success:
        raise RuntimeError(reply.status_message)
    move = rospy.ServiceProxy("/gazebo/set_model_state", SetModelState)
    random = np.random.default_rng(1)
    images = []
    with Collector("/calib/image_raw", Image) as topic:
        topic.wait()
        for _ in range(count):
            reply = move(ModelState(model_name="board", pose=pose(random, info)))
            if not reply.success:
                raise RuntimeError(reply.status_message)
            topic.clear()
            message = topic.wait(2)  # the first may have been under way
            rgb = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
            images.append(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
    return info, images


def _fisheye_flag(name: str) -> int:
    """OpenCV 4 keeps these flags in cv2.fisheye, OpenCV 5 does not."""
    return getattr(cv2.fisheye, f"CALIB_{name}", None) or getattr(cv2, f"CALIB_{name}")


def calibrate(info: CameraInfo, images: list[np.ndarray]) -> dict:
    """Run camera_calibration's own calibrator; return published and found intrinsics."""
    calibrator = MonoCalibrator(
        [ChessboardInfo("chessboard", COLUMNS, ROWS, SQUARE)],
        fisheye_flags=_fisheye_flag("RECOMPUTE_EXTRINSIC") | _fisheye_flag("FIX_SKEW"),
    )
    if info.distortion_model == "equidistant":
        calibrator.set_cammodel(CAMERA_MODEL.FISHEYE)
    used = len(calibrator.collect_corners(images))
    calibrator.cal(images)
    K, published = calibrator.intrinsics, np.array(info.K).reshape(3, 3)
    return {
        "boards_found": used,
        "published": [round(float(published[i]), 4) for i in ((0, 0), (1, 1), (0, 2), (1, 2))],
        "found": [round(float(K[i]), 4) for i in ((0, 0), (1, 1), (0, 2), (1, 2))],
        "D_published": list(info.D),
        "D_found": [round(float(d), 5) for d in np.ravel(calibrator.distortion)],
        "focal_error_percent": round(
            100 * float(max(abs(K[i, i] / published[i, i] - 1) for i in (0, 1))), 4
        ),
        "centre_error_px": round(float(np.abs(K[:2, 2] - published[:2, 2]).max()), 4),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", default="calibrated", help="preset (default calibrated)")
    parser.add_argument("--views", type=int, default=40, help="poses of the board (default 40)")
    arguments = parser.parse_args()
    preset = yaml.safe_load((PRESETS / f"{arguments.camera}.yaml").read_text())
    with tempfile.TemporaryDirectory() as directory:
        master = RosMaster(Path(directory))
        os.environ.update({k: master.environment[k] for k in ("ROS_MASTER_URI", "ROS_IP")})
        rospy.init_node("camera_calibration_benchmark", disable_rostime=True)
        place = {"parent": "world", "pose": [0.0, 0.0, HEIGHT, 0.0, 0.0, 0.0], "near": 0.02}
        rospy.set_param("/gazebo/cameras", {"calib": {**preset, **place}})
        simulator = Launch(master, ("aras_sim_bridge", "empty_world.launch"), {})
        try:
            simulator.wait_for_nodes(["/gazebo"])
            info, images = views(arguments.views)
        finally:
            simulator.stop()
            rospy.signal_shutdown("done")
            master.stop()
    result = {"camera": arguments.camera, **calibrate(info, images)}
    print(json.dumps(result))
    return int(result["focal_error_percent"] > 0.2 or result["centre_error_px"] > 0.3)


if __name__ == "__main__":
    sys.exit(main())
