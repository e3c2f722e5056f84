"""Compiled updates between images give the same result as those in Python."""

import numpy as np
import pytest
from test_driver import Bench

from aras_visual_servo_controller.records.state import JointCommand
from aras_visual_servo_controller.runner import compiled_updates


class Joined(Bench):
    """Bench that processes joint states in compiled code where possible."""

    def __init__(self, **given):
        super().__init__(**given)
        self.ticks, self.answered = compiled_updates.LoopStateConverter(self.driver), 0

    def tell(self, names, positions, velocities, stamp):
        state = self.ticks.make_loop()
        q, v = np.array(positions), np.array(velocities)
        became = compiled_updates.NEEDS_PYTHON
        if state is not None:
            became = compiled_updates.process_joint_state(q, v, stamp, state)
        if became == compiled_updates.NEEDS_PYTHON:
            if state is not None:
                self.ticks.apply_results([], np.empty((0, 3, 6)))
            super().tell(names, positions, velocities, stamp)
            return
        command = self.ticks.command.copy()
        self.ticks.apply_results([stamp], np.array([[q, v, command]]))
        self.answered += 1
        if became == compiled_updates.NEW_COMMAND:
            self.send(JointCommand(stamp, names, command))


def jump(bench):
    """Move the joints ahead of their motion, so that the command approaches them again."""
    bench.step(40)
    (_, before), (_, now) = bench.sent[-2:]
    bench.q = bench.q + 0.3 * np.sign(now.values - before.values)
    bench.tell(bench.arm.names, bench.q, np.zeros(6), bench.t + 0.001)
    bench.step(60)


def implausible(bench):
    bench.step(90)
    bench.step(5, position=1e9)
    bench.step(60)
    bench.tell(bench.arm.names, bench.q, np.full(6, 1e9), bench.t + 0.001)
    bench.step(60)


def without(*names, count, begin=91):
    """Steps of which some do without joint states, images or commands that arrive."""
    def play(bench):
        bench.step(begin)
        kept = {name: getattr(bench, name) for name in names}
        for name in names:
            lost = lambda command: bench.sent.append((bench.t, command))  # noqa: E731
            setattr(bench, name, lost if name == "send" else False)
        bench.step(count)
        for name, value in kept.items():
            setattr(bench, name, value)
        bench.step(60)

    return play


def late(bench):
    bench.step(60)
    bench.step(3, stamp=bench.t)
    bench.step(60)


CASES = {
    "a whole run": (lambda bench: bench.step(180), {}),
    "delayed": (lambda bench: bench.step(200), {"delay": 0.05}),
    "slowed": (lambda bench: bench.step(200), {"gain": 15.0, "max_velocity": 0.2}),
    "at a limit": (lambda bench: bench.step(200), {"lower": {"J3": -0.27}}),
    "a slow approach": (lambda bench: bench.step(250), {"start": "2015", "max_acceleration": 2.0}),
    "drawn aside": (lambda bench: bench.step(60), {
        "scheme": "gravity_centre", "max_acceleration": 1.0, "posture": {"J2": 0.3, "J3": -0.1}}),
    "short lead": (lambda bench: bench.step(200), {"lead": 0.003, "lag": 0.01}),
    "jump": (jump, {}), "implausible": (implausible, {}), "late": (late, {}),
    "gap": (without("joints", count=40), {}), "starved": (without("images", count=60), {}),
    # Joint states come 0.16 s apart, and a step is 0.1 s at most.
    "seldom": (without("joints", "images", "is_watched", count=13), {}),
    "stuck": (without("send", count=60, begin=20), {}),  # all wait for joints that hear nothing
}  # fmt: skip


@pytest.mark.parametrize(("play", "given"), CASES.values(), ids=CASES)
def test_compiled_ticks_do_what_the_driver_does(play, given):
    """To the bit: what is sent, and told of each image."""
    joined, single = Joined(**given), Bench(**given)
    for bench in (joined, single):
        play(bench)
    assert joined.answered > 20
    for (t, one), (other_t, other) in zip(joined.sent, single.sent, strict=True):
        assert t == other_t
        np.testing.assert_array_equal(one.values, other.values)
    for one, other in zip(joined.states, single.states, strict=True):
        assert (one.stamp, one.phase, one.outcome, one.reason) == (
            other.stamp, other.phase, other.outcome, other.reason)  # fmt: skip
        np.testing.assert_array_equal(one.command, other.command)
    for (_, commands), (_, others) in zip(joined.seen, single.seen, strict=True):
        for one, other in zip(commands, others, strict=True):
            assert one.stamp == other.stamp and one.names == other.names
            np.testing.assert_array_equal(one.positions, other.positions)
            np.testing.assert_array_equal(one.velocities, other.velocities)


@pytest.mark.parametrize("given", [{"output": "velocity"}, {"lockstep": True}, {"dry": True}])
def test_what_is_not_position_commands_at_once_is_the_driver_s(given):
    bench = Joined(**given)
    bench.step(100)
    assert bench.answered == 0
