"""An object is held by the friction of a gripper's fingers, or by libgazebo_grasp_fix."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world import Pose

PALM, REACH = 0.3, 0.065  # m: height of the palm, of the fingers' middles below it


def gripper(make, mu=None, tips=False, mimic=True, least=0.0, more=""):
    """A palm on a vertical slide with two fingers that close along y, 0.2 kg of box between them.

    tips: the fingers' shapes are those of links fixed to them. mimic: one finger follows the other.
    least: how far the fingers open beyond their places, m.
    """
    finger = make.box("0.03 0.01 0.08")
    still = (1e-4,) * 3 + (0, 0, 0)
    follows = '<mimic joint="left" multiplier="1"/>' if mimic else ""
    parts = [
        make.link("world"), make.link("palm", 1.0, "0 0 0", (0.01,) * 3 + (0, 0, 0)),
        make.joint("lift", "world", "palm", "prismatic", f"0 0 {PALM}", "0 0 1", -0.3, 0.5, 300.0)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shape = "" if tips else finger
        rough = f'<gazebo reference="{side}_{"tip" if tips else "finger"}"><mu1>{mu}</mu1></gazebo>'
        parts += [
            make.link(f"{side}_finger", 0.1, "0 0 0", still, shape),
            make.joint(side, "palm", f"{side}_finger", "prismatic", f"0 {0.045 * sign} {-REACH}",
                       f"0 {-sign} 0", least, 0.04, 50.0, 0.05, extra=follows * (sign < 0)),
            rough if mu is not None else ""]
        if tips:
            parts += [make.link(f"{side}_tip", 0.01, "0 0 0", (1e-6,) * 3 + (0, 0, 0), finger),
                      make.joint(f"at_{side}", f"{side}_finger", f"{side}_tip", "fixed")]
    return parse_urdf(make.robot(*parts, more))


def box_of(make, mu):
    """A box of 0.2 kg that stands between the fingers."""
    return make.block((0.04, 0.04, 0.06), 0.2, f"<mu1>{mu}</mu1>", link="box")


def held(world, make, mu, **how):
    """A box that was grasped and lifted; a function that goes on for some steps and tells where the
    box is in the palm's frame."""
    box = world.spawn(box_of(make, mu), "box", Pose((0.004, 0.0, 0.03)))
    hand = world.spawn(gripper(make, mu, **how), "hand", joint_positions={"lift": -0.18})
    fingers = ("left",) if how.get("mimic", True) else ("left", "right")

    def go_on(count, height):
        begin = hand.read_joints()[0][0]
        for k in range(count):
            position, velocity = (part[0] for part in hand.read_joints()[:2])
            wanted = begin + (height - begin) * min(2.0 * k / count, 1.0)
            hand.apply_effort("lift", 9.8 * 1.4 + 400.0 * (wanted - position) - 60.0 * velocity)
            for finger in fingers:
                hand.apply_effort(finger, 10.0)
            world.step()
        return hand.link_pose("palm").inverse() @ box.pose()

    go_on(200, -0.18)
    go_on(700, 0.1)
    assert box.pose().xyz[2] > 0.25
    return go_on


@pytest.mark.parametrize("mu, how", [(0.5, {}), (1.0, {"mimic": False}), (0.5, {"tips": True})],
                         ids=["mimic", "two", "tips"])
def test_what_two_fingers_hold_stays_there(world, ground, make, mu, how):
    """0.2 kg held with twice the force that friction needs; it crept by 1 mm and 6 degrees."""
    go_on = held(world, make, mu, **how)
    first = go_on(300, 0.1)
    last = go_on(500, 0.15)
    # Along y nothing holds two fingers that push against each other.
    assert math.dist(first.xyz[::2], last.xyz[::2]) < 1e-6
    turned = np.abs(np.subtract(first.quat, last.quat)).max()
    assert turned < 1e-6


ARM = "<arm><arm_name>hand</arm_name><palm_link>palm</palm_link>{}</arm>"
FINGERS = "".join(f"<gripper_link>{side}_finger</gripper_link>" for side in ("left", "right"))
SETTINGS = "<update_rate>20</update_rate><grip_count_threshold>4</grip_count_threshold>" \
           "<max_grip_count>8</max_grip_count>"


