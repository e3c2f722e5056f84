#!/usr/bin/env python3
"""Measure the processor time of simulator, camera node and controller on the ROS graph.

Starts the shipped robot (320 x 240 pixels at 30 Hz) and its nodes on a master of its own, and
measures each process while the arm moves to its goal and afterwards. Needs the sourced workspace:

    . devel/setup.bash && .venv/bin/python tests/benchmarks/nodes_cost.py [--seconds 10]

The last line is JSON: for each phase the percentage of one core that each process and all of them
together use, per second of simulated time, their memory, and the real-time factor. Arguments such
as `one_process:=true` are passed to aras_visual_servo_nodes.launch.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from graph import ROBOT, cpu_seconds, memory_mb, process_of, robot, simulated

CAMERA, CONTROLLER = f"{ROBOT}_camera", f"{ROBOT}_controller"


def measure(pids: dict[str, int], seconds: float) -> dict[str, float]:
    """Return the processor time of each process in % of the simulated time that passes."""
    start, before = simulated(), {name: cpu_seconds(pid) for name, pid in pids.items()}
    began = time.monotonic()
    time.sleep(seconds)
    spent = {name: cpu_seconds(pid) - before[name] for name, pid in pids.items()}
    wall, duration = time.monotonic() - began, simulated() - start
    spent["total"] = sum(spent.values())
    figures = {name: round(100.0 * s / duration, 2) for name, s in spent.items()}
    memory = round(sum(memory_mb(pid) for pid in pids.values()))
    return {**figures, "memory_mb": memory, "real_time_factor": round(duration / wall, 3)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="wall time of each phase")
    parser.add_argument("arguments", nargs="*", help="arguments of the nodes' launch file")
    asked = parser.parse_args()
    with robot() as (pid, master):
        from ros_graph import Launch

        arguments = dict(text.split(":=", 1) for text in asked.arguments)
        arguments.setdefault("gain", "0.4")  # slow enough to be under way in the first phase
        launch = Launch(
            master, ("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch"), arguments
        )
        try:
            launch.wait_for_nodes([CONTROLLER])
            wait_for_phase("servoing")
            time.sleep(0.5)
            nodes = [node for node in (CAMERA, CONTROLLER) if node in master.nodes()]
            pids = {"simulator": pid, **{node: process_of(node, master) for node in nodes}}
            results = {"servoing": measure(pids, min(asked.seconds, 5.0))}
            wait_for_phase("converged")
            results["converged"] = measure(pids, asked.seconds)
        except Exception:
            print(launch.output()[-5000:], file=sys.stderr)
            raise
        finally:
            launch.stop(clean=False)
    for phase, figures in results.items():
        print(phase, figures)
    print(json.dumps(results))
    return 0


def wait_for_phase(phase: str) -> None:
    """Wait until the controller is in a phase; the subscription ends then, because it costs time.
    """
    from aras_visual_servo_controller.msg import ServoState
    from ros_graph import wait_for_message

    wait_for_message(f"{ROBOT}/controller/state", ServoState, 60.0, lambda m: m.phase == phase)


if __name__ == "__main__":
    sys.exit(main())
