"""A solid target on the graph: mesh as a launch argument, and servoing by its pose."""

import sys
from pathlib import Path

import numpy as np
import pytest
import rosnode
import rospy
from aras_visual_servo_controller.msg import ServoState
from gazebo_calls import call, delete, time_goes_on
from gazebo_msgs.msg import ModelState
from gazebo_msgs.srv import SetModelState
from geometry_msgs.msg import Point, Quaternion, Twist
from geometry_msgs.msg import Pose as GazeboPose
from ros_graph import wait_for_message
from sensor_msgs.msg import JointState

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "camera"))

from tracking_scenes import corners_of, write_obj

from aras_visual_servo_base.poses import Pose, inverse, matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.goals.goal import Goal

SPACE = "/aras_visual_servo"
NODE = "/aras_visual_servo_camera"
PLACE = [0.0, 0.0, 0.5905, 0.0, 0.0, 0.3]


CRATE = """<sdf version="1.6"><world name="a">
<light name="sun" type="directional"><direction>-0.3 0.2 -1</direction></light>
<model name="ground_plane"><static>1</static><link name="link">
  <collision name="c"><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>
  <visual name="v"><geometry><plane><normal>0 0 1</normal></plane></geometry></visual>
</link></model>
<model name="crate"><static>1</static><pose>AT</pose><link name="body">
  <collision name="c"><geometry><box><size>0.08 0.05 0.06</size></box></geometry></collision>
  <visual name="v"><geometry><box><size>0.08 0.05 0.06</size></box></geometry>
    <material><ambient>0.5 0.1 0.1 1</ambient><diffuse>0.5 0.1 0.1 1</diffuse></material></visual>
</link></model>
</world></sdf>"""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Folder with the mesh of a bracket, and the files of two worlds with a crate."""
    folder = tmp_path_factory.mktemp("solids")
    write_obj(folder / "bracket.obj", [(corners_of("bracket"), 0.1)])
    for name, at in (("near", "0.02 0.01 0.62 0 0 0.6"), ("far", "0 2 0.62 0 0 0")):
        (folder / f"{name}.world").write_text(CRATE.replace("AT", at))
    return folder


@pytest.fixture(scope="module", autouse=True)
def robot(launch, ros_node, world):
    """The robot above the bracket; the crate is out of sight."""
    launch("aras_visual_servo_gazebo", "aras_visual_servo.launch", nodes=["/gazebo"], paused=True,
           target=world / "bracket.obj", target_place="-x 0 -y 0 -z 0.5905 -Y 0.3",
           world_name=world / "far.world")
    with time_goes_on():
        wait_for_message(f"{SPACE}/joint_states", JointState, 60.0)


def test_a_solids_goal_is_taught_where_the_arm_is(launch, world, ros_master, tmp_path):
    mesh = world / "bracket.obj"
    shown = Experiment(target={"shape": str(mesh), "pose": PLACE}, scheme="model",
                       goal=[0.02, 0.06, -0.05, 0.04, -0.05, 0.1])  # fmt: skip
    made = assemble(shown)
    made.plant.close()
    (tmp_path / "there.yaml").write_text(made.goal.to_yaml("for a test"))
    taught = tmp_path / "taught.yaml"
    launch("aras_visual_servo_gazebo", "one_camera.launch", nodes=[f"{NODE}_own"], name="own",
           images="/labrob/camera", features=f"{SPACE}/camera")
    start = f"{{pose: {PLACE}}}"
    command = ["rosrun", "aras_visual_servo_controller", "teach", "--go",
               str(tmp_path / "there.yaml"), "--scheme", "model", "--images", "10", str(taught),
               f"_model:={mesh}", f"_model_start:={start}"]
    with time_goes_on():
        ros_master.run(command, 90.0)
    rosnode.kill_nodes([f"{NODE}_own"])  # its launch goes on: it clears parameters
    goal = Goal.load(taught)
    distance, angle = pose_difference(goal.world_T_camera, made.goal.world_T_camera)
    assert distance < 1e-3 and angle < 5e-3
    assert goal.plane == pytest.approx(made.goal.plane, rel=0.02, abs=0.02)
    assert goal.target is None and goal.depth == pytest.approx(made.goal.depth, rel=5e-3)


def test_a_link_of_the_world_is_servoed_to(launch, world, collect, tmp_path):
    """It was moved before the start of the nodes, whose argument is its name."""
    above = {"pose": [0.03, -0.02, 0.89, np.pi, 0.0, 0.0]}
    made = assemble(Experiment(world=str(world / "near.world"), target={"model": "crate"},
                               goal=above, scheme="model"))  # fmt: skip
    made.plant.close()
    (tmp_path / "goal.yaml").write_text(made.goal.to_yaml("for a test"))
    arm, at = made.servo.arm, made.goal.get_joints(made.servo.arm.names)
    states = collect(f"{SPACE}/controller/state", ServoState)
    joints = collect(f"{SPACE}/joint_states", JointState)
    delete("target")
    moved = Pose.from_rpy((0.035, -0.005, 0.623), (0.0, 0.0, 0.5))
    place = GazeboPose(Point(*moved.xyz), Quaternion(*moved.quat))
    assert call("set_model_state", SetModelState, ModelState("crate", place, Twist(), "")).success
    nodes = launch("aras_visual_servo_gazebo", "aras_visual_servo_nodes.launch",
                   nodes=["/aras_visual_servo_controller"], scheme="model", goal=tmp_path
                   / "goal.yaml", link="crate", world_name=world / "far.world", gain=3.0,
                   start=str((at + [0.02, 0.03, -0.03, 0.02, -0.02, 0.1]).round(5).tolist()))
    told = rospy.get_param("/aras_visual_servo_controller/model_start")["pose"]
    assert told == pytest.approx([0.035, -0.005, 0.623, 0.0, 0.0, 0.5], abs=1e-4)
    crate = matrix_from_xyz_rpy((0.02, 0.01, 0.62), (0.0, 0.0, 0.6))
    wanted = moved.matrix() @ inverse(crate) @ made.goal_pose
    try:
        with time_goes_on():
            states.wait(20, timeout=90.0, where=lambda state: state.phase == "converged")
    finally:
        print([(m.phase, m.reason) for m in states.messages[-1:]], nodes.output()[-1500:])
    q = arm.read_joints(joints.messages[-1].name, joints.messages[-1].position).positions
    distance, angle = pose_difference(wanted, arm.pose(q))
    assert distance < 5e-4 and angle < np.radians(0.3)
