"""Physics, compared with closed forms: no force is added or lost."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

DT = 0.001
G = 9.8


def _quarter_period(amplitude: float) -> float:
    """Complete elliptic integral K(sin²(amplitude / 2)), by the arithmetic-geometric mean."""
    a, b = 1.0, math.cos(amplitude / 2)
    while abs(a - b) > 1e-15:
        a, b = (a + b) / 2, math.sqrt(a * b)
    return math.pi / (2 * a)


@pytest.fixture
def world():
    """An empty world."""
    with World() as it:
        yield it


def spawn(world, xml, **options):
    """A model named 'm'."""
    return world.spawn(parse_urdf(xml), "m", **options)


def steps(world, count, model=None, **efforts):
    """Advance with constant efforts."""
    for _ in range(count):
        for joint, effort in efforts.items():
            model.apply_effort(joint, effort)
        world.step()


def spin_up(model, joint, velocity):
    """Give a joint a velocity by an effort impulse that the caller's next step carries."""
    inertia = 0.01
    model.apply_effort(joint, inertia * velocity / DT)


def test_free_fall_matches_the_integrator_exactly(world, make):
    ball = spawn(world, make.robot(make.link("ball", 2.0, "0.1 0.2 0.3")), pose=Pose((0, 0, 100)))
    steps(world, 1000)
    # Semi-implicit Euler: z = z0 - g dt² n (n + 1) / 2, within a millimetre a second of g t²/2.
    assert ball.pose().xyz[2] == pytest.approx(100 - G * DT**2 * 1000 * 1001 / 2, abs=1e-9)
    assert ball.twist().linear[2] == pytest.approx(-G, abs=1e-9)
    assert ball.pose().quat == (0, 0, 0, 1)


def test_torque_free_top_keeps_angular_momentum(world, make):
    world.set_physics(gravity=(0, 0, 0))
    inertia = np.diag((0.1, 0.2, 0.25))
    top = spawn(world, make.robot(make.link("top", 1.0, "0 0 0", (0.1, 0.2, 0.25, 0, 0, 0))))
    top.set_twist(Twist((0, 0, 0), (1.0, 2.0, 0.5)))
    before = inertia @ (1.0, 2.0, 0.5)
    steps(world, 500)
    rows = np.array(top.pose().matrix())[:3, :3]
    after = rows @ inertia @ rows.T @ top.twist().angular
    assert np.linalg.norm(after - before) < 2e-3 * np.linalg.norm(before)


@pytest.mark.parametrize("amplitude", [0.1, 1.5])
def test_pendulum_period_is_exact_within_a_thousandth(world, make, amplitude):
    bob = spawn(world, make.pendulum(), joint_positions={"swing": amplitude})
    inertia = 0.01 + 1.0 * 0.5**2
    exact = 4 * math.sqrt(inertia / (G * 0.5)) * _quarter_period(amplitude)
    angles = []
    for _ in range(round(5.2 * exact / DT)):
        world.step()
        angles.append(bob.read_joints()[0][0])
    angles = np.array(angles)
    rising = np.where((angles[:-1] < 0) & (angles[1:] >= 0))[0]
    crossing = rising - angles[rising] / (angles[rising + 1] - angles[rising])
    assert np.diff(crossing).mean() * DT == pytest.approx(exact, rel=2e-5)


@pytest.mark.parametrize("damping", [0.1, 1.0, 4.0, 6.0, 21.0, 1e3, 1e6])
def test_damping_is_stable_and_monotone_for_any_size(world, make, damping):
    model = spawn(world, make.rotor(damping=damping))
    ratio = damping * DT / 0.01
    spin_up(model, "spin", 1.0 + ratio)  # this step is damped too
    rates = []
    for _ in range(50):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert rates[0] == pytest.approx(1.0, rel=1e-6)
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False))
    # Off the exact decay by r²/2, and never by more than implicit Euler's worst, 0.204 at r = 2.5.
    exact = math.exp(-ratio)
    assert rates[1] == pytest.approx(exact, abs=min(0.21, ratio**2 / 2 + 1e-9))


