"""Robot without physics engine: unit masses that are driven by efforts or by positions."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest

from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.control.manager import ControllerManager

sys.path.insert(0, str(Path(__file__).parents[1] / "as_new"))  # recorded_values.py

PREFIX = "hardware_interface/"


def _limits(lower=-2.0, upper=2.0, velocity=5.0, effort=100.0):
    return SimpleNamespace(lower=lower, upper=upper, velocity=velocity, effort=effort)


def _soft(lower=-1.5, upper=1.5, k_position=10.0, k_velocity=20.0):
    return SimpleNamespace(
        lower=lower, upper=upper, k_position=k_position, k_velocity=k_velocity
    )


def _joint(
    name, kind="revolute", interface="EffortJointInterface", limits=None, soft_limits=None, **more
):
    """Return a joint with its transmission; limits: SimpleNamespace, or 'none'."""
    if limits is None:
        limits = _limits()
    joint = SimpleNamespace(
        name=name, kind=kind, limits=None if limits == "none" else limits, soft_limits=soft_limits
    )
    full = PREFIX + interface if interface else ""
    transmission = SimpleNamespace(
        name=f"{name}_transmission", type="SimpleTransmission", joint=name, interface=full,
        has_actuator=True, joints=(name,), interfaces=(full,),
    )
    for key, value in more.items():
        setattr(transmission, key, value)
    return joint, transmission


class FakeModel:
    """Robot of unit masses. `stuck` joints do not move; `calls` records the calls of the hardware.
    """

    def __init__(self, names):
        self.joint_names = tuple(names)
        self.q = [0.0] * len(names)
        self.v = [0.0] * len(names)
        self.tau = [0.0] * len(names)
        self.stuck = set()
        self.calls = []

    def read_joints(self):
        return self.q, self.v, self.tau

    def apply_effort(self, joint, effort):
        self.calls.append(("effort", joint, effort))
        self.tau[self.joint_names.index(joint)] = effort

    def set_position(self, joint, position):
        self.calls.append(("position", joint, position))
        if joint not in self.stuck:
            self.q[self.joint_names.index(joint)] = position
        return position

    def set_velocity_motor(self, joint, velocity, max_effort):
        self.calls.append(("velocity", joint, velocity, max_effort))
        if joint not in self.stuck:
            self.v[self.joint_names.index(joint)] = velocity

    def integrate(self, dt):
        """Integrate by semi-implicit Euler over dt, s."""
        for k, name in enumerate(self.joint_names):
            if name not in self.stuck:
                self.v[k] += self.tau[k] * dt
                self.q[k] += self.v[k] * dt


@dataclass
class Rig:
    """Model, hardware, manager and loop with a simulated clock; `log` collects messages."""

    model: FakeModel
    hardware: RobotHardware
    manager: ControllerManager
    loop: ControlLoop
    log: list = field(default_factory=list)
    time_ns: int = 0
    step_ns: int = 1_000_000
    physics: bool = True

    def step(self, n=1):
        """Make n physics steps."""
        for _ in range(n):
            self.time_ns += self.step_ns
            self.loop.step(self.time_ns)
            if self.physics:
                self.model.integrate(self.step_ns / 1e9)

    def run(self, *names):
        """Load and start controllers; returns them."""
        controllers = [self.manager.load(name) for name in names]
        request = self.manager.switch(names, [], 2)
        self.step()
        assert request.is_successful, request.reason
        return controllers if len(controllers) > 1 else controllers[0]


@pytest.fixture
def make_joint():
    return _joint


@pytest.fixture
def make_limits():
    return _limits


@pytest.fixture
def make_soft():
    return _soft


@pytest.fixture
def make_rig():
    """Factory: make_rig([make_joint(...), ...], parameters, step_ns, control_period_ns)."""

    def make(joints, parameters=None, step_ns=1_000_000, control_period_ns=None, physics=True,
             q=None):
        log = []
        description = SimpleNamespace(
            joints={joint.name: joint for joint, _ in joints},
            transmissions=tuple(transmission for _, transmission in joints),
        )
        model = FakeModel([joint.name for joint, _ in joints if joint.kind != "fixed"])
        model.q[:] = q or model.q
        parameters = {} if parameters is None else parameters
        hardware = RobotHardware(description, model, parameters, "/robot", log.append)
        manager = ControllerManager(hardware, parameters, "/robot", log.append, log.append)
        loop = ControlLoop(hardware, manager, step_ns, control_period_ns)
        return Rig(model, hardware, manager, loop, log, 0, step_ns, physics)

    return make
