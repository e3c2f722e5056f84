"""Robot without physics engine: unit masses that are driven by efforts or by positions."""

import socket
import struct
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from aras_sim_bridge.control.drives import SimulatedRobot
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.description import (
    Joint,
    JointLimits,
    RobotDescription,
    Transmission,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "as_new"))  # recorded_values.py

PREFIX = "hardware_interface/"


def limits_of(lower=-2.0, upper=2.0, velocity=5.0, effort=100.0):
    return JointLimits(lower, upper, effort, velocity)


def joint_of(name, kind="revolute", interface="EffortJointInterface", limits=None, **more):
    """Joint and transmission; `limits`: JointLimits, or 'none'; `more`: of the transmission."""
    limits = {None: limits_of(), "none": None}.get(limits, limits)
    full = PREFIX + interface if interface else ""
    transmission = Transmission(
        f"{name}_transmission", "SimpleTransmission", name, full, True, (name,), (full,)
    )
    return Joint(name, kind, "base", name, limits=limits), replace(transmission, **more)


class UnitMasses(SimulatedRobot):
    """`stuck` joints do not move, `stops` are upper stops, `calls` lists the hardware's calls."""

    def __init__(self, names):
        self.joint_names = tuple(names)
        self.q, self.v, self.tau = ([0.0] * len(names) for _ in range(3))
        self.stuck, self.stops, self.calls = set(), {}, []

    def read_joints(self):
        return self.q, self.v, self.tau

    def apply_effort(self, joint, effort):
        self.calls.append(("effort", joint, effort))
        self.tau[self.joint_names.index(joint)] = effort

    def set_position(self, joint, position):
        self.calls.append(("position", joint, position))
        position = min(position, self.stops.get(joint, position))
        if joint not in self.stuck:
            self.q[self.joint_names.index(joint)] = position
        return position

    def set_velocity_motor(self, joint, velocity, max_effort):
        self.calls.append(("velocity", joint, velocity, max_effort))
        if joint not in self.stuck:
            self.v[self.joint_names.index(joint)] = velocity

    def bound_speed(self, joint, fastest):
        self.calls.append(("bound", joint, fastest))

    def integrate(self, dt):
        for k, name in enumerate(self.joint_names):
            if name not in self.stuck:
                self.v[k] += self.tau[k] * dt
                self.q[k] += self.v[k] * dt


@dataclass
class Rig:
    """Model, hardware, manager and loop with a simulated clock; `log`: texts of what was logged."""

    model: UnitMasses
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop
    caplog: pytest.LogCaptureFixture
    time_ns: int = 0
    step_ns: int = 1_000_000
    physics: bool = True

    @property
    def log(self):
        return self.caplog.messages

    def step(self, n=1):
        for _ in range(n):
            self.time_ns += self.step_ns
            self.loop.step(self.time_ns)
            if self.physics:
                self.model.integrate(self.step_ns / 1e9)

    def run(self, *names):
        controllers = [self.manager.load(name) for name in names]
        request = self.manager.switch(names, [], 2)
        self.step()
        assert request.is_successful, request.reason
        return controllers if len(controllers) > 1 else controllers[0]


class Connection:
    endpoint_id = "/listener"

    def __init__(self):
        self.socket, self.far = socket.socketpair()
        self.far.settimeout(5.0)

    def close(self):
        self.socket.close()

    def bodies(self, count):
        sizes = (struct.unpack("<I", self.read(4))[0] for _ in range(count))
        return [self.read(size) for size in sizes]

    def read(self, size):
        data = b""
        while len(data) < size:
            data += self.far.recv(size - len(data))
        return data


class AdvertisedTopic:
    """rospy's side of one topic: its connections, and `tell` for its SubscribeListener."""

    make_connection = Connection

    def __init__(self):
        self.connections, self.removed, self.tell = [], [], None

    def remove_connection(self, connection):
        self.removed.append(connection)

    def join(self, connection=None):
        connection = connection or Connection()
        self.connections = [*self.connections, connection]
        self.tell()
        return connection

    def leave(self, connection):
        self.connections = [c for c in self.connections if c is not connection]
        connection.close()
        self.tell()


@pytest.fixture
def ros(monkeypatch):
    import rospy

    topic = AdvertisedTopic()

    class Publisher:
        def __init__(self, *_args, subscriber_listener, **_options):
            topic.tell = subscriber_listener.peer_subscribe
            self.impl = topic

        def unregister(self):
            self.impl = None

    monkeypatch.setattr(rospy, "Publisher", Publisher)
    return topic


@pytest.fixture
def make_joint():
    return joint_of


@pytest.fixture
def make_limits():
    return limits_of


@pytest.fixture
def make_rig(caplog):
    """Factory: make_rig([make_joint(...), ...], parameters, step_ns, control_period_ns)."""

    def make(joints, parameters=None, step_ns=1_000_000, control_period_ns=None, physics=True,
             q=None):
        caplog.clear()
        description = RobotDescription(
            "robot", "base", {}, {joint.name: joint for joint, _ in joints},
            tuple(transmission for _, transmission in joints),
        )
        model = UnitMasses([joint.name for joint, _ in joints if joint.kind != "fixed"])
        model.q[:] = q or model.q
        parameters = {} if parameters is None else parameters
        hardware = RobotHardware(description, model, parameters, "/robot")
        manager = ControllerManager(hardware, parameters, "/robot")
        loop = ControlLoop(hardware, manager, step_ns, control_period_ns)
        return Rig(model, hardware, manager, loop, caplog, 0, step_ns, physics)

    return make
