"""An object held by the friction of a gripper's fingers does not slip."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World

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
        make.joint("lift", "world", "palm", "prismatic", f"0 0 {PALM}", "0 0 1", -0.3, 0.5, 300.0),
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shape = "" if tips else finger
        rough = f'<gazebo reference="{side}_{"tip" if tips else "finger"}"><mu1>{mu}</mu1></gazebo>'
        parts += [
            make.link(f"{side}_finger", 0.1, "0 0 0", still, shape),
            make.joint(side, "palm", f"{side}_finger", "prismatic", f"0 {0.045 * sign} {-REACH}",
                       f"0 {-sign} 0", least, 0.04, 50.0, 0.05, extra=follows * (sign < 0)),
            rough if mu is not None else "",
        ]
        if tips:
            parts += [make.link(f"{side}_tip", 0.01, "0 0 0", (1e-6,) * 3 + (0, 0, 0), finger),
                      make.joint(f"at_{side}", f"{side}_finger", f"{side}_tip", "fixed")]
    return parse_urdf(make.robot(*parts, more))


def box_of(make, mu):
    """A box of 0.2 kg that stands between the fingers."""
    return parse_urdf(make.robot(
        make.link("box", 0.2, "0 0 0", (8.7e-5, 8.7e-5, 5.3e-5, 0, 0, 0),
                  make.box("0.04 0.04 0.06")),
        f'<gazebo reference="box"><mu1>{mu}</mu1></gazebo>'))


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

    go_on(300, -0.18)
    go_on(900, 0.1)
    assert box.pose().xyz[2] > 0.25
    return go_on


@pytest.mark.parametrize("mu, how", [(0.5, {}), (1.0, {"mimic": False}), (0.5, {"tips": True})],
                         ids=["mimic", "two", "tips"])
def test_what_two_fingers_hold_stays_there(make, mu, how):
    """0.2 kg held with twice the force that friction needs; it crept by 1 mm and 6 degrees."""
    with World() as world:
        world.spawn_ground_plane()
        go_on = held(world, make, mu, **how)
        first = go_on(300, 0.1)
        last = go_on(500, 0.15)
        # Along y nothing holds two fingers that push against each other.
        assert math.dist(first.xyz[::2], last.xyz[::2]) < 1e-6
        turned = np.abs(np.subtract(first.quat, last.quat)).max()
        assert turned < 1e-6


@pytest.mark.parametrize("mimic", [True, False])
def test_what_slips_through_the_fingers_is_slowed_down_by_their_friction(make, mimic):
    """A bar pulled along between two fingers; one effort on two coupled ones is shared by both."""
    mu, press, mass, pull = 0.3, 10.0, 0.5, 8.0
    with World() as world:
        bar = world.spawn(parse_urdf(make.robot(
            make.link("world"), make.link("bar", mass, "0 0 0", (0.01,) * 3 + (0, 0, 0),
                                          make.box("2 0.04 0.06")),
            make.joint("slide", "world", "bar", "prismatic", f"0 0 {PALM - REACH}", "1 0 0",
                       -50.0, 50.0),
            f'<gazebo reference="bar"><mu1>{mu}</mu1></gazebo>')), "bar")
        hand = world.spawn(gripper(make, mu, mimic=mimic), "hand")
        speeds = []
        for _ in range(300):
            position, velocity = (part[0] for part in hand.read_joints()[:2])
            hand.apply_effort("lift", 9.8 * 1.2 - 200.0 * position - 60.0 * velocity)
            for finger in ("left",) if mimic else ("left", "right"):
                hand.apply_effort(finger, press)
            bar.apply_effort("slide", pull)
            world.step()
            speeds.append(bar.read_joints()[1][0])
    rubs = mu * press * (1.0 if mimic else 2.0)
    assert (speeds[-1] - speeds[-101]) / 0.1 == pytest.approx((pull - rubs) / mass, rel=0.01)
