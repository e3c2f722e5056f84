"""Order and periods of read, update and write; equal inputs give bit-identical results."""

import threading

import pytest

from aras_sim_bridge.control.controllers.forward import ForwardController
from aras_sim_bridge.control.joints import VELOCITY
from aras_sim_bridge.control.loop import ControlLoop

STEP = 1_000_000


class Log:
    """Hardware and manager in one, that write down what is called."""

    def __init__(self):
        self.calls = []

    def reset(self):
        """Record the call, like the manager's reset."""

    def __getattr__(self, verb):
        return lambda *times: self.calls.append((verb, *times))


def loop_of(control_ns=None):
    log = Log()
    return ControlLoop(log, log, STEP, control_ns), log.calls


def test_read_update_write_each_step_with_the_steps_period():
    loop, calls = loop_of()
    loop.step(STEP)
    loop.step(2 * STEP)
    assert calls == [
        ("read",), ("update", STEP, 0.001), ("write", STEP, 0.001),
        ("read",), ("update", 2 * STEP, 0.001), ("write", 2 * STEP, 0.001),
    ]


def test_slower_controllers_get_the_period_that_passed_and_writing_goes_on():
    loop, calls = loop_of(2_500_000)
    for k in range(1, 8):
        loop.step(k * STEP)
    # 2.5 ms is reached at whole steps only.
    updates = [(t[0] // STEP, t[1]) for verb, *t in calls if verb == "update"]
    assert updates == [(1, 0.001), (4, 0.003), (7, 0.003)]
    assert len([c for c in calls if c[0] == "write"]) == 7


def test_after_a_reset_the_first_period_is_one_step():
    loop, calls = loop_of()
    loop.step(5000 * STEP)
    loop.reset()
    calls.clear()
    loop.step(5010 * STEP)
    assert {call[2] for call in calls[1:]} == {0.001}
    loop.reset()
    calls.clear()
    loop.step(STEP)
    assert {call[2] for call in calls[1:]} == {0.001}


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
    """Ignores small commands when they arrive."""

    interface = VELOCITY

    def set_command(self, value):
        super().set_command(value if abs(value) > 0.1 else 0.0)


class LateDeadBand(ForwardController):
    """Ignores small commands when they are used."""

    interface = VELOCITY

    def apply_pending_command(self, time_ns):
        self.slot.append([value if abs(value) > 0.1 else 0.0 for value in self.slot.pop()])
        super().apply_pending_command(time_ns)


@pytest.mark.parametrize("kind", [DeadBand, LateDeadBand])
def test_compiled_cycles_do_not_bypass_methods_of_a_users_controller(make_rig, make_joint, kind):
    rig = make_rig(
        [make_joint("a", "revolute", VELOCITY)],
        {"c": {"type": f"{kind.__module__}:{kind.__name__}", "joint": "a"}},
    )
    controller = rig.run("c")
    rig.step()
    for command, used in ((0.3, 0.3), (0.05, 0.0)):
        controller.set_command(command)
        assert rig.loop.start_cycles(rig.time_ns + STEP, STEP) is None
        rig.step()
        assert rig.hardware.handles["a"].velocity_command == used


def test_a_command_beyond_the_limits_is_told_in_compiled_cycles_too(make_rig, make_joint):
    rig = make_rig([make_joint(name) for name in "ab"], {"c": {
        "type": "effort_controllers/JointGroupPositionController", "joints": ["a", "b"],
        "a": {"pid": {"p": 1.0}}, "b": {"pid": {"p": 1.0}}}})  # fmt: skip
    controller = rig.run("c")
    rig.step()
    for commands, told in (([1.5, -1.5], 0), ([9.0, -9.0], 2)):
        controller.set_command(commands)
        assert rig.loop.start_cycles(rig.time_ns + STEP, STEP)
        assert sum("is beyond its limits [-2, 2]" in line for line in rig.log) == told


PID = {"p": 100.0, "i": 10.0, "d": 20.0, "i_clamp": 0.05}


def robot(make_rig, make_joint):
    parameters = {
        f"{name}_controller": {
            "type": "effort_controllers/JointPositionController", "joint": name, "pid": PID
        }
        for name in ("a", "b", "c")
    }
    rig = make_rig([make_joint(name) for name in "abc"], parameters)
    return rig, rig.run(*parameters)


def test_two_runs_are_bit_identical(make_rig, make_joint):
    def run():
        rig, controllers = robot(make_rig, make_joint)
        trace = []
        for k in range(500):
            controllers[k % 3].set_command(0.001 * k)
            rig.step()
            trace.append((*rig.model.q, *rig.model.v, *rig.model.tau))
        return trace

    assert run() == run()


def test_a_flood_of_commands_from_other_threads_is_followed_to_the_last(make_rig, make_joint):
    rig, controllers = robot(make_rig, make_joint)

    def flood(controller, last):
        for k in range(3000):
            controller.set_command(-1.0 if k % 2 else 1.0)
        controller.set_command(last)

    threads = [
        threading.Thread(target=flood, args=(controller, 0.1 * (k + 1)))
        for k, controller in enumerate(controllers)
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        rig.step()
    rig.step(4000)
    assert rig.model.q == pytest.approx([0.1, 0.2, 0.3], abs=1e-3)
