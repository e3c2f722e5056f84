"""Small mechanisms for the tests of the world."""

import subprocess
import sys
from pathlib import Path

import pybullet
import pytest

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import World

HERE = str(Path(__file__).resolve().parent)
for folder in (HERE, str(Path(HERE).parent / "as_new")):  # the latter for recorded_values.py
    if folder not in sys.path:
        sys.path.insert(0, folder)


def link_xml(name: str, mass: float = 1.0, com: str = "0 0 0",
             inertia: tuple = (0.1, 0.1, 0.1, 0.0, 0.0, 0.0), shapes: str = "") -> str:
    """Return a <link>; inertia is (ixx, iyy, izz, ixy, ixz, iyz)."""
    ixx, iyy, izz, ixy, ixz, iyz = inertia
    return (f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/>'
            f"</inertial>{shapes}</link>")


def joint_xml(name: str, parent: str, child: str, kind: str = "revolute", xyz: str = "0 0 0",
              axis: str = "0 1 0", lower: float = -10.0, upper: float = 10.0,
              effort: float = 1000.0, damping: float = 0.0, friction: float = 0.0,
              rpy: str = "0 0 0", extra: str = "") -> str:
    inside = "" if kind == "fixed" else (
        f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="{effort}" '
        f'velocity="100"/><dynamics damping="{damping}" friction="{friction}"/>'
    )
    return (f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<parent link="{parent}"/><child link="{child}"/>{inside}{extra}</joint>')


def box_xml(size: str, origin: str = "0 0 0", collide: bool = True) -> str:
    """Return a visual box and, if `collide`, an equal collision box."""
    body = f'<origin xyz="{origin}"/><geometry><box size="{size}"/></geometry>'
    return f"<visual>{body}</visual>" + (f"<collision>{body}</collision>" if collide else "")


def robot_xml(*parts: str, name: str = "robot") -> str:
    return f'<?xml version="1.0"?><robot name="{name}">' + "".join(parts) + "</robot>"


def pendulum_xml(damping: float = 0.0, friction: float = 0.0, mass: float = 1.0,
                 length: float = 0.5, inertia: float = 0.01, kind: str = "continuous",
                 lower: float = -3.0, upper: float = 3.0, name: str = "pendulum") -> str:
    """Return a compound pendulum about y that hangs along -z from the world."""
    return robot_xml(
        '<link name="world"/>',
        link_xml("bob", mass, f"0 0 {-length}", (inertia, inertia, inertia, 0, 0, 0)),
        joint_xml("swing", "world", "bob", kind, lower=lower, upper=upper, damping=damping,
                  friction=friction),
        name=name,
    )


def rotor_xml(damping: float = 0.0, friction: float = 0.0, inertia: float = 0.01) -> str:
    """Return a balanced wheel about z, which has inertia but no torque of gravity."""
    return robot_xml(
        '<link name="world"/>', link_xml("wheel", 1.0, "0 0 0", (inertia,) * 3 + (0, 0, 0)),
        joint_xml("spin", "world", "wheel", "continuous", axis="0 0 1", damping=damping,
                  friction=friction),
    )


@pytest.fixture(scope="session", autouse=True)
def another_world():
    """Occupy Bullet's first client, so that calls without a client id fail."""
    first = pybullet.connect(pybullet.DIRECT)
    yield
    pybullet.disconnect(first)


@pytest.fixture
def world():
    with World() as it:
        yield it


@pytest.fixture
def ground(world):
    return world.spawn_ground_plane()


@pytest.fixture
def window(monkeypatch):
    """Bullet's window without a display, in which Bullet makes all steps; what is configured."""
    connect, configured = pybullet.connect, []
    monkeypatch.setattr(pybullet, "connect", lambda mode: connect(pybullet.DIRECT))
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: subprocess.CompletedProcess((), 0))
    monkeypatch.setattr(pybullet, "configureDebugVisualizer",
                        lambda what, on, physicsClientId: configured.append((what, bool(on))))
    return configured


def block(size, mass=1.0, tags="", at="0 0 0", link="block"):
    """Return a solid box of x, y, z m, whose middle is `at`; fixed if its link is 'world'."""
    x, y, z = size
    still = [mass / 12 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y))]
    shape = box_xml(f"{x} {y} {z}", at)
    body = f'<link name="world">{shape}</link>' if link == "world" else link_xml(
        link, mass, at, (*still, 0, 0, 0), shape)
    return parse_urdf(robot_xml(body, f'<gazebo reference="{link}">{tags}</gazebo>'))


def ball(radius=0.05, mass=1.0, gravity=True, tags=""):
    shape = f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'
    return parse_urdf(robot_xml(
        link_xml("ball", mass, "0 0 0", (0.4 * mass * radius**2,) * 3 + (0, 0, 0), shape),
        f'<gazebo reference="ball"><gravity>{int(gravity)}</gravity>{tags}</gazebo>'))


def step(world, count, model=None, **efforts):
    """Make steps of a World or Simulation under constant efforts of a model's joints."""
    for _ in range(count):
        for joint, effort in efforts.items():
            model.apply_effort(joint, effort)
        world.step()


class Mechanisms:
    """The functions of this file, for tests (fixture `make`)."""

    link, joint, box, robot = (staticmethod(f) for f in (link_xml, joint_xml, box_xml, robot_xml))
    pendulum, rotor, block, ball, step = (
        staticmethod(f) for f in (pendulum_xml, rotor_xml, block, ball, step))


@pytest.fixture(scope="session")
def make() -> type[Mechanisms]:
    return Mechanisms
