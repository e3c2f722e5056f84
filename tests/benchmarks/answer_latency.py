#!/usr/bin/env python3
"""How long an image waits for its answer in the graph: from its arrival to the command's.

Starts the shipped machine and its nodes on a master of its own, and listens as any node would. The
controller publishes an image's state right after its command, with the image's stamp: so that is
what is waited for. Both ends are arrivals in this process; what is measured has the camera node,
the controller node and two more messages in it. Needs the sourced workspace:

    . devel/setup.bash && python tests/benchmarks/answer_latency.py [--seconds 10] [--scheme points]

The last line is JSON: medians and 95 % of image to answer, ms, and of the part that the scheme and
resolver took by the controller's own clock (processor time), ms. Targets on the machine that the
issue's figures are from: 1.5 ms and 0.3 ms.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

import numpy as np
import rospy
from ros_graph import Launch, RosMaster, wait_for

MACHINE = ("aras_visual_servo_gazebo", "aras_visual_servo.launch")
NODES = ("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch")


class Stopwatch:
    """Arrivals of images and answers by stamp, ns, and what answers say they took."""

    def __init__(self) -> None:
        from aras_visual_servo_controller.msg import ServoReport, ServoState
        from sensor_msgs.msg import Image

        self.images: dict[int, float] = {}
        self.answers: dict[int, float] = {}
        self.computing: list[float] = []
        space, options = "/aras_visual_servo/controller", {"tcp_nodelay": True, "queue_size": 1}
        rospy.Subscriber("/labrob/camera/image_raw", Image, self._image, **options)
        rospy.Subscriber(f"{space}/state", ServoState, self._state, **options)
        rospy.Subscriber(f"{space}/diagnosis", ServoReport, self._report, **options)

    def _image(self, message: object) -> None:
        self.images.setdefault(message.header.stamp.to_nsec(), time.monotonic())

    def _state(self, message: object) -> None:
        if message.phase in ("servoing", "converged"):
            self.answers.setdefault(message.header.stamp.to_nsec(), time.monotonic())

    def _report(self, message: object) -> None:
        if message.computing > 0.0:
            self.computing.append(message.computing)

    def result(self) -> dict[str, float]:
        """Medians and 95 %, ms."""
        both = self.images.keys() & self.answers.keys()
        waits = [self.answers[stamp] - self.images[stamp] for stamp in both]
        found = {"images": len(both)}
        for name, values in (("answer", waits), ("law", self.computing)):
            for part in (50, 95):
                found[f"{name}_{part}_ms"] = round(1e3 * float(np.percentile(values, part)), 3)
        return found


def main(argv: list[str] | None = None) -> int:
    """Measure; print the result as the last line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of wall time, once it servoes")
    parser.add_argument("--scheme", default="moments")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        master = RosMaster(Path(folder))
        launched: list[Launch] = []
        try:
            launched.append(Launch(master, MACHINE, {}))
            launched[0].wait_for_nodes(["/gazebo"], 60.0)
            launched.append(Launch(master, NODES, {"scheme": options.scheme}))
            os.environ["ROS_MASTER_URI"] = master.environment["ROS_MASTER_URI"]
            rospy.init_node("answer_latency", disable_signals=True)
            watch = Stopwatch()
            wait_for(lambda: len(watch.answers) > 10, 60.0, "answers")
            time.sleep(options.seconds)
            print(json.dumps(watch.result()))
        finally:
            rospy.signal_shutdown("done")
            for one in reversed(launched):
                one.stop()
            master.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
