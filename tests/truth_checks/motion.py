"""Falling, sliding, resting and swinging bodies, compared with closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pinocchio
from scipy.special import ellipk

from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.world import Model, Pose, Twist, World

from .check import Row, check
from .joints import ArasRobot
from .robots import Robot

G = 9.8
_PENDULUM = """<robot name="pendulum"><link name="world"/><link name="bob"><inertial>
<origin xyz="0 0 -0.5"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="continuous"><parent link="world"/><child link="bob"/>
<axis xyz="0 1 0"/></joint></robot>"""


def _box(size: tuple[float, float, float], mu: float, mass: float = 10.0) -> str:
    x, y, z = size
    ixx, iyy, izz = (mass / 12 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y)))
    return f"""<robot name="box"><link name="box"><inertial><mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="{x} {y} {z}"/></geometry></collision></link>
<gazebo reference="box"><mu1>{mu}</mu1></gazebo></robot>"""


def _round(name: str, shape: str, inertia: tuple[float, float, float], mass: float = 2.0) -> str:
    """Return a link whose axis is along y."""
    ixx, iyy, izz = inertia
    turned = f'<origin rpy="{math.pi / 2} 0 0"/>'
    return f"""<link name="{name}"><inertial>{turned}<mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision>{turned}<geometry><{shape}/></geometry></collision></link>"""


def _cylinder(mass: float, radius: float, length: float) -> tuple[float, float, float]:
    """Compute the principal moments of inertia of a solid cylinder along z, kg m²."""
    across = mass * (3 * radius**2 + length**2) / 12
    return across, across, mass * radius**2 / 2


def _capsule(mass: float, radius: float, length: float) -> tuple[float, float, float]:
    """Compute the principal moments of inertia of a solid capsule; `length` excludes its ends."""
    share = length / (length + 4 / 3 * radius)
    tube, balls = share * mass, (1 - share) * mass
    across = tube * (length**2 / 12 + radius**2 / 4) + balls * (
        0.4 * radius**2 + length**2 / 4 + 3 / 8 * length * radius)
    return across, across, tube * radius**2 / 2 + balls * 0.4 * radius**2


def steps(world: World, count: int) -> None:
    for _ in range(count):
        world.step()


def _on_ground(angle: float = 0.0) -> World:
    """A world with a ground plane that is inclined along x by an angle, rad."""
    world = World(gravity=(G * math.sin(angle), 0.0, -G * math.cos(angle)))
    world.spawn_ground_plane()
    return world


def _speed(model: Model) -> float:
    return math.hypot(*model.twist().linear)


def _way(model: Model) -> float:
    """Return the direction of the horizontal velocity, degrees from x."""
    x, y, _ = model.twist().linear
    return math.degrees(math.atan2(y, x))


@check("elliptic integral (SciPy)", quick=True)
def pendulum() -> Iterator[Row]:
    """Compare the period of a compound pendulum of 0.5 m."""
    for amplitude in (0.1, 0.5, 1.5):
        exact = 4 * math.sqrt(0.26 / (G * 0.5)) * ellipk(math.sin(amplitude / 2) ** 2)
        with World() as world:
            bob = world.spawn(parse_urdf(_PENDULUM), "m", joint_positions={"swing": amplitude})
            angles = []
            for _ in range(round(2.2 * exact / 1e-3)):
                world.step()
                angles.append(bob.read_joints()[0][0])
        angles = np.array(angles)
        rising = np.where((angles[:-1] < 0) & (angles[1:] >= 0))[0]
        crossing = rising - angles[rising] / (angles[rising + 1] - angles[rising])
        period = np.diff(crossing).mean() * 1e-3
        yield Row(f"period at {amplitude} rad", f"{exact:.6f} s", abs(period / exact - 1.0), 2e-5)


@check("closed form", quick=True)
def free_fall() -> Iterator[Row]:
    """Compare the free fall of a box and its rotation without torque, for 1 s."""
    with World() as world:
        box = world.spawn(parse_urdf(_box((0.2, 0.2, 0.2), 1.0)), "m", Pose((0, 0, 100)))
        steps(world, 1000)
        fallen = 100.0 - box.pose().xyz[2]
    yield Row("path after 1 s", "4.9 m plus half a step", abs(fallen - G / 2 * 1.001), 1e-9, "m")


@check("Pinocchio", quick=True)
def energy_and_momentum() -> Iterator[Row]:
    """Check the energy of a swinging UR5 and the momentum of a floating arm, for 1 s."""
    with Robot("UR5") as robot:
        start = np.array([0.3, -0.6, 0.5, 0.2, 0.4, 0.1])
        robot.set_state(start, np.zeros(6))

        def energy() -> float:
            q, v, _ = robot.model.read_joints()
            full, rates = robot.pin_state(q), robot.pin_vector(v)
            kinetic = pinocchio.computeKineticEnergy(robot.pin, robot.data, full, rates)
            return kinetic + pinocchio.computePotentialEnergy(robot.pin, robot.data, full)

        begun, most, kinetic = energy(), 0.0, 1e-9
        for _ in range(1000):
            robot.world.step()
            most = max(most, abs(energy() - begun))
            q, v, _ = robot.model.read_joints()
            kinetic = max(kinetic, pinocchio.computeKineticEnergy(
                robot.pin, robot.data, robot.pin_state(q), robot.pin_vector(v)))
    yield Row("energy, UR5", "constant", most / kinetic, 0.01, "of the kinetic energy")
    with Robot("free arm") as robot:
        robot.world.set_physics(gravity=(0.0, 0.0, 0.0))
        robot.model.set_twist(Twist((0.1, 0.2, 0.3), (0.5, -0.4, 0.3)))
        before = _momentum(robot)
        for k in range(1000):
            robot.step(np.sin([0.005 * k, 0.007 * k, 0.009 * k]))
        after = _momentum(robot)
    for what, part in (("linear", slice(0, 3)), ("angular", slice(3, 6))):
        change = np.linalg.norm(after[part] - before[part]) / np.linalg.norm(before[part])
        yield Row(f"{what} momentum, floating arm", "constant", float(change), 0.02)


def _momentum(robot: Robot) -> np.ndarray:
    q, v, _ = robot.model.read_joints()
    pose, twist = robot.model.pose(), robot.model.twist()
    turn = pose.matrix()[:3, :3]
    rates = robot.pin_vector(v)
    rates[:3], rates[3:6] = turn.T @ twist.linear, turn.T @ twist.angular
    found = pinocchio.computeCentroidalMomentum(robot.pin, robot.data, robot.pin_state(q, pose),
                                                rates)
    return np.concatenate([found.linear, found.angular])


@check("closed form", quick=True)
def slope() -> Iterator[Row]:
    """Compare a cube with friction 0.5 on an inclined plane with friction 1."""
    for degrees in (20.0, 35.0):
        angle = math.radians(degrees)
        with _on_ground(angle) as world:
            box = world.spawn(parse_urdf(_box((0.4, 0.4, 0.1), 0.5)), "m", Pose((0, 0, 0.05)))
            steps(world, 300)
            at, speed = box.pose().xyz[0], _speed(box)
            steps(world, 300)
            if degrees < 26.0:
                yield Row(f"held at {degrees:g}°", "at rest",
                          1e3 * abs(box.pose().xyz[0] - at) / 0.3, 0.1, "mm/s")
            else:
                expected = G * (math.sin(angle) - 0.5 * math.cos(angle))
                found = (_speed(box) - speed) / 0.3
                yield Row(f"slides at {degrees:g}°", f"{expected:.3f} m/s²",
                          abs(found / expected - 1.0), 0.01)


@check("closed form", quick=True)
def contact_friction() -> Iterator[Row]:
    """Compare the deceleration of a box from 2 m/s with the smaller coefficient times g."""
    for size, name in (((0.2, 0.2, 0.2), "cube"), ((0.4, 0.2, 0.1), "long box"),
                       ((0.6, 0.1, 0.1), "beam")):
        for degrees in (0.0, 30.0):
            with _on_ground() as world:
                box = world.spawn(parse_urdf(_box(size, 0.5)), "m", Pose((0, 0, size[2] / 2)))
                steps(world, 200)
                aim = math.radians(degrees)
                box.set_twist(Twist((2 * math.cos(aim), 2 * math.sin(aim), 0.0)))
                steps(world, 200)
                found = (2.0 - _speed(box)) / 0.2 / G
                way = _way(box) - degrees
            case = f"{name}, {degrees:g}° to its edges"
            yield Row(f"{case}, deceleration", "0.5 g", abs(found / 0.5 - 1.0), 0.01)
            yield Row(f"{case}, direction of the path", "straight", abs(way), 0.5, "°")


@check("closed form", quick=True)
def rolling() -> Iterator[Row]:
    """Compare rolling bodies of 2 kg and 0.1 m radius on slopes, and a cart on four cylinders."""
    size = 'radius="0.1" length="0.3"'
    for name, shape, inertia in (
            ("cylinder", f"cylinder {size}", _cylinder(2.0, 0.1, 0.3)),
            ("capsule", f"capsule {size}", _capsule(2.0, 0.1, 0.3)),
            ("sphere", 'sphere radius="0.1"', (0.008,) * 3)):
        described = parse_urdf(f'<robot name="r">{_round("round", shape, inertia)}</robot>')
        for degrees in (5.0, 10.0, 20.0):
            angle = math.radians(degrees)
            expected = G * math.sin(angle) / (1.0 + inertia[2] / 0.02)
            with _on_ground(angle) as world:
                body = world.spawn(described, "m", Pose((0, 0, 0.1)))
                steps(world, 1000)
                found = body.twist().linear[0] / 1.0
            yield Row(f"{name} on {degrees:g}°", f"{expected:.3f} m/s²",
                      abs(found / expected - 1.0), 0.01)
    with _on_ground() as world:
        cart = world.spawn(parse_urdf(_cart()), "m", Pose((0, 0, 0.1)))
        steps(world, 100)
        cart.set_twist(Twist((1.0, 0.0, 0.0)))
        cart.joints.restore([(0.0, 10.0)] * 4)
        steps(world, 2000)
        yield Row("speed of a cart after 2 s", "1 m/s", abs(cart.twist().linear[0] - 1.0), 0.01,
                  "m/s")
        yield Row("height of the cart", "0.1 m", 1e3 * abs(cart.pose().xyz[2] - 0.1), 0.05, "mm")


def _cart() -> str:
    wheel = _cylinder(1.0, 0.1, 0.05)
    base = _box((0.8, 0.4, 0.1), 1.0).split("<gazebo")[0]
    wheels = "".join(
        _round(f"w{x}{y}", 'cylinder radius="0.1" length="0.05"', wheel, 1.0) +
        f'<joint name="j{x}{y}" type="continuous"><origin xyz="{x} {y} 0"/><parent link="box"/>'
        f'<child link="w{x}{y}"/><axis xyz="0 1 0"/></joint>'
        for x in (-0.3, 0.3) for y in (-0.3, 0.3))
    return base + wheels + "</robot>"


@check("closed form", quick=True)
def drops() -> Iterator[Row]:
    """Compare rebounds of a ball of 20 mm radius, a cube of 30 mm, and of two balls."""
    still = 0.4 * 2.0 * 0.02**2
    ball = _round("box", 'sphere radius="0.02"', (still,) * 3)
    cube = _box((0.03, 0.03, 0.03), 0.5, 2.0)
    for name, text, height in (("ball", f'<robot name="r">{ball}</robot>', 0.02),
                               ("cube", cube, 0.015)):
        for speed in (1.0, 5.9):
            for share in (0.0, 0.5, 0.9):
                tag = "" if not share else (
                    '<gazebo reference="box"><collision><surface><bounce><restitution_coefficient>'
                    f"{share}</restitution_coefficient></bounce></surface></collision></gazebo>")
                described = parse_urdf(text.replace("</robot>", tag + "</robot>"))
                worst = max(abs(_rebound(described, height + 0.02 + k / 8 * speed * 1e-3, speed)
                                - share) for k in range(8))
                yield Row(f"{name} at {speed:g} m/s, restitution {share:g}",
                          f"rebounds with {share:g} of its speed", worst, 0.01 if not share
                          else 0.05 * share)
    with World(gravity=(0.0, 0.0, 0.0)) as world:
        balls = [world.spawn(parse_urdf(f'<robot name="r">{ball}</robot>'), f"ball{k}",
                             Pose((0.1003 * k, 0.0, 0.0))) for k in range(2)]
        balls[0].set_twist(Twist((5.9, 0.0, 0.0)))
        steps(world, 50)
        parted = balls[1].twist().linear[0] - balls[0].twist().linear[0]
    yield Row("two balls at 5.9 m/s, restitution 0", "stay together", abs(parted) / 5.9, 0.01)


def _rebound(described: RobotDescription, height: float, speed: float) -> float:
    """Return the ratio of the speeds of a body after and before its impact on the ground."""
    with _on_ground() as world:
        body = world.spawn(described, "m", Pose((0, 0, height)))
        body.set_twist(Twist((0.0, 0.0, -speed)))
        before = after = 0.0
        for _ in range(100):
            now = body.twist().linear[2]
            world.step()
            if not before and body.twist().linear[2] > now + 1e-6:
                before = -now
            if before:
                after = max(after, body.twist().linear[2])
        return after / before


@check("the same run without this body", quick=True)
def distant_bodies() -> Iterator[Row]:
    """Compare random motions of the default arm, alone and with another model in the world."""
    box = parse_urdf(_box((0.1, 0.1, 0.1), 0.5, 1.0))
    shelf = parse_urdf(_box((0.4, 0.4, 0.05), 0.5).replace(
        "</robot>", '<gazebo reference="box"><kinematic>true</kinematic></gazebo></robot>'))
    alone = _thrown_about(None, Pose())
    for what, model, at in (("a box on the ground, 7 m away", box, Pose((7.0, 0.0, 0.05))),
                            ("a box on the robot's base", box, Pose((-0.9, 0.4, 0.65))),
                            ("a shelf within its reach", shelf, Pose((0.6, 0.5, 1.2)))):
        differ = int((_thrown_about(model, at) != alone).sum())
        yield Row(f"{what}: joint positions", "bit-identical", differ, 0.0, "differences")


def _thrown_about(model: RobotDescription | None, at: Pose) -> np.ndarray:
    """Return the joint positions, one row per step."""
    with closing(ArasRobot()) as robot:
        if model is not None:
            robot.simulation.spawn(model, "other", at)
        seen = []
        for k in range(1000):
            if k % 500 == 0:
                robot.command([(-1) ** (k // 500) * q for q in (0.1, 0.3, 0.2, -0.2, -0.2, 0.4)])
            robot.steps(1)
            seen.append(robot.model.read_joints()[0])
        return np.array(seen)


@check("closed form", quick=True)
def stack() -> Iterator[Row]:
    """Measure the drift of a stack of three cubes over 2 s."""
    with _on_ground() as world:
        cubes = [world.spawn(parse_urdf(_box((0.2, 0.2, 0.2), 0.5)), f"cube{k}",
                             Pose((0, 0, 0.1 + 0.2 * k))) for k in range(3)]
        steps(world, 500)
        begun = [cube.pose().xyz for cube in cubes]
        steps(world, 2000)
        moved = max(math.dist(a, cube.pose().xyz) for a, cube in zip(begun, cubes, strict=True))
    yield Row("displacement of the highest box in 2 s", "none", 1e3 * moved, 0.1, "mm")


@check("a base at rest")
def free_base_at_rest() -> Iterator[Row]:
    """Measure the drift of a free base of 1.7 t, for a minute at rest and a minute of motion."""
    with closing(ArasRobot()) as robot:
        robot.steps(1000)
        for what, poses in (("at rest", ((0.0,) * 6,) * 2),
                            ("while the arm moves", ((0.5, 0.5, 0.3, -0.3, -0.3, 0.5),
                                                     (-0.5, -0.5, -0.3, 0.3, 0.3, -0.5)))):
            begun = robot.model.pose()
            for k in range(60):
                robot.command(poses[k % 2])
                robot.steps(1000)
            now = robot.model.pose()
            turned = 2 * math.acos(min(1.0, abs(np.dot(begun.quat, now.quat))))
            yield Row(f"displacement in a minute, {what}", "none",
                      1e3 * math.dist(begun.xyz, now.xyz), 0.1, "mm")
            yield Row(f"rotation in a minute, {what}", "none", math.degrees(turned), 0.01, "°")
