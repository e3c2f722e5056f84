"""Robots for the tests of the world: the ARAS figures as boxes, and small mechanisms."""

import math
import sys
from pathlib import Path

import pybullet
import pytest

HERE = str(Path(__file__).resolve().parent)
if HERE not in sys.path:
    sys.path[:0] = [HERE, str(Path(HERE).parent / "as_new")]  # its object_state.py

# name: kind, parent, child, xyz, rpy, axis, lower, upper, effort, damping, friction
ARAS_JOINTS = (
    ("gantry", "prismatic", "base_link", "slider", "0 0 1.6263", "1.5708 0 -1.5708", "0 0 -1",
     -1.5, 1.5, 80000, 0.8, 0.5),
    ("J0", "fixed", "slider", "link0", "0 -0.02888 0", "-1.5708 0 3.1416", "", 0, 0, 0, 0, 0),
    ("J1", "revolute", "link0", "link1", "0 0 0.168", "0 0 0", "0 0 1",
     -2.0943, 2.0943, 50000, 0.7, 0.9),
    ("J2", "revolute", "link1", "link2", "0 0 0.132", "0 0 0", "0 1 0",
     -2.0943, 2.0943, 50000, 0.1, 0.9),
    ("J3", "revolute", "link2", "link3", "0 0 0.25", "0 0 0", "0 1 0",
     -2.0943, 2.0943, 50000, 0.9, 0.9),
    ("J5", "revolute", "link3", "link5", "0 0 0.16", "0 0 3.1416", "0 -1 0",
     -2.0943, 2.0943, 50000, 0.9, 0.9),
    ("J6", "revolute", "link5", "link6", "0 0 0.0718", "0 0 -3.1416", "0 0 1",
     -3000, 3000, 50000, 0.1, 0.9),
    ("camera_joint", "fixed", "link6", "camera_link", "0 0 0.0334", "3.14 -1.57 0", "",
     0, 0, 0, 0, 0),
    ("J01", "fixed", "base_link", "planar_object", "0 0 0.59", "1.5708 0 -1.5708", "",
     0, 0, 0, 0, 0),
)
# name: mass, com, (ixx, iyy, izz, ixy, ixz, iyz), box size, box centre
ARAS_LINKS = (
    ("base_link", 1729.39, "0.01605 0.38072 -0.00071",
     (475.397, 1072.78, 1103.62, 34.566, -1.799, -1.692), "2.63 1.36 0.59", "0.115 0 0.295"),
    ("slider", 1.5957, "0 -0.0079955 -0.00255",
     (0.0042058, 0.0076559, 0.0044974, 0, 0, 0), "0.1524 0.061 0.1524", "0 0 0"),
    ("link0", 5.272, "-0.03889 0 0.07653",
     (0.021924, 0.032682, 0.030507, 0, 0.0018667, 0), "0.251 0.186 0.168", "-0.04 0 0.084"),
    ("link1", 2.2792, "-0.007172 0 0.080508",
     (0.0091615, 0.0096145, 0.0051301, 0, 0, 0), "0.155 0.155 0.19", "0 0 0.1"),
    ("link2", 3.6544, "-0.00045943 0 0.11501",
     (0.039615, 0.02958, 0.015467, 0, 0, 0), "0.124 0.176 0.36", "0 0 0.118"),
    ("link3", 1.6841, "0 -0.0003295 0.069078",
     (0.0082866, 0.0076034, 0.0027866, 0, 0, 0), "0.095 0.116 0.25", "0 0 0.077"),
    ("link5", 1.32285, "0 0 -0.0052055",
     (0.00029998, 0.00041146, 0.00021741, 0, 0, 0), "0.084 0.044 0.103", "0 0 -0.005"),
    ("link6", 0.3641, "0 0 0.0076492",
     (0.00031783, 0.0003178, 0.00043046, 0, 0, 0), "0.09 0.09 0.059", "0 0 0.003"),
    ("camera_link", 0.1, "0 0 0", (1e-6, 1e-6, 1e-6, 0, 0, 0), "0.01 0.09 0.09", "0 0 0"),
    ("planar_object", 1.0, "0 0 0", (2e-4, 4e-4, 2e-4, 0, 0, 0), "0.05 0.001 0.05", "0 0 0"),
)
ARAS_GAINS = {  # joint: p, i, d, i_clamp
    "gantry": (15000.0, 5.0, 400.0, 1000.0),
    "J1": (3000.0, 40.0, 40.0, 1000.0),
    "J2": (7000.0, 1000.0, 165.0, 1000.0),
    "J3": (4000.0, 200.0, 0.0, 1000.0),
    "J5": (3500.0, 150.0, 0.0, 1000.0),
    "J6": (70.0, 2.0, 0.0, 1000.0),
}


