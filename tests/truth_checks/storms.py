"""Random joint commands: no joint exceeds a stop or is blocked, and a reset restores the state."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.simulation import Simulation, SimulationConfig

from .check import Row, check
from .robots import ARMS, SOURCES, Robot, bare_urdf

_SETTINGS = SOURCES / "aras_visual_servo_gazebo" / "config" / "aras_visual_servo_control.yaml"
_TRANSMISSION = """<transmission name="{0}_t"><type>transmission_interface/SimpleTransmission</type>
<joint name="{0}"><hardwareInterface>hardware_interface/{1}JointInterface</hardwareInterface>
</joint><actuator name="{0}_m"/></transmission>"""
_PLUGIN = '<gazebo><plugin name="control" filename="libgazebo_ros_control.so"/></gazebo>'
# hardware interface, controller, whether the drive has PID gains
KINDS = {
    "effort": ("Effort", "effort_controllers/JointEffortController", False),
    "effort PID": ("Effort", "effort_controllers/JointPositionController", False),
    "position": ("Position", "position_controllers/JointPositionController", False),
    "position PID": ("Position", "position_controllers/JointPositionController", True),
    "velocity": ("Velocity", "velocity_controllers/JointVelocityController", False),
    "velocity PID": ("Velocity", "velocity_controllers/JointVelocityController", True),
}
# limits of the robot; unbounded efforts; unbounded efforts with a hard velocity limit
LIMITS = ("own", "strong", "clamped")
_STORM, _PROBE = 300, 40  # steps with random commands, and steps that test the reset
_PATIENCE = 4000  # largest number of steps until a joint reaches its next goal


@dataclass
class Found:
    """Results: excess beyond a stop relative to the range, and numbers of blocked joints, of runs
    that differ from that of a new robot, and of paused worlds."""

    beyond: float = 0.0
    stuck: int = 0
    different: int = 0
    paused: int = 0
    runs: int = 0


@cache
def _stable_gains(robot: str, of_speed: bool) -> dict[str, dict[str, float]]:
    """Return PID gains by joint that do not oscillate at 1 kHz: d dt / I is 0.2."""
    with Robot(robot) as it:
        inverse = np.linalg.inv(it.model.joints.space.mass_matrix())
        found = {}
        for name, mobility in zip(it.names, np.diag(inverse), strict=True):
            d = float(0.2 / (1e-3 * mobility))
            pull = {"i": 20.0 * d, "i_clamp": 200.0 * d, "antiwindup": True}
            found[name] = {"p": d, **pull} if of_speed else {"p": 20.0 * d, "d": d, **pull}
        return found


@cache
def _shipped_gains() -> dict[str, dict[str, float]]:
    tree = yaml.safe_load(_SETTINGS.read_text())["aras_visual_servo"]
    return {c["joint"]: c["pid"] for c in tree.values() if "joint" in c}


def _description(robot: str, interface: str, strong: bool) -> tuple[RobotDescription, list[str]]:
    """Return the robot with a transmission for each joint that is not a mimic, and these joints."""
    bare = parse_urdf(bare_urdf(robot))
    joints = [j.name for j in bare.joints.values() if j.is_movable and j.mimic is None]
    bolt = f'<gazebo reference="{bare.root}"><kinematic>true</kinematic></gazebo>'
    extra = bolt + "".join(_TRANSMISSION.format(name, interface) for name in joints) + _PLUGIN
    described = parse_urdf(bare_urdf(robot).replace("</robot>", extra + "</robot>"))
    if strong:
        changed = {
            name: replace(joint, limits=replace(joint.limits, effort=1e9))
            if joint.limits is not None else joint
            for name, joint in described.joints.items()
        }
        described = replace(described, joints=MappingProxyType(changed))
    return described, joints


@dataclass
class Rig:
    robot: str
    kind: str
    limits_as: str
    found: Found = field(default_factory=Found)

    def __post_init__(self) -> None:
        interface, controller, drive = KINDS[self.kind]
        described, self.joints = _description(self.robot, interface, self.limits_as != "own")
        shipped = self.robot == "shipped arm"
        gains = _shipped_gains() if shipped else _stable_gains(self.robot, False)
        parameters: dict[str, Any] = {
            f"{joint}_c": {"type": controller, "joint": joint, "pid": gains[joint]}
            for joint in self.joints
        }
        parameters["gazebo_ros_control"] = {"hard_velocity_limits": self.limits_as == "clamped"}
        if drive:
            own = _stable_gains(self.robot, self.kind.startswith("velocity"))
            parameters["gazebo_ros_control"]["pid_gains"] = own
        self.travel = {
            name: (joint.limits.lower or 0.0, joint.limits.upper or 0.0)
            for name, joint in described.joints.items()
            if joint.is_movable and joint.kind != "continuous"
        }
        self.simulation = Simulation(SimulationConfig(ground_plane=False))
        self.model = self.simulation.spawn(
            described, "robot", parameters=parameters,
            joint_positions={joint: self.middle(joint) for joint in self.joints})
        # tolerance of the position, rad or m: friction f stops a joint within f / p
        springs = gains if self.kind == "effort PID" else (
            _stable_gains(self.robot, False) if self.kind == "position PID" else {})
        self.near = dict.fromkeys(self.joints, 0.1)
        for joint in springs and self.joints:
            self.near[joint] += described.joints[joint].friction / springs[joint]["p"]
        self.limits = {j: described.joints[j].limits for j in self.joints}
        self.simulation.robots["robot"].start([f"{joint}_c" for joint in self.joints])
        self.steps(2)

    @property
    def _places(self) -> bool:
        return self.kind in ("effort PID", "position", "position PID")

    def steps(self, count: int) -> None:
        """Advance, and record how far joints exceed their stops."""
        for _ in range(count):
            self.simulation.step()
            for joint, q in self.positions().items():
                if joint in self.travel:
                    lower, upper = self.travel[joint]
                    over = max(lower - q, q - upper)
                    if over > 0.0:
                        self.found.beyond = max(self.found.beyond, over / (upper - lower))

    def positions(self) -> dict[str, float]:
        return dict(zip(self.model.joint_names, self.model.read_joints()[0], strict=True))

    def command(self, joint: str, value: float) -> None:
        self.simulation.robots["robot"].command(f"{joint}_c", value)

    def middle(self, joint: str) -> float:
        """Return the middle of a joint's range, or 0 if the range is more than a turn."""
        lower, upper = self.travel.get(joint, (-1e9, 1e9))
        return 0.5 * (lower + upper) if upper - lower < 2.0 * math.pi else 0.0

    def storm(self, rng: np.random.Generator) -> None:
        """Send random commands, inside and beyond the limits, to random joints."""
        left = _STORM
        size = rng.choice([0.3, 1.0, 1.5])
        longest = rng.choice([5, 50, 200])
        try:
            while left > 0:
                for joint in rng.permutation(self.joints)[: rng.integers(1, len(self.joints) + 1)]:
                    self.command(joint, float(rng.choice([-size, size, rng.uniform(-size, size)])
                                              * self._scale(joint)))
                pause = int(min(rng.integers(1, longest + 1), left))
                self.steps(pause)
                left -= pause
            if self.limits_as != "strong":  # a loop with 1e9 N m may oscillate without end
                self.found.stuck += self._stuck()
        except WorldError as error:
            assert "diverged" in str(error), error
            self.found.paused += 1
        self.found.runs += 1

    def _scale(self, joint: str) -> float:
        limits = self.limits[joint]
        if self.kind == "effort":
            return limits.effort
        if self.kind.startswith("velocity"):
            return limits.velocity
        lower, upper = self.travel.get(joint, (-3.0, 3.0))
        return min(max(abs(lower), abs(upper)), 10.0)

    def _stuck(self) -> int:
        """Return how many joints do not reach the middle of their range when commanded."""
        if self.kind == "effort":
            return 0  # an effort has no goal position
        waiting = set(self.joints)
        for k in range(_PATIENCE):
            if k % 20 == 0:
                here = self.positions()
                for joint in self.joints:
                    aim = self.middle(joint)
                    error = aim - here[joint]
                    error_of_angle = math.remainder(error, 2.0 * math.pi)
                    if min(abs(error), abs(error_of_angle)) < self.near[joint]:
                        waiting.discard(joint)
                    if self.kind.startswith("velocity"):
                        aim = max(-1.0, min(1.0, 3.0 * error))
                    self.command(joint, aim)
                if not waiting:
                    return 0
            self.steps(1)
        return len(waiting)

    def probe(self) -> list[tuple]:
        """Reset the simulation and return the states of a short run with fixed commands."""
        self.simulation.reset_simulation()
        for joint in self.joints:
            self.command(joint, 0.02 + (self.middle(joint) if self._places else 0.0))
        states = []
        for _ in range(_PROBE):
            self.simulation.step()
            states.append(tuple(map(tuple, self.model.read_joints())))
        return states


