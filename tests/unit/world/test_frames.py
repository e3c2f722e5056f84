"""Link frames, twists and state of a model: URDF frames, not centres of mass."""

import math

import numpy as np
import pytest
from test_joint_dynamics import tree_xml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist, World

POSE = Pose.from_rpy((1.0, -2.0, 3.0), (0.3, -0.4, 0.5))


def xml(make, base="0.1 0.2 -0.3"):
    """A free body with an offset, tilted inertia, and an arm on it."""
    tilted = (0.3, 0.4, 0.5, 0.05, -0.04, 0.03)
    return make.robot(
        make.link("hull", 3.0, base, tilted), make.link("arm", 1.0, "0.05 -0.1 0.4", tilted),
        make.link("tip", 0.2, "0 0 0.01", (0.01,) * 3 + (0, 0, 0)),
        make.joint("turn", "hull", "arm", "continuous", xyz="0.2 0 0.5", rpy="0.1 0.2 0.3",
                   axis="1 2 3"),
        make.joint("fix", "arm", "tip", "fixed", xyz="0 0.3 0.8", rpy="3.14 -1.57 0"),
    )


def transform(xyz, rpy, axis=(0, 0, 1), angle=0.0):
    """(4, 4) of a joint, written out independently of the code under test."""
    def about(unit, a):
        k = np.cross(np.eye(3), unit)
        return np.eye(3) + math.sin(a) * k + (1 - math.cos(a)) * k @ k

    result = np.eye(4)
    result[:3, :3] = (about((0, 0, 1), rpy[2]) @ about((0, 1, 0), rpy[1])
                      @ about((1, 0, 0), rpy[0]) @ about(axis, angle))
    result[:3, 3] = xyz
    return result


def test_link_frames_are_those_of_the_urdf(world, make):
    model = world.spawn(parse_urdf(xml(make)), "m", POSE, {"turn": 0.7})
    axis = np.array((1, 2, 3)) / math.sqrt(14)
    hull = transform((1.0, -2.0, 3.0), (0.3, -0.4, 0.5))
    arm = hull @ transform((0.2, 0, 0.5), (0.1, 0.2, 0.3), axis, 0.7)
    tip = arm @ transform((0, 0.3, 0.8), (3.14, -1.57, 0))
    for name, expected in (("hull", hull), ("arm", arm), ("tip", tip)):
        np.testing.assert_allclose(model.link_pose(name).matrix(), expected, atol=1e-12)
    assert list(model.link_states()) == ["hull", "arm", "tip"]
    asked = (lambda: model.link_state("arm")[0], lambda: model.link_states()["arm"][0],
             lambda: Pose(*(values[0] for values in model.read_link_frames(("arm",)))))
    for turned, ask in zip((-1.1, 0.4, 2.0), asked, strict=True):  # no step is made
        model.set_joint_positions({"turn": turned})
        arm = hull @ transform((0.2, 0, 0.5), (0.1, 0.2, 0.3), axis, turned)
        np.testing.assert_allclose(ask().matrix(), arm, atol=1e-6)
    assert model.pose().xyz == pytest.approx((1, -2, 3), abs=1e-15)


