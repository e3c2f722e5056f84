"""A thousand mixed service calls from eight clients at once. Bounds: every one answered as it
should be, real-time factor 0.9.

    . devel/setup.bash && .venv/bin/python tests/benchmarks/service_flood.py [calls]
"""

from __future__ import annotations

import json
import sys
import threading
import time

from graph import ROBOT, Use, robot

CLIENTS = 8


def requests() -> list:
    """(name, type, arguments, check) of the calls that are mixed."""
    from controller_manager_msgs.srv import ListControllers, SwitchController
    from gazebo_msgs.srv import (
        GetJointProperties,
        GetLinkState,
        GetModelState,
        GetPhysicsProperties,
        GetWorldProperties,
        SetModelConfiguration,
    )

    manager = f"{ROBOT}/controller_manager"
    model = ROBOT.strip("/")
    return [
        ("/gazebo/get_world_properties", GetWorldProperties, (), lambda r: r.success),
        ("/gazebo/get_model_state", GetModelState, (model, ""), lambda r: r.success),
        ("/gazebo/get_link_state", GetLinkState, (f"{model}::camera_link", ""), _succeeded),
        ("/gazebo/get_joint_properties", GetJointProperties, ("J1",), _succeeded),
        ("/gazebo/get_physics_properties", GetPhysicsProperties, (), _succeeded),
        ("/gazebo/get_model_state", GetModelState, ("nobody", ""), lambda r: not r.success),
        ("/gazebo/set_model_configuration", SetModelConfiguration, (model, "", [], []), _succeeded),
        (f"{manager}/list_controllers", ListControllers, (), lambda r: len(r.controller) == 7),
        (f"{manager}/switch_controller", SwitchController, ([], [], 2, False, 0.0), _ok),
    ]


def _succeeded(response: object) -> bool:
    return response.success


def _ok(response: object) -> bool:
    return response.ok


def main() -> int:
    """Print one JSON line; status 1 when a bound is missed."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with robot() as pid:
        import rospy

        mix = requests()
        numbers = iter(range(count))
        lock = threading.Lock()
        faults: list[str] = []
        latencies: list[float] = []

        def client() -> None:
            while True:
                with lock:
                    number = next(numbers, None)
                if number is None:
                    return
                name, service, arguments, check = mix[number % len(mix)]
                begin = time.monotonic()
                try:
                    if not check(rospy.ServiceProxy(name, service)(*arguments)):
                        faults.append(f"{name}: wrong answer")
                except rospy.ServiceException as error:
                    faults.append(f"{name}: {error}")
                latencies.append(time.monotonic() - begin)

        time.sleep(2.0)
        use = Use(pid)
        clients = [threading.Thread(target=client) for _ in range(CLIENTS)]
        for thread in clients:
            thread.start()
        for thread in clients:
            thread.join()
        figures = use.figures()
    latencies.sort()
    ok = not faults and figures["real_time_factor"] >= 0.9 and len(latencies) == count
    figures |= {
        "calls": len(latencies),
        "calls_per_second": round(count / figures["seconds"]),
        "median_ms": round(1e3 * latencies[count // 2], 2),
        "worst_ms": round(1e3 * latencies[-1], 1),
        "faults": faults[:5],
    }
    print(json.dumps({"benchmark": "service_flood", "ok": ok, **figures}))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
