"""Controllers built as the originals': six topics flooded from a loop without sleep, one step of
the law a camera message, and only when every joint is within 0.01 of its command; joints are read
by index. Written anew here; gains and kinematics are ours, so steps and seconds are our own.

The first generation's structure drives the gantry from its kernel features (20 numbers), the
second all joints from moments (4 numbers) down to its thresholds (0.001, 0.003, 0.005, 0.001).
Both run against the machine they were made for: `joint_friction:=false`, the second with
`camera:=calibrated`. Bounds: gantry within 10 mm of its goal within 45 s; thresholds met within
300 s (both of simulated time, as the joints' stamps tell it); real-time factor 0.95 meanwhile,
which needs a machine of one's own.

    . devel/setup.bash && .venv/bin/python tests/benchmarks/original_controllers.py [first|second]

With --gain the steps, and with --rest the time at rest at the poses, differ from the originals'.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from graph import COMMANDS, ROBOT, Use, robot

ORDER = ("J1", "J2", "J3", "J5", "J6", "gantry")  # of joint_states, read by index
COMMANDED = ("gantry", "J1", "J2", "J3", "J5", "J6")
GOAL = {
    "first": (0.0, 0.0, 0.05, -0.09, 0.045, 0.0), "second": (0.05, 0.0, -0.09, 0.045, 0.045, 0.0)
}  # fmt: skip
START = {
    "first": (0.1, 0.0, 0.12, -0.12, 0.02, 0.0), "second": (-0.1, 0.0, 0.2, -0.15, -0.05, 0.17)
}  # fmt: skip
NEAR = 0.01  # rad or m: so near to its command must every joint be before the next step
THRESHOLDS = np.array([0.001, 0.003, 0.005, 0.001])
GAIN, REST = 0.02, 3.0  # of a step; s of simulated time at rest at a pose
WITHIN = {"first": 45.0, "second": 300.0}  # s of simulated time
PATIENCE = 60.0  # s of simulated time to come to rest at a pose
STANDS = 60.0  # s of wall time after which a simulation that tells nothing has stopped
FLOOD = r"""
#include <ros/ros.h>
#include <std_msgs/Float64.h>
#include <array>
#include <cstdio>
#include <fcntl.h>
#include <unistd.h>
// Publishes the last six numbers of its standard input over and over, without sleep.
int main(int argc, char** argv) {
  ros::init(argc, argv, "flood");
  ros::NodeHandle node;
  std::array<ros::Publisher, 6> topics;
  for (int k = 0; k < 6; ++k) topics[k] = node.advertise<std_msgs::Float64>(argv[k + 1], 10);
  std::array<double, 6> last{};
  fcntl(0, F_SETFL, O_NONBLOCK);
  std_msgs::Float64 message;
  long sent = 0;
  bool begun = false;
  const double begin = ros::WallTime::now().toSec();
  while (ros::ok()) {
    std::array<double, 6> next;
    ssize_t got = read(0, next.data(), sizeof next);
    if (got == 0) break;
    if (got == sizeof next) { last = next; begun = true; }
    if (!begun) { ros::WallDuration(0.01).sleep(); continue; }
    for (int k = 0; k < 6; ++k) { message.data = last[k]; topics[k].publish(message); }
    ++sent;
    ros::spinOnce();
  }
  printf("%f\n", 6 * sent / (ros::WallTime::now().toSec() - begin));
  fflush(stdout);
  _exit(0);
}
"""


def build(directory: Path) -> Path:
    source, program = directory / "flood.cpp", directory / "flood"
    source.write_text(FLOOD)
    libraries = ["-lroscpp", "-lrostime", "-lroscpp_serialization", "-lrosconsole"]
    subprocess.run(["g++", "-O2", "-std=c++17", source, "-o", program, *libraries], check=True)
    return program


class Controller:
    """Common parts of both generations: the gate, the steps, the flood of commands."""

    def __init__(self, program: Path, gain: float, rest: float) -> None:
        import rospy
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self._flood = subprocess.Popen(
            [program, *COMMANDS], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.gain, self._rest = gain, rest
        self.joints: np.ndarray | None = None
        self.features: np.ndarray | None = None
        self.steps = 0
        self.now = 0.0  # simulated time, s
        rospy.Subscriber(f"{ROBOT}/joint_states", JointState, self._hear)
        rospy.Subscriber(f"{ROBOT}/camera/data", Float64MultiArray, self._see)

    def _hear(self, message) -> None:
        given = dict(zip(ORDER, message.position, strict=True))
        self.joints = np.array([given[name] for name in COMMANDED])
        self.now = message.header.stamp.to_sec()

    def _see(self, message) -> None:
        self.features = np.array(message.data)

    def command(self, q: np.ndarray) -> None:
        self._flood.stdin.write(np.asarray(q, float).tobytes())
        self._flood.stdin.flush()

    def reach(self, q: np.ndarray, end: float) -> np.ndarray:
        """Command q, wait until every joint is near it, and return the next camera message's
        numbers."""
        self.command(q)
        self._wait(lambda: np.abs(self.joints - q).max() < NEAR, end, lambda: (
            f"joints off their commands by "
            f"{dict(zip(COMMANDED, np.round(self.joints - q, 4).tolist(), strict=True))}"
        ))  # fmt: skip
        self.features = None
        self._wait(lambda: self.features is not None, end, lambda: "no camera message")
        self.steps += 1
        return self.features

    def rest(self) -> None:
        end = self.now + self._rest
        self._wait(lambda: self.now >= end, math.inf, str)

    def begin(self) -> None:
        """Wait for the first joint states and the first camera message."""
        self._wait(lambda: not (self.joints is None or self.features is None), math.inf, str)

    def _wait(self, come: Callable[[], bool], end: float, trouble: Callable[[], str]) -> None:
        heard, told = time.monotonic(), self.now
        while not come():
            if self.now > end:
                raise TimeoutError(trouble())
            if self.now != told:
                heard, told = time.monotonic(), self.now
            elif time.monotonic() - heard > STANDS:
                raise TimeoutError(f"no joint states for {STANDS:g} s")
            time.sleep(0.001)

    def close(self) -> float:
        """Stop the flood; return the number of messages per second that it sent."""
        self._flood.stdin.close()  # which ends it
        with self._flood.stdout as said:
            return float(said.read())


def settle(controller: Controller, q: tuple[float, ...]) -> np.ndarray:
    """Return the features with the arm at rest at q; they are the taught goal."""
    end = controller.now + PATIENCE
    controller.reach(np.array(q), end)
    controller.rest()
    return controller.reach(np.array(q), end)


def first(controller: Controller) -> dict[str, object]:
    """Servo with the gantry until the kernel feature along its axis has the taught value."""
    taught = settle(controller, GOAL["first"])[16:]
    q = np.array(START["first"])
    q[1:] = GOAL["first"][1:]
    probe = q - [0.02, 0, 0, 0, 0, 0]
    far = settle(controller, tuple(q))[16:]
    slopes = (far - settle(controller, tuple(probe))[16:]) / 0.02
    along = int(np.argmax(np.abs(slopes[:2]) / np.abs(taught[:2])))
    began = controller.now
    end = began + WITHIN["first"]
    try:
        while controller.now < end:
            seen = controller.reach(q, end)[16:]
            error = (seen[along] - taught[along]) / slopes[along]
            q[0] -= controller.gain * error
            if abs(error) < 5e-4:
                break
    except TimeoutError as error:
        return {"ok": False, "why": str(error)}
    off = abs(controller.joints[0] - GOAL["first"][0])
    return {"ok": bool(off < 0.01), "gantry_off_mm": round(1e3 * float(off), 2),
            "simulated": round(controller.now - began, 1), "steps": controller.steps}  # fmt: skip


def second(controller: Controller) -> dict[str, object]:
    """Servo with all joints by normalised moments and the camera's Jacobian."""
    import rospy

    from aras_visual_servo_controller.kinematics import Arm

    arm = Arm.from_urdf(rospy.get_param("robot_description"))
    order = [COMMANDED.index(name) for name in arm.names]
    taught = settle(controller, GOAL["second"])
    depth = arm.pose(np.array(GOAL["second"])[order])[2, 3] - 0.59  # m above the target's plane

    def features(data: np.ndarray) -> np.ndarray:
        """Return (xn, yn, an, α) from row, column, m00 and 0.1 α."""
        an = depth * math.sqrt(taught[2] / data[2])
        return np.array([an * data[1], an * data[0], an, 10.0 * data[3]])

    wanted, q = features(taught), np.array(START["second"])
    began = controller.now
    error = np.full(4, np.inf)
    try:
        while (np.abs(error) >= THRESHOLDS).any():
            now = features(controller.reach(q, began + WITHIN["second"]))
            error = now - wanted
            error[3] = (error[3] + math.pi / 2) % math.pi - math.pi / 2
            # twist (vx, vy, vz, wz) for which the features go back, as the moments' theory has it
            x, y = now[0], now[1]
            gain, wz = controller.gain, controller.gain * error[3]
            twist = np.array([gain * error[0] + y * wz, gain * error[1] - x * wz,
                              gain * error[2], wz])  # fmt: skip
            J = arm.jacobian(q[order])
            # no turning about the image's axes that the arm can help (wy is of its five)
            task = np.vstack([J[[0, 1, 2, 5]], 0.1 * J[[3, 4]]])
            demand = np.concatenate([twist, [0.0, 0.0]])
            step = task.T @ np.linalg.solve(task @ task.T + 1e-6 * np.eye(6), demand)
            q[order] += np.clip(step, -0.5 * NEAR, 0.5 * NEAR)
    except TimeoutError as late:
        return {"ok": False, "why": str(late), "errors": np.round(error, 5).tolist()}
    return {"ok": True, "steps": controller.steps, "errors": np.round(error, 5).tolist(),
            "simulated": round(controller.now - began, 1)}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", nargs="?", choices=GOAL, default="second", help="generation")
    parser.add_argument("--gain", type=float, default=GAIN, help="of a step")
    parser.add_argument("--rest", type=float, default=REST, help="simulated time, s")
    options = parser.parse_args()
    which = options.which
    preset = "calibrated" if which == "second" else "original"
    with tempfile.TemporaryDirectory() as temporary:
        program = build(Path(temporary))
        with robot(joint_friction=False, camera=preset) as (pid, _):
            layout = "moments" if which == "second" else "kernel"
            camera = subprocess.Popen(
                ["rosrun", "aras_visual_servo_camera", "aras_visual_servo_camera_node",
                 f"_layout:={layout}"], env=os.environ,
            )  # fmt: skip
            try:
                controller = Controller(program, options.gain, options.rest)
                controller.begin()
                use = Use(pid)
                found = {"first": first, "second": second}[which](controller)
                figures = use.figures()
                figures["messages_a_second"] = round(controller.close())
            finally:
                camera.terminate()
                camera.wait(20.0)
    ok = bool(found.pop("ok")) and figures["real_time_factor"] >= 0.95
    print(json.dumps({"benchmark": f"original_controllers {which}", "ok": ok, **found, **figures}))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
