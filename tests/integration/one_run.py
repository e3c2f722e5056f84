"""One experiment of the Bullet arm: in the runner, on a graph in lockstep, and read from its bag.

They are compared by `tests/one_run`; one in test_runner_equals_graph.py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import signal
import sys
import tempfile
import time
import xmlrpc.client
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import rosbag
import rospy
import yaml
from aras_visual_servo_controller.msg import ServoReport, ServoState
from controller_manager_msgs.srv import ListControllers
from gazebo_calls import call
from ros_graph import Collector, GraphError, Launch, RosMaster, wait_for
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from std_srvs.srv import Empty

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.metrics.summary import summarise
from aras_visual_servo_bench.recording.graph_recording import GraphRecording
from aras_visual_servo_bench.recording.message_run_builder import MessageRunBuilder
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.recording.verdict import Verdict
from aras_visual_servo_bench.ros.bag import read_bag
from aras_visual_servo_bench.ros.describe import collect_description
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_ros.parameters import get_parameter

ROBOT = "/aras_visual_servo"
COMMANDS = [f"{ROBOT}/{name}_position_controller/command"
            for name in ("gantry", "joint1", "joint2", "joint3", "joint5", "joint6")]
AWAY = (0.05, 0.02, 0.1, -0.05, -0.05, 0.1)
TURNED = (0.02, -0.03, -0.05, 0.08, 0.02, -0.3)
HIGH = (0.07, 0.01, -0.15, 0.09, 0.06, 0.2)
GOAL = (0.05, 0.0, -0.09, 0.045, 0.045, 0.0)  # of 2016
NEAR = (0.052, 0.002, -0.088, 0.046, 0.044, 0.004)
CAMERAS = ("original", "wide", "calibrated")
POLICY = "aras_visual_servo_bench.learning.policy:Policy"
PICTURED = ("points", POLICY)  # schemes that see pictures
FRAMES = 45  # 1.5 s: the way to the start takes about 0.9 s, the rest is servoed
IMAGE, INFO = "/labrob/camera/image_raw", "/labrob/camera/camera_info"
# What a listener to joint states, states and reports has no pictures for, nor the wall's clock.
NOT_HEARD = {"images", "image_rate", "images_late", "delay", "real_time_factor", "computing",
             "image_excursion", "largest_depth", "decay_predicted"}


@dataclass(frozen=True)
class Case:
    """One experiment.

    robot, nodes: further launch arguments. keys: the same as keys of an Experiment.
    parameters: of the controller, in a file on the graph. frames: after which it ends.
    ends: how the outcome at that frame begins.
    """

    name: str
    scheme: str = "moments"
    camera: str = "original"
    start: tuple[float, ...] = AWAY
    robot: dict[str, str] = field(default_factory=dict)
    nodes: dict[str, str] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, Any] = field(default_factory=dict)
    frames: int = FRAMES
    ends: str = ""

    @property
    def taught(self) -> bool:
        """Return whether the goal is taught, because the shipped goal does not fit."""
        return self.scheme in PICTURED or "target" in self.keys

    def experiment(self, goal: str | tuple[float, ...]) -> Experiment:
        """Return the experiment without an end; the loop drives the arm to the start."""
        parameters = {key: value for key, value in self.parameters.items() if key != "delay"}
        return Experiment(scheme=self.scheme, camera=self.camera, start=(0.0,) * 6, goal=goal,
                          commands="images", duration=1e3, time_after_convergence=None,
                          controller_parameters={"start": list(self.start), **parameters},
                          **{"delay": 0.0, **self.keys})

    def goal(self, folder: Path) -> str:
        """Return the name or the file of the goal."""
        if not self.taught:
            return "2016"
        file = folder / "taught.yaml"
        file.write_text(assemble(self.experiment(GOAL)).goal.to_yaml("for a test"))
        return str(file)

    @property
    def camera_process(self) -> str:
        """Return the name of the node that measures the moments."""
        return f"{ROBOT}_controller" if "one_process" in self.nodes else f"{ROBOT}_camera"

    def listened(self) -> set[str]:
        """Return the topics that the controller must receive before time continues."""
        moments = {f"{ROBOT}/camera/moments", f"{ROBOT}/joint_states"}
        if "one_process" in self.nodes:
            moments = {f"{ROBOT}/joint_states"}
        if self.scheme in PICTURED:
            return {IMAGE, INFO, f"{ROBOT}/joint_states"}
        return moments | ({f"{ROBOT}/camera/kernel"} if self.scheme == "kernel" else set())


def _moved(*xyz: float) -> dict[str, Any]:
    """Return the arguments that displace a camera in its link, m."""
    return {"robot": {"camera_xyz": " ".join(map(str, xyz))}, "keys": {"camera_xyz": xyz}}


def _law(name: str, gain: float | None = None) -> dict[str, Any]:
    keys: dict[str, Any] = {"law": name} if gain is None else {"law": name, "gain": gain}
    return {"nodes": {key: str(value) for key, value in keys.items()}, "keys": keys}


def _delayed(seconds: float) -> dict[str, Any]:
    return {"parameters": {"delay": seconds}, "keys": {"delay": seconds}}


def _target(shape: str) -> dict[str, Any]:
    return {"robot": {"target": shape, "target_size": "0.06 0.05"},
            "keys": {"target": {"shape": shape, "size": (0.06, 0.05),
                                "pose": (0, 0, 0.591, 0, 0, 0)}}}


def _cases() -> Iterable[Case]:
    """Return all cases: schemes with cameras, starts, delays, targets, laws and mountings."""
    for scheme in ("moments", "moments_2016", "kernel", "points"):
        # Kernels are of one camera: that which the shipped goal was taught with.
        for camera in ("original",) if scheme == "kernel" else CAMERAS:
            yield Case(f"{scheme}/{camera}", scheme, camera)
        for word, start in (("turned", TURNED), ("high", HIGH)):
            yield Case(f"{scheme}/{word}", scheme, start=start, frames=75)
        for delay in (0.02, 0.05):
            yield Case(f"{scheme}/delay {delay:g} s", scheme, **_delayed(delay))
    for camera in ("fisheye", "noisy", "rolling"):
        yield Case(f"moments/{camera}", camera=camera)
    yield Case("moments/shaking", camera=str(Path(__file__).with_name("shaking.yaml")))
    yield Case("moments/near", start=NEAR, frames=150, ends="converged")
    for shape in ("square", "triangle", "l_shape"):
        yield Case(f"moments/{shape}", **_target(shape))
    for law, gain in (("adaptive", None), ("pi", None), ("proportional", 3.0)):
        yield Case(f"moments/{law}" + (f" {gain:g}" if gain else ""), **_law(law, gain))
    yield Case("kernel/adaptive", "kernel", **_law("adaptive"))
    yield Case("policy", POLICY, frames=75)
    yield Case("moments/camera moved", **_moved(0.0, 0.02, 0.005))
    yield Case("points/camera moved", "points", **_moved(0.0, -0.01, 0.003))
    yield Case("moments/one process", nodes={"one_process": "true"})
    yield Case("points/one process", "points", nodes={"one_process": "true"}, **_delayed(0.02))
    yield Case("moments/no friction", robot={"joint_friction": "false"}, keys={"friction": False})


CASES = {case.name: case for case in _cases()}


def all_running() -> bool:
    controllers = call(f"{ROBOT}/controller_manager/list_controllers", ListControllers).controller
    return len(controllers) == 7 and all(c.state == "running" for c in controllers)


def connections(master: RosMaster, node: str) -> set[tuple[str, str]]:
    """Return (direction, topic) of the node's live connections."""
    api = xmlrpc.client.ServerProxy(master.api.lookupNode(node))
    _, _, links = api.getBusInfo("/tests")
    return {(link[2], link[4]) for link in links if link[5]}


