"""Order and periods of read, update and write; equal inputs give bit-identical results."""

import pytest

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.controllers.forward import ForwardController
from aras_sim_bridge.control.joints import VELOCITY
from aras_sim_bridge.control.loop import ControlLoop
from aras_sim_bridge.errors import HardwareError

STEP = 1_000_000


class Recorder(Controller):
    interface = "EffortJointInterface"

    def init(self, hardware, parameters, context):
        super().init(hardware, parameters, context)
        self.handle, self.updates = self.take_handle(hardware, "a"), []

    def update(self, time_ns, period):
        self.updates.append((time_ns // STEP, period))
        self.handle.effort_command = self.handle.position


@pytest.fixture
def record(make_rig, make_joint):
    def make(control_period_ns=None):
        rig = make_rig([make_joint("a")], {"c": {"type": f"{__name__}:Recorder"}},
                       control_period_ns=control_period_ns, physics=False)
        return rig, rig.run("c").updates

    return make


def test_controllers_get_the_period_that_passed(record):
    rig, updates = record()
    for position in (0.5, 0.25):
        rig.model.q[0] = position
        rig.step()
        assert rig.model.tau == [position]
    assert updates == [(2, 0.001), (3, 0.001)]
    for time_ns in (5000 * STEP, 5010 * STEP, STEP):
        updates.clear()
        rig.time_ns = time_ns
        rig.loop.reset()
        rig.step()
        assert updates == [(time_ns // STEP + 1, 0.001)]
    rig, updates = record(2_500_000)
    rig.step(7)
    # 2.5 ms is reached at whole steps only.
    assert updates == [(4, 0.003), (7, 0.003)]
    assert len(rig.model.calls) == 8


@pytest.mark.parametrize("periods", [(0, 1000), (1000, 0), (-1, 1000), (1000, -1), (0,)])
def test_periods_must_be_positive(periods):
    with pytest.raises(HardwareError, match="must be positive"):
        ControlLoop(None, None, *periods)
    ControlLoop(None, None, 1, 1)


@pytest.mark.parametrize("slower", [False, True])
def test_compiled_cycles_follow_one_another_and_have_the_controllers_period(
    make_rig, make_joint, slower
):
    rig = make_rig([make_joint("a")], {"c": {
        "type": "effort_controllers/JointEffortController", "joint": "a"}},
        control_period_ns=3 * STEP if slower else None)
    rig.run("c")
    rig.step(4)
    first, again = (rig.loop.start_cycles(rig.time_ns + STEP, STEP) for _ in range(2))
    assert first is again is None if slower else first[0] is again[0]  # gathered once
    assert rig.loop.start_cycles(rig.time_ns + 2 * STEP, STEP) is None  # a step was left out
    assert rig.loop.start_cycles(rig.time_ns, STEP) is None


class DeadBand(ForwardController):
    """Ignores small commands when they are used, or when they arrive."""

    interface = VELOCITY

    def apply_pending_command(self, time_ns):
        self.slot.append([value if abs(value) > 0.1 else 0.0 for value in self.slot.pop()])
        super().apply_pending_command(time_ns)


class EarlyDeadBand(ForwardController):
    interface = VELOCITY

    def set_command(self, value):
        super().set_command(value if abs(value) > 0.1 else 0.0)


@pytest.mark.parametrize("kind", [DeadBand, EarlyDeadBand])
def test_compiled_cycles_do_not_bypass_methods_of_a_users_controller(make_rig, make_joint, kind):
    rig = make_rig([make_joint("a", "revolute", VELOCITY)],
                   {"c": {"type": f"{kind.__module__}:{kind.__name__}", "joint": "a"}})
    controller = rig.run("c")
    rig.step()
    for command, used in ((0.3, 0.3), (0.05, 0.0)):
        controller.set_command(command)
        assert rig.loop.start_cycles(rig.time_ns + STEP, STEP) is None
        rig.step()
        assert rig.hardware.handles["a"].velocity_command == used
