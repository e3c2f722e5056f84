"""Processor share of the idle node at real time: controllers run, joint_states at 100 Hz are read,
nobody wants images. Bound: 15 % of one core.

    . devel/setup.bash && .venv/bin/python tests/benchmarks/node_cpu.py [seconds]
"""

from __future__ import annotations

import json
import subprocess
import sys
import time

from graph import ROBOT, Use, robot

BOUND = 15.0  # percent of one core


def main() -> int:
    """Print one JSON line; status 1 when the bound is missed."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    with robot() as pid:
        import rospy
        from sensor_msgs.msg import JointState

        heard = []
        rospy.Subscriber(f"{ROBOT}/joint_states", JointState, heard.append, tcp_nodelay=True)
        time.sleep(3.0)
        heard.clear()
        use = Use(pid)
        if len(sys.argv) > 2:  # a profiler's command line; {} stands for the process id
            subprocess.run(sys.argv[2].format(pid), shell=True, check=False)
        else:
            time.sleep(seconds)
        figures = use.figures()
        figures["joint_states_hz"] = round(len(heard) / figures["seconds"], 1)
    figures["bound"] = BOUND
    print(json.dumps({"benchmark": "node_cpu", **figures}))
    return 0 if figures["cpu_percent"] <= BOUND else 1


if __name__ == "__main__":
    sys.exit(main())
