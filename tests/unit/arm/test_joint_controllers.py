"""Controllers are found by joint and type in the parameters of a robot's namespace."""

import pytest

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.kinematics.ros_control_controllers import (
    RosControlController,
    choose_controllers,
    find_joint_controllers,
)

SPACE = "/robot"


def single(kind, joint, package="effort_controllers"):
    return {"type": f"{package}/Joint{kind}Controller", "joint": joint}


PARAMETERS = {
    "states": {"type": "joint_state_controller/JointStateController", "publish_rate": 100},
    "rate": 50,
    "b_position_controller": single("Position", "b"),
    "turns_b": single("Velocity", "b", "velocity_controllers"),
    "a_position_controller": single("Position", "a", "position_controllers"),
    "slow_a": single("Velocity", "a"),
    "push_a": single("Effort", "a"),
    "follow": {"type": "effort_controllers/JointTrajectoryController", "joints": ["a", "b"]},
    "nothing": {"type": "effort_controllers/JointPositionController"},
    "both": {"type": "effort_controllers/JointGroupEffortController", "joints": ["b", "a"]},
}


def names(kind, named=None, joints=("a", "b"), parameters=PARAMETERS):
    return [one.name for one in choose_controllers(parameters, joints, kind, named or {}, SPACE)]


def test_each_joint_has_its_controller_of_the_kind_a_named_one_first():
    found = {one.name: one for one in find_joint_controllers(PARAMETERS)}
    assert list(found) == ["b_position_controller", "turns_b", "a_position_controller", "slow_a",
                           "push_a", "both"]  # fmt: skip
    assert found["turns_b"] == RosControlController("turns_b", ("b",), "velocity", False)
    assert found["both"] == RosControlController("both", ("b", "a"), "effort", True)
    more = {**PARAMETERS, "quick_a": single("Velocity", "a"), "z": single("Position", "a")}
    # as the shipped robot's file names its position controllers
    shipped = {"a": "a_position_controller", "b": "b_position_controller"}
    for kind, named, joints, chosen in (
        ("position", {}, "ab", ["a_position_controller", "b_position_controller"]),
        ("velocity", {}, "ba", ["turns_b", "slow_a"]),
        ("velocity", {}, "ab", ["slow_a", "turns_b"]),  # the first of those that fit
        ("velocity", {"a": "quick_a"}, "ab", ["quick_a", "turns_b"]),
        ("velocity", shipped, "ab", ["slow_a", "turns_b"]),
        ("position", {"a": "z"}, "a", ["z"]),
    ):
        assert names(kind, named, tuple(joints), more) == chosen


def test_a_group_serves_where_no_single_one_does():
    (group,) = choose_controllers(PARAMETERS, ("a", "b"), "effort", {}, SPACE)
    assert group.joints == ("b", "a") and group.is_group
    with pytest.raises(ConfigurationError, match="for b "):  # the group has not all of these
        choose_controllers(PARAMETERS, ("a", "b", "c"), "effort", {"b": "mine"}, SPACE)


def test_a_joint_whose_controllers_take_other_commands_is_refused():
    given = {name: PARAMETERS[name] for name in ("a_position_controller", "turns_b", "slow_a")}
    with pytest.raises(ConfigurationError) as fault:
        choose_controllers(given, ("a", "b"), "position", {}, SPACE)
    assert str(fault.value) == (
        "no controller in /robot takes position commands for b (turns_b takes velocity): load and "
        "start one of type .../JointPositionController, or set ~output"
    )


def test_where_nothing_is_known_the_name_counts():
    assert choose_controllers({}, ("b",), "effort", {}, SPACE) == [
        RosControlController("b_effort_controller", ("b",), "effort", False)
    ]
    assert names("velocity", parameters={}) == ["a_velocity_controller", "b_velocity_controller"]
    assert names("position", {"b": "mine"}, parameters={"rate": 3}) == [
        "a_position_controller", "mine",
    ]
    # nothing tells what it takes, but its name does
    assert names("velocity", {"a": "a_position_controller", "b": "b_velocity"}, parameters={}) == [
        "a_velocity_controller", "b_velocity",
    ]