def storms(robot: str, count: int, seed: int, kinds: tuple[str, ...] = tuple(KINDS)) -> Found:
    """Run `count` random sequences on one robot, over all interfaces and LIMITS."""
    total = Found()
    rng = np.random.default_rng(seed)
    places = [(kind, limits) for kind in kinds for limits in LIMITS]
    for k, (kind, limits) in enumerate(places):
        rig = Rig(robot, kind, limits, total)
        fresh = rig.probe()
        for _ in range(count * (k + 1) // len(places) - count * k // len(places)):
            paused = total.paused
            rig.storm(rng)
            total.different += rig.probe() != fresh
            if limits != "strong" and total.paused > paused:
                total.stuck += 1  # no state may diverge
        rig.simulation.close()
    return total


def _rows(count: int) -> Iterator[Row]:
    logging.disable(logging.WARNING)
    try:
        for k, robot in enumerate(ARMS):
            found = storms(robot, count, seed=k)
            title = f"{robot}, {found.runs} runs"
            yield Row(f"{title}: beyond a stop", "no limit exceeded", found.beyond, 0.01,
                      "of the range")
            yield Row(f"{title}: afterwards", "no joint blocked", found.stuck, 0, "joints")
            yield Row(f"{title}: after a reset", "bit-identical to the first run",
                      found.different, 0, "runs")
    finally:
        logging.disable(logging.NOTSET)


@check("joint limits and repeated runs")
def random_joint_loads() -> Iterator[Row]:
    """Run a thousand random sequences."""
    yield from _rows(334)


@check("joint limits and repeated runs", quick=True)
def random_joint_loads_short() -> Iterator[Row]:
    """Run one random sequence of each kind."""
    yield from _rows(18)
