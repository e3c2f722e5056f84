"""A launch tree written for Gazebo, shaped as the second generation of the original, runs as it is:
whole by one file, with a plain description, a world of its own, and nodes launched after it."""

from pathlib import Path

import numpy as np
import pytest
import rospy
from controller_manager_msgs.srv import ListControllers
from ros_graph import wait_for
from sensor_msgs.msg import CameraInfo, Image, JointState

TREES = Path(__file__).parents[1] / "conformance"


@pytest.fixture(scope="module")
def second_generation(launch, ros_node):
    """Everything by one launch file."""
    launch(str(TREES / "second_generation/launch/cell.launch"), nodes=["/gazebo"], gui=False,
           show_rviz=False, start=-0.25)  # fmt: skip


@pytest.fixture
def cell_joints(second_generation, collect):
    states = collect("/cell/joint_states", JointState)
    states.wait(2, 60.0)

    def position(joint: str) -> float:
        last = states.messages[-1]
        return last.position[last.name.index(joint)]

    return position


def test_the_second_tree_spawns_its_joints_where_they_are_to_begin(cell_joints):
    assert cell_joints("rail") == pytest.approx(-0.25, abs=0.01)


def test_its_controllers_run_or_wait_as_their_spawners_say(cell_joints):
    lists = rospy.ServiceProxy("/cell/controller_manager/list_controllers", ListControllers)

    def states() -> dict[str, str]:
        return {c.name: c.state for c in lists().controller}

    wait_for(lambda: len(states()) == 4, 30.0, "four controllers")
    names = ("joint_state_controller", "rail_position_controller", "lift_position_controller")
    assert all(states()[name] == "running" for name in names)
    assert states()["path_controller"] in ("initialized", "stopped")


@pytest.fixture(scope="module")
def commanded(second_generation, launch):
    """The user's nodes, launched later."""
    launch(str(TREES / "second_generation/launch/cell_nodes.launch"),
           nodes=["/commander", "/levelling"])  # fmt: skip


def test_nodes_launched_later_move_their_joints(commanded, cell_joints):
    """Dry friction is in the description: they come as near as the integral has had time to."""
    wait_for(lambda: abs(cell_joints("rail") - 0.2) < 0.005, 30.0, "the carriage arrives")
    wait_for(lambda: abs(cell_joints("lift")) < 0.02, 30.0, "the boom is level")


def test_the_camera_sees_the_target_through_its_lens(commanded, cell_joints, collect):
    wait_for(lambda: abs(cell_joints("lift")) < 0.02, 30.0, "the boom is level")
    image = collect("/cell/camera/image_raw", Image).wait(1, 30.0)
    info = collect("/cell/camera/camera_info", CameraInfo).wait(1, 30.0)
    assert (image.width, image.height, info.header.frame_id) == (160, 120, "eye_optical")
    assert info.distortion_model == "plumb_bob" and info.D[:2] == pytest.approx((-0.33, 0.117))
    grey = np.frombuffer(image.data, np.uint8).reshape(120, 160, 3).mean(axis=2)
    assert 50 < np.count_nonzero(grey < 40) < 0.3 * grey.size, "the black plate"
    assert np.count_nonzero(grey > 200) > 0.3 * grey.size, "the white table around it"
