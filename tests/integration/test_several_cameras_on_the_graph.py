"""Two fixed cameras and an arm that carries the target: docs/examples on one graph.

A scheme of one's own and one of this workspace by launch arguments, before rendered pictures, to
the goal that the runner taught for it (`unit/bench/test_user_schemes_run.py` runs more of them
there, unchanged).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import rospy
import yaml
from aras_visual_servo_controller.msg import ServoState
from gazebo_calls import time_goes_on
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Pose
from ros_graph import wait_for
from sensor_msgs.msg import Image, JointState
from tf.transformations import quaternion_from_euler

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.target_files import write_description

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
SPACE = "/aras_visual_servo"
JOINTS = ("along", "across", "up", "wrist")
PORTAL = yaml.safe_load((EXAMPLES / "portal.yaml").read_text())
NAMED = {"left": {"namespace": "/left"}, "right": {"namespace": "/right"}}
SCHEME = "stereo_ibvs:StereoIBVS"


@pytest.fixture(scope="module")
def portal(launch, ros_node, ros_master):
    """The arm; nodes find the examples as in a sourced workspace that has them."""
    patch = pytest.MonkeyPatch()
    patch.chdir(EXAMPLES)
    patch.syspath_prepend(str(EXAMPLES))
    before = ros_master.environment["PYTHONPATH"]
    patch.setitem(ros_master.environment, "PYTHONPATH", f"{EXAMPLES}{os.pathsep}{before}")
    controllers = " ".join(f"{joint}_position_controller" for joint in JOINTS)
    yield launch(
        "aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], paused=True,
        robot="portal",
        urdf=EXAMPLES / "portal.urdf", gains=EXAMPLES / "portal_controllers.yaml",
        controllers=controllers, target="none",
    )  # fmt: skip
    patch.undo()


@pytest.fixture(scope="module")
def eyes(portal, launch):
    """A camera node for each camera."""
    for name in ("left", "right"):
        launch("aras_visual_servo_gazebo", "one_camera.launch", name=name,
               nodes=[f"{SPACE}_camera_{name}"])  # fmt: skip


def files(folder, scheme, cameras=None):
    """The goal of the runner, and the node's cameras."""
    goal = assemble(Experiment.from_mapping({**PORTAL, "scheme": scheme})).goal
    (folder / "goal.yaml").write_text(goal.to_yaml("for a test"))
    named = {"cameras": NAMED if cameras is None else cameras}
    (folder / "cameras.yaml").write_text(yaml.safe_dump({**named, "target_frame": "hand"}))


def servoed_to(goal, launch, collect, folder, scheme, start):
    """The loop's states on the way to joints, by a scheme and the files of this folder."""
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", scheme=scheme,
        nodes=[f"{SPACE}_controller"], start=str(start), goal=folder / "goal.yaml",
        cameras=folder / "cameras.yaml",
    )  # fmt: skip
    try:
        with time_goes_on():
            states.wait(timeout=60.0, where=lambda state: state.phase == "converged")
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
        nodes.interrupt()
    wait_for(lambda: joints.messages, 5.0, "joint states")
    last = dict(zip(joints.messages[-1].name, joints.messages[-1].position, strict=True))
    assert np.abs([last[joint] - q for joint, q in zip(JOINTS, goal, strict=True)]).max() < 1e-3
    return states.messages


def test_two_cameras_servo_the_arm_by_launch_arguments(eyes, launch, collect, tmp_path):
    files(tmp_path, SCHEME)
    states = servoed_to(PORTAL["goal"], launch, collect, tmp_path, SCHEME, PORTAL["start"])
    assert all(state.scheme == SCHEME for state in states)


def test_one_in_the_hand_and_one_that_stands_servo_together(portal, ros_node, launch, collect,
                                                            tmp_path):  # fmt: skip
    """docs/examples/both_eyes.yaml, with the runner's goal."""
    asked = Experiment.from_yaml(EXAMPLES / "both_eyes.yaml")
    (tmp_path / "goal.yaml").write_text(assemble(asked).goal.to_yaml("for a test"))
    cameras = {"palm": {"namespace": "/palm"}, "left": {**NAMED["left"], "target_frame": "hand"}}
    named = {"cameras": cameras, "target_frame": ""}  # that of the tests before is still set
    (tmp_path / "cameras.yaml").write_text(yaml.safe_dump(named))
    place, urdf = Pose(), write_description(asked.target).read_text()
    x, y, z, *turns = asked.target.pose
    place.position.x, place.position.y, place.position.z = x, y, z
    (place.orientation.x, place.orientation.y, place.orientation.z,
     place.orientation.w) = quaternion_from_euler(*turns)  # fmt: skip
    spawn = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
    assert spawn("on_the_ground", urdf, "", place, "world").success
    try:
        states = servoed_to(
            asked.goal, launch, collect, tmp_path, asked.scheme, list(asked.start)
        )  # fmt: skip
        servoed = next(state for state in states if state.feature_names)
        assert {name.partition(".")[0] for name in servoed.feature_names} == {"palm", "left"}
    finally:
        rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)("on_the_ground")


def test_both_cameras_expose_together(portal, collect):
    left, right = (collect(f"/{name}/image_raw", Image) for name in ("left", "right"))
    with time_goes_on():
        left.wait(5)
        right.wait(5)
        stamps = {m.header.stamp.to_nsec() for m in left.messages}
        wait_for(lambda: len(stamps & {m.header.stamp.to_nsec() for m in right.messages}) > 2, 5.0,
                 "stamps that meet")  # fmt: skip


def test_a_camera_that_is_silent_is_named(portal, launch, tmp_path):
    files(tmp_path, SCHEME, {**NAMED, "right": {"namespace": "/nowhere"}})
    nodes = launch(
        "aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch", start="none",
        scheme=SCHEME, nodes=[f"{SPACE}_controller"], goal=tmp_path / "goal.yaml",
        cameras=tmp_path / "cameras.yaml",
    )  # fmt: skip
    try:
        with time_goes_on():
            wait_for(lambda: "no image on /nowhere/image_raw" in nodes.output(), 20.0, "its name")
    finally:
        nodes.interrupt()
