"""Comparisons of joints with damping, friction, stops and controllers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pinocchio
from aras_robot import CONTROLLERS, ArasRobot
from scipy.integrate import solve_ivp

from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.world import Twist, World

from .check import Row, check
from .reference import Reference
from .robots import GRAVITY, Robot, bare_urdf

_SLIDE = """<robot name="block">
<link name="base"><inertial><mass value="20"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
 iyz="0"/></inertial></link>
<link name="slide"><inertial><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0"
 iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
 <limit lower="-0.5" upper="0.5" effort="1000" velocity="100"/></joint></robot>"""
_WHEEL = """<robot name="wheel"><link name="world"/><link name="wheel"><inertial>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="spin" type="revolute"><parent link="world"/><child link="wheel"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1e4" velocity="1e3"/></joint></robot>"""


@check("closed form", quick=True)
def joint_stops() -> Iterator[Row]:
    """Measure how far a wheel exceeds its stops, which are 2 rad apart."""
    for what, unit, sizes in (("initial speed", "rad/s", (1.0, 5.0, 50.0)),
                              ("driven with", "N m", (5.0, 5000.0))):  # fmt: skip
        for size in sizes:
            with World() as world:
                wheel, beyond = world.spawn(parse_urdf(_WHEEL), "wheel"), 0.0
                for k in range(4200 if unit == "rad/s" else 2000):
                    if unit == "N m":
                        wheel.apply_effort("spin", size if k % 1000 < 500 else -size)
                    elif k % 2100 == 0:
                        wheel.joints.restore([(0.0, size if k == 0 else -size)])
                    world.step()
                    beyond = max(beyond, abs(wheel.read_joints()[0][0]) - 1.0)
            yield Row(f"{what} {size:g} {unit}", "never exceeded", beyond / 2.0, 0.01,
                      "of the range")


@check("closed form", quick=True)
def joint_stops_of_a_free_base() -> Iterator[Row]:
    """Measure how far a prismatic joint on a free block exceeds the stops of Bullet."""
    for speed in (1.0, 5.0, 20.0):
        with World() as world:
            block = world.spawn(parse_urdf(_SLIDE), "block")
            block.set_twist(Twist((0.1, 0.0, 0.0), (0.0, 0.0, 0.2)))
            beyond = last = 0.0
            for direction in (1.0, -1.0):
                block.joints.restore([(0.0, direction * speed)])
                for _ in range(1000):
                    world.step()
                    last = max(0.0, abs(block.read_joints()[0][0]) - 0.5)
                    beyond = max(beyond, last)
            yield Row(f"initial speed {speed:g} m/s", "exceeded by at most one step", beyond,
                      1.1 * speed * world.time_step, "m")
            yield Row(f"initial speed {speed:g} m/s, afterwards", "within the stop", last, 1e-4,
                      "m")


def _shipped(damping: Mapping[str, float]) -> RobotDescription:
    """Return the default arm without shapes and stops, with other damping of some joints."""
    xml = bare_urdf("shipped arm")
    description = parse_urdf(xml)
    joints = {
        name: replace(joint, damping=damping.get(name, joint.damping),
                      limits=replace(joint.limits, lower=-1e3, upper=1e3, velocity=1e9))
        if joint.is_movable else joint for name, joint in description.joints.items()
    }
    return replace(description, joints=MappingProxyType(joints))


def _reference(description: RobotDescription, names: tuple[str, ...]
               ) -> tuple[Reference, list[int]]:
    """Return the same arm as a Reference, and the indices of `names` in its vectors."""
    model = pinocchio.buildModelFromXML(bare_urdf("shipped arm"))
    model.gravity.linear = np.array(GRAVITY)
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    damping, friction = np.zeros(model.nv), np.zeros(model.nv)
    for place, name in zip(order, names, strict=True):
        damping[place] = description.joints[name].damping
        friction[place] = description.joints[name].friction
    return Reference(model, damping, friction), order


_START = (0.1, 0.3, 0.6, -0.5, 0.4, 0.2)


