"""A second start, emergency stop or step does not depend on the first."""

import pytest


def test_a_restarted_trajectory_controller_tells_its_state_at_the_same_pace(make_rig, make_joint):
    rig = make_rig([make_joint("a", interface="PositionJointInterface")], {"c": {
        "type": "position_controllers/JointTrajectoryController", "joints": ["a"],
        "state_publish_rate": 100}})
    controller = rig.run("c")
    lives = []
    for _ in range(2):
        stamps = []
        controller.on_state = lambda state, stamps=stamps: stamps.append(state.stamp_ns)
        began = rig.time_ns
        rig.step(55)
        lives.append([stamp - began for stamp in stamps])
        rig.manager.switch([], ["c"])
        rig.step(2)
        rig.manager.switch(["c"], [])
        rig.step()
    assert lives[0] == lives[1] and len(lives[0]) == 5


def test_each_emergency_stop_holds_where_it_found_the_joint(make_rig, make_joint, make_limits):
    """The first position measured after the stop is held, whatever happens to the joint then."""
    rig = make_rig(
        [make_joint("a", "revolute", "PositionJointInterface", make_limits(velocity=1e4))],
        {"c": {"type": "position_controllers/JointPositionController", "joint": "a"}},
        physics=False)
    controller = rig.run("c")
    rig.model.stuck.add("a")
    for place in (0.3, -0.6):
        rig.hardware.e_stop = True
        rig.model.q[0] = place
        controller.set_command(1.0)
        rig.step(2)
        rig.model.q[0] = place + 0.05
        rig.step(2)
        assert rig.model.calls[-1] == ("position", "a", place)
        rig.hardware.e_stop = False
        rig.step(3)


def test_an_emergency_stop_holds_the_joint_where_a_reset_has_put_it(make_rig, make_joint):
    rig = make_rig([make_joint("a", interface="PositionJointInterface")], physics=False)
    rig.model.stuck.add("a")
    rig.hardware.e_stop = True
    for place in (0.3, 0.1):
        rig.model.q[0] = place
        rig.loop.restart()
        rig.step(2)
        assert rig.model.calls[-1] == ("position", "a", pytest.approx(place))


def test_a_clock_that_was_put_back_leaves_a_pid_what_it_has_gathered(make_rig, make_joint):
    rig = make_rig([make_joint("a")], {"c": {
        "type": "effort_controllers/JointPositionController", "joint": "a",
        "pid": {"p": 0.0, "i": 10.0, "i_clamp": 9.0}}})
    rig.model.stuck.add("a")
    rig.run("c").set_command(0.5)
    for begin, gathered in ((rig.loop.reset, 200), (rig.loop.restart, 100)):
        rig.step(100)
        begin()
        rig.step(100)
        assert rig.model.tau[0] == pytest.approx(10.0 * 0.5 * 1e-3 * gathered)


@pytest.mark.parametrize("compiled", [False, True])
def test_a_restarted_loop_has_forgotten_the_way_that_it_went(make_rig, make_joint, compiled):
    """Also once its row has moved to where compiled cycles have it."""
    rig = make_rig([make_joint("a")], {"c": {
        "type": "effort_controllers/JointPositionController", "joint": "a", "pid": {"p": 1.0},
        "interpolate": True}}, physics=False)
    controller = rig.run("c")
    rig.step()
    if compiled:
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
