"""Streams of commands, from C++: a counter at 1 kHz, of which each number is to act, and a flood as
the original controllers make it: six Float64 topics at 6 000 messages a second each, for a minute.

Bounds of the counter: 99 % act, in order, each within 2 ms of being sent. Bounds of the flood:
real-time factor 0.95, joints follow the last command, memory flat.

    . devel/setup.bash && .venv/bin/python tests/benchmarks/command_flood.py [seconds]
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from graph import COMMANDS, JOINTS, ROBOT, Use, memory_mb, robot

RATE = 6000  # messages a second and topic
TARGET = {"gantry": 0.05, "J1": 0.1, "J2": 0.1, "J3": -0.1, "J5": -0.1, "J6": 0.2}
# What friction lets a joint hang by: its torque over the proportional gain (f / p).
HANG = {"gantry": 2e-3, "J1": 2e-3, "J2": 2e-3, "J3": 2e-3, "J5": 2e-3, "J6": 15e-3}
PUBLISHER = r"""
#include <ros/ros.h>
#include <std_msgs/Float64.h>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <time.h>
double monotonic() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}
// Arguments: seconds, rate, then topic and last value, as often as there are topics. A last value
// that is no number stands for the time at which the message is sent.
int main(int argc, char** argv) {
  ros::init(argc, argv, "flood", ros::init_options::AnonymousName);
  ros::NodeHandle node;
  const double seconds = atof(argv[1]), rate = atof(argv[2]);
  std::vector<ros::Publisher> topics;
  std::vector<double> last;
  for (int k = 3; k + 1 < argc; k += 2) {
    topics.push_back(node.advertise<std_msgs::Float64>(argv[k], 10));
    last.push_back(atof(argv[k + 1]));
  }
  ros::AsyncSpinner spinner(1);
  spinner.start();
  for (auto& topic : topics)
    while (ros::ok() && topic.getNumSubscribers() == 0) ros::WallDuration(0.01).sleep();
  const double begin = monotonic();
  long sent = 0;
  std_msgs::Float64 message;
  for (double now = 0; now < seconds && ros::ok(); now = monotonic() - begin) {
    const long due = static_cast<long>(now * rate);
    for (; sent < due; ++sent)
      for (size_t k = 0; k < topics.size(); ++k) {
        message.data = std::isnan(last[k])
            ? monotonic() : last[k] * (1 + 0.5 * std::sin(6.28 * 0.2 * now));
        topics[k].publish(message);
      }
    ros::WallDuration(0.0002).sleep();
  }
  const double took = monotonic() - begin;
  for (int n = 0; n < 20; ++n) {  // the last command, a few times as the originals do
    for (size_t k = 0; k < topics.size(); ++k) {
      message.data = last[k];
      if (!std::isnan(last[k])) topics[k].publish(message);
    }
    ros::WallDuration(0.005).sleep();
  }
  printf("%ld %f\n", sent, took);
  fflush(stdout);
  ros::WallDuration(0.5).sleep();
  _exit(0);
}
"""
LISTENER = '''
"""Notes when each command acts: a controller of a user's own."""
import time

from aras_sim_bridge.control.controllers import Controller


class Listener(Controller):
    command_kind = "float64"
    interface = "JointStateInterface"

    def init(self, hardware, parameters, context):
        super().init(hardware, parameters, context)
        self.file = parameters["file"]
        self.acted, self.command, self.seen = [], None, None

    def set_command(self, value):
        self.command = value

    def update(self, time_ns, period):
        if self.command != self.seen:
            self.seen = self.command
            self.acted.append((self.seen, time.monotonic(), time_ns))

    def stopping(self, time_ns):
        with open(self.file, "w") as file:
            file.writelines(f"{sent!r} {acted!r} {at}\\n" for sent, acted, at in self.acted)