def recorded(heard: GraphRecording, path: Path) -> Run:
    """Write the messages to a bag, and return the run that is read from it."""
    with rosbag.Bag(str(path), "w") as bag:
        for topic, messages in ((f"{ROBOT}/controller/state", heard.states),
                                (f"{ROBOT}/joint_states", heard.joints),
                                (f"{ROBOT}/controller/diagnosis", heard.reports.values())):
            for message in messages:
                bag.write(topic, message, message.header.stamp)
        bag.write(f"{ROBOT}/experiment", String(heard.experiment_text),
                  heard.states[0].header.stamp)
    return read_bag(path)


def on_the_graph(launch: Callable[..., Launch], master: RosMaster, case: Case, goal: str,
                 folder: Path) -> tuple[GraphRecording, dict[int, str]]:
    """Return all messages of joint states and controller up to the last frame, and the hashes of
    the images by their stamps."""
    arguments = dict(case.nodes)
    if case.parameters:
        file = folder / "parameters.yaml"
        file.write_text(yaml.safe_dump(case.parameters))
        arguments["parameters"] = str(file)
    robot = launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"],
                   paused=True, speed_mode="lockstep", camera=case.camera, **case.robot)
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                   nodes=[case.camera_process, f"{ROBOT}_controller"], start=str(list(case.start)),
                   scheme=case.scheme, goal=goal, **arguments)
    wait_for(all_running, 40.0, "seven running controllers")
    topics = {IMAGE: Image, f"{ROBOT}/joint_states": JointState,
              f"{ROBOT}/controller/state": ServoState, f"{ROBOT}/controller/diagnosis": ServoReport}
    heard = [Collector(topic, kind) for topic, kind in topics.items()]
    images, joints, states, reports = heard
    wait_for(lambda: ({("i", topic) for topic in COMMANDS} <= connections(master, "/gazebo")
                      and {("i", IMAGE), ("i", INFO)} <= connections(master, case.camera_process)
                      and {("i", t) for t in case.listened()}
                      <= connections(master, f"{ROBOT}_controller")), 20.0,
             "all nodes to be connected")
    for collector in heard:
        wait_for(collector.connected, 5.0, collector.topic)
    call("unpause_physics", Empty)
    images.wait(case.frames, timeout=60.0 * case.frames / FRAMES)
    call("pause_physics", Empty)
    last = images.messages[case.frames - 1].header.stamp
    told = GraphRecording(Path("the graph"))
    told.states = [m for m in states.messages if m.header.stamp <= last]
    told.joints = [m for m in joints.messages if m.header.stamp <= last]
    for message in reports.messages:
        told.add_report(message)
    described = collect_description(get_parameter("/"), f"{ROBOT}_controller")
    told.experiment_text = json.dumps(described, default=str)
    output = robot.output()
    for collector in heard:
        collector.close()
    ended = master.nodes() - {rospy.get_name()}
    nodes.stop()
    robot.stop()
    assert {"/gazebo", "/controller_spawner", f"{ROBOT}_controller"} <= ended
    # Or the master would end nodes that later get their addresses, when these names start again.
    assert not [name for name in ended if master.knows(name)]
    assert "lockstep: after waiting" not in output, output[-2000:]
    return told, {m.header.stamp.to_nsec(): hashlib.sha256(m.data).hexdigest()
                  for m in images.messages[: case.frames]}  # fmt: skip


