"""A restarted controller, and a second emergency stop or step, does not depend on the first."""

import math

import pytest
from recorded_values import values

from aras_sim_bridge.control.controllers.gripper import GripperGoal
from aras_sim_bridge.control.controllers.registry import ControllerTypes
from aras_sim_bridge.control.controllers.trajectory_types import Trajectory, TrajectoryPoint

PIDS = {"a": {"p": 20.0, "i": 7.0, "d": 1.5, "i_clamp": 3.0},
        "b": {"p": 10.0, "i": 50.0, "d": 0.1, "i_clamp": 100.0, "antiwindup": True}}  # fmt: skip
TYPES = ControllerTypes().list_types()
KEEPS_ITS_RHYTHM = "joint_state_controller/JointStateController"  # over restarts, as in ros_control


def interface_of(kind):
    made = ControllerTypes().find(kind).interface or "EffortJointInterface"
    return made.replace("::", "/").rpartition("/")[2]


def settings_of(kind):
    given = {"type": kind, "interpolate": kind.startswith("effort")}
    if "JointState" in kind:
        return {**given, "publish_rate": 125.0}
    if "Group" in kind:
        return {**given, "joints": ["b", "a"], **{n: {"pid": PIDS[n]} for n in "ab"}}
    if "Trajectory" in kind:
        return {**given, "joints": ["b", "a"], "gains": PIDS}
    if "Gripper" in kind:
        return {**given, "joint": "b", "gains": {"b": PIDS["b"]}, "stall_timeout": 0.01}
    return {**given, "joint": "b", "pid": PIDS["b"]}


def ask(controller, kind, far):
    """Give it something to do; `far` for another thing."""
    if "Gripper" in kind:
        controller.submit_goal(GripperGoal(0.2 + far, 3.0 + far))
    elif "Trajectory" in kind:
        controller.set_command(Trajectory(["a", "b"], [
            TrajectoryPoint(40_000_000, [0.1, 0.4 + far], [0.0, 0.2]),
            TrajectoryPoint(90_000_000, [0.3, -0.2 - far], [0.0, 0.0]),
        ]))  # fmt: skip
    elif "Group" in kind:
        controller.set_command([0.4 + far, -0.25])
    else:
        controller.set_command(0.4 + far)


@pytest.fixture
def make(make_rig, make_joint, make_limits):
    def _make(kind):
        limits = {"a": make_limits(-2.0, 2.5, 3.0, 40.0), "b": make_limits(-1.5, 1.0, 6.0, 90.0)}
        joints = [make_joint(n, "revolute", interface_of(kind), limits[n]) for n in "ab"]
        return make_rig(joints, {"c": settings_of(kind)})

    return _make


class Bench:
    """Joints that go their own way, and what a controller makes of it; no hardware behind it."""

    def __init__(self, rig):
        self.rig, self.k, self.trace = rig, 0, []

    def go_on(self, count, push=0.0):
        """Run `count` cycles of 1 ms; `push`: offset of the joints from their trajectory."""
        rig = self.rig
        for _ in range(count):
            self.k += 1
            t = 1e-3 * self.k
            rig.model.q[:] = 0.3 * math.sin(31.0 * t), -0.45 * math.cos(23.0 * t) + push
            rig.model.v[:] = 9.3 * math.cos(31.0 * t), 10.35 * math.sin(23.0 * t) - 3.0 * push
            rig.hardware.read()
            rig.manager.update(1_000_000 * self.k, 1e-3)
            self.trace.append([h.row.tolist() for h in rig.hardware.handles.values()])

    def switch(self, starts, stops):
        request = self.rig.manager.switch(starts, stops)
        self.go_on(1)
        assert request.is_successful, request.reason


def live(bench, kind):
    """Stopped in the middle of what it does, pushed about, published, with a command waiting."""
    controller = bench.rig.manager.load("c")
    if controller.state_kind:
        controller.on_state = bench.trace.append
    bench.switch(["c"], [])
    ask(controller, kind, 0.3)
    bench.go_on(37)
    bench.go_on(11, push=0.4)
    ask(controller, kind, 0.1)
    bench.go_on(12)
    ask(controller, kind, -0.2)
    bench.switch([], ["c"])
    bench.go_on(5)
    if "Trajectory" not in kind:
        ask(controller, kind, 0.6)  # what a stopped one is told is nothing to the next start


