"""A flood of commands, as the original controllers make it: six Float64 topics at 6 000 messages a
second each, from one C++ process, for a minute. Bounds: real-time factor 0.95, joints follow the
last command, memory flat.

    . devel/setup.bash && .venv/bin/python tests/benchmarks/command_flood.py [seconds]
"""

from __future__ import annotations

import json
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
// Arguments: seconds, rate, then topic and last value, six times.
int main(int argc, char** argv) {
  ros::init(argc, argv, "flood", ros::init_options::AnonymousName);
  ros::NodeHandle node;
  const double seconds = atof(argv[1]), rate = atof(argv[2]);
  std::vector<ros::Publisher> topics;
  std::vector<double> last;
  for (int k = 3; k + 1 < argc; k += 2) {
    topics.push_back(node.advertise<std_msgs::Float64>(argv[k], 1));
    last.push_back(atof(argv[k + 1]));
  }
  ros::AsyncSpinner spinner(1);
  spinner.start();
  for (auto& topic : topics)
    while (ros::ok() && topic.getNumSubscribers() == 0) ros::WallDuration(0.01).sleep();
  const ros::WallTime begin = ros::WallTime::now();
  long sent = 0;
  std_msgs::Float64 message;
  for (double now = 0; now < seconds && ros::ok(); now = (ros::WallTime::now() - begin).toSec()) {
    const long due = static_cast<long>(now * rate);
    for (; sent < due; ++sent)
      for (size_t k = 0; k < topics.size(); ++k) {
        message.data = last[k] * (1 + 0.5 * std::sin(6.28 * 0.2 * now));
        topics[k].publish(message);
      }
    ros::WallDuration(0.0002).sleep();
  }
  for (int n = 0; n < 20; ++n, ++sent) {  // the last command, a few times as the originals do
    for (size_t k = 0; k < topics.size(); ++k) {
      message.data = last[k];
      topics[k].publish(message);
    }
    ros::WallDuration(0.005).sleep();
  }
  printf("%ld %f\n", sent, (ros::WallTime::now() - begin).toSec());
  fflush(stdout);
  ros::WallDuration(0.5).sleep();
  _exit(0);
}
"""


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


def main() -> int:
    """Print one JSON line; status 1 when a bound is missed."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with tempfile.TemporaryDirectory() as directory, robot() as pid:
        from control_msgs.msg import JointControllerState
        from sensor_msgs.msg import JointState

        program = build(Path(directory))
        arguments = [a for t, j in zip(COMMANDS, JOINTS, strict=True) for a in (t, str(TARGET[j]))]
        flood = subprocess.Popen(
            [program, str(seconds), str(RATE), *arguments],
            env=os.environ,
            stdout=subprocess.PIPE,
            text=True,
        )
        time.sleep(2.0)
        before = memory_mb(pid)
        use = Use(pid)
        time.sleep(seconds - 3.0)
        figures = use.figures()
        sent, took = (float(word) for word in flood.communicate()[0].split())
        time.sleep(3.0)
        import rospy

        state = rospy.wait_for_message(f"{ROBOT}/joint_states", JointState, 10.0)
        errors = {
            name: round(position - TARGET[name], 5)
            for name, position in zip(state.name, state.position, strict=True)
        }
        last = {}
        for topic, name in zip(COMMANDS, JOINTS, strict=True):
            state = topic.replace("command", "state")
            last[name] = rospy.wait_for_message(state, JointControllerState, 10.0).set_point
    figures |= {
        "messages_per_second_and_topic": round(sent / took),
        "memory_growth_mb": round(figures["memory_mb"] - before, 1),
        "errors": errors,
    }
    followed = last == TARGET and all(abs(error) <= HANG[name] for name, error in errors.items())
    ok = (
        figures["real_time_factor"] >= 0.95 and followed and figures["memory_growth_mb"] < 10.0
    )
    print(json.dumps({"benchmark": "command_flood", "ok": ok, **figures}))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
