"""Attached links move as one body, and are free again after they are detached."""

import math

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.world import Pose
from aras_sim_bridge.world.attachments import LinkPair
from aras_sim_bridge.world.description_changes import change_link

TURNED = Pose.from_rpy((0.3, 0.1, 0.6), (0.4, -0.3, 0.8))


def thing(make, mass=0.5):
    """A box whose frame is neither its centre of mass nor along its principal axes."""
    return parse_urdf(make.robot(make.link(
        "body", mass, "0.02 0.01 -0.03", (2e-3, 3e-3, 4e-3, 5e-4, 0.0, -3e-4),
        make.box("0.05 0.06 0.07"))))


def arm(make, bolted):
    """Two joints; on the ground, its base is a heavy plate that is not bolted down."""
    root = make.link("world") if bolted else make.link(
        "plate", 200.0, "0 0 0.05", (20.0, 20.0, 40.0, 0, 0, 0), make.box("1 1 0.1", "0 0 0.05"))
    return parse_urdf(make.robot(
        root, make.link("upper", 2.0, "0 0 0.2", (0.05, 0.05, 0.01, 0, 0, 0)),
        make.link("lower", 1.0, "0.15 0 0", (0.01, 0.03, 0.03, 0, 0, 0)),
        make.joint("one", "world" if bolted else "plate", "upper", xyz="0 0 0.1", axis="0 0 1"),
        make.joint("two", "upper", "lower", xyz="0 0 0.4", axis="0 1 0", rpy="0.2 0 0")))


def holder(world, make, kind):
    if kind == "ground":
        return world.model("ground_plane"), "link"
    if kind == "thing":
        return world.spawn(thing(make), "hand", Pose.from_rpy((0.0, 0.4, 1.5), (0.1, 0.2, 0.3))), \
            "body"
    model = world.spawn(arm(make, kind == "arm"), "hand", joint_positions={"one": 0.5, "two": 0.3})
    return model, "lower"


def move(world, model, steps):
    """Pass time in which joints are driven; WorldError where it diverges."""
    for k in range(steps):
        for name in model.joint_names:
            model.apply_effort(name, 6.0 * math.sin(0.01 * k) - 2.0 * model.read_joints()[1][
                model.joint_names.index(name)])
        world.step()


def apart(first, second):
    turned = abs(float(np.dot(first.quat, second.quat)))
    return math.dist(first.xyz, second.xyz), 2.0 * math.acos(min(1.0, turned))


@pytest.mark.parametrize("kind", ["thing", "arm", "arm on the ground", "ground"])
def test_attached_links_move_as_one(world, ground, make, kind):
    model, link = holder(world, make, kind)
    held = world.spawn(thing(make), "held", TURNED)

    def between():
        return model.link_pose(link).inverse() @ held.link_pose("body")

    move(world, model, 20)
    ends = LinkPair(model.name, link, "held", "body")
    world.attachments.attach(ends)
    assert ends in world.attachments
    first, start = between(), held.pose()
    move(world, model, 500 if kind != "thing" else 200)
    distance, angle = apart(first, between())
    assert distance < 2e-3 and angle < 1e-2
    assert kind == "ground" or apart(start, held.pose())[0] > 0.01
    # Other masses mean another body in Bullet, which holds on all the same.
    world.change_model("held", change_link(held.description, "body", 0.2, (0, 0, 0),
                                   (1e-3, 0, 0, 1e-3, 0, 1e-3), True))
    move(world, model, 100)
    now = between()
    assert apart(first, now)[0] < 2e-3
    world.attachments.detach(ends)
    move(world, model, 300)
    assert kind == "thing" or apart(now, between())[0] > 0.05  # two that fall stay side by side


def test_what_is_held_is_carried_by_what_holds_it(world, make):
    """A bolted arm with a thing on it has the momentum of both: its torque at rest says so."""
    model = world.spawn(parse_urdf(make.robot(
        make.link("world"), make.link("beam", 1.0, "0 0 0", (0.01,) * 3 + (0, 0, 0)),
        make.joint("hinge", "world", "beam", axis="0 1 0"))), "beam")
    held = world.spawn(thing(make), "held", Pose((0.5, 0.0, 0.0)))
    world.attachments.attach(LinkPair("beam", "beam", "held", "body"))
    torque = -9.8 * 0.5 * (0.5 + 0.02)  # about y, of the thing's centre of mass
    make.step(world, 50, model, hinge=torque)
    assert abs(model.read_joints()[1][0]) < 1e-2
    assert held.pose().xyz[2] == pytest.approx(0.0, abs=1e-3)


def test_attachments_that_cannot_be_or_whose_models_go(world, make):
    world.spawn(thing(make), "one")
    world.spawn(thing(make), "two", Pose((1.0, 0.0, 0.0)))
    for words, *ends in (("'three'", "one", "body", "three", "body"),
                         ("'hand'", "one", "hand", "two", "body"),
                         ("itself", "one", "body", "one", "body")):
        with pytest.raises(WorldError, match=words):
            world.attachments.attach(LinkPair(*ends))
    with pytest.raises(WorldError, match="not attached; attached are: none"):
        world.attachments.detach(LinkPair("one", "body", "two", "body"))
    assert not world.attachments
    for k in range(3):
        world.spawn(thing(make), f"thing_{k}", Pose((0.3 * k, 0.0, 1.0)))
    first, second = (LinkPair("thing_0", "body", f"thing_{k}", "body") for k in (1, 2))
    world.attachments.attach(first)
    world.attachments.attach(second)
    world.delete("thing_1")
    assert first not in world.attachments
    assert second in world.attachments
    world.step()
    world.reset_simulation()
    assert not world.attachments
    world.attachments.attach(second)
    world.step()
