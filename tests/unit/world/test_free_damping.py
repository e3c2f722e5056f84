"""Joint damping of robots with a free base: applied by motors or by Bullet."""

import numpy as np
import pinocchio
import pytest
from test_joint_dynamics import tree_xml

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Pose, World


def test_accelerations_by_efforts_of_a_free_body_are_pinocchio_s(make):
    hull = make.link("hull", 4.0, "0.1 -0.2 0.05", (0.3, 0.4, 0.5, 0.02, -0.03, 0.01))
    text = tree_xml(make, 3).replace('<link name="world"/>', hull).replace('"world"', '"hull"')
    reference = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    q = np.linspace(-1.0, 1.3, 8)
    with World() as world:
        model = world.spawn(parse_urdf(text), "m", Pose.from_rpy((1, 2, 3), (0.3, -0.5, 1.0)))
        model.set_joint_positions(dict(zip(model.joint_names, q.tolist(), strict=True)))
        found = model.joints.inverse_inertia()
        joints = [reference.joints[reference.getJointId(name)] for name in model.joint_names]
        configuration = pinocchio.neutral(reference)
        for joint, value in zip(joints, q, strict=True):
            configuration[joint.idx_q:joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)])
        mass = pinocchio.crba(reference, reference.createData(), configuration)
        mass = np.triu(mass) + np.triu(mass, 1).T
        order = [joint.idx_v for joint in joints]
        expected = np.linalg.inv(mass)[np.ix_(order, order)]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * abs(expected).max())


def test_a_free_body_with_a_tensor_that_no_body_has_is_damped_as_any_other(make):
    """Bullet refuses to work with the tensor, and the first step ended with a SystemError."""
    odd = (1e-3, 1e-3, 0.1, 0, 0, 0)
    xml = make.robot(make.link("hull", 5.0), make.link("plate", 1.0, "0 0 0", odd),
                     make.joint("spin", "hull", "plate", "continuous", axis="0 0 1", damping=0.5))
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        model = world.spawn(parse_urdf(xml), "m")
        rates = []
        for _ in range(100):
            model.apply_effort("spin", 1.0)
            world.step()
            rates.append(model.read_joints()[1][0])
        both = 1 / (1 / 0.1 + 1 / 0.1)  # plate against hull
        assert rates[-1] == pytest.approx(2.0 * (1 - np.exp(-0.1 * 0.5 / both)), rel=0.01)
