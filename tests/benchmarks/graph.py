"""ROS graph with a running robot for benchmarks, and the resources that a node's process uses."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "integration"))

ROBOT = "/aras_visual_servo"
COMMANDS = tuple(
    f"{ROBOT}/{name}_position_controller/command"
    for name in ("gantry", "joint1", "joint2", "joint3", "joint5", "joint6")
)
TICK = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")


@contextmanager
def robot(**arguments: object) -> Iterator[tuple[int, Any]]:
    """Run the ARAS robot with its controllers on a graph; yield the simulator's pid and the master.
    """
    from ros_graph import Launch, RosMaster, wait_for

    with tempfile.TemporaryDirectory() as directory:
        master = RosMaster(Path(directory), watched=False)
        names = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR")
        os.environ.update({name: master.environment[name] for name in names})
        launched = Launch(
            master, ("aras_visual_servo_gazebo", "aras_visual_servo.launch"), arguments
        )
        try:
            launched.wait_for_nodes(["/gazebo"])
            import rospy

            from aras_visual_servo_ros.rospy_patches import find_publishers

            find_publishers()
            rospy.init_node("benchmark", disable_rostime=True, disable_signals=True)
            wait_for(_all_running, 60.0, "the seven controllers")
            yield process_of("/gazebo", master), master
            rospy.signal_shutdown("measured")
        except Exception:
            print(launched.output()[-5000:], file=sys.stderr)
            raise
        finally:
            launched.stop()
            master.stop()


def _all_running() -> bool:
    import rospy
    from controller_manager_msgs.srv import ListControllers

    name = f"{ROBOT}/controller_manager/list_controllers"
    rospy.wait_for_service(name, 60.0)
    states = [c.state for c in rospy.ServiceProxy(name, ListControllers)().controller]
    return states == ["running"] * 7


def process_of(node: str, master: Any) -> int:
    import xmlrpc.client

    return xmlrpc.client.ServerProxy(master.api.lookupNode(node)).getPid("/benchmark")[2]


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has used so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def memory_mb(pid: int) -> float:
    """Resident memory of a process [MB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 1e6


class Use:
    """Use of processor (%), memory and real-time factor of the node since this object was made."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._wall, self._cpu, self._time = time.monotonic(), cpu_seconds(pid), simulated()

    def figures(self) -> dict[str, float]:
        time_s = simulated()
        wall = time.monotonic() - self._wall
        return {
            "seconds": round(wall, 1),
            "cpu_percent": round(100.0 * (cpu_seconds(self._pid) - self._cpu) / wall, 2),
            "real_time_factor": round((time_s - self._time) / wall, 4),
            "memory_mb": round(memory_mb(self._pid), 1),
        }


def simulated() -> float:
    import rospy
    from gazebo_msgs.srv import GetWorldProperties

    return rospy.ServiceProxy("/gazebo/get_world_properties", GetWorldProperties)().sim_time
