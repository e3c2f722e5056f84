"""The same experiment in the runner and on a graph in lockstep: one joint trajectory."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import rosbag
import rospy
from aras_visual_servo_controller.msg import ServoReport, ServoState
from ros_graph import wait_for
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from std_srvs.srv import Empty
from test_bridge_lockstep import COMMANDS, ROBOT, all_running, call, connections

from aras_visual_servo_bench.asked.assembly import assemble
from aras_visual_servo_bench.asked.experiment import Experiment
from aras_visual_servo_bench.numbers.summary import summarise
from aras_visual_servo_bench.recording.from_bag import Messages
from aras_visual_servo_bench.recording.from_graph import Heard
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.ros.bag import read_bag
from aras_visual_servo_bench.ros.describe import gathered
from aras_visual_servo_bench.running.loop import Loop

FRAMES = 45  # 1.5 s: the approach to the start takes 0.9 s, the rest is servoed
START = [0.05, 0.02, 0.1, -0.05, -0.05, 0.1]
IMAGE = "/labrob/camera/image_raw"
LISTENED = {  # by the controller, for the images of a scheme; it has joint states besides
    "moments": {f"{ROBOT}/camera/moments"},
    "moments_2016": {f"{ROBOT}/camera/moments"},
    "kernel": {f"{ROBOT}/camera/moments", f"{ROBOT}/camera/kernel"},
    "points": {IMAGE, "/labrob/camera/camera_info"},
}


# Of the loop's records: the way of the camera is the physics' own in the runner, and that of
# joint states of a step before in a bag.
PRINTED = ("outcome", "reason", "mend", "iterations", "overshoot", "decay_rate", "error_settled",
           "servoing_time", "top_speed", "smallest_singular_value", "condition_L",
           "manipulability", "scale")  # fmt: skip


def recorded(heard: Heard, path: Path) -> Run:
    """The run of a bag of the same messages."""
    with rosbag.Bag(str(path), "w") as bag:
        for topic, messages in (
            (f"{ROBOT}/controller/state", heard.states), (f"{ROBOT}/joint_states", heard.joints),
            (f"{ROBOT}/controller/diagnosis", heard.reports.values()),
        ):  # fmt: skip
            for message in messages:
                bag.write(topic, message, message.header.stamp)
        bag.write(f"{ROBOT}/experiment", String(heard.described), heard.states[0].header.stamp)
    return read_bag(path)


def on_the_graph(
    launch, collect, master, scheme: str, camera: str, goal: str
) -> tuple[dict[int, dict[str, float]], Heard]:
    """Joint positions by stamp, ns, up to the last frame, as joint_states tells them; and all
    that the controller says."""
    robot = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
        paused=True, speed_mode="lockstep", camera=camera,
    )  # fmt: skip
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
        nodes=[f"{ROBOT}_camera", f"{ROBOT}_controller"], start=str(START), scheme=scheme,
        goal=goal,
    )  # fmt: skip
    wait_for(all_running, 40.0, "seven running controllers")
    images = collect(IMAGE, Image)
    states = collect(f"{ROBOT}/joint_states", JointState)
    said = collect(f"{ROBOT}/controller/state", ServoState)
    reports = collect(f"{ROBOT}/controller/diagnosis", ServoReport)
    heard = {("i", topic) for topic in LISTENED[scheme] | {f"{ROBOT}/joint_states"}}
    wait_for(
        lambda: (
            {("i", topic) for topic in COMMANDS} <= connections(master, "/gazebo")
            and {("i", IMAGE), ("i", "/labrob/camera/camera_info")}
            <= connections(master, f"{ROBOT}_camera")
            and heard <= connections(master, f"{ROBOT}_controller")
        ),
        20.0,
        "all nodes to be connected",
    )
    wait_for(states.connected, 5.0, "joint states")
    wait_for(images.connected, 5.0, "images")
    wait_for(said.connected, 5.0, "states")
    wait_for(reports.connected, 5.0, "reports")
    call("/gazebo/unpause_physics", Empty)
    images.wait(FRAMES, timeout=60.0)
    call("/gazebo/pause_physics", Empty)
    last = images.messages[FRAMES - 1].header.stamp.to_nsec()
    found = {
        m.header.stamp.to_nsec(): dict(zip(m.name, m.position, strict=True))
        for m in states.messages
        if m.header.stamp.to_nsec() <= last
    }
    told = Heard(Path("the graph"))
    told.states = [m for m in said.messages if m.header.stamp.to_nsec() <= last]
    for message in reports.messages:
        told.take_report(message)
    told.joints = [m for m in states.messages if m.header.stamp.to_nsec() <= last]
    told.described = json.dumps(gathered(rospy.get_param("/"), f"{ROBOT}_controller"), default=str)
    output = robot.output()
    images.close()
    states.close()
    nodes.stop()
    robot.stop()
    assert "in vain" not in output, output[-2000:]
    return found, told


def in_the_runner(
    scheme: str, camera: str, goal: str, last_ns: int
) -> tuple[dict[int, dict[str, float]], Run]:
    """The same of the runner, whose loop drives the arm from zero to the start; and its run."""
    experiment = Experiment(
        scheme=scheme, camera=camera, start=(0.0,) * 6, goal=goal, commands="images", delay=0.0,
        duration=1e3, linger=None, options={"start": START},
    )  # fmt: skip
    loop = Loop(experiment, assemble(experiment))
    while loop.plant.time_ns <= last_ns:
        loop.to_image()
    result = loop.result()
    loop.close()
    assert result.phases[-1] in ("servoing", "converged")
    return {
        round(stamp * 1e9): dict(zip(result.joint_names, q, strict=True))
        for stamp, q in zip(result.joint_stamp, result.measured, strict=True)
        if round(stamp * 1e9) <= last_ns
    }, result


def shown(run: Run) -> dict[str, str]:
    """What a report prints of what the loop and its joint states tell."""
    return {q.key: q.shown for q in summarise(run) if q.key in PRINTED}


@pytest.mark.parametrize(
    ("scheme", "camera"),
    [
        ("kernel", "original"),
        ("moments_2016", "wide"),
        ("moments", "original"),
        ("moments", "wide"),
        ("points", "original"),
    ],
)
def test_runner_and_graph_are_one(launch, collect, ros_node, ros_master, scheme, camera, tmp_path):
    goal = "2016"
    if scheme == "points":  # the shipped goals hold no corners: taught by the camera's picture
        goal = str(tmp_path / "corners.yaml")
        taught = assemble(Experiment(scheme=scheme, camera=camera, goal="2016")).goal
        (tmp_path / "corners.yaml").write_text(taught.to_yaml("for a test"))
    graph, heard = on_the_graph(launch, collect, ros_master, scheme, camera, goal)
    runner, own = in_the_runner(scheme, camera, goal, max(graph))
    assert set(graph) == set(runner)  # joint states at the same instants, none lost
    off = {t: max(abs(graph[t][name] - q) for name, q in runner[t].items()) for t in graph}
    worst = max(off, key=off.get)
    assert off[worst] <= 1e-9, f"{off[worst]:.3g} at {worst * 1e-9:.3f} s"
    live, kept = Messages(heard).run("live"), recorded(heard, tmp_path / "run.bag")
    last = live.stamp[-1]  # of the images that the graph has answered
    assert len(live.stamp) > 10
    count = int((own.stamp <= last).sum())
    own = replace(own, states=own.states[:count], pose=own.pose[:count])
    assert shown(live) == shown(kept) == shown(own)
    first = graph[min(graph)]["gantry"]
    assert max(abs(q["gantry"] - first) for q in graph.values()) > 0.02
