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


def drop(make, kind="revolute", xyz="0 0 0", lower=-3.0, upper=3.0, axis="0 1 0", above=""):
    """An arm of 0.5 m along x that falls from a fixed base; `above`: links and joints before."""
    parent = "lift" if above else "world"
    return parse_urdf(make.robot(
        '<link name="world"/>', above,
        make.link("arm", 1.0, "0.25 0 0", (0.01, 0.03, 0.03, 0, 0, 0),
                  make.box("0.5 0.05 0.05", "0.25 0 0")),
        make.joint("fall", parent, "arm", kind, xyz, axis, lower, upper)))


def lift(make, kind, travel):
    """A link that a joint moves down the world's z axis, or that hangs fixed below."""
    xyz = f"0 0 {-travel}" if kind == "fixed" else "0 0 0"
    return (make.link("lift", 1.0) +
            make.joint("down", "world", "lift", kind, xyz, "0 0 -1", 0.0, travel))


def tip_height(model):
    return model.link_pose("arm").apply((0.5, 0.0, 0.0))[2]


@pytest.mark.parametrize("height", [0.3, 0.49, 0.53])
def test_a_link_that_can_reach_the_ground_lands_on_it(make, height):
    with World() as world:
        world.spawn_ground_plane()
        model = world.spawn(drop(make), "arm", Pose((0, 0, height)))
        for _ in range(1000):
            world.step()
        lowest = min(tip_height(model), model.link_pose("arm").apply((0.5, 0.0, -0.025))[2])
        # From 0.53 m it hangs straight down and swings.
        assert lowest > (-0.002 if height < 0.5 else 0.0)
        assert (len(pybullet.getContactPoints(physicsClientId=world.client)) > 0) is (height < 0.5)


@pytest.mark.parametrize("order", ["ground first", "arm first", "moved down", "reset", "changed"])
def test_whatever_brings_link_and_ground_together_is_noticed(make, order):
    with World() as world:
        if order != "arm first":
            world.spawn_ground_plane()
        height = 5.0 if order in ("moved down", "reset") else 0.3
        model = world.spawn(drop(make), "arm", Pose((0, 0, height)))
        if order == "arm first":
            world.spawn_ground_plane()
        if order == "reset":
            model.set_pose(Pose((0, 0, 0.3)))
            world.reset_simulation()
            model.set_pose(Pose((0, 0, 0.3)))
        if order == "moved down":
            model.set_pose(Pose((0, 0, 0.3)))
        if order == "changed":
            world.change_model("arm", model.description)
        for _ in range(1000):
            world.step()
        assert tip_height(model) > -0.002


def test_a_body_that_falls_onto_a_link_out_of_the_ground_s_reach_rests_there(make):
    with World() as world:
        world.spawn_ground_plane()
        held = parse_urdf(make.robot(
            '<link name="world"/>',
            make.link("shelf", 1.0, shapes=make.box("1 1 0.1")),
            make.joint("bolt", "world", "shelf", "fixed")))
        world.spawn(held, "shelf", Pose((0, 0, 3.0)))
        cube = make.link("cube", 1.0, inertia=(2e-3, 2e-3, 2e-3, 0, 0, 0),
                         shapes=make.box("0.1 0.1 0.1"))
        body = world.spawn(parse_urdf(make.robot(cube)), "cube", Pose((0, 0, 3.3)))
        for _ in range(1000):
            world.step()
        assert body.pose().xyz[2] == pytest.approx(3.1, abs=1e-3)


def test_more_models_than_bullet_has_groups_stand_on_the_ground(make):
    """Thirty cubes, each with a cap fixed on it, two high: they rest on one another."""
    cube = make.robot(
        make.link("cube", 1.0, inertia=(2e-3, 2e-3, 2e-3, 0, 0, 0), shapes=make.box("0.1 0.1 0.1")),
        make.link("cap", 1.0, inertia=(2e-3, 2e-3, 2e-3, 0, 0, 0),
                  shapes=make.box("0.1 0.1 0.02", "0 0 0.06")),
        make.joint("glue", "cube", "cap", "fixed"))
    with World() as world:
        world.spawn_ground_plane()
        cubes = [world.spawn(parse_urdf(cube), f"cube{k}", Pose((k // 2, 0, 0.05 + k % 2 * 0.12)))
                 for k in range(30)]
        for _ in range(300):
            world.step()
        for k, model in enumerate(cubes):
            assert model.pose().xyz[2] == pytest.approx(0.05 + k % 2 * 0.12, abs=2e-3)


@pytest.fixture
def robot():
    it = ArasRobot(Simulation())
    yield it
    it.close()


def creep(robot):
    """Return the largest speed of the joints that friction can hold."""
    robot.steps(1)
    robot.command(POSE)
    robot.steps(2000)
    model = robot.model
    speeds = []
    for joint, load, speed in zip(model.joint_names, model.bias_efforts(),
                                  robot.velocities().values(), strict=True):
        effort = robot.hardware.handles[joint].effort_command
        if abs(effort - load) < 0.95 * model.description.joints[joint].friction:
            speeds.append(abs(speed))
    assert len(speeds) >= 5
    return max(speeds)


def test_joints_that_friction_holds_stand_still(robot):
    """50 sweeps leave 2e-5 rad/s. A reset must not bring them back."""
    assert creep(robot) < 1e-12
    robot.simulation.reset_simulation()
    assert creep(robot) < 1e-12


def test_bullet_s_remarks_stay_off_the_standard_output(robot, make, capfd):
    world = robot.simulation.world
    world.spawn(parse_urdf(make.robot(make.link("stone"))), "stone", Pose((3, 0, 5)))
    world.delete("stone")
    world.reset_simulation()
    print("after")
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("after\n", "")


def test_what_c_code_said_before_bullet_was_kept_quiet_is_heard(capfd):
    c = ctypes.CDLL(None)
    c.setvbuf(ctypes.c_void_p.in_dll(c, "stdout"), None, 0, 4096)  # as for a pipe or file
    c.puts(b"before")
    with bullet.silence_output():
        c.puts(b"meanwhile")
    assert capfd.readouterr().out == "before\n"


def test_keeping_bullet_quiet_leaves_no_descriptor_open():
    before = os.listdir("/proc/self/fd")
    for _ in range(3):
        with bullet.silence_output():
            pass
    assert os.listdir("/proc/self/fd") == before


def test_only_a_bullet_that_made_no_step_serves_another_world(make):
    stone = parse_urdf(make.robot(make.link("stone")))
    for steps in (1, 0):
        with World() as world:
            client = world.client
            world.spawn(stone, "stone")
            for _ in range(steps):
                world.step()
        assert bool(pybullet.getConnectionInfo(client)["isConnected"]) == (steps == 0)
    with World() as world:
        assert world.client == client