@pytest.mark.parametrize("damping", [0.0, 500.0])
def test_gravity_acts_along_the_world_s_z_on_a_tilted_robot(world, make, damping):
    # The same arm, upright in a turned base whose principal axes are turned once more.
    tilt = Pose.from_rpy((0.0, 0.0, 0.0), (0.4, 0.0, 0.0))
    back = Pose.from_rpy((0.0, 0.0, 0.0), (-0.4, 0.0, 0.0))
    base = make.link("base", 5.0, "0.1 0.2 0", (0.3, 0.4, 0.5, 0.05, -0.04, 0.03))
    models = []
    for name, pose, rpy in (("upright", Pose(), "0 0 0"), ("tilted", tilt, "-0.4 0 0")):
        xml = make.robot(base, make.link("arm", 1.0, "0 0 -0.5"),
                         make.joint("swing", "base", "arm", "continuous", rpy=rpy,
                                    damping=damping))
        models.append(world.spawn(parse_urdf(xml), name, pose, {"swing": 0.5}, fixed_base=True))
    assert (tilt @ back).quat == pytest.approx((0, 0, 0, 1))
    assert models[1].bias_efforts() == pytest.approx([G * 0.5 * math.sin(0.5)], rel=1e-9)
    steps(world, 50)
    assert models[1].read_joints()[0][0] == pytest.approx(models[0].read_joints()[0][0], abs=1e-9)
    assert models[1].read_joints()[1][0] < 0


def test_heavy_damping_on_a_free_base_is_stable(world, make):
    world.set_physics(gravity=(0, 0, 0))
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=50.0),
    )
    model = spawn(world, xml)
    model.apply_effort("spin", 20.0)
    rates = []
    for _ in range(50):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False))
    assert rates[-1] < 1e-6


@pytest.mark.parametrize("damping", [0.0, 0.5, 100.0])
def test_friction_holds_below_and_slips_above(world, make, damping):
    model = spawn(world, make.rotor(friction=0.3, damping=damping))
    steps(world, 500, model, spin=0.299)
    assert abs(model.read_joints()[0][0]) < 1e-9
    steps(world, 1000, model, spin=0.4)
    expected = 0.1 / damping if damping else 0.1 * 1.0 / 0.01
    assert model.read_joints()[1][0] == pytest.approx(expected, rel=1e-3)


def test_prismatic_joint_falls_and_stops_at_its_limit(world, make):
    xml = make.robot('<link name="world"/>', make.link("car", 2.0),
                     make.joint("slide", "world", "car", "prismatic", axis="0 0 -1",
                                lower=0.0, upper=0.3))
    model = spawn(world, xml)
    steps(world, 200)
    assert model.read_joints()[0][0] == pytest.approx(G * DT**2 * 200 * 201 / 2, rel=1e-6)
    assert model.link_pose("car").xyz[2] == pytest.approx(-model.read_joints()[0][0], abs=1e-12)
    steps(world, 500)
    assert model.read_joints()[0][0] == pytest.approx(0.3, abs=1e-4)


@pytest.mark.parametrize("effort", [20.0, 500.0, 5000.0])
def test_limits_hold_in_effort_mode(world, make, effort):
    model = spawn(world, make.pendulum(kind="revolute", lower=-0.4, upper=0.5))
    for sign, bound in ((1, 0.5), (-1, -0.4)):
        overshoot = fastest = 0.0
        for _ in range(600):
            fastest = max(fastest, abs(model.read_joints()[1][0]))
            model.apply_effort("swing", sign * effort)
            world.step()
            overshoot = max(overshoot, sign * (model.read_joints()[0][0] - bound))
        # Nobody can stop before the step in which the stop is met is over.
        assert overshoot < (fastest + (effort + G * 0.5) / 0.26 * DT) * DT
        assert model.read_joints()[0][0] == pytest.approx(bound, abs=1e-3)


def test_velocity_motor_drives_up_to_its_effort(world, make):
    model = spawn(world, make.rotor(friction=0.1))
    model.set_velocity_motor("spin", 3.0, 0.5)
    steps(world, 10)
    assert model.read_joints()[1][0] == pytest.approx(0.5 * 0.01 / 0.01)
    steps(world, 100)
    assert model.read_joints()[1][0] == pytest.approx(3.0)
    model.set_velocity_motor("spin", 0.0, 0.1)  # friction alone
    steps(world, 100)
    assert model.read_joints()[1][0] == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("stepper", ["own", "bullet"])
