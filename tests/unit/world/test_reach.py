"""Bounding boxes of all poses that links can reach: complete, and as small as possible."""

import math

import numpy as np
import pytest
from test_joint_dynamics import tree_xml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, collision_filters
from aras_sim_bridge.world import collision_filters as reach

HULL = 2e-3  # m: Bullet's margins around shapes
ROOT = Pose.from_rpy((1.0, -2.0, 3.0), (0.4, -0.3, 2.0))


def corners(size, centre):
    half = np.array(size) / 2
    return [np.add(centre, half * signs) for signs in np.ndindex(2, 2, 2)
            for signs in [2 * np.array(signs) - 1]]


@pytest.mark.parametrize("seed", range(3))
def test_no_link_ever_leaves_its_box(world, make, seed):
    shape = make.box("0.3 0.1 0.2", "0.1 -0.2 0.05")
    text = tree_xml(make, seed).replace("</inertial></link>", f"</inertial>{shape}</link>")
    rng = np.random.default_rng(seed)
    model = world.spawn(parse_urdf(text.replace("10.0", "0.6")), "m", ROOT)
    boxes = collision_filters.compute_reach(model)
    assert set(boxes) == set(model.link_names) - {"world"}
    for _ in range(40):
        model.set_joint_positions({j: rng.uniform(-0.6, 0.6) for j in model.joint_names})
        for link, (low, high) in boxes.items():
            at = model.link_pose(link)
            found = [at.apply(tuple(one)) for one in corners((0.3, 0.1, 0.2), (0.1, -0.2, 0.05))]
            assert (np.array(found) >= low).all() and (np.array(found) <= high).all(), link


def test_a_box_holds_what_a_slide_and_a_turn_allow_and_no_more(world, make):
    """A slide on a tilted root, a fixed arm on it, what turns at its end, and what slides there."""
    long = make.box("0.4 0.1 0.1", "0.2 0 0")
    text = make.robot(
        '<link name="world"/>', make.link("car"), make.link("arm", shapes=long),
        make.link("bare"), make.link("tip", shapes=long),
        make.joint("rail", "world", "car", "prismatic", "0.1 0.2 0.3", "0 0.6 0.8", -0.5, 1.5),
        make.joint("bolt", "car", "arm", "fixed", "0.3 0 0", rpy="0 0 1.2"),
        make.joint("turn", "arm", "bare", "continuous", "0 0.4 0", "0 0 1"),
        make.joint("boom", "bare", "tip", "prismatic", "0.2 0 0", "1 0 0", -0.4, 0.3))
    model = world.spawn(parse_urdf(text), "m", ROOT)
    boxes = collision_filters.compute_reach(model)
    assert set(boxes) == {"arm", "tip"}
    ends = []
    for q in (-0.5, 1.5):
        model.set_joint_positions({"rail": q})
        ends.append((model.link_pose("arm").xyz, model.link_pose("bare").xyz))
    model.set_joint_positions({"rail": 0.0})
    for link, which, farther in (("arm", 0, 0.0), ("tip", 1, 0.2 + 0.4)):
        one, two = ends[0][which], ends[1][which]
        # As far as the box around the shape as it stands reaches from the link's origin.
        at = model.link_pose(link)
        shape = np.array([at.apply(tuple(c)) for c in corners((0.4, 0.1, 0.1), (0.2, 0, 0))])
        about = np.linalg.norm(np.abs(shape - at.xyz).max(axis=0)) + farther
        assert boxes[link].low == pytest.approx(np.minimum(one, two) - about, abs=2 * HULL)
        assert boxes[link].high == pytest.approx(np.maximum(one, two) + about, abs=2 * HULL)


def test_gaps_between_boxes_and_above_slopes():
    box = collision_filters.BoundingBox((1, 2, 3), (1.5, 4, 3.2))
    other = collision_filters.BoundingBox((-1, 0, 3.1), (0.7, 3, 9))
    assert box.gap(other) == pytest.approx(0.3) and other.gap(box) == pytest.approx(0.3)
    slope = collision_filters.HalfSpace((0.0, 0.0, 1.0), (0.6, 0.0, -0.8))
    assert slope.gap(box) == pytest.approx(0.6 * 1.0 - 0.8 * (3.2 - 1.0))


def test_solids_are_the_shapes_of_the_links_that_are_asked_for(world, make):
    """A tilted plane on one link, a box on another; what has no shape is none."""
    plane = '<collision><origin xyz="0 0 0.5" rpy="0.3 0 0"/><geometry><plane normal="0 1 0"/>' \
        "</geometry></collision>"
    text = make.robot(
        '<link name="world">', plane, "</link>",
        make.link("arm", shapes=make.box("0.2 0.4 0.6")), make.link("bare"),
        make.joint("turn", "world", "arm", "continuous", "0 0 2"),
        make.joint("more", "arm", "bare", "continuous", "0 0 2"))
    model = world.spawn(parse_urdf(text), "m", Pose.from_rpy((1.0, 2.0, 3.0), (0, 0, 0.7)))
    index = model.link_indices
    (half,) = collision_filters.find_solids(model, [-1, index["bare"]])
    assert half.point == pytest.approx((1.0, 2.0, 3.5))
    assert half.normal == pytest.approx(
        (-math.sin(0.7) * math.cos(0.3), math.cos(0.7) * math.cos(0.3), math.sin(0.3)))
    (arm,) = collision_filters.find_solids(model, [index["arm"]])
    c, s = math.cos(0.7), math.sin(0.7)
    half = (0.1 * c + 0.2 * s, 0.1 * s + 0.2 * c, 0.3)
    assert arm.low == pytest.approx(np.subtract((1, 2, 5), half), abs=2 * HULL)
    assert arm.high == pytest.approx(np.add((1, 2, 5), half), abs=2 * HULL)


def test_what_may_meet_touches_a_root_or_what_another_s_joints_reach(world, make):
    post = make.robot(f'<link name="world">{make.box("0.2 0.2 0.2")}</link>',
                      make.link("car", shapes=make.box("0.2 0.2 0.2")),
                      make.joint("rail", "world", "car", "prismatic", "0 5 0", "1 0 0", -1.0, 2.0))
    planes = "".join(f'<collision><geometry><plane normal="{x} 0 0.8"/></geometry></collision>'
                     for x in (0.6, -0.6))
    groove = make.robot(f'<link name="world">{planes}</link>')
    for text, at, ever in (
        (post, (0.15, 0.0, 0.0), True), (post, (0.3, 0.0, 0.0), False),
        (post, (2.1, 5.0, 0.0), True), (post, (-0.9, 5.0, 0.1), True),
        (post, (3.0, 5.0, 0.0), False), (groove, (-3.0, 0.0, 1.1), True),
        (groove, (3.0, 0.0, 1.1), True), (groove, (0.0, 0.0, 1.1), False)):
        model = world.spawn(parse_urdf(text), "m")
        box = collision_filters.BoundingBox(tuple(v - 0.1 for v in at), tuple(v + 0.1 for v in at))
        far = collision_filters.BoundingBox((9, 9, 99), (9, 9, 99))
        assert reach.can_meet([far, box], model) is ever
        world.delete("m")