def in_the_runner(experiment: Experiment, last_ns: int) -> tuple[Run, dict[int, str]]:
    """Return the run of the runner, up to the first image after a time, and hashes of its images.
    """
    hashes = {}

    def hash_image(_: Loop, frame: Frame) -> None:
        if frame.image is not None:
            image = frame.image if frame.encoding == "rgb8" else frame.image[..., ::-1]
            hashes[frame.stamp_ns] = hashlib.sha256(image.tobytes()).hexdigest()

    loop = Loop(experiment, assemble(experiment), on_frame=hash_image)
    try:
        while loop.plant.time_ns <= last_ns:
            loop.run_to_image()
        return loop.make_run(), hashes
    finally:
        loop.close()


def ended(run: Run, images: int, joints: int) -> Run:
    """Return the run cut to these numbers of images and joint states, with its last verdict."""
    last = run.states[images - 1]
    return replace(
        run, outcome=last.outcome, reason=last.reason, remedy=last.remedy,
        verdict=Verdict.compare(run.goal_pose, run.true_pose[joints - 1],
                           run.goal.distance, run.experiment.reached),
        states=run.states[:images], pose=run.pose[:images],
        **{name: getattr(run, name)[:joints] for name in
           ("joint_stamp", "measured_positions", "measured_velocities", "joint_commands",
            "true_pose")})


def shown(run: Run) -> dict[str, str]:
    """Return outcome and metrics as a report prints them."""
    return {q.key: q.value_text for q in summarise(run) if q.key not in NOT_HEARD}


