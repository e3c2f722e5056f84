"""Disturbances of the controller node with a simulated robot: losses, silence, pauses.

One node for all; each test begins with the arm at zero and the clock at its beginning, as after a
simulator's restart.
"""

from __future__ import annotations

import re
import time

import numpy as np
import pytest
from dynamic_reconfigure.client import Client
from played_robot import Node, Plant, described, forgotten, phase_is
from ros_graph import wait_for

pytest_plugins = ["played_robot"]


@pytest.fixture(scope="module")
def servoed(ros_master, ros_node):
    """A robot and the node that servoes it."""
    described()
    played = Plant()
    node = Node(ros_master, "_start:=none", "_image_timeout:=0.3", "_joint_timeout:=0.3",
                "_wall_watchdog:=0.5")  # fmt: skip
    yield played, node
    assert node.stop() == 0
    played.close()
    forgotten()


@pytest.fixture
def plant(servoed, states):
    """The robot, when the node has just started to servo it."""
    played, _ = servoed
    before = states.wait(1, 20.0).header.stamp
    played.valid = played.images = played.joints = played.time = True
    played.strange = None
    played.restart()
    states.wait(1, 20.0, where=lambda m: m.phase == "servoing" and m.header.stamp < before)
    states.clear()
    played.received.clear()
    states.wait(1, 20.0)
    wait_for(lambda: played.received, 20.0, "commands")
    return played


@pytest.fixture
def said(servoed, plant):
    """Function that returns what the node has printed in this test."""
    before = len(servoed[1].output())
    return lambda: servoed[1].output()[before:]


def test_lost_target_holds_and_resumes(plant, said, states):
    plant.valid = False
    wait_for(phase_is(states, "holding"), 5.0, "holding")
    assert "no target in the image" in states.messages[-1].reason
    time.sleep(0.3)  # smoothly to rest
    commands = {tuple(c) for c in plant.received[-6:]}
    time.sleep(0.3)
    assert {tuple(c) for c in plant.received[-6:]} <= commands
    plant.valid = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the loss")
    assert re.search("holding: .*no target in the image", said())


def test_silence_is_named_and_waited_through(plant, said, states):
    plant.images = False
    wait_for(
        lambda: "no features on /aras_visual_servo/camera/moments" in states.messages[-1].reason,
        5.0,
        "waiting for images",
    )
    assert states.messages[-1].phase == "waiting"
    plant.joints = False
    wait_for(
        lambda: "no joint states" in states.messages[-1].reason, 5.0, "waiting for joint states"
    )
    plant.images = plant.joints = True
    wait_for(lambda: states.messages[-1].phase in ("servoing", "converged"), 5.0, "going on")
    assert said().count("waiting: ") < 10


def test_paused_time_holds_until_it_goes_on(plant, states):
    plant.time = False
    time.sleep(1.2)
    rest = plant.command.copy()
    time.sleep(0.2)
    assert np.array_equal(plant.command, rest)
    plant.time = True
    wait_for(phase_is(states, "converged"), 20.0, "convergence after the pause")


def test_joints_that_cannot_be_measured_stop_the_arm(plant, said, states):
    plant.strange = 1e308
    wait_for(phase_is(states, "holding"), 5.0, "holding")
    assert "position 1e+308 of gantry is impossible" in states.messages[-1].reason
    time.sleep(0.3)
    plant.strange = None
    wait_for(phase_is(states, "converged"), 20.0, "convergence afterwards")
    assert np.abs(plant.received).max() < 10.0
    assert "Traceback" not in said()


def test_gains_can_be_changed_while_it_runs(plant, states):
    client = Client("/aras_visual_servo_controller/gains", timeout=10.0)
    try:
        assert client.get_configuration(timeout=5.0)["gain"] == 5.0
        assert client.update_configuration({"gain": 0.2})["gain"] == 0.2
        time.sleep(3.0)  # it has converged after two with a gain of 5
        assert states.messages[-1].phase == "servoing"
        assert client.update_configuration({"gain": 6.0})["gain"] == 6.0
        wait_for(phase_is(states, "converged"), 10.0, "convergence")
    finally:
        client.update_configuration({"gain": 5.0})
        client.close()
