"""Fault injection every three seconds during an hour of visual servoing."""

from __future__ import annotations

import math
import random
import time
from statistics import median

import rospy
from aras_visual_servo_controller.msg import ServoReport
from dynamic_reconfigure.msg import DoubleParameter
from dynamic_reconfigure.srv import ReconfigureRequest
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import (
    ApplyBodyWrenchRequest,
    SetModelConfigurationRequest,
    SetModelStateRequest,
)
from ros_graph import GraphError, wait_for
from std_msgs.msg import Float64

from .bed import COMMANDS, JOINTS, NODES, ROBOT, Bed, UnansweredError
from .outcome import Outcome
from .reports import Report, contradictions
from .traffic import judged

EVERY = 3.0  # s of wall time between disturbances
AGAIN = 60.0  # s of simulated time: what has not converged by then will not
REPORT = f"/{ROBOT}/controller/diagnosis"
ARM = ("J1", "J2", "J3", "J5", "J6")


def disturbed(bed: Bed, scale: float, seed: int) -> Outcome:
    """Pushes, jolts of the joints, pauses, resets, commands of another node, other gains, and a
    target that moves; after each the arm is to converge again, by itself."""
    draw = random.Random(seed)
    reports: list[ServoReport] = []
    every: list[ServoReport] = []

    def heard(report: ServoReport) -> None:
        reports.append(report)
        every.append(report)

    listener = rospy.Subscriber(REPORT, ServoReport, heard)
    with bed.group("servoing under disturbances") as outcome:
        took: list[float] = []
        clock = bed.simulated()
        end = time.monotonic() + max(3600.0 * scale, 12.0)
        while time.monotonic() < end:
            outcome.injected += 1
            began, disturbed_at = time.monotonic(), bed.simulated()
            try:
                how = draw.choice(DISTURBANCES)(bed, draw)
                time.sleep(EVERY)
                reports.clear()
                _converge(bed, reports, how)
            except (GraphError, UnansweredError) as error:
                outcome.lost.append(str(error))
                continue
            took.append(max(bed.simulated() - disturbed_at, 0.0))  # a reset takes time back
            outcome.recovered = max(outcome.recovered, time.monotonic() - began)
        outcome.lost += contradictions(map(Report.from_message, every))
        judged(bed, outcome, len(took), "after the disturbances")
        outcome.note = (
            f"converged again after {len(took)} of {outcome.injected} disturbances, half of them "
            f"within {median(took or [0.0]):.1f} s, all within {max(took, default=0.0):.1f} s; "
            f"{bed.simulated() - clock:.0f} s of simulated time"
        )
    listener.unregister()
    return outcome


def _converge(bed: Bed, reports: list[ServoReport], after: str) -> None:
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


def _push(bed: Bed, draw: random.Random) -> str:
    push = ApplyBodyWrenchRequest(body_name=f"{ROBOT}::camera_link")
    push.wrench.force.x, push.wrench.force.y = draw.gauss(0, 40), draw.gauss(0, 40)
    push.duration.secs = 1
    bed.call("/gazebo/apply_body_wrench", push)
    return f"a push of {push.wrench.force.x:.0f}, {push.wrench.force.y:.0f} N"


def _jolt(bed: Bed, draw: random.Random) -> str:
    jolt = [draw.uniform(-0.15, 0.15) for _ in ARM]
    bed.call(
        "/gazebo/set_model_configuration",
        SetModelConfigurationRequest(ROBOT, "robot_description", list(ARM), jolt),
    )
    return f"a jolt to {', '.join(f'{q:.3f}' for q in jolt)}"


def _pause(bed: Bed, draw: random.Random) -> str:
    bed.call("/gazebo/pause_physics")
    time.sleep(draw.choice((0.5, 7.0)))
    bed.calm()
    return "a pause"


def _target(bed: Bed, draw: random.Random) -> str:
    """Move the target to another place on the table for a while, possibly out of reach."""
    x, y, turn = draw.uniform(-0.04, 0.04), draw.uniform(-0.04, 0.04), draw.uniform(-0.5, 0.5)
    state = ModelState(model_name="target")
    for part in (1.0, 0.0):
        place = state.pose.position
        place.x, place.y, place.z = part * x, part * y, 0.591
        state.pose.orientation.z = math.sin(part * turn / 2)
        state.pose.orientation.w = math.cos(part * turn / 2)
        bed.call("/gazebo/set_model_state", SetModelStateRequest(state))
        time.sleep(part * draw.uniform(0.5, 6.0))
    return f"the target at {x:.3f}, {y:.3f} m, turned by {turn:.2f} rad, and back"


def _commands(bed: Bed, draw: random.Random) -> str:
    """This node commands some joints; while it does so and they do not follow the loop, the
    loop's reason names it."""
    chosen = draw.sample(range(len(COMMANDS)), draw.choice((1, 1, 2, 6)))
    rate, seconds = draw.choice((5.0, 50.0, 500.0)), draw.uniform(1.0, 4.0)
    values = [draw.uniform(-0.25, 0.25) for _ in chosen]
    restless, named = draw.random() < 0.3, []
    publishers = [
        rospy.Publisher(COMMANDS[k], Float64, queue_size=1, tcp_nodelay=True) for k in chosen
    ]
    what = f"{rate:g} commands/s for {seconds:.1f} s on {[JOINTS[k] for k in chosen]}"
    late: list[str] = []

    def heard(report: ServoReport) -> None:
        late[:] = [report.reason]
        named.append(rospy.get_name() in report.reason)

    listener = rospy.Subscriber(REPORT, ServoReport, heard)
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for publisher, value in zip(publishers, values, strict=True):
                publisher.publish(draw.gauss(value, 0.05) if restless else value)
            time.sleep(1.0 / rate)
        if rate >= 50.0 and seconds > 3.0 and late and "waiting for" in late[0] and not any(named):
            raise GraphError(f"no reason names this node during {what}, the last is {late[0]}")
    finally:
        listener.unregister()
        for publisher in publishers:
            publisher.unregister()
    return what


def _reset(bed: Bed, draw: random.Random) -> str:
    name = draw.choice(("reset_world", "reset_simulation"))
    bed.call(f"/gazebo/{name}")
    return name


def _gain(bed: Bed, draw: random.Random) -> str:
    gain = draw.choice((0.5, 1.0, 2.0, 4.0))
    change = ReconfigureRequest()
    change.config.doubles = [DoubleParameter("gain", gain)]
    bed.call(f"{NODES[2]}/gains/set_parameters", change)
    return f"a gain of {gain:g}"


DISTURBANCES = (_push, _jolt, _pause, _target, _commands, _commands, _reset, _gain)

GROUPS = (disturbed,)