def test_gravity_and_step_act_as_they_were_set_last(world, make, stepper):
    """On a tilted root too, before and after a reset."""
    if stepper == "bullet":
        cube = make.link("cube", shapes=make.box("0.1 0.1 0.1"))
        world.spawn(parse_urdf(make.robot(cube)), "cube", Pose((9, 0, 5)))
    bob = spawn(world, make.pendulum(), joint_positions={"swing": 0.5})
    pull = math.sin(0.5) * 0.5 / 0.26
    world.set_physics(time_step=0.002, gravity=(0, 0, 4.0))
    for _ in range(2):
        steps(world, 1)
        assert bob.read_joints()[1][0] == pytest.approx(0.002 * 4.0 * pull, rel=1e-9)
        world.reset_simulation()
    bob.set_pose(Pose.from_rpy((0, 0, 0), (0, math.pi / 2, 0)))
    steps(world, 1)
    sideways = math.cos(0.5) * 0.5 / 0.26
    assert abs(bob.read_joints()[1][0]) == pytest.approx(0.002 * 4.0 * sideways, rel=1e-9)


def test_damping_of_a_free_body_is_chosen_anew_for_another_step(world, make):
    """Explicit damping, right at 0.1 ms, would throw the wheel about at 5 ms."""
    world.set_physics(gravity=(0, 0, 0), time_step=1e-4)
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=3.0))
    model = spawn(world, xml)
    steps(world, 5, model, spin=20.0)
    world.set_physics(time_step=0.005)
    rates = [model.read_joints()[1][0]]
    for _ in range(20):
        world.step()
        rates.append(model.read_joints()[1][0])
    assert rates[0] > 0.5
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False))


def test_a_free_body_s_joint_has_its_friction_again_once_its_damping_needs_no_motor(world, make):
    world.set_physics(gravity=(0, 0, 0), time_step=0.005)
    xml = make.robot(
        make.link("hull", 1.0, "0 0 0", (0.1, 0.1, 0.1, 0, 0, 0)),
        make.link("wheel", 0.1, "0 0 0", (0.001, 0.001, 0.001, 0, 0, 0)),
        make.joint("spin", "hull", "wheel", "continuous", axis="0 0 1", damping=3.0, friction=0.5))
    model = spawn(world, xml)
    steps(world, 3, model, spin=2.0)
    world.set_physics(time_step=1e-4)
    steps(world, 200, model, spin=0.49)
    assert abs(model.read_joints()[1][0]) < 1e-9
    steps(world, 2000, model, spin=2.0)
    assert model.read_joints()[1][0] == pytest.approx((2.0 - 0.5) / 3.0, rel=1e-3)


def test_damping_of_a_free_body_is_chosen_anew_where_its_joints_are_put_elsewhere(world, make):
    """Explicit damping, right with the weight half a metre out, would throw the arm about with the
    weight at its axis."""
    world.set_physics(gravity=(0, 0, 0))
    small = (0.001, 0.001, 0.001, 0, 0, 0)
    xml = make.robot(
        make.link("hull", 5.0, "0 0 0", (1.0, 1.0, 1.0, 0, 0, 0)),
        make.link("arm", 0.1, "0 0 0", small), make.link("weight", 0.5, "0 0 0", small),
        make.joint("turn", "hull", "arm", "continuous", axis="0 0 1", damping=10.0),
        make.joint("slide", "arm", "weight", "prismatic", axis="1 0 0"))
    model = spawn(world, xml, joint_positions={"slide": 0.5})
    turn = model.joint_names.index("turn")
    steps(world, 5, model, turn=1.0)
    assert model.read_joints()[1][turn] > 0.0
    model.set_joint_positions({"slide": 0.0})
    steps(world, 1, model, turn=1.0)
    rates = [model.read_joints()[1][turn]]
    for _ in range(20):
        world.step()
        rates.append(model.read_joints()[1][turn])
    assert rates[0] > 0.0
    assert all(0 <= b <= a for a, b in zip(rates, rates[1:], strict=False)), rates
