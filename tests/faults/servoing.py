"""An hour of servoing, disturbed every three seconds."""

from __future__ import annotations

import random
import time

import rospy
from aras_visual_servo_controller.msg import ServoReport
from gazebo_msgs.srv import (
    ApplyBodyWrenchRequest,
    SetModelConfigurationRequest,
)
from ros_graph import GraphError, wait_for

from .bed import ROBOT, Bed
from .outcome import Outcome
from .traffic import judged

EVERY = 3.0  # s of wall time between disturbances
REPORT = f"/{ROBOT}/controller/diagnosis"
ARM = ("J1", "J2", "J3", "J5", "J6")


def disturbed(bed: Bed, scale: float, seed: int) -> Outcome:
    """Pushes, jolts of the joints and short pauses; after each the arm is to converge again."""
    draw = random.Random(seed)
    reports: list[ServoReport] = []
    listener = rospy.Subscriber(REPORT, ServoReport, reports.append)
    with bed.group("servoing under disturbances") as outcome:
        again = 0
        end = time.monotonic() + max(3600.0 * scale, 12.0)
        while time.monotonic() < end:
            outcome.injected += 1
            began = time.monotonic()
            _disturb(bed, draw)
            time.sleep(EVERY)
            reports.clear()
            try:
                wait_for(
                    lambda: any(r.phase == "converged" for r in list(reports)[-3:]), 20.0,
                    "the arm to converge again",
                )  # fmt: skip
                again += 1
            except GraphError as error:
                last = reports[-1] if reports else None
                outcome.lost.append(f"{error}: {last and (last.phase, last.outcome, last.reason)}")
                continue
            outcome.recovered = max(outcome.recovered, time.monotonic() - began)
        judged(bed, outcome, again, "after the disturbances")
        outcome.note = f"converged again after {again} of {outcome.injected} disturbances"
    listener.unregister()
    return outcome


def _disturb(bed: Bed, draw: random.Random) -> None:
    how = draw.randrange(3)
    if how == 0:
        push = ApplyBodyWrenchRequest(body_name=f"{ROBOT}::camera_link")
        push.wrench.force.x, push.wrench.force.y = draw.gauss(0, 40), draw.gauss(0, 40)
        push.duration.secs = 1
        bed.call("/gazebo/apply_body_wrench", push)
    elif how == 1:
        bed.call(
            "/gazebo/set_model_configuration",
            SetModelConfigurationRequest(
                ROBOT, "robot_description", list(ARM), [draw.uniform(-0.15, 0.15) for _ in ARM]
            ),
        )
    else:
        bed.call("/gazebo/pause_physics")
        time.sleep(0.5)
        bed.calm()


GROUPS = (disturbed,)