@pytest.mark.parametrize("kind", [kind for kind in TYPES if kind != KEEPS_ITS_RHYTHM])
def test_it_is_started_again_as_new(make, kind):
    old, new = Bench(make(kind)), Bench(make(kind))
    live(old, kind)
    new.rig.manager.load("c")
    new.go_on(old.k)
    # what is left of the commands is the hardware's affair
    old.rig.hardware.handle_rows[:] = new.rig.hardware.handle_rows
    both = [bench.rig.manager.get("c") for bench in (old, new)]
    for bench, controller in zip((old, new), both, strict=True):
        bench.trace.clear()
        # A PID's is every tenth update, counted over restarts.
        controller.on_state = bench.trace.append if "Trajectory" in kind else None
        bench.switch(["c"], [])
    for bench, controller in zip((old, new), both, strict=True):
        bench.go_on(7)
        ask(controller, kind, 0.05)
        bench.go_on(150)
    assert values(old.trace) == values(new.trace) and len(new.trace) >= 158


def test_each_emergency_stop_holds_where_it_found_the_joint_or_a_reset_has_put_it(
    make_rig, make_joint, make_limits
):
    rig = make_rig(
        [make_joint("a", "revolute", "PositionJointInterface", make_limits(velocity=1e4))],
        {"c": {"type": "position_controllers/JointPositionController", "joint": "a"}},
        physics=False)
    controller = rig.run("c")
    rig.model.stuck.add("a")
    for place, is_reset in ((0.3, False), (-0.6, False), (0.1, True)):
        rig.hardware.e_stop = True
        rig.model.q[0] = place
        controller.set_command(1.0)
        if is_reset:
            rig.step(2)
            rig.model.q[0] = place = 0.2
            rig.loop.restart()
        rig.step(2)
        rig.model.q[0] = place + 0.05
        rig.step(2)
        assert rig.model.calls[-1] == ("position", "a", pytest.approx(place))
        rig.hardware.e_stop = False
        rig.step(3)


@pytest.mark.parametrize("kind", ["Position", "Velocity"])
def test_a_clock_that_was_put_back_leaves_a_pid_what_it_has_gathered(make_rig, make_joint, kind):
    rig = make_rig([make_joint("a")], {"c": {
        "type": f"effort_controllers/Joint{kind}Controller", "joint": "a",
        "pid": {"p": 0.0, "i": 10.0, "i_clamp": 9.0}}})
    rig.model.stuck.add("a")
    rig.run("c").set_command(0.5)
    for begin, gathered in ((rig.loop.reset, 200), (rig.loop.restart, 100)):
        rig.step(100)
        begin()
        rig.step(100)
        assert rig.model.tau[0] == pytest.approx(10.0 * 0.5 * 1e-3 * gathered)


def test_a_restarted_loop_has_forgotten_the_way_that_it_went(make_rig, make_joint):
    """Also once its row has moved to where compiled cycles have it."""
    rig = make_rig([make_joint("a")], {"c": {
        "type": "effort_controllers/JointPositionController", "joint": "a", "pid": {"p": 1.0},
        "interpolate": True}}, physics=False)
    controller = rig.run("c")
    rig.step()
    assert rig.loop.start_cycles(rig.time_ns + rig.step_ns, rig.step_ns)
    controller.set_command(0.9)
    rig.step(9)
    assert 0.0 < rig.model.tau[0] < 0.9
    for start, stop in (([], ["c"]), (["c"], [])):
        rig.manager.switch(start, stop)
        rig.step()
    rig.step(9)
    assert rig.model.tau[0] == 0.0


@pytest.mark.parametrize("step_ns", [500_000, 1_000_000, 4_000_000])
def test_the_first_write_lasts_one_step_of_the_physics(make_rig, make_joint, step_ns):
    """A position joint may move by its velocity limit, 5 rad/s, times the step."""
    rig = make_rig([make_joint("a", interface="PositionJointInterface")], step_ns=step_ns,
                   physics=False)
    for k, begin in enumerate((int, rig.loop.reset, rig.loop.restart), 1):
        begin()
        rig.hardware.handles["a"].position_command = 1.0
        rig.time_ns = 7 * step_ns * (k % 2)  # the clock goes back, or on
        rig.step()
        assert rig.model.q[0] == pytest.approx(k * 5.0 * step_ns / 1e9)
