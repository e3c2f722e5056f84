#!/usr/bin/env python3
"""Write images/rviz.png and images/page.png from a running servo loop on a separate ROS graph.

    . devel/setup.bash; .venv/bin/python docs/live_pictures.py rviz     # needs Xvfb
    . devel/setup.bash; .venv/bin/python docs/live_pictures.py page     # needs headless Chromium

The windows do not appear on your display.
"""

from __future__ import annotations

import argparse
import os
import re
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import rospy
from aras_visual_servo_controller.msg import ServoState

from aras_visual_servo_bench.ros.ros_launch import RosLaunch, find_free_port

IMAGES = Path(__file__).parent / "images"
SIZE = (1500, 900)
PAGE = (1440, 860)
SLOW = "0.5"  # gain, 1/s; the camera is still moving when the picture is taken
PICTURE_TIME = 1.6  # time of the picture since servoing started, s
# Objects that must be visible in the scene: red, green, blue (0 to 255) and tolerance.
OBJECT_COLOURS = {
    "robot": "[118, 121, 137], 45", "desired camera": "[61, 120, 255], 40",
    "camera": "[242, 242, 242], 12", "camera path": "[230, 158, 0], 30", "target": "[8, 8, 8], 12",
}  # fmt: skip
MIN_FRACTION = 1e-4  # least fraction of the pixels that an object covers
COUNT_PIXELS = """((colour, off) => { const from = document.getElementById("scene");
    const c = document.createElement("canvas"), x = c.getContext("2d");
    c.width = from.width; c.height = from.height; x.drawImage(from, 0, 0);
    const p = x.getImageData(0, 0, c.width, c.height).data;
    let found = 0;
    for (let i = 0; i < p.length; i += 4)
        found += colour.every((v, k) => Math.abs(p[i + k] - v) <= off);
    return 4 * found / p.length; })(%s)"""


def screenshot(framebuffer: Path) -> np.ndarray:
    """Return the (rows, columns, 3) bgr image of an X window dump (xwd, 32 bits per pixel)."""
    content = framebuffer.read_bytes()
    header = struct.unpack(">25I", content[:100])
    size, width, height, line, colours = header[0], header[4], header[5], header[12], header[19]
    pixels = np.frombuffer(content, np.uint8, line * height, size + 12 * colours)
    return pixels.reshape(height, line)[:, : 4 * width].reshape(height, width, 4)[:, :, :3]


class Run:
    """Context manager that runs the simulator and its nodes with a separate ROS master."""

    def __init__(self, directory: Path, **arguments: str) -> None:
        port = find_free_port()
        os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1",
                          ROS_LOG_DIR=str(directory))  # fmt: skip
        self._launches = []
        given = [f"{key}:={value}" for key, value in arguments.items()]
        self._launch(directory / "robot.txt", "-p", str(port), "aras_visual_servo_gazebo",
                     "aras_visual_servo.launch", "server_required:=true", *given)  # fmt: skip
        self.state: ServoState | None = None
        self._start_time: float | None = None
        self._directory = directory

    def _launch(self, log: Path, *words: str) -> None:
        self._launches.append(RosLaunch(list(words), log, dict(os.environ)))

    def servo(self, seconds: float, **arguments: str) -> None:
        """Start the nodes and wait until they have servoed for the given time, s."""
        deadline = time.monotonic() + 120.0
        while subprocess.run(["rosservice", "info", "/gazebo/pause_physics"], check=False,
                             capture_output=True).returncode:  # fmt: skip
            if time.monotonic() > deadline:
                end = self._launches[0].read_last_lines()
                raise SystemExit(f"the simulator did not start: {end}")
            time.sleep(0.5)
        rospy.init_node("pictures", anonymous=True, disable_rostime=True, disable_signals=True)
        rospy.Subscriber("/aras_visual_servo/controller/state", ServoState, self._on_state)
        time.sleep(6.0)  # until the window is open
        given = [f"{key}:={value}" for key, value in arguments.items()]
        self._launch(self._directory / "nodes.txt", "aras_visual_servo_gazebo",
                     "aras_visual_servo_nodes.launch", *given)  # fmt: skip
        deadline = time.monotonic() + 120.0
        while self.get_servoing_time() < seconds:
            if time.monotonic() > deadline:
                raise SystemExit(f"the nodes do not servo: {self._launches[-1].read_last_lines()}")
            time.sleep(0.01)

    def address(self) -> str:
        """Return the address of the live page, which the log contains."""
        deadline = time.monotonic() + 60.0
        log = self._directory / "robot.txt"
        while not (found := re.search(r"http://127\S+/\?token=\S+", log.read_text())):
            if time.monotonic() > deadline:
                end = self._launches[0].read_last_lines()
                raise SystemExit(f"the log contains no address of the live page: {end}")
            time.sleep(0.2)
        return found[0]

    def _on_state(self, message: ServoState) -> None:
        self.state = message
        if self._start_time is None and message.phase == "servoing":
            self._start_time = message.header.stamp.to_sec()

    def get_servoing_time(self) -> float:
        """Return the time since servoing started, s; -1 before."""
        if self.state is None or self._start_time is None:
            return -1.0
        return self.state.header.stamp.to_sec() - self._start_time

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        for launch in reversed(self._launches):
            launch.stop()


