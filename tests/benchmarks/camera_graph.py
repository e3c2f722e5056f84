#!/usr/bin/env python3
"""Measure how fast images arrive on the ROS graph while the control loop runs, and point clouds.

Starts the shipped machine and its nodes on a master of its own, once per case of size and rate, and
listens as any node would. For clouds the camera sends depth too, and the nodes do not run. Needs
the sourced workspace:

    . devel/setup.bash && python tests/benchmarks/camera_graph.py [--seconds 10]

The last line is JSON: for each case the rate of images and frames lost in simulated time, the
real-time factor, and the stamp-to-arrival delay. The delay's zero is the earliest arrival of
/clock, within the second around the image; so it includes exposure, drawing, publishing and
receiving. Targets: real-time factor >= 0.98, no frame lost, median delay of images <= 5 ms.
"""

from __future__ import annotations

import argparse
import bisect
import json
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

import numpy as np
import rospy
import yaml
from ros_graph import Launch, RosMaster, wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2

IMAGES, CLOUDS = ("image_raw", Image), ("points", PointCloud2)
CASES = (("640x480 at 30 Hz", 640, 480, 30.0, IMAGES),
         ("320x240 at 100 Hz", 320, 240, 100.0, IMAGES),
         ("clouds of 640x480 at 20 Hz", 640, 480, 20.0, CLOUDS),
         ("clouds of 640x480 at 30 Hz", 640, 480, 30.0, CLOUDS))
PRESETS = Path(__file__).parents[2] / "src/aras_visual_servo_gazebo/config/cameras"


class Listener:
    """Recorder of the arrival times of images or point clouds, and of clock messages."""

    def __init__(self, what: tuple[str, type]) -> None:
        self.images: list[tuple[float, float]] = []
        self.clock: list[tuple[float, float]] = []
        options = {"tcp_nodelay": True}
        self._subscribers = [
            rospy.Subscriber(f"/labrob/camera/{what[0]}", what[1], self._on_image,
                             buff_size=2**24, **options),
            rospy.Subscriber("/clock", Clock, self._on_clock, **options),
        ]

    def _on_image(self, message: Image | PointCloud2) -> None:
        self.images.append((message.header.stamp.to_sec(), time.monotonic()))

    def _on_clock(self, message: Clock) -> None:
        self.clock.append((message.clock.to_sec(), time.monotonic()))

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()

    def figures(self, rate: float) -> dict[str, float | int]:
        """Return the measured figures of a camera with `rate` images per second."""
        stamps, arrivals = np.array(self.images[1:]).T  # the first may be a latched one
        ticks, heard = np.array(self.clock).T
        offset = heard - ticks
        delays = []
        for stamp, arrival in zip(stamps, arrivals, strict=True):
            low = bisect.bisect_left(heard, arrival - 0.5)
            high = bisect.bisect_right(heard, arrival + 0.5)
            delays.append(arrival - stamp - offset[low:high].min())
        span = stamps[-1] - stamps[0]
        return {
            "images": len(stamps),
            "rate_hz": round(float((len(stamps) - 1) / span), 2),
            "lost": round(float(span * rate)) + 1 - len(stamps),
            "real_time_factor": round(float((ticks[-1] - ticks[0]) / (heard[-1] - heard[0])), 4),
            "delay_median_ms": round(1e3 * float(np.median(delays)), 2),
            "delay_95_percent_ms": round(1e3 * float(np.quantile(delays, 0.95)), 2),
        }


def measure(master: RosMaster, width: int, height: int, rate: float, what: tuple[str, type],
            seconds: float, folder: Path) -> dict:
    """Run one case; the loop of images servoes from the initial pose and then holds the target."""
    preset = yaml.safe_load((PRESETS / "original.yaml").read_text())
    preset |= {"width": width, "height": height, "update_rate": rate}
    if what is CLOUDS:
        preset |= {"depth": True, "depth_topics": {"points": "points"}}
    path = folder / "preset.yaml"
    path.write_text(yaml.safe_dump(preset))
    launches = []
    try:
        launches.append(
            Launch(master, ("aras_visual_servo_gazebo", "aras_visual_servo.launch"),
                   {"camera": path})
        )  # fmt: skip
        launches[0].wait_for_nodes(["/gazebo"])
        if what is IMAGES:
            nodes = ("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch")
            launches.append(Launch(master, nodes, {}))
            launches[1].wait_for_nodes(["/aras_visual_servo_controller"])
        first = Listener(what)
        wait_for(lambda: first.images, 30.0, "images")
        time.sleep(4.0)  # start-up is over
        first.close()
        listener = Listener(what)
        time.sleep(seconds)
        listener.close()
        return listener.figures(rate)
    finally:
        for launch in reversed(launches):
            launch.stop()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="wall time a case is watched")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        master = RosMaster(Path(directory), watched=False)
        os.environ.update({k: master.environment[k] for k in ("ROS_MASTER_URI", "ROS_IP")})
        rospy.init_node("camera_graph_benchmark", disable_rostime=True)
        results = {}
        try:
            for name, *case in CASES:
                if asked.only in name:
                    results[name] = measure(master, *case, asked.seconds, Path(directory))
                    print(name, results[name], flush=True)
        finally:
            rospy.signal_shutdown("done")
            master.stop()
    print(json.dumps(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