def link_xml(name: str, mass: float = 1.0, com: str = "0 0 0",
             inertia: tuple = (0.1, 0.1, 0.1, 0.0, 0.0, 0.0), shapes: str = "") -> str:
    """A <link>; inertia is (ixx, iyy, izz, ixy, ixz, iyz)."""
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/>'
        f"</inertial>{shapes}</link>"
    )


def joint_xml(name: str, parent: str, child: str, kind: str = "revolute", xyz: str = "0 0 0",
              axis: str = "0 1 0", lower: float = -10.0, upper: float = 10.0,
              effort: float = 1000.0, damping: float = 0.0, friction: float = 0.0,
              rpy: str = "0 0 0", extra: str = "") -> str:
    """A <joint>."""
    inside = "" if kind == "fixed" else (
        f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="{effort}" '
        f'velocity="100"/><dynamics damping="{damping}" friction="{friction}"/>'
    )
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/>{inside}{extra}</joint>'
    )


def box_xml(size: str, origin: str = "0 0 0", collide: bool = True) -> str:
    """A visual box, and the same as collision."""
    body = f'<origin xyz="{origin}"/><geometry><box size="{size}"/></geometry>'
    return f"<visual>{body}</visual>" + (f"<collision>{body}</collision>" if collide else "")


def robot_xml(*parts: str, name: str = "robot") -> str:
    """A <robot> of the parts."""
    return f'<?xml version="1.0"?><robot name="{name}">' + "".join(parts) + "</robot>"


def pendulum_xml(damping: float = 0.0, friction: float = 0.0, mass: float = 1.0,
                 length: float = 0.5, inertia: float = 0.01, kind: str = "continuous",
                 lower: float = -3.0, upper: float = 3.0, name: str = "pendulum") -> str:
    """A compound pendulum about y, hanging along -z from the world."""
    return robot_xml(
        '<link name="world"/>',
        link_xml("bob", mass, f"0 0 {-length}", (inertia, inertia, inertia, 0, 0, 0)),
        joint_xml("swing", "world", "bob", kind, lower=lower, upper=upper, damping=damping,
                  friction=friction),
        name=name,
    )


def rotor_xml(damping: float = 0.0, friction: float = 0.0, inertia: float = 0.01) -> str:
    """A balanced wheel about z: inertia only, no gravity torque."""
    return robot_xml(
        '<link name="world"/>', link_xml("wheel", 1.0, "0 0 0", (inertia,) * 3 + (0, 0, 0)),
        joint_xml("spin", "world", "wheel", "continuous", axis="0 0 1", damping=damping,
                  friction=friction),
    )


def aras_xml(tags: str = "") -> str:
    """The ARAS robot with boxes for meshes."""
    parts = [
        link_xml(name, mass, com, inertia, box_xml(size, centre))
        for name, mass, com, inertia, size, centre in ARAS_LINKS
    ]
    parts += [
        joint_xml(name, parent, child, kind, xyz, axis, lower, upper, effort, damping, friction,
                  rpy)
        for name, kind, parent, child, xyz, rpy, axis, lower, upper, effort, damping, friction
        in ARAS_JOINTS
    ]
    return robot_xml(*parts, tags, name="aras_visual_servo")


@pytest.fixture(scope="session", autouse=True)
def another_world():
    """Bullet's first client is somebody else's: what forgets to say which one it means fails."""
    first = pybullet.connect(pybullet.DIRECT)
    yield
    pybullet.disconnect(first)


class Mechanisms:
    """The builders above, for tests (fixture `make`)."""

    link, joint, box, robot = (staticmethod(f) for f in (link_xml, joint_xml, box_xml, robot_xml))
    pendulum, rotor, aras = (staticmethod(f) for f in (pendulum_xml, rotor_xml, aras_xml))
    gains = ARAS_GAINS
    start = {"gantry": 0.1, "J1": 0.0, "J2": math.radians(10), "J3": math.radians(-5),
             "J5": math.radians(-5), "J6": 0.0}


@pytest.fixture(scope="session")
def make() -> type[Mechanisms]:
    """Builders of URDF texts."""
    return Mechanisms