def differences(case: Case, launch: Callable[..., Launch], master: RosMaster, folder: Path
                ) -> list[str]:  # fmt: skip
    """Return every difference between the runs of the runner, the graph and the bag."""
    goal = case.goal(folder)
    heard, images = on_the_graph(launch, master, case, goal, folder)
    live, kept = MessageRunBuilder(heard).build_run("live"), recorded(heard, folder / "run.bag")
    own, own_images = in_the_runner(case.experiment(goal), heard.joints[-1].header.stamp.to_nsec())
    count, rows = len(live.stamp), len(live.joint_stamp)
    found = []
    if count <= 10:
        found.append(f"{count} images were servoed on")
    if not (own.joint_stamp[:rows] == live.joint_stamp).all():
        found.append("joint states are of other instants")
    else:
        off = abs(own.measured_positions[:rows] - live.measured_positions).max()
        if off > 1e-14:
            found.append(f"joints differ by {off:.3g}")
    other = [stamp for stamp, image in images.items() if own_images.get(stamp) != image]
    if other:
        found.append(f"{len(other)} of {len(images)} images differ, the first of {other[0]} ns")
    strange = np.flatnonzero(own.stamp[:count] != live.stamp)
    if strange.size:
        i = strange[0]
        found.append(f"image {i} of {count} is of {own.stamp[i]:.9f} s, on the graph of "
                     f"{live.stamp[i]:.9f} s")
    own = ended(own, count, rows)
    runs = {"graph": shown(live), "bag": shown(kept), "runner": shown(own)}
    for key in dict.fromkeys(key for run in runs.values() for key in run):
        values = {name: run.get(key, "missing") for name, run in runs.items()}
        if len(set(values.values())) > 1:
            found.append(f"{key}: " + ", ".join(f"{n} {v}" for n, v in values.items()))
    if not own.outcome.startswith(case.ends):
        found.append(f"it is {own.outcome} and not {case.ends}: {own.reason}")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Return 0 if all runs are equal, 1 if one is not, 2 for an unknown experiment."""
    parser = argparse.ArgumentParser(prog="tests/one_run", description=__doc__.splitlines()[0],
                                     epilog="example: tests/one_run --list")
    parser.add_argument("--only", default="", metavar="REGEX", help="experiments by name")
    parser.add_argument("--list", action="store_true", help="their names")
    parser.add_argument("--write", type=Path, metavar="FILE", help="the JSON of the last line too")
    options = parser.parse_args(arguments)
    chosen = [case for name, case in CASES.items() if re.search(options.only, name)]
    if not chosen:
        print(f"one_run: no experiment matches '{options.only}': --list names them",
              file=sys.stderr)  # fmt: skip
        return 2
    if options.list:
        print("\n".join(case.name for case in chosen))
        return 0
    began, differing = time.monotonic(), {}
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was started ends too
    with tempfile.TemporaryDirectory() as folder:
        master = RosMaster(Path(folder))
        os.environ.update({key: master.environment[key] for key in
                           ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR")})  # fmt: skip
        try:
            rospy.init_node("one_run", anonymous=True, disable_signals=True)
            for case in chosen:
                found = _compared(case, master, Path(folder))
                print(f"{'DIFFERS' if found else 'one run'}  {case.name}", *found, sep="\n    ",
                      flush=True)  # fmt: skip
                if found:
                    differing[case.name] = found
            rospy.signal_shutdown("all experiments are over")
        finally:
            master.stop()
    result = json.dumps({"experiments": len(chosen), "one_run": len(chosen) - len(differing),
                         "differing": differing, "seconds": round(time.monotonic() - began)})
    if options.write:
        options.write.write_text(result + "\n", encoding="utf-8")
    print(result)
    return 1 if differing else 0


def _compared(case: Case, master: RosMaster, folder: Path) -> list[str]:
    """Return `differences`, including exceptions."""
    launches: list[Launch] = []

    def launch(*target: str, nodes: Iterable[str], **arguments: Any) -> Launch:
        launches.append(Launch(master, target, arguments))
        launches[-1].wait_for_nodes(tuple(nodes))
        return launches[-1]

    try:
        return differences(case, launch, master, folder)
    except Exception as error:  # the next experiment may be none the worse
        return [f"{type(error).__name__}: {error}"]
    finally:
        for one in reversed(launches):
            try:
                one.stop()
            except GraphError as error:
                print(f"{case.name}: {error}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
