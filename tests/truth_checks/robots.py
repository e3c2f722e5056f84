"""Robots of the checks, each as a model of the bridge, of Pinocchio and of MuJoCo."""

from __future__ import annotations

import re
import sysconfig
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio

from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.world import Pose, World

SOURCES = Path(__file__).parents[2] / "src"
SHIPPED = SOURCES / "aras_visual_servo_gazebo" / "robots" / "aras_visual_servo.urdf"
FOREIGN = Path(sysconfig.get_paths()["purelib"], "cmeel.prefix/share/example-robot-data/robots")
GRAVITY = (0.0, 0.0, -9.8)
_FILES = {
    "shipped arm": SHIPPED,
    "UR5": FOREIGN / "ur_description/urdf/ur5_robot.urdf",
    "Panda": FOREIGN / "panda_description/urdf/panda.urdf",
}
ARMS = tuple(_FILES)
_LINK = """<link name="{name}"><inertial><origin xyz="{com}" rpy="{rpy}"/><mass value="{mass}"/>
<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/></inertial></link>"""
_JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
<limit lower="-3" upper="3" effort="1e3" velocity="1e3"/></joint>"""


def bare_urdf(name: str) -> str:
    """Return the URDF with masses and joints only; 'free arm' has a free base."""
    root = ElementTree.fromstring(_free_arm() if name == "free arm" else _FILES[name].read_text())
    for link in root.findall("link"):
        for part in (*link.findall("visual"), *link.findall("collision")):
            link.remove(part)
    for tag in ("gazebo", "transmission", "material"):
        for element in root.findall(tag):
            root.remove(element)
    return ElementTree.tostring(root, encoding="unicode")


def _free_arm() -> str:
    """Return a base of 5 kg with an elbow of two links on one side and a slide on the other."""
    links = (("base", "0.02 -0.01 0.03", "0.2 0.1 0.3", 5.0, 0.08, 0.1, 0.12, 0.01, -0.005, 0.008),
             ("upper", "0.1 0.02 -0.01", "0.3 0 0.1", 1.2, 0.008, 0.02, 0.019, 0.001, 0.0, 0.002),
             ("lower", "0.15 0 0.03", "0 0.5 0", 0.8, 0.002, 0.011, 0.01, 0.0, 0.001, 0.0),
             ("slide", "0 0.05 0.2", "0 0 0", 0.6, 0.009, 0.008, 0.002, 0.0, 0.0, 0.001))
    joints = (("shoulder", "revolute", "base", "upper", "0.1 0.2 0.05", "0.4 0.2 0", "0 1 0.2"),
              ("elbow", "revolute", "upper", "lower", "0.3 0 0", "0 0 0.7", "0.1 1 0"),
              ("rail", "prismatic", "base", "slide", "-0.2 0 0.1", "0.3 0 0", "0 0.3 1"))
    keys = ("name", "com", "rpy", "mass", "xx", "yy", "zz", "xy", "xz", "yz")
    parts = [_LINK.format(**dict(zip(keys, link, strict=True))) for link in links]
    keys = ("name", "kind", "parent", "child", "xyz", "rpy", "axis")
    parts += [_JOINT.format(**dict(zip(keys, joint, strict=True))) for joint in joints]
    return f'<robot name="free_arm">{"".join(parts)}</robot>'


class Robot:
    """One robot as three models: `model` in a separate World, `pin` and `mj`, without friction,
    damping and contacts. Joint vectors are in the order of `names`.

    free: it floats; the state is then the root's pose and twist, too.
    """

    def __init__(self, name: str, time_step: float = 1e-3) -> None:
        xml = bare_urdf(name)
        self.free = name == "free arm"
        description = without_losses(parse_urdf(xml))
        self.world = World(time_step, GRAVITY)
        self.model = self.world.spawn(description, "robot", fixed_base=not self.free)
        self.names = self.model.joint_names
        self._build_pinocchio(xml)
        self._build_mujoco(xml)

    def _build_pinocchio(self, xml: str) -> None:
        free = (pinocchio.JointModelFreeFlyer(),) if self.free else ()
        self.pin = pinocchio.buildModelFromXML(xml, *free)
        self.pin.gravity.linear = np.array(GRAVITY)
        self.data = self.pin.createData()
        joints = [self.pin.joints[self.pin.getJointId(name)] for name in self.names]
        self.pin_q = [(j.idx_q, j.nq) for j in joints]
        self.pin_v = [j.idx_v for j in joints]

    def _build_mujoco(self, xml: str) -> None:
        compiler = '<mujoco><compiler discardvisual="true" boundmass="0"/></mujoco>'
        text = re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", xml, count=1)
        spec = mujoco.MjSpec.from_string(text)
        if self.free:
            spec.worldbody.first_body().add_freejoint()
        self.mj = spec.compile()
        self.mj.opt.gravity[:] = GRAVITY
        self.mj.dof_damping[:] = 0.0
        self.mj.dof_frictionloss[:] = 0.0
        self.mj.jnt_limited[:] = 0
        self.mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY  # Panda has a mimic joint
        self.mj_data = mujoco.MjData(self.mj)
        ids = [mujoco.mj_name2id(self.mj, mujoco.mjtObj.mjOBJ_JOINT, n) for n in self.names]
        self.mj_q = [self.mj.jnt_qposadr[i] for i in ids]
        self.mj_v = [self.mj.jnt_dofadr[i] for i in ids]

    def close(self) -> None:
        self.world.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ------------------------------------------------------------------ bridge

    def set_state(self, q: Sequence[float], v: Sequence[float]) -> None:
        self.model.joints.restore(list(zip(map(float, q), map(float, v), strict=True)))

    def step(self, efforts: Sequence[float]) -> np.ndarray:
        """Return the joint accelerations (n,) of the bridge's model over one step."""
        before = np.array(self.model.read_joints()[1])
        for name, effort in zip(self.names, efforts, strict=True):
            self.model.apply_effort(name, float(effort))
        self.world.step()
        return (np.array(self.model.read_joints()[1]) - before) / self.world.time_step

    # ------------------------------------------------------------------ Pinocchio

    def pin_state(self, q: Sequence[float], pose: Pose = Pose()) -> np.ndarray:  # noqa: B008
        full = pinocchio.neutral(self.pin)
        if self.free:
            full[:7] = [*pose.xyz, *pose.quat]
        for (start, size), value in zip(self.pin_q, q, strict=True):
            full[start : start + size] = [value] if size == 1 else [np.cos(value), np.sin(value)]
        return full

    def pin_vector(self, v: Sequence[float]) -> np.ndarray:
        """Return joint values in Pinocchio's order, with 0 for other joints."""
        full = np.zeros(self.pin.nv)
        full[self.pin_v] = v
        return full


def without_losses(description: RobotDescription) -> RobotDescription:
    joints = {
        name: replace(joint, damping=0.0, friction=0.0, mimic=None,
                      kind="continuous" if joint.kind == "revolute" else joint.kind,
                      limits=None if joint.limits is None else
                      replace(joint.limits, lower=-1e3, upper=1e3, velocity=1e9))
        if joint.is_movable else joint
        for name, joint in description.joints.items()
    }
    return replace(description, joints=MappingProxyType(joints))
