"""A fixed model moves as if it were alone until something can touch it."""

import math
from functools import cache

import numpy as np
import pybullet
import pytest
from aras_robot import ArasRobot

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import Pose, Twist

POSES = ((0.1, 0.2, 0.25, -0.1, -0.1, 0.3), (-0.2, -0.4, 0.1, 0.3, 0.2, -0.5))


def shelf(make, *size):
    return make.block(size or (0.4, 0.4, 0.05), link="world")


class Trial:
    """The shipped robot, thrown about by its controllers; what its joints did in each step."""

    def __init__(self):
        self.robot = ArasRobot(Simulation(SimulationConfig(renderer="tiny")))
        self.world = self.robot.simulation.world
        self.model = self.robot.model
        self.states, self.has_own_dynamics = [], []

    def run(self, count=600, stride=1):
        simulation = self.robot.simulation
        for k in range(0, count, stride):
            if k % 300 == 0:
                self.robot.command(POSES[k // 300 % 2])
            until = simulation.time_ns + stride * simulation.step_ns
            while simulation.time_ns < until:
                simulation.step(until)
            self.states.append((self.model.joints.read()[0], self.model.joints.read()[1]))
            self.has_own_dynamics.append(self.model.joints.has_own_dynamics)
        return self

    def handles(self):
        return [row.tolist() for entry in self.robot.manager.running
                for row in getattr(entry.controller, "rows", ())]


@cache
def alone(stride):
    trial = Trial()
    trial.robot.steps(2)
    return trial.run(stride=stride)


def cart(make):
    return parse_urdf(make.robot(
        make.link("base", 10.0, "0 0 0", shapes=make.box("0.4 0.4 0.1")), make.link("mast"),
        make.joint("turn", "base", "mast", "continuous", axis="0 0 1")))


@pytest.mark.parametrize(("what", "at", "speed", "stride"), [
    ("ball", (7.0, 0.0, 0.05), (0.0, 0.0, 0.0), 1), ("ball", (3.0, 0.0, 1.0), (0.0, 4.0, 3.0), 15),
    ("ball", (-0.9, 0.4, 0.7), (0.0, 0.0, 0.0), 15), ("shelf", (0.6, 0.5, 1.2), None, 1),
    ("cart", (4.0, 0.0, 0.3), None, 15),
], ids=["resting", "flying", "on the base", "bolted", "cart"])
def test_what_is_out_of_its_way_changes_no_bit_of_a_trajectory(make, what, at, speed, stride):
    """Loose on the ground, in the air and on the robot's own base; bolted within its reach."""
    trial, described = Trial(), {"ball": make.ball(), "shelf": shelf(make), "cart": cart(make)}
    other = trial.world.spawn(described[what], "other", Pose(at))
    if speed is not None:
        other.set_twist(Twist(speed))
    trial.robot.steps(2)
    trial.run(stride=stride)
    expected = alone(stride)
    assert all(trial.has_own_dynamics)
    assert trial.states == expected.states
    assert repr(trial.handles()) == repr(expected.handles())  # NaN equals NaN
    assert np.ptp([q for q, _ in trial.states], axis=0).min() > 0.1
    if at[2] == 1.0:  # it flies, each of the arm's steps
        height = 1.0 + 3.0 * 0.602 - 0.5 * 9.8 * 0.602 * 0.603
        assert other.pose().xyz == pytest.approx((3.0, 4.0 * 0.602, height), abs=1e-6)


def test_a_ball_that_is_thrown_at_the_arm_strikes_it_and_leaves_it_alone_again(make):
    trial, expected = Trial(), Trial()
    for each in (trial, expected):
        each.robot.steps(2)
        each.run(300)
    target = trial.model.link_pose("link3").xyz
    body = trial.world.spawn(make.ball(mass=0.05, gravity=False), "ball",
                             Pose((target[0], target[1] - 1.0, target[2])))
    body.set_twist(Twist((0.0, 8.0, 0.0)))
    for each in (trial, expected):
        each.run(300)
    first = trial.has_own_dynamics.index(False)
    assert trial.states[:first] == expected.states[:first]
    assert 300 < first < 300 + 125  # before the surfaces meet
    away = np.abs(np.subtract(trial.states, expected.states)).max(axis=(1, 2))
    assert away[first:].max() > 0.02, "it was struck"
    assert trial.model.fixed_base
    assert abs(body.twist().linear[1]) < 7.0
    body.set_pose(Pose((5.0, 0.0, 1.0)))
    trial.run(2)
    assert trial.has_own_dynamics[-1], "and moves by itself when the ball has gone"


def lever(make, length=0.5):
    """An arm that turns about z, bolted at its middle height."""
    return parse_urdf(make.robot(
        '<link name="world"/>',
        make.link("lever", 2.0, f"{length / 2} 0 0", (0.01, 0.05, 0.05, 0, 0, 0),
                  make.box(f"{length} 0.05 0.05", f"{length / 2} 0 0")),
        make.joint("turn", "world", "lever", "continuous", axis="0 0 1")))


@pytest.mark.parametrize("turn", [2.0, 20.0])
def test_a_lever_stops_at_a_bolted_post_in_its_way(world, make, turn):
    model = world.spawn(lever(make), "lever", Pose((0, 0, 0.5)))
    world.spawn(shelf(make, 0.1, 0.1, 1.0), "post", Pose((0.0, 0.4, 0.5)))
    world.step()
    assert model.joints.has_own_dynamics
    model.joints.restore([(0.0, turn)])
    farthest = 0.0
    for _ in range(2000):
        model.apply_effort("turn", 0.5)
        world.step()
        farthest = max(farthest, model.read_joints()[0][0])
    # The lever's side meets the post's near corner.
    meets = math.atan2(0.35, 0.05) - math.asin(0.025 / math.hypot(0.05, 0.35))
    assert farthest < math.pi / 2
    assert model.read_joints()[0][0] == pytest.approx(meets, abs=0.02)


def test_a_beam_that_spins_where_it_stands_strikes_what_its_ends_reach(world, make):
    """Its middle has no speed; its ends have 100 m/s and meet the lever within 16 steps."""
    long = parse_urdf(make.robot(
        make.link("beam", 1.0, "0 0 0", (0.01, 0.33, 0.33, 0, 0, 0), make.box("2 0.05 0.05")),
        '<gazebo reference="beam"><gravity>false</gravity></gazebo>'))
    model = world.spawn(lever(make), "lever", Pose((0, 0, 0.5)))
    beam = world.spawn(long, "beam", Pose((0.3, 0.9, 0.5)))
    world.step()
    beam.set_twist(Twist((0.0, 0.0, 0.0), (0.0, 0.0, 100.0)))
    make.step(world, 30)
    assert model.read_joints()[0][0] < -0.03
    assert beam.twist().angular[2] < 90.0


@pytest.mark.parametrize("speed", [1.0, 60.0])
def test_a_lever_strikes_a_ball_that_lies_in_its_way_where_it_lies(world, make, speed):
    model = world.spawn(lever(make), "lever", Pose((0, 0, 0.5)))
    body = world.spawn(make.ball(gravity=False), "ball", Pose((-0.3, 0.3, 0.5)))
    world.step()
    assert model.joints.has_own_dynamics
    model.joints.restore([(0.0, speed)])
    world.contact_forecast.steps_until_update = 0  # a set speed is not noticed
    while body.twist() == Twist():
        world.step()
        assert model.read_joints()[0][0] < 0.75 * math.pi
    meets = 0.75 * math.pi - math.asin(0.075 / math.hypot(0.3, 0.3))
    assert model.read_joints()[0][0] == pytest.approx(meets, abs=0.0015 * speed + 2e-3)


def test_two_robots_that_reach_for_one_another_touch(world, make):
    one, two = (world.spawn(lever(make), f"lever{k}", Pose((x, 0.0, 0.5)))
                for k, x in enumerate((0.0, 0.8)))
    two.set_joint_positions({"turn": math.pi / 2})
    world.step()
    assert one.joints.has_own_dynamics and two.joints.has_own_dynamics
    alone_until = None
    for _ in range(2500):
        two.apply_effort("turn", 0.3)
        world.step()
        if alone_until is None and not two.joints.has_own_dynamics:
            alone_until = two.read_joints()[0][0]
    assert math.pi / 2 + 0.1 < alone_until < math.pi - 0.05
    assert abs(one.read_joints()[0][0]) > 0.05, "it is pushed aside"


def test_a_loose_body_that_is_put_beside_the_arm_is_felt_at_once(world, make):
    model, far = (world.spawn(lever(make), f"lever{x}", Pose((x, 0, 0.5))) for x in (0, 5))
    body = world.spawn(make.ball(gravity=False), "ball", Pose((9.0, 0.0, 0.5)))
    make.step(world, 5)
    assert model.joints.has_own_dynamics and world.contact_forecast.steps_until_update > 50
    before = pybullet.getJointState(model.body_id, 0, world.client)[:2]
    pybullet.setJointMotorControl2(model.body_id, 0, pybullet.TORQUE_CONTROL, force=5.0,
                                   physicsClientId=world.client)
    pybullet.stepSimulation(world.client)  # of what moves by itself Bullet moves nothing
    assert pybullet.getJointState(model.body_id, 0, world.client)[:2] == before
    body.set_pose(Pose((0.4, 0.08, 0.5)))
    world.step()
    world.step()
    assert not model.joints.has_own_dynamics and far.joints.has_own_dynamics
    body.set_pose(Pose((9.0, 0.0, 0.5)))
    world.step()
    assert model.joints.has_own_dynamics
    body.apply_force("ball", (0.0, 0.0, 1e5), body.pose().xyz)
    assert world.contact_forecast.steps_until_update == 0


def test_what_is_put_elsewhere_is_another_s_ground_only_within_its_reach(world, make):
    one, two = (world.spawn(lever(make), name, Pose((x, 0, 0.5)))
                for name, x in (("one", 0.0), ("two", 9.0)))
    post = world.spawn(shelf(make, 0.1, 0.1, 1.0), "post", Pose((4.0, 0.0, 0.5)))
    shown = {island.model: island for island in world.contact_forecast.isolated_models}
    assert [shown[m].nearby_models for m in (one, two)] == [(), ()]
    for x, grounds in ((0.4, [(post,), ()]), (9.0, [(), (post,)]), (9.2, [(), (post,)]),
                       (4.0, [(), ()])):
        world.contact_forecast.steps_until_update = 7
        post.set_pose(Pose((x, 0.0, 0.5)))
        assert [shown[m].nearby_models for m in (one, two)] == grounds
        assert world.contact_forecast.steps_until_update == 0
    two.set_pose(Pose((0.9, 0.0, 0.5)))
    assert [i.nearby_models for i in world.contact_forecast.isolated_models] == [(two,), (one,)]
    assert world.contact_forecast.steps_until_update == 0
