"""Joints of a model with either solver: reading, setting, motors, errors."""

import math

import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import HardwareError, WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import Pose, World

NAMES = ("turn", "slide", "follow")


def described(make, root="hull", **options):
    """A turning joint, one that slides, one that follows the second: unlike in everything."""
    hull = f'<link name="{root}"/>' if root == "world" else make.link(
        root, 8.0, "0.1 0 0", (0.3, 0.4, 0.5, 0, 0, 0))
    return parse_urdf(make.robot(
        hull, make.link("a", 1.0, "0.1 0 0"), make.link("b", 2.0), make.link("c", 0.5),
        make.joint("turn", root, "a", axis="0 0 1", lower=-0.5, upper=1.5, effort=0.1, **options),
        make.joint("slide", "a", "b", "prismatic", axis="1 0 0", lower=-0.2, upper=0.3,
                   effort=0.1, **options),
        make.joint("follow", root, "c", axis="0 1 0", xyz="1 0 0", lower=-2.0, upper=2.0,
                   extra='<mimic joint="slide" multiplier="3" offset="0.1"/>')))


@pytest.fixture(params=["own", "bullet", "free"])
def model(make, request, window):
    """Bolted and by its own dynamics, bolted but in Bullet's hands, or free."""
    with World(gravity=(0.0, 0.0, 0.0), gui=request.param == "bullet") as world:
        root = "hull" if request.param == "free" else "world"
        it = world.spawn(described(make, root), "m", Pose((1.0, 2.0, 3.0)))
        world.step()
        assert it.joint_names == NAMES
        assert it.joints.has_own_dynamics is (request.param == "own")
        it.step = world.step
        yield it


def values(model):
    return [list(part) for part in model.read_joints()[:2]]