def rviz(directory: Path) -> None:
    """Write images/rviz.png: rviz under Xvfb with Mesa's rasteriser."""
    display = f":{100 + os.getpid() % 800}"
    server = subprocess.Popen(
        ["Xvfb", display, "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24", "-fbdir", str(directory),
         "-nocursor"]
    )
    try:
        time.sleep(1.0)
        os.environ.update(DISPLAY=display, LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1")
        with Run(directory, show_rviz="true") as run:
            run.servo(PICTURE_TIME, gain=SLOW, start="2016")
            picture = screenshot(directory / "Xvfb_screen0")
    finally:
        server.terminate()
        server.wait()
    cv2.imwrite(str(IMAGES / "rviz.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def page(directory: Path) -> None:
    """Write images/page.png: the live page in headless Chromium."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit" / "bench"))
    from browser import Browser

    with Browser(PAGE) as browser, Run(directory, dashboard="true", dashboard_port="18777") as run:
        run.servo(-1.0, gain=SLOW, start="2016")
        tab = browser.open(run.address())
        tab.wait("window.arasPage && arasPage.scene && arasPage.scene.meshes.length > 5", 60.0)
        tab.wait(f"""["servoing", "converged"].includes(arasPage.state.controller.phase) &&
            arasPage.scene.shapes.path && arasPage.state.samples.filter(
            (s) => s[1].length).length > {30 * PICTURE_TIME}""", 60.0)
        tab.js("arasPage.isFrozen = true; arasPage.scene.requestDraw()")
        # Wait until the software renderer has drawn the scene.
        tab.wait("!arasPage.scene.isDrawing && !arasPage.scene.isDrawRequested", 60.0)
        time.sleep(1.0)
        fractions = {name: tab.js(COUNT_PIXELS % colour) for name, colour in OBJECT_COLOURS.items()}
        content = np.frombuffer(tab.screenshot(), np.uint8)
    picture = cv2.imdecode(content, cv2.IMREAD_COLOR)
    cv2.imwrite(str(IMAGES / "page.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print("fraction of the pixels of each object:", fractions)
    if missing := [name for name, part in fractions.items() if not part > MIN_FRACTION]:
        raise SystemExit(f"not visible in the scene: {', '.join(missing)}")


def main() -> int:
    """Write the selected pictures; return the exit status."""
    makers = {"rviz": rviz, "page": page}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/live_pictures.py page")
    parser.add_argument("what", nargs="+", choices=makers)
    for name in parser.parse_args().what:
        with tempfile.TemporaryDirectory() as directory:
            makers[name](Path(directory))
    return 0


if __name__ == "__main__":
    sys.exit(main())