def test_twists_agree_with_finite_differences(make):
    with World(time_step=1e-4) as world:
        model = world.spawn(parse_urdf(xml(make)), "m", POSE, {"turn": 0.7})
        model.set_twist(Twist((0.3, -0.2, 1.0), (0.5, 1.0, -2.0)))
        assert model.twist().linear == pytest.approx((0.3, -0.2, 1.0))
        assert model.twist().angular == pytest.approx((0.5, 1.0, -2.0))
        make.step(world, 100, model, turn=5.0)
        before = {n: s[0].matrix() for n, s in model.link_states().items()}
        twists = [model.link_states()]
        world.step()
        after = {n: s[0].matrix() for n, s in model.link_states().items()}
        twists.append(model.link_states())
        for name in before:
            mean = [np.mean([t[name][1][k] for t in twists], axis=0) for k in (0, 1)]
            linear = (after[name][:3, 3] - before[name][:3, 3]) / 1e-4
            turn = (after[name][:3, :3] @ before[name][:3, :3].T - np.eye(3)) / 1e-4
            angular = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                                turn[1, 0] - turn[0, 1])) / 2
            np.testing.assert_allclose(mean[0], linear, atol=2e-3)
            np.testing.assert_allclose(mean[1], angular, atol=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_a_bolted_model_s_own_link_frames_are_bullet_s(world, make, seed):
    rng = np.random.default_rng(seed)
    root = Pose.from_rpy(tuple(rng.uniform(-2, 2, 3)), tuple(rng.uniform(-3, 3, 3)))
    model = world.spawn(parse_urdf(tree_xml(make, seed)), "m", root, fixed_base=True)
    names = tuple(n for n in model.link_names if n != model.description.root)
    for moved in (root, Pose.from_rpy((0.4, 5.0, -1.0), (1.0, -0.2, 3.0))):
        model.set_pose(moved)
        model.set_joint_positions({j: rng.uniform(-2, 2) for j in model.joint_names})
        assert model.joints.has_own_dynamics
        own = {name: model.link_pose(name) for name in model.link_names}
        for name, *frame in zip(names, *model.read_link_frames(names), strict=True):
            assert tuple(map(tuple, frame)) == own[name]
        (place,), _ = model.read_link_frames(names[3:4])
        assert tuple(place) == own[names[3]].xyz
        model.joints.set_own_dynamics(False)
        for name, pose in own.items():
            bullet_s = model.link_pose(name).matrix()
            np.testing.assert_allclose(pose.matrix(), bullet_s, atol=1e-12)
            assert np.linalg.norm(pose.quat) == pytest.approx(1.0, abs=1e-14)
        assert model.pose() == moved
        model.joints.set_own_dynamics(True)


TURN = {"axis": "0 0.6 0.8", "xyz": "0.2 0 0.5"}


def described(make, root="hull"):
    """Fixed links at the root and on what a joint moves, in no order."""
    hull = f'<link name="{root}"/>' if root == "world" else make.link(
        root, 5.0, "0.1 -0.2 0.05", (0.3, 0.4, 0.5, 0.02, -0.03, 0.01))
    return parse_urdf(make.robot(
        make.link("tip", 0.5), make.link("arm", 1.0, "0.1 0 0.2"), make.link("bolt", 0.25), hull,
        make.link("nut", 0.125), make.joint("f3", "bolt", "nut", "fixed", "0 0 0.1"),
        make.joint("f1", "arm", "tip", "fixed", "0 0.3 0"),
        make.joint("f2", root, "bolt", "fixed", "0.1 0 0"),
        make.joint("turn", root, "arm", "continuous", damping=0.2, **TURN)))


@pytest.mark.parametrize("root", ["hull", "world"])
def test_its_base_is_known_and_its_state_goes_on_where_it_is_loaded_anew(world, make, root):
    world.set_physics(gravity=(0.0, 0.0, 0.0))
    model = world.spawn(described(make, root), "m", POSE)
    names = {index: name for name, index in model.link_indices.items()}
    assert {names[index] for index in model.list_base_links()} == {root, "bolt", "nut"}
    assert model.mass == pytest.approx(1.875 + (5.0 if root == "hull" else 0.0))
    assert names[-1] == root and model.link_index("tip") == model.link_indices["tip"]
    model.set_twist(Twist((0.1, 0.2, 0.3), (0.4, 0.5, -0.6)))
    model.joints.restore([(0.7, 2.0)])
    make.step(world, 3)
    before, state = model.link_states(), model.joints.read_states()[0]
    model.rebuild(model.description)
    assert model.joints.read_states()[0] == pytest.approx(state)
    for name, (pose, twist) in model.link_states().items():
        np.testing.assert_allclose(pose.matrix(), before[name][0].matrix(), atol=1e-6)
        np.testing.assert_allclose(np.ravel(twist), np.ravel(before[name][1]), atol=1e-5)
    assert any(before["tip"][1].linear)


def test_what_has_no_joints_and_all_its_weight_needs_nothing_before_a_step(world, make):
    light = '<gazebo reference="b"><gravity>false</gravity></gazebo>'
    plain = make.link("a") + make.link("b") + make.joint("f", "a", "b", "fixed", "0 1 0")
    still, floats, jointed = (world.spawn(parse_urdf(text), str(k), Pose((0.0, 3.0 * k, 1.0)))
                              for k, text in enumerate((
                                  make.robot(plain), make.robot(plain, light),
                                  make.robot(plain.replace("fixed", "continuous")))))
    assert [m.needs_steps for m in (still, floats, jointed)] == [False, True, True]
    world.step()
    assert still.twist().linear[2] == pytest.approx(-9.8e-3)
    # One of two kilograms weighs nothing: it tips about what they share, half a metre off.
    tips = 9.8e-3 * 0.5 / (2 * 0.1 + 2 * 0.25)
    assert floats.twist().angular[0] == pytest.approx(tips, rel=1e-6)
    assert floats.twist().linear[2] == pytest.approx(-4.9e-3 - 0.5 * tips, rel=1e-3)