def test_joints_are_put_at_rest_at_their_stops_and_followers_follow(model):
    model.joints.restore([(0.4, 2.0), (0.1, -1.0), (0.4, -3.0)])
    assert model.joints.read_states() == [(0.4, 2.0), (0.1, -1.0), (0.4, -3.0)]
    model.set_joint_positions({"turn": -0.3})
    assert values(model) == [[-0.3, 0.1, 0.4], [0.0, -1.0, -3.0]]
    model.set_joint_positions({"slide": 0.2})
    assert model.read_joints()[0] == pytest.approx([-0.3, 0.2, 0.7])
    model.set_joint_positions({"slide": -0.1, "follow": 1.0})  # asked for itself
    assert values(model) == [[-0.3, -0.1, 1.0], [0.0, 0.0, 0.0]]
    for asked, put in ((1.4, 1.4), (1.6, 1.5), (-0.7, -0.5)):
        assert model.set_position("turn", asked) == put
        assert model.read_joints()[0][0] == put
    assert model.set_position("slide", 7.0) == 0.3  # and what follows it is where that is
    assert model.read_joints()[0] == pytest.approx([-0.5, 0.3, 1.0])
    model.joints.restore([(0.4, 2.0), (0.1, -1.0), (0.4, -3.0)])
    model.joints.stop_joints()
    assert values(model) == [[0.4, 0.1, 0.4], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_or_no_joint_changes_nothing(model, bad):
    model.joints.restore([(0.4, 2.0), (0.1, -1.0), (0.4, -3.0)])
    before = values(model)
    for positions in ({"turn": 0.1, "slide": bad}, {"turn": 0.1, "nose": 0.0}):
        with pytest.raises(WorldError, match="'slide': position .* is not finite|'nose'"):
            model.set_joint_positions(positions)
        with pytest.raises(WorldError):
            model.set_position(*list(positions.items())[1])
    for velocity, effort in ((bad, 1.0), (1.0, -1e-9), (1.0, math.nan)):
        with pytest.raises(WorldError, match="'turn': velocity .* must be finite, and max_effort"):
            model.set_velocity_motor("turn", velocity, effort)
    assert values(model) == before
    model.apply_effort("turn", bad)
    with pytest.raises(WorldError, match=r"model 'm', joint \['turn'\]: the effort is not finite"):
        model.check_efforts()
    model.check_efforts()  # they were dropped
    assert values(model) == before


def test_efforts_add_up_and_motors_hold_a_speed_up_to_their_effort(model):
    for joint, effort in (("turn", 3.0), ("turn", -1.0), ("slide", 4.0)):
        model.apply_effort(joint, effort)
    assert model.read_joints()[2] == [0.0] * 3
    model.step()
    first = model.read_joints()[1]
    assert model.read_joints()[2] == [2.0, 4.0, 0.0]
    assert first[0] > 1e-4 and first[1] > 1e-4
    model.step()
    assert model.read_joints()[2] == [0.0] * 3
    assert model.read_joints()[1] == pytest.approx(first, rel=0.01)
    model.set_velocity_motor("turn", 1.0, math.inf)
    model.step()
    assert model.read_joints()[1][0] == pytest.approx(1.0, rel=1e-6)
    model.set_velocity_motor("turn", -5.0, 0.0)  # which is none
    model.step()
    assert model.read_joints()[1][0] == pytest.approx(1.0, rel=1e-4)


def test_stops_are_as_strong_as_it_takes_whatever_effort_the_file_allows(model):
    for _ in range(3):
        model.joints.restore([(1.49, 30.0), (0.29, 40.0), (0.97, 120.0)])
        for _ in range(100):
            model.apply_effort("turn", 200.0)
            model.apply_effort("slide", 300.0)
            model.step()
        assert model.read_joints()[0][:2] == pytest.approx([1.5, 0.3], abs=2e-3)


@pytest.mark.parametrize("start", [1.9, 2.5, -1.2])
def test_a_joint_beyond_its_stop_comes_back_within_its_velocity_limit(model, start):
    """Of 100 rad/s; by a fifth of the way a step. In Bullet alone it came back at 160 rad/s."""
    model.joints.restore([(start, 0.0), (0.0, 0.0), (0.1, 0.0)])
    fastest = 0.0
    for _ in range(200):
        model.step()
        fastest = max(fastest, abs(model.read_joints()[1][0]))
    assert fastest < 101.0
    assert -0.502 < model.read_joints()[0][0] < 1.502


def test_a_joint_that_runs_away_is_named(model):
    if model.joints.has_own_dynamics:
        model.joints.restore([(0.0, 0.0), (math.nan, 0.0), (0.1, 0.0)])
        with pytest.raises(WorldError, match="'m', joint 'slide': the simulation diverged"):
            model.step()
        return

    def put(slot, position, velocity):
        pybullet.resetJointState(model.body_id, model.body.joint_indices[NAMES[slot]], position,
                                 velocity, physicsClientId=model.client)
        model.joints.after_step()

    for slot, position, velocity in ((0, 0.1, -1.1e6), (1, math.nan, 0.0), (2, 0.0, 1.2e6),
                                     (2, math.inf, 0.0), (0, -math.inf, 0.0)):
        put(slot, position, velocity)
        with pytest.raises(WorldError, match=f"joint '{NAMES[slot]}': the simulation diverged"):
            model.read_joints()
        put(slot, 0.0, 0.9e6)
        assert model.read_joints()[1][slot] == 0.9e6
        put(slot, 0.0, 0.0)


@pytest.mark.parametrize("bound", [0.0, -1.0, math.nan])
def test_a_bound_on_speed_needs_a_bolted_root_and_a_positive_number(model, bound):
    if model.fixed_base:
        with pytest.raises(WorldError, match="joint 'turn': a hard velocity limit of .* would "
                                             "lock"):
            model.bound_speed("turn", bound)
    else:
        with pytest.raises(WorldError, match="joint 'turn': .* fixed base"):
            model.bound_speed("turn", 1.0)
    with pytest.raises(WorldError, match="'nose'"):
        model.bound_speed("nose", 1.0)


def test_a_follower_that_was_put_elsewhere_comes_back(model):
    """A fifth of what lacks a step, a fifth of that in Bullet's; its leader does not give way."""
    model.set_velocity_motor("slide", 0.0, 1e6)
    model.joints.restore([(0.0, 0.0), (0.1, 0.0), (0.45, 0.0)])
    lacks = []
    for _ in range(6):
        model.step()
        position, _ = values(model)
        lacks.append(position[2] - 3 * position[1] - 0.1)
        assert position[1] == pytest.approx(0.1, abs=1e-3)
    left = [b / a for a, b in zip(lacks, lacks[1:], strict=False)]
    assert left == pytest.approx([0.8 if model.joints.has_own_dynamics else 0.96] * 5, abs=1e-4)


def test_nothing_slows_a_fast_joint_down(model):
    """Bullet by itself cuts its speed at 100 rad/s."""
    model.apply_effort("turn", 400.0 / 1e-3 / model.joints.inverse_inertia()[0, 0])
    model.step()
    speed = model.read_joints()[1][0]
    assert speed == pytest.approx(400.0, rel=0.01)
    model.step()
    assert model.read_joints()[1][0] == pytest.approx(speed, rel=0.2)


TAIL = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="spin"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>
</joint><actuator name="m"/></transmission>
<gazebo><plugin name="c" filename="libgazebo_ros_control.so"/></gazebo></robot>"""


def spawned(make, switch, bolted=True, velocity="100"):
    """A wheel under hardware with its effort limit of 1000 N m, and its simulation."""
    text = make.rotor().replace("</robot>", TAIL)
    text = text.replace('velocity="100"', f'velocity="{velocity}"')
    if not bolted:
        text = text.replace('<link name="world"/>', make.link("hub")).replace("world", "hub")
    simulation = Simulation(SimulationConfig(ground_plane=False))
    parameters = {} if switch is None else {"gazebo_ros_control": {"hard_velocity_limits": switch}}
    return simulation, simulation.spawn(parse_urdf(text), "wheel", parameters=parameters)


@pytest.mark.parametrize("effort", [5e3, -5e3])
def test_with_hard_limits_nothing_passes_them_before_or_after_a_reset(make, effort):
    simulation, model = spawned(make, True)
    for _ in range(2):
        make.step(simulation, 5, model, spin=effort)
        assert model.read_joints()[1][0] == math.copysign(100.0, effort)
        simulation.reset_simulation()


@pytest.mark.parametrize("switch", [None, False])
def test_without_hard_limits_a_push_does(make, switch):
    simulation, model = spawned(make, switch)
    make.step(simulation, 5, model, spin=5e3)
    assert model.read_joints()[1][0] == pytest.approx(2500.0)


@pytest.mark.parametrize(("options", "error", "reason"), [
    ({"switch": "yes"}, HardwareError, "hard_velocity_limits is 'yes', must be true or false"),
    ({"switch": True, "bolted": False}, WorldError, "fixed base"),
    ({"switch": True, "velocity": "0"}, WorldError, "would lock the joint")])
def test_what_cannot_be_done_is_refused_and_nothing_is_spawned(make, options, error, reason):
    with pytest.raises(error, match=reason):
        spawned(make, **options)
