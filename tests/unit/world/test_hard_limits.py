"""Stops and hard_velocity_limits, which no command or push exceeds."""

import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import HardwareError, WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import Pose

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


def speed_after(simulation, model, effort, steps=5):
    for _ in range(steps):
        model.apply_effort("spin", effort)
        simulation.step()
    return model.read_joints()[1][0]


@pytest.mark.parametrize("effort", [5e3, -5e3])
def test_with_them_nothing_passes_the_limit_before_or_after_a_reset(make, effort):
    simulation, model = spawned(make, True)
    for _ in range(2):
        assert speed_after(simulation, model, effort) == 100.0 * (1 if effort > 0 else -1)
        simulation.reset_simulation()


@pytest.mark.parametrize("switch", [None, False])
def test_without_them_a_push_does(make, switch):
    assert speed_after(*spawned(make, switch), 5e3) == pytest.approx(2500.0)


@pytest.mark.parametrize(("options", "error", "reason"), [
    ({"switch": "yes"}, HardwareError, "hard_velocity_limits is 'yes', must be true or false"),
    ({"switch": True, "bolted": False}, WorldError, "fixed base"),
    ({"switch": True, "velocity": "0"}, WorldError, "would lock the joint"),
])
def test_what_cannot_be_done_is_refused_and_nothing_is_spawned(make, options, error, reason):
    with pytest.raises(error, match=reason):
        spawned(make, **options)


@pytest.mark.parametrize(("bolted", "lower"), [(True, -2.0), (False, 0.8)])
def test_a_joint_that_is_spawned_beyond_its_stop_comes_back_gently(make, bolted, lower):
    """In Bullet it came back by a fifth of the way in one step, at 160 rad/s. What lies on the
    turning arm keeps it in Bullet."""
    upper = lower + 1.2
    root = make.link("world" if bolted else "base", 5.0, shapes=make.box("1 1 0.1"))
    text = make.robot(root, make.link("arm", shapes=make.box("0.4 0.1 0.1")),
                      make.joint("turn", "world" if bolted else "base", "arm", xyz="0 0 0.5",
                                 axis="0 0 1", lower=lower, upper=upper))
    text = text.replace('velocity="100"', 'velocity="0.6"')
    config = SimulationConfig(ground_plane=False, gravity=(0.0, 0.0, 0.0))
    simulation = Simulation(config)
    model = simulation.spawn(parse_urdf(text), "arm")
    simulation.spawn(parse_urdf(make.robot(make.link("thing", shapes=make.box("0.1 0.1 0.1")))),
                     "thing", Pose((0.0, 0.0, 0.6)))
    fastest = 0.0
    for _ in range(2500):
        simulation.step()
        fastest = max(fastest, abs(model.read_joints()[1][0]))
    assert fastest < 0.65
    assert lower - 1e-3 <= model.read_joints()[0][0] <= upper + 1e-3
    simulation.close()