'''


def build(directory: Path) -> Path:
    """Compile the publisher; raises CalledProcessError without a compiler or roscpp."""
    source, program = directory / "flood.cpp", directory / "flood"
    source.write_text("#include <unistd.h>\n#include <vector>\n" + PUBLISHER)
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "roscpp"], check=True, capture_output=True, text=True
    ).stdout.split()
    libraries = ["-lroscpp", "-lrostime", "-lroscpp_serialization", "-lrosconsole"]
    subprocess.run(
        ["g++", "-O2", "-std=c++17", str(source), "-o", str(program), *flags, *libraries],
        check=True,
    )
    return program


def publish(program: Path, seconds: float, rate: float, topics: dict[str, float]) -> list[str]:
    """The command that publishes so long, ending with these values; NaN: the time of sending."""
    return [str(program), str(seconds), str(rate), *(str(w) for t in topics.items() for w in t)]


def counter(program: Path, directory: Path, seconds: float, pid: int) -> dict[str, float]:
    """How many of the numbers of a 1 kHz stream acted, and how late."""
    import rospy
    from controller_manager_msgs.srv import LoadController, SwitchController

    name, noted = "listener", directory / "acted.txt"
    kind = {"type": "command_listener:Listener", "file": str(noted)}
    rospy.set_param(f"{ROBOT}/{name}", kind)
    manager = f"{ROBOT}/controller_manager"
    assert rospy.ServiceProxy(f"{manager}/load_controller", LoadController)(name).ok
    switch = rospy.ServiceProxy(f"{manager}/switch_controller", SwitchController)
    assert switch([name], [], 2, False, 0.0).ok
    use = Use(pid)
    stream = publish(program, seconds, 1000.0, {f"{ROBOT}/{name}/command": math.nan})
    done = subprocess.run(stream, env=os.environ, stdout=subprocess.PIPE, text=True, check=True)
    figures = use.figures()
    assert switch([], [name], 2, False, 0.0).ok
    rows = [line.split() for line in noted.read_text().splitlines()]
    sent = [float(row[0]) for row in rows]
    delays = sorted(float(row[1]) - float(row[0]) for row in rows)
    return {
        "counter_sent": int(done.stdout.split()[0]),
        "counter_acted_percent": round(100.0 * len(rows) / int(done.stdout.split()[0]), 2),
        "counter_in_order": sent == sorted(sent),
        "counter_median_ms": round(1e3 * delays[len(delays) // 2], 3),
        "counter_99_percent_ms": round(1e3 * delays[int(0.99 * len(delays))], 3),
        "counter_within_2_ms_percent": round(
            100.0 * sum(delay <= 2e-3 for delay in delays) / len(delays), 2
        ),
        "counter_cpu_percent": figures["cpu_percent"],
        "counter_real_time_factor": figures["real_time_factor"],
    }


def main() -> int:
    """Print one JSON line; status 1 when a bound is missed."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary)
        program = build(directory)
        (directory / "command_listener.py").write_text(LISTENER)
        os.environ["PYTHONPATH"] = f"{directory}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        with robot() as pid:
            counted = counter(program, directory, min(seconds, 20.0), pid)
            figures = flood(program, seconds, pid)
    bounds = {
        "flood": figures.pop("ok"),
        "counter": counted["counter_acted_percent"] >= 99.0
        and counted["counter_within_2_ms_percent"] >= 99.0
        and counted["counter_in_order"],
    }
    ok = all(bounds.values())
    print(json.dumps({"benchmark": "command_flood", "ok": ok, **figures, **counted}))
    return 0 if ok else 1


def flood(program: Path, seconds: float, pid: int) -> dict[str, object]:
    """What six topics at RATE cost the node, and where the joints are in the end."""
    import rospy
    from control_msgs.msg import JointControllerState
    from sensor_msgs.msg import JointState

    topics = {topic: TARGET[joint] for topic, joint in zip(COMMANDS, JOINTS, strict=True)}
    flooding = subprocess.Popen(
        publish(program, seconds, RATE, topics),
        env=os.environ,
        stdout=subprocess.PIPE,
        text=True,
    )
    time.sleep(2.0)
    before = memory_mb(pid)
    use = Use(pid)
    time.sleep(seconds - 3.0)
    figures = use.figures()
    sent, took = (float(word) for word in flooding.communicate()[0].split())
    time.sleep(3.0)
    state = rospy.wait_for_message(f"{ROBOT}/joint_states", JointState, 10.0)
    errors = {
        name: round(position - TARGET[name], 5)
        for name, position in zip(state.name, state.position, strict=True)
    }
    last = {}
    for topic, name in zip(COMMANDS, JOINTS, strict=True):
        state = topic.replace("command", "state")
        last[name] = rospy.wait_for_message(state, JointControllerState, 10.0).set_point
    growth = round(figures["memory_mb"] - before, 1)
    followed = last == TARGET and all(abs(error) <= HANG[name] for name, error in errors.items())
    return {
        "ok": figures["real_time_factor"] >= 0.95 and followed and growth < 10.0,
        **figures,
        "messages_per_second_and_topic": round(sent / took),
        "memory_growth_mb": growth,
        "errors": errors,
    }


if __name__ == "__main__":
    sys.exit(main())
