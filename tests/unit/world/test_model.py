"""Models: notification of changes, and state that is retained when they are reloaded."""

import numpy as np
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, Twist

AT = Pose.from_rpy((1.0, 2.0, 3.0), (0.3, -0.4, 0.5))
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
    model = world.spawn(described(make, root), "m", AT)
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