def _released(damping: Mapping[str, float], dt: float, seconds: float) -> float:
    """Return the largest difference of joint positions while the arm falls, rad or m."""
    description = _shipped(damping)
    with World(dt, GRAVITY) as world:
        model = world.spawn(description, "arm", fixed_base=True)
        names = model.joint_names
        model.joints.set_joint_positions(dict(zip(names, _START, strict=True)))
        reference, order = _reference(description, names)
        reference.q[order] = _START
        nothing, worst = np.zeros(len(order)), 0.0
        for _ in range(round(seconds / dt)):
            world.step()
            reference.step(nothing, dt)
            worst = max(worst, float(np.abs(model.read_joints()[0] - reference.q[order]).max()))
    return worst


@check("Pinocchio, Gauss-Seidel", quick=True)
def friction_and_damping_short() -> Iterator[Row]:
    """Release the arm with joint friction for 0.15 s."""
    for dt in (1e-3, 5e-3):
        yield Row(f"J2 damping 60, steps of {1e3 * dt:g} ms", "equal positions",
                  _released({"J2": 60.0}, dt, 0.15), 1e-3, "rad")


@check("Pinocchio, Gauss-Seidel")
def friction_and_damping() -> Iterator[Row]:
    """Release the arm with joint friction for 1 s."""
    for damping in ({}, {"J2": 60.0}, {"J5": 5.0, "J3": 20.0}):
        said = ", ".join(f"{name} damping {value:g}" for name, value in damping.items())
        for dt in (1e-3, 2e-3, 5e-3):
            yield Row(f"{said or 'default damping'}, steps of {1e3 * dt:g} ms", "equal positions",
                      _released(damping, dt, 1.0), 1e-3, "rad")


@check("SciPy (DOP853), Pinocchio")
def time_steps() -> Iterator[Row]:
    """Let the UR5 swing for 0.5 s: semi-implicit Euler has a time error of the order of dt."""
    start = np.array([0.3, -0.6, 0.5, 0.2, 0.4, 0.1])
    with Robot("UR5") as robot:
        def rates(_: float, state: np.ndarray) -> np.ndarray:
            q, v = np.split(state, 2)
            found = pinocchio.aba(robot.pin, robot.data, robot.pin_state(q), robot.pin_vector(v),
                                  np.zeros(robot.pin.nv))
            return np.concatenate([v, found[robot.pin_v]])

        exact = solve_ivp(rates, (0.0, 0.5), np.concatenate([start, np.zeros(6)]), "DOP853",
                          rtol=1e-10, atol=1e-12).y[:, -1]
        for dt in (2.5e-4, 5e-4, 1e-3, 2e-3, 5e-3):
            robot.world.set_physics(time_step=dt)
            robot.set_state(start, np.zeros(6))
            for _ in range(round(0.5 / dt)):
                robot.world.step()
            q, v, _ = robot.model.read_joints()
            late = np.abs(np.subtract(q, exact[:6])).max() / np.abs(exact[6:]).max()
            yield Row(f"steps of {1e3 * dt:g} ms", "error of at most 2 steps", late / dt, 2.0,
                      "steps")


@check("an independent PID and Gauss-Seidel solver, Pinocchio")
def PID_steps() -> Iterator[Row]:
    """Command a quintic trajectory to the default controllers at every step."""
    target = np.array([0.1, 0.2, 0.3, -0.25, -0.2, 0.4])  # in the order of CONTROLLERS
    with closing(ArasRobot(interpolate=False)) as robot:
        names = robot.model.joint_names
        reference, order = _reference(robot.model.description, names)
        places = [order[names.index(joint)] for joint in CONTROLLERS]
        gains = [robot.settings[c] for c in CONTROLLERS.values()]
        gains = [g.get("pid", g) for g in gains]
        p, i, d, clamp = (np.array([float(g.get(k, 0.0)) for g in gains])
                          for k in ("p", "i", "d", "i_clamp"))
        last, total = np.zeros(6), np.zeros(6)
        worst, effort = 0.0, np.zeros(len(order))
        dt = 1e-3
        for k in range(1200):
            s = min(1.0, (k + 1) / 800)
            command = target * s**3 * (10 - 15 * s + 6 * s * s)
            robot.command(command)
            robot.steps(1)
            error = command - reference.q[places]
            total = total + dt * error
            effort[places] = (p * error + np.clip(i * total, -clamp, clamp)
                              + d * (error - last) / dt)
            last = error
            reference.step(effort, dt)
            ours = robot.model.read_joints()[0]
            worst = max(worst, float(np.abs(ours - reference.q[order]).max()))
        yield Row("all six joints, 1.2 s", "equal positions", worst, 1e-4, "rad")
