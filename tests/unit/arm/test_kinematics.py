"""Compiled kinematics, compared with Pinocchio, for very different kinematic chains."""

import numpy as np
import pinocchio
import pytest

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.urdf import Joint, JointLimits
from aras_visual_servo_controller.kinematics import Arm

LIMITS = JointLimits(-3.0, 3.0, 5.0, 10.0)


def joint(draw, name, parent, child, kind):
    """A joint aslant, with a skew axis."""
    axis = draw.normal(size=3) * [1, 2, 1]
    return Joint(
        name, kind, parent, child, tuple(draw.uniform(-0.5, 0.5, 3)), tuple(draw.uniform(-2, 2, 3)),
        tuple(axis / np.linalg.norm(axis)), None if kind == "fixed" else LIMITS,
    )  # fmt: skip


def paths(draw, kinds, target_kinds, shared):
    """Joints from the base to the camera, and to a target that branches off after some of them."""
    camera = [joint(draw, f"c{k}", f"l{k}" if k else "base", f"l{k + 1}", kind)
              for k, kind in enumerate(kinds)]  # fmt: skip
    target = camera[:shared] if target_kinds else []
    for k, kind in enumerate(target_kinds):
        parent = target[-1].child if target else "base"
        target = [*target, joint(draw, f"t{k}", parent, f"m{k}", kind)]
    return camera, target


def oracle(path, names, q, locked):
    """Pose (4, 4) and Jacobian (6, n) in its own frame of the end of a path, by Pinocchio."""
    model, ids, parent, place = pinocchio.Model(), {}, 0, pinocchio.SE3.Identity()
    for one in path:
        place = place * pinocchio.SE3(matrix_from_xyz_rpy(one.origin_xyz, one.origin_rpy))
        axis = np.array(one.axis)
        if one.kind == "fixed":
            continue
        if one.name not in names:
            twist = np.zeros(6)
            twist[slice(0, 3) if one.kind == "prismatic" else slice(3, 6)] = axis * locked[one.name]
            place = place * pinocchio.exp6(twist)
            continue
        kind = (pinocchio.JointModelPrismaticUnaligned if one.kind == "prismatic"
                else pinocchio.JointModelRevoluteUnaligned)  # fmt: skip
        ids[one.name] = parent = model.addJoint(parent, kind(axis), place, one.name)
        place = pinocchio.SE3.Identity()
    if not ids:  # Pinocchio crashes on a model that does not move
        return place, np.zeros((6, len(names)))
    frame = model.addFrame(pinocchio.Frame("end", parent, place, pinocchio.FrameType.OP_FRAME))
    data, inner = model.createData(), np.zeros(model.nv)
    for name, number in ids.items():
        inner[model.joints[number].idx_v] = q[names.index(name)]
    pinocchio.computeJointJacobians(model, data, inner)
    found = pinocchio.getFrameJacobian(model, data, frame, pinocchio.LOCAL)
    jacobian = np.zeros((6, len(names)))
    for name, number in ids.items():
        jacobian[:, names.index(name)] = found[:, model.joints[number].idx_v]
    return pinocchio.updateFramePlacement(model, data, frame), jacobian


@pytest.mark.parametrize(("kinds", "target_kinds", "shared", "joints", "locked"), [
    (("revolute", "prismatic", "fixed", "continuous", "revolute"), (), 0, None, {}),
    (("fixed", "revolute", "revolute", "prismatic"), (), 0, ("c3", "c1"), {"c2": 0.7}),
    (("prismatic", "revolute", "revolute"), ("revolute", "fixed", "prismatic"), 1, None, {}),
    (("revolute", "revolute", "fixed"), ("prismatic", "revolute"), 0, ("t1", "c1", "t0", "c0"), {}),
    (("fixed",), ("revolute", "prismatic", "revolute"), 0, None, {}),
], ids=["camera", "chosen", "branch", "apart", "eye to hand"])  # fmt: skip
def test_pose_and_jacobian_are_pinocchio_s(kinds, target_kinds, shared, joints, locked):
    draw = np.random.default_rng(5)
    for _ in range(20):
        camera, target = paths(draw, kinds, target_kinds, shared)
        arm = Arm(camera, target, joints, locked)
        q = draw.uniform(-2.5, 2.5, len(arm))
        pose, jacobian = arm.pose_and_jacobian(q)
        wanted, moving = oracle(camera, arm.names, q, locked)
        if target:
            place, moved = oracle(target, arm.names, q, locked)
            moving = moving - wanted.actInv(place).toActionMatrix() @ moved
            wanted = place.actInv(wanted)
        assert pose == pytest.approx(wanted.homogeneous, abs=1e-13)
        assert jacobian == pytest.approx(moving, abs=1e-13)
        assert arm.pose_and_jacobian(q)[0] is pose and not pose.flags.writeable
        many = np.array([q, draw.uniform(-2.5, 2.5, len(arm))])
        assert (arm.poses(many) == [arm.pose(one) for one in many]).all()


def test_joint_frames_are_those_that_turn_the_camera():
    """A small turn about each axis through its place moves the camera as its column says."""
    draw = np.random.default_rng(8)
    arm = Arm(paths(draw, ("revolute", "prismatic", "revolute"), (), 0)[0])
    q = draw.uniform(-1.0, 1.0, 3)
    places, axes = arm.joint_frames(q)
    pose, jacobian = arm.pose_and_jacobian(q)
    for k in range(3):
        speed = axes[k] if arm.is_prismatic[k] else np.cross(axes[k], pose[:3, 3] - places[k])
        assert pose[:3, :3] @ jacobian[:3, k] == pytest.approx(speed, abs=1e-13)
