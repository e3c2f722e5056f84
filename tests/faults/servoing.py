"""An hour of servoing, disturbed every three seconds."""

from __future__ import annotations

import random
import time
from statistics import median

import rospy
from aras_visual_servo_controller.msg import ServoReport
from gazebo_msgs.srv import (
    ApplyBodyWrenchRequest,
    SetModelConfigurationRequest,
)
from ros_graph import GraphError, wait_for

from .bed import ROBOT, Bed, UnansweredError
from .outcome import Outcome
from .traffic import judged

EVERY = 3.0  # s of wall time between disturbances
AGAIN = 60.0  # s of simulated time: what has not converged by then will not
REPORT = f"/{ROBOT}/controller/diagnosis"
ARM = ("J1", "J2", "J3", "J5", "J6")


def disturbed(bed: Bed, scale: float, seed: int) -> Outcome:
    """Pushes, jolts of the joints and short pauses; after each the arm is to converge again."""
    draw = random.Random(seed)
    reports: list[ServoReport] = []
    listener = rospy.Subscriber(REPORT, ServoReport, reports.append)
    with bed.group("servoing under disturbances") as outcome:
        took: list[float] = []
        clock = bed.simulated()
        end = time.monotonic() + max(3600.0 * scale, 12.0)
        while time.monotonic() < end:
            outcome.injected += 1
            began, disturbed_at = time.monotonic(), bed.simulated()
            try:
                how = _disturb(bed, draw)
                time.sleep(EVERY)
                reports.clear()
                _converge(bed, reports, how)
            except (GraphError, UnansweredError) as error:
                outcome.lost.append(str(error))
                continue
            took.append(bed.simulated() - disturbed_at)
            outcome.recovered = max(outcome.recovered, time.monotonic() - began)
        judged(bed, outcome, len(took), "after the disturbances")
        outcome.note = (
            f"converged again after {len(took)} of {outcome.injected} disturbances, half of them "
            f"within {median(took or [0.0]):.1f} s, all within {max(took, default=0.0):.1f} s; "
            f"{bed.simulated() - clock:.0f} s of simulated time"
        )
    listener.unregister()
    return outcome


def _converge(bed: Bed, reports: list[ServoReport], after: str) -> None:
    """Wait until the arm has converged; GraphError when it has not within AGAIN."""
    end = bed.simulated() + AGAIN

    def ended() -> bool:
        return bed.simulated() > end or any(r.phase == "converged" for r in list(reports)[-3:])

    wait_for(ended, 10.0 * AGAIN, "the simulated time in which the arm converges again")
    if bed.simulated() > end:
        last = reports[-1] if reports else None
        state = last and f"{last.phase}, {last.outcome}, {last.reason}"
        raise GraphError(
            f"{bed.simulated():.1f} s: not converged {AGAIN:g} s after {after}: {state}"
        )


def _disturb(bed: Bed, draw: random.Random) -> str:
    """Do something to the robot; in words."""
    how = draw.randrange(3)
    if how == 0:
        push = ApplyBodyWrenchRequest(body_name=f"{ROBOT}::camera_link")
        push.wrench.force.x, push.wrench.force.y = draw.gauss(0, 40), draw.gauss(0, 40)
        push.duration.secs = 1
        bed.call("/gazebo/apply_body_wrench", push)
        return f"a push of {push.wrench.force.x:.0f}, {push.wrench.force.y:.0f} N"
    if how == 1:
        jolt = [draw.uniform(-0.15, 0.15) for _ in ARM]
        bed.call(
            "/gazebo/set_model_configuration",
            SetModelConfigurationRequest(ROBOT, "robot_description", list(ARM), jolt),
        )
        return f"a jolt to {', '.join(f'{q:.3f}' for q in jolt)}"
    bed.call("/gazebo/pause_physics")
    time.sleep(0.5)
    bed.calm()
    return "a pause"


GROUPS = (disturbed,)