def grasping(make, inside):
    """A gripper with this plug-in, whose fingers also open."""
    return gripper(make, mimic=False, least=-0.02, more='<gazebo><plugin name="grasp" '
                   f'filename="libgazebo_grasp_fix.so">{inside}</plugin></gazebo>')


class Hand:
    """A gripper around a slippery box of 0.2 kg on the ground."""

    def __init__(self, simulation, make, inside):
        self.simulation = simulation
        self.box = simulation.spawn(box_of(make, 0.02), "box", Pose((0.004, 0.0, 0.03)))
        self.model = simulation.spawn(grasping(make, inside), "hand",
                                      joint_positions={"lift": -0.18})

    def go(self, steps, height, grip):
        """Move the palm towards a height while the fingers press with `grip` N."""
        for _ in range(steps):
            position, velocity = (part[0] for part in self.model.read_joints()[:2])
            self.model.apply_effort("lift", 9.8 * 1.4 + 400.0 * (height - position)
                                    - 60.0 * velocity)
            for finger in ("left", "right"):
                self.model.apply_effort(finger, grip)
            self.simulation.step()

    @property
    def box_in_palm(self):
        return self.model.link_pose("palm").inverse() @ self.box.pose()


@pytest.fixture
def simulation():
    it = Simulation()
    yield it
    it.close()


@pytest.mark.parametrize("collides, grip", [(True, 10.0), (False, 0.0)])
def test_what_is_pressed_is_held_and_let_go(simulation, make, collides, grip):
    """The threshold of 4 counts at 20 Hz is passed 0.25 s after the fingers press. Where what is
    held touches nothing, fingers that go on pressing would pass through it."""
    extra = f"<disable_collisions_on_attach>{not collides}</disable_collisions_on_attach>"
    hand = Hand(simulation, make, ARM.format(FINGERS) + SETTINGS + extra)
    (grasp,) = simulation.grasps
    hand.go(150, -0.18, 10.0)
    assert not grasp.grasped
    for _ in range(250):
        hand.go(1, -0.18, grip if grasp.grasped else 10.0)
    assert grasp.grasped["hand"].link == ("box", "box")
    before = hand.box_in_palm
    hand.go(700, 0.1, grip)
    assert hand.box.pose().xyz[2] > 0.25
    assert math.dist(before.xyz, hand.box_in_palm.xyz) < 2e-3
    hand.go(300, 0.1, -10.0)
    assert not grasp.grasped
    hand.go(400, 0.1, -10.0)
    assert 0.01 < hand.box.pose().xyz[2] < 0.05  # it touches the ground again


def test_deleted_things_and_resets_leave_nothing_held(simulation, make):
    hand = Hand(simulation, make, ARM.format(FINGERS) + SETTINGS)
    (grasp,) = simulation.grasps
    hand.go(400, -0.18, 10.0)
    assert grasp.grasped
    simulation.delete("box")
    hand.go(100, -0.18, 10.0)
    assert not grasp.grasped
    simulation.reset_simulation()
    hand.go(100, -0.18, 10.0)
    simulation.delete("hand")
    assert not simulation.grasps
    simulation.step()


@pytest.mark.parametrize("inside, words", [
    (ARM.format("<gripper_link>thumb</gripper_link>"),
     ["gripper_link 'thumb' of arm", "no valid <arm>"]),
    (ARM.format(FINGERS).replace("palm<", "wrist<"), ["palm_link 'wrist'", "no valid <arm>"]),
    (ARM.format(FINGERS) * 2, ["another arm has the same name"]),
    ("", ["no valid <arm>"]),
    (ARM.format(FINGERS) + "<update_rate>0</update_rate>", ["update_rate is 0 Hz"]),
    # With 60 degrees Gazebo grasps nothing either.
    (ARM.format(FINGERS) + "<forces_angle_tolerance>60</forces_angle_tolerance>", ["60 degrees"]),
])
def test_what_cannot_be_is_named_and_costs_the_plug_in_alone(make, inside, words):
    made = grasping(make, inside)
    for word in words:
        assert sum(word in one for one in made.warnings) == 1, made.warnings
    assert bool(made.grasps) is (words == ["another arm has the same name"])
