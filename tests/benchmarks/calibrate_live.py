#!/usr/bin/python3
"""Test of Debian's camera_calibration on a live topic: it must find the published intrinsics.

Starts the simulator with a camera fixed in the world, holds a chessboard before it in many poses,
and lets camera_calibration's own node look on: the one behind `cameracalibrator.py`, without its
window. When the node says that it has seen enough, it calibrates and commits to set_camera_info,
as its buttons do. It runs with Debian's interpreter and Debian's OpenCV, whatever the virtual
environment holds. Needs the sourced workspace and

    apt install --no-install-recommends ros-camera-calibration python3-opencv python3-cv-bridge \\
        python3-image-geometry
    . devel/setup.bash && python tests/benchmarks/calibrate_live.py [--camera wide] [--poses 160]

The last line is JSON with published and found intrinsics; the status is 0 if focal lengths agree
within 0.2 % and the centre within 0.3 px, and the commit has arrived.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
from pathlib import Path

DEBIAN = Path("/usr/bin/python3")
if Path(sys.executable).parent != DEBIAN.parent:
    # camera_calibration and cv_bridge are made for Debian's OpenCV, not for that of .venv.
    os.execv(DEBIAN, [str(DEBIAN), *sys.argv])

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

try:
    import cv2
    import rospy
    import yaml
    from camera_calibration.calibrator import CAMERA_MODEL, ChessboardInfo
    from camera_calibration.camera_calibrator import CalibrationNode
    from ros_graph import Launch, RosMaster, wait_for_message
    from sensor_msgs.msg import CameraInfo, Image
    from show_chessboard import COLUMNS, ROWS, SQUARE, Board, poses
except ImportError as error:
    # Debian's package does not depend on all that it imports.
    sys.exit(
        f"calibrate_live: {DEBIAN} has no {error.name}; source devel/setup.bash, and as root:\n"
        "  apt install --no-install-recommends ros-camera-calibration python3-opencv "
        "python3-cv-bridge python3-image-geometry"
    )

PRESETS = Path(__file__).parents[2] / "src/aras_visual_servo_gazebo/config/cameras"
CAMERA = "calib"
PLACE = {"parent": "world", "pose": [0.0, 0.0, 1.0, 0.0, 1.5708, 0.0], "near": 0.02}
# cameracalibrator.py --fisheye-recompute-extrinsicsts --fisheye-fix-skew
FISHEYE_FLAGS = cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW
# --k-coefficients 2, its default
PINHOLE_FLAGS = cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K4 | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6


class Calibrator(CalibrationNode):
    """Node of cameracalibrator.py without its window; it reports which images it has processed."""

    def __init__(self, fisheye: bool) -> None:
        self._looked = threading.Condition()
        self._last = rospy.Time(0)
        self._fisheye = fisheye
        super().__init__(
            [ChessboardInfo("chessboard", COLUMNS, ROWS, SQUARE)],
            flags=PINHOLE_FLAGS,
            fisheye_flags=FISHEYE_FLAGS,
            camera_name=CAMERA,
            checkerboard_flags=0,  # --disable_calib_cb_fast_check: small squares do not pass it
        )

    def handle_monocular(self, msg: Image) -> None:
        super().handle_monocular(msg)
        with self._looked:
            if self._fisheye:  # the slider of the window
                self.c.set_cammodel(CAMERA_MODEL.FISHEYE)
            self._last = msg.header.stamp
            self._looked.notify_all()

    def look(self) -> bool:
        """Wait until a new image has been processed; return whether it shows the board."""
        now = rospy.Time.now()
        with self._looked:
            if not self._looked.wait_for(lambda: self._last > now, timeout=20.0):
                raise RuntimeError("no image for 20 s")
            return self.c.last_frame_corners is not None


def calibrate(count: int) -> dict:
    """Show `count` poses, calibrate and commit; return the published and the found intrinsics."""
    published = wait_for_message(f"/{CAMERA}/camera_info", CameraInfo, timeout=30.0)
    board = Board(CAMERA)
    node = Calibrator(published.distortion_model == "equidistant")
    seen = 0
    for R, middle in poses(published, count):
        board.hold(R, middle)
        seen += node.look()
    if not node.c.goodenough:
        raise RuntimeError(f"CALIBRATE is still grey: {node.c.compute_goodenough()}")
    node.c.do_calibration()
    found = node.c.as_message()
    committed = node.do_upload()
    later = wait_for_message(
        f"/{CAMERA}/camera_info", CameraInfo, where=lambda info: tuple(found.K) == info.K
    )
    focal = [abs(found.K[i] / published.K[i] - 1.0) for i in (0, 4)]
    centre = [abs(found.K[i] - published.K[i]) for i in (2, 5)]
    return {
        "boards_shown": count,
        "boards_found": seen,
        "samples": len(node.c.db),
        "published": [round(published.K[i], 4) for i in (0, 4, 2, 5)],
        "found": [round(found.K[i], 4) for i in (0, 4, 2, 5)],
        "D_published": list(published.D),
        "D_found": [round(d, 5) for d in found.D],
        "focal_error_percent": round(100.0 * max(focal), 4),
        "centre_error_px": round(max(centre), 4),
        "committed": committed and later.distortion_model == published.distortion_model,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", default="calibrated", help="preset (default calibrated)")
    parser.add_argument("--poses", type=int, default=160, help="of the board (default 160)")
    arguments = parser.parse_args()
    preset = yaml.safe_load((PRESETS / f"{arguments.camera}.yaml").read_text())
    with tempfile.TemporaryDirectory() as directory:
        master = RosMaster(Path(directory))
        for name in ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR"):
            os.environ[name] = master.environment[name]
        rospy.set_param("/gazebo/cameras", {CAMERA: {**preset, **PLACE}})
        simulator = Launch(master, ("aras_sim_bridge", "empty_world.launch"), {})
        try:
            simulator.wait_for_nodes(["/gazebo"])
            rospy.init_node(
                "cameracalibrator", [f"image:=/{CAMERA}/image_raw", f"camera:=/{CAMERA}"]
            )
            result = {"camera": arguments.camera, **calibrate(arguments.poses)}
        finally:
            simulator.stop()
            rospy.signal_shutdown("done")
            master.stop()
    print(json.dumps(result))
    good = result["focal_error_percent"] <= 0.2 and result["centre_error_px"] <= 0.3
    return int(not (good and result["committed"]))


if __name__ == "__main__":
    sys.exit(main())
