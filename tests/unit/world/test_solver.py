"""Physics step: contacts only between links that can touch, joints solved to rounding."""

import ctypes
import os

import pytest
from aras_robot import ArasRobot

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Pose, World, bullet
from aras_sim_bridge.world.bullet import pybullet

POSE = (0.1, 0.0, 0.17, -0.09, -0.09, 0.0)


def drop(make):
    return parse_urdf(make.robot(
        '<link name="world"/>',
        make.link("arm", 1.0, "0.25 0 0", (0.01, 0.03, 0.03, 0, 0, 0),
                  make.box("0.5 0.05 0.05", "0.25 0 0")),
        make.joint("fall", "world", "arm", lower=-3.0, upper=3.0)))


def tip_height(model):
    return model.link_pose("arm").apply((0.5, 0.0, 0.0))[2]


@pytest.mark.parametrize("height", [0.3, 0.49, 0.53])
def test_a_link_that_can_reach_the_ground_lands_on_it(world, ground, make, height):
    model = world.spawn(drop(make), "arm", Pose((0, 0, height)))
    make.step(world, 1000)
    lowest = min(tip_height(model), model.link_pose("arm").apply((0.5, 0.0, -0.025))[2])
    # From 0.53 m it hangs straight down and swings.
    assert lowest > (-0.002 if height < 0.5 else 0.0)
    assert (len(pybullet.getContactPoints(physicsClientId=world.client)) > 0) is (height < 0.5)


@pytest.mark.parametrize("order", ["arm first", "moved down", "reset", "changed"])
def test_whatever_brings_link_and_ground_together_is_noticed(world, make, order):
    if order != "arm first":
        world.spawn_ground_plane()
    height = 5.0 if order in ("moved down", "reset") else 0.3
    model = world.spawn(drop(make), "arm", Pose((0, 0, height)))
    if order == "arm first":
        world.spawn_ground_plane()
    if order == "changed":
        world.change_model("arm", model.description)
    if order == "reset":
        model.set_pose(Pose((0, 0, 0.3)))
        world.reset_simulation()
    if height == 5.0:
        model.set_pose(Pose((0, 0, 0.3)))
    make.step(world, 1000)
    assert tip_height(model) > -0.002


def test_a_body_that_falls_onto_a_link_out_of_the_ground_s_reach_rests_there(world, ground, make):
    held = parse_urdf(make.robot(
        '<link name="world"/>', make.link("shelf", 1.0, shapes=make.box("1 1 0.1")),
        make.joint("bolt", "world", "shelf", "fixed")))
    world.spawn(held, "shelf", Pose((0, 0, 3.0)))
    body = world.spawn(make.block((0.1, 0.1, 0.1)), "cube", Pose((0, 0, 3.3)))
    make.step(world, 1000)
    assert body.pose().xyz[2] == pytest.approx(3.1, abs=1e-3)


def test_more_models_than_bullet_has_groups_stand_on_the_ground(world, make):
    """Thirty cubes, each with a cap fixed on it, two high: they rest on one another."""
    cube = make.robot(
        make.link("cube", 1.0, inertia=(2e-3, 2e-3, 2e-3, 0, 0, 0), shapes=make.box("0.1 0.1 0.1")),
        make.link("cap", 1.0, inertia=(2e-3, 2e-3, 2e-3, 0, 0, 0),
                  shapes=make.box("0.1 0.1 0.02", "0 0 0.06")),
        make.joint("glue", "cube", "cap", "fixed"))
    world.spawn_ground_plane()
    cubes = [world.spawn(parse_urdf(cube), f"cube{k}", Pose((k // 2, 0, 0.05 + k % 2 * 0.12)))
             for k in range(30)]
    make.step(world, 300)
    for k, model in enumerate(cubes):
        assert model.pose().xyz[2] == pytest.approx(0.05 + k % 2 * 0.12, abs=2e-3)


@pytest.fixture
def robot():
    it = ArasRobot(Simulation())
    yield it
    it.close()


def test_joints_that_friction_holds_stand_still(robot):
    """50 sweeps leave 2e-5 rad/s. A reset must not bring them back."""
    for _ in range(2):
        robot.steps(1)
        robot.command(POSE)
        robot.steps(2000)
        model, speeds = robot.model, []
        for joint, load, speed in zip(model.joint_names, model.bias_efforts(),
                                      robot.velocities().values(), strict=True):
            effort = robot.hardware.handles[joint].effort_command
            if abs(effort - load) < 0.95 * model.description.joints[joint].friction:
                speeds.append(abs(speed))
        assert len(speeds) >= 5 and max(speeds) < 1e-12
        robot.simulation.reset_simulation()


def test_bullet_s_remarks_stay_off_the_standard_output(robot, make, capfd):
    world = robot.simulation.world
    world.spawn(parse_urdf(make.robot(make.link("stone"))), "stone", Pose((3, 0, 5)))
    world.delete("stone")
    world.reset_simulation()
    print("after")
    assert capfd.readouterr() == ("after\n", "")


def test_what_c_code_said_before_bullet_was_kept_quiet_is_heard(capfd):
    c, before = ctypes.CDLL(None), os.listdir("/proc/self/fd")
    c.setvbuf(ctypes.c_void_p.in_dll(c, "stdout"), None, 0, 4096)  # as for a pipe or file
    c.puts(b"before")
    for _ in range(3):
        with bullet.silence_output():
            c.puts(b"meanwhile")
    assert capfd.readouterr().out == "before\n"
    assert os.listdir("/proc/self/fd") == before


def test_only_a_bullet_that_made_no_step_serves_another_world(make):
    stone = parse_urdf(make.robot(make.link("stone")))
    for steps in (1, 0):
        with World() as world:
            client = world.client
            world.spawn(stone, "stone")
            make.step(world, steps)
        assert bool(pybullet.getConnectionInfo(client)["isConnected"]) == (steps == 0)
    with World() as world:
        assert world.client == client
