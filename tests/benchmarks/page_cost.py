#!/usr/bin/env python3
"""Measure the cost of the live page: its node's processor time, and the real-time factor.

    . devel/setup.bash; .venv/bin/python tests/benchmarks/page_cost.py

Servoes on a graph of its own and comes and goes as one viewer, by turns with no page at all. The
viewer is a WebSocket that reads everything; what a browser draws of it is the browser's.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import socket
import statistics
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import rospy
from aras_visual_servo_controller.msg import ServoState
from tornado.websocket import websocket_connect

from aras_visual_servo_bench.ros.ros_launch import RosLaunch, find_free_port

TOKEN, PORT = "a-token-for-measuring", find_free_port()
TICK = os.sysconf("SC_CLK_TCK")


def processor_time(pid: int) -> float:
    """Return the processor time of a process with its threads, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def node_pid(name: str) -> int:
    """Return the process id of a node of this graph, by the name from roslaunch or rosrun."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().decode(errors="replace")
            uri = (entry / "environ").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if name in words and os.environ["ROS_MASTER_URI"] in uri and "roslaunch" not in words:
            return int(entry.name)
    raise SystemExit(f"no process of {name}")


class Factor:
    """Real-time factor, from the controller's stamps."""

    def __init__(self) -> None:
        self.latest = (0.0, 0.0)
        rospy.Subscriber("/aras_visual_servo/controller/state", ServoState, self._on_state,
                         queue_size=1)  # fmt: skip

    def _on_state(self, message: ServoState) -> None:
        self.latest = time.monotonic(), message.header.stamp.to_sec()

    def over(self, seconds: float) -> float:
        """Return simulated time divided by wall time during the next seconds."""
        wall, stamp = self.latest
        time.sleep(seconds)
        return (self.latest[1] - stamp) / (self.latest[0] - wall)


def watch(stop: threading.Event, told: list[int]) -> None:
    """Act as a viewer until stopped; count messages and bytes."""

    async def read() -> None:
        viewer = await websocket_connect(f"ws://127.0.0.1:{PORT}/live?token={TOKEN}")
        while not stop.is_set():
            message = await viewer.read_message()
            if message is None:
                raise SystemExit("the page has gone")
            await viewer.write_message("ack")
            told[0], told[1] = told[0] + 1, told[1] + len(message)
        viewer.close()

    asyncio.run(read())


def await_port() -> None:
    """Wait until the page listens."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", PORT)) == 0:
                return
        time.sleep(0.2)
    raise SystemExit("the page does not come up")


def main() -> int:
    """Measure, and print a table and a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of each turn (default 10)")
    parser.add_argument("--turns", type=int, default=3, help="with and without (default 3)")
    given = parser.parse_args()
    directory, port = Path(tempfile.mkdtemp(prefix="page_cost")), find_free_port()
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1",
                      ROS_LOG_DIR=str(directory))  # fmt: skip
    launches = [RosLaunch(["-p", str(port), "aras_visual_servo_gazebo", "aras_visual_servo.launch"],
                       directory / "robot.txt", dict(os.environ))]  # fmt: skip
    rows = []
    try:
        time.sleep(8.0)
        launches.append(RosLaunch(["aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch"],
                               directory / "nodes.txt", dict(os.environ)))  # fmt: skip
        rospy.init_node("page_cost", anonymous=True, disable_rostime=True, disable_signals=True)
        factor = Factor()
        while not factor.latest[1] > 5.0:
            time.sleep(0.2)
        simulator, camera = node_pid("__name:=gazebo"), node_pid("aras_visual_servo_camera_node")
        for _ in range(given.turns):
            for page in (False, True):
                rows.append(turn(page, given.seconds, factor, simulator, camera))
                print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    finally:
        for launch in reversed(launches):
            launch.stop()
    means = {
        page: {key: round(statistics.mean(row[key] for row in rows if row["page"] == page), 4)
               for key in ("factor", "page_cpu", "camera_cpu", "simulator_cpu")}
        for page in (False, True)
    }  # fmt: skip
    print(json.dumps({"without": means[False], "with one viewer": means[True]}))
    return 0


def turn(
    page: bool, seconds: float, factor: Factor, simulator: int, camera: int
) -> dict[str, float | bool]:
    """Make one measurement, with or without page; return the used parts of a core and the factor.
    """
    process, stop, told, viewer = None, threading.Event(), [0, 0], None
    if page:
        process = subprocess.Popen(
            ["rosrun", "aras_visual_servo_bench", "dashboard", f"_token:={TOKEN}",
             f"_port:={PORT}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        await_port()
        viewer = threading.Thread(target=watch, args=(stop, told), daemon=True)
        viewer.start()
    time.sleep(2.0)
    pids = {"simulator_cpu": simulator, "camera_cpu": camera}
    if page:
        pids["page_cpu"] = node_pid("aras_visual_servo_bench/dashboard")
    before, wall = {key: processor_time(pid) for key, pid in pids.items()}, time.monotonic()
    row: dict[str, float | bool] = {"page": page, "factor": round(factor.over(seconds), 4),
                                    "page_cpu": 0.0}  # fmt: skip
    wall = time.monotonic() - wall
    row |= {key: round((processor_time(pid) - before[key]) / wall, 4) for key, pid in pids.items()}
    row["kilobytes_s"] = round(told[1] / 1e3 / wall, 1)
    stop.set()
    if process is not None:
        viewer.join(5.0)
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(20.0)
        process.kill()
    return row


if __name__ == "__main__":
    raise SystemExit(main())
