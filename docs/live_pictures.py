#!/usr/bin/env python3
"""Makes images/rviz.png and images/page*.png: a run on a graph of its own, on its way.

    . devel/setup.bash; .venv/bin/python docs/live_pictures.py rviz     # needs Xvfb
    . devel/setup.bash; .venv/bin/python docs/live_pictures.py page     # needs headless Chromium

Nothing is shown on your display.
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
SLOW = "0.5"  # gain, 1/s: a run that is still on its way when its picture is taken
ON_THE_WAY = 1.6  # s of servoing at which it is taken
# What has to be in the scene: red, green, blue of its pixels, 0 to 255, and how far they are off.
DRAWN = {
    "robot": "[118, 121, 137], 45", "desired camera": "[61, 120, 255], 40",
    "camera": "[242, 242, 242], 12", "its way": "[230, 158, 0], 30", "target": "[8, 8, 8], 12",
}  # fmt: skip
LEAST = 1e-4  # of the pixels
SEEN = """((colour, off) => { const from = document.getElementById("scene");
    const c = document.createElement("canvas"), x = c.getContext("2d");
    c.width = from.width; c.height = from.height; x.drawImage(from, 0, 0);
    const p = x.getImageData(0, 0, c.width, c.height).data;
    let found = 0;
    for (let i = 0; i < p.length; i += 4)
        found += colour.every((v, k) => Math.abs(p[i + k] - v) <= off);
    return 4 * found / p.length; })(%s)"""


def screenshot(framebuffer: Path) -> np.ndarray:
    """The (rows, columns, 3) bgr picture of an X window dump (xwd, 32 bits a pixel)."""
    content = framebuffer.read_bytes()
    header = struct.unpack(">25I", content[:100])
    size, width, height, line, colours = header[0], header[4], header[5], header[12], header[19]
    pixels = np.frombuffer(content, np.uint8, line * height, size + 12 * colours)
    return pixels.reshape(height, line)[:, : 4 * width].reshape(height, width, 4)[:, :, :3]


class Run:
    """A simulator and its nodes on a master of their own, as long as the block lasts."""

    def __init__(self, directory: Path, **arguments: str) -> None:
        port = find_free_port()
        os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1",
                          ROS_LOG_DIR=str(directory))  # fmt: skip
        self._launches = []
        given = [f"{key}:={value}" for key, value in arguments.items()]
        self._launch(directory / "robot.txt", "-p", str(port), "aras_visual_servo_gazebo",
                     "aras_visual_servo.launch", "server_required:=true", *given)  # fmt: skip
        self.state: ServoState | None = None
        self._began: float | None = None
        self._directory = directory

    def _launch(self, log: Path, *words: str) -> None:
        self._launches.append(RosLaunch(list(words), log, dict(os.environ)))

    def servo(self, seconds: float, **arguments: str) -> None:
        """Start the nodes; returns when they have servoed for so long."""
        deadline = time.monotonic() + 120.0
        while subprocess.run(["rosservice", "info", "/gazebo/pause_physics"], check=False,
                             capture_output=True).returncode:  # fmt: skip
            if time.monotonic() > deadline:
                raise SystemExit(
                    f"the simulator did not start: {self._launches[0].read_last_lines()}"
                )
            time.sleep(0.5)
        rospy.init_node("pictures", anonymous=True, disable_rostime=True, disable_signals=True)
        rospy.Subscriber("/aras_visual_servo/controller/state", ServoState, self._on_state)
        time.sleep(6.0)  # the window opens
        given = [f"{key}:={value}" for key, value in arguments.items()]
        self._launch(self._directory / "nodes.txt", "aras_visual_servo_gazebo",
                     "aras_visual_servo_nodes.launch", *given)  # fmt: skip
        deadline = time.monotonic() + 120.0
        while self.servoed() < seconds:
            if time.monotonic() > deadline:
                raise SystemExit(f"no servoing: {self._launches[-1].read_last_lines()}")
            time.sleep(0.01)

    def address(self) -> str:
        """Of the live page, as it was said."""
        deadline = time.monotonic() + 60.0
        log = self._directory / "robot.txt"
        while not (said := re.search(r"http://127\S+/\?token=\S+", log.read_text())):
            if time.monotonic() > deadline:
                raise SystemExit(f"no page: {self._launches[0].read_last_lines()}")
            time.sleep(0.2)
        return said[0]

    def _on_state(self, message: ServoState) -> None:
        self.state = message
        if self._began is None and message.phase == "servoing":
            self._began = message.header.stamp.to_sec()

    def servoed(self) -> float:
        """s of servoing; -1 before it has begun."""
        if self.state is None or self._began is None:
            return -1.0
        return self.state.header.stamp.to_sec() - self._began

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        for launch in reversed(self._launches):
            launch.stop()


def rviz(directory: Path) -> None:
    """images/rviz.png, of rviz under Xvfb with Mesa's rasteriser."""
    display = f":{100 + os.getpid() % 800}"
    server = subprocess.Popen(
        ["Xvfb", display, "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24", "-fbdir", str(directory),
         "-nocursor"]
    )
    try:
        time.sleep(1.0)
        os.environ.update(DISPLAY=display, LIBGL_ALWAYS_SOFTWARE="1", QT_X11_NO_MITSHM="1")
        with Run(directory, show_rviz="true") as run:
            run.servo(ON_THE_WAY, gain=SLOW, start="2016")
            picture = screenshot(directory / "Xvfb_screen0")
    finally:
        server.terminate()
        server.wait()
    cv2.imwrite(str(IMAGES / "rviz.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def page(directory: Path) -> None:
    """images/page.png, of the live page in headless Chromium."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit" / "bench"))
    from browser import Browser

    with Browser(PAGE) as browser, Run(directory, dashboard="true", dashboard_port="18777") as run:
        run.servo(-1.0, gain=SLOW, start="2016")
        tab = browser.open(run.address())
        tab.wait("window.arasPage && arasPage.scene && arasPage.scene.meshes.length > 5", 60.0)
        tab.wait(f"""["servoing", "converged"].includes(arasPage.state.controller.phase) &&
            arasPage.scene.shapes.path && arasPage.state.samples.filter(
            (s) => s[1].length).length > {30 * ON_THE_WAY}""", 60.0)
        tab.js("arasPage.isFrozen = true; arasPage.scene.requestDraw()")
        # A software renderer has time for the picture, then.
        tab.wait("!arasPage.scene.isDrawing && !arasPage.scene.isDrawRequested", 60.0)
        time.sleep(1.0)
        seen = {name: tab.js(SEEN % colour) for name, colour in DRAWN.items()}
        content = np.frombuffer(tab.screenshot(), np.uint8)
    picture = cv2.imdecode(content, cv2.IMREAD_COLOR)
    cv2.imwrite(str(IMAGES / "page.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print("part of the scene's pixels:", seen)
    if missing := [name for name, part in seen.items() if not part > LEAST]:
        raise SystemExit(f"the scene shows nothing of: {', '.join(missing)}")


def main() -> int:
    """Make what is asked for."""
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
