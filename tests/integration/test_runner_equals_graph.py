"""The same experiment in the runner and on a graph in lockstep: one joint trajectory."""

from __future__ import annotations

import pytest
from ros_graph import wait_for
from sensor_msgs.msg import Image, JointState
from std_srvs.srv import Empty
from test_bridge_lockstep import COMMANDS, ROBOT, all_running, call, connections

from aras_visual_servo_bench.asked.assembly import assemble
from aras_visual_servo_bench.asked.experiment import Experiment
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


def on_the_graph(
    launch, collect, master, scheme: str, camera: str, goal: str
) -> dict[int, dict[str, float]]:
    """Joint positions by stamp, ns, up to the last frame, as joint_states tells them."""
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
    call("/gazebo/unpause_physics", Empty)
    images.wait(FRAMES, timeout=60.0)
    call("/gazebo/pause_physics", Empty)
    last = images.messages[FRAMES - 1].header.stamp.to_nsec()
    found = {
        m.header.stamp.to_nsec(): dict(zip(m.name, m.position, strict=True))
        for m in states.messages
        if m.header.stamp.to_nsec() <= last
    }
    output = robot.output()
    images.close()
    states.close()
    nodes.stop()
    robot.stop()
    assert "in vain" not in output, output[-2000:]
    return found


def in_the_runner(scheme: str, camera: str, goal: str, last_ns: int) -> dict[int, dict[str, float]]:
    """The same of the runner; the arm begins at zero, its loop drives it to the start."""
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
    }


@pytest.mark.parametrize(
    ("scheme", "camera"),
    [
        ("kernel", "original"),
        ("moments_2016", "wide"),
        ("moments", "original"),
        ("points", "original"),
    ],
)
def test_runner_and_graph_are_one(launch, collect, ros_node, ros_master, scheme, camera, tmp_path):
    goal = "2016"
    if scheme == "points":  # the shipped goals hold no corners: taught by the camera's picture
        goal = str(tmp_path / "corners.yaml")
        taught = assemble(Experiment(scheme=scheme, camera=camera, goal="2016")).goal
        (tmp_path / "corners.yaml").write_text(taught.to_yaml("for a test"))
    graph = on_the_graph(launch, collect, ros_master, scheme, camera, goal)
    runner = in_the_runner(scheme, camera, goal, max(graph))
    assert set(graph) == set(runner)  # joint states at the same instants, none lost
    off = {t: max(abs(graph[t][name] - q) for name, q in runner[t].items()) for t in graph}
    worst = max(off, key=off.get)
    assert off[worst] <= 1e-9, f"{off[worst]:.3g} at {worst * 1e-9:.3f} s"
    first = graph[min(graph)]["gantry"]
    assert max(abs(q["gantry"] - first) for q in graph.values()) > 0.02
