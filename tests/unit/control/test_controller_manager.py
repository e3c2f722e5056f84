"""controller_manager: states, strictness, conflicts, time of a switch, errors of users' code."""

import pytest

from aras_sim_bridge.control.controllers import Controller, ControllerTypes
from aras_sim_bridge.control.switching import BEST_EFFORT, STRICT
from aras_sim_bridge.errors import ControllerError

EFFORT = "effort_controllers/JointEffortController"
POSITION = "effort_controllers/JointPositionController"
PARAMETERS = {
    "a1": {"type": EFFORT, "joint": "a"},
    "a2": {"type": POSITION, "joint": "a", "pid": {"p": 1.0}},
    "b1": {"type": EFFORT, "joint": "b"},
    "ab": {"type": "effort_controllers/JointGroupEffortController", "joints": ["b", "a"]},
    "jsc": {"type": "joint_state_controller/JointStateController", "publish_rate": 100},
}


class Recorder(Controller):
    """Controller that records the manager's calls, and raises an error if requested."""

    interface = "EffortJointInterface"

    def init(self, hardware, parameters, context):
        # Deliberately without super().init().
        self.calls = []
        self.raises = parameters.get("raises")
        self.fault = SystemExit("enough") if parameters.get("quits") else RuntimeError("no luck")
        self.joints = tuple(parameters.get("joints", ()))
        if self.raises == "init":
            raise self.fault

    def _note(self, verb):
        self.calls.append(verb)
        if self.raises == verb:
            raise self.fault

    def starting(self, time_ns):
        self._note("starting")

    def update(self, time_ns, period):
        self._note("update")

    def stopping(self, time_ns):
        self._note("stopping")

    def reset(self):
        self._note("reset")


@pytest.fixture
def rig(make_rig, make_joint):
    users = f"{Recorder.__module__}:Recorder"
    parameters = {**PARAMETERS, "r": {"type": users}}
    for verb in ("init", "starting", "update", "stopping", "reset"):
        own = {"type": users, "raises": verb, "joints": ["b"]}
        parameters[f"r_{verb}"] = own
        parameters[f"q_{verb}"] = {**own, "quits": True}
    return make_rig([make_joint("a"), make_joint("b")], parameters, physics=False)


def states(rig):
    return {info.name: info.state for info in rig.manager.list()}


def load(rig, *names):
    return [rig.manager.load(name) for name in names]


def switch(rig, start=(), stop=(), strictness=STRICT, **more):
    """Ask, step once, return (ok, reason)."""
    try:
        request = rig.manager.switch(start, stop, strictness, **more)
    except ControllerError as refusal:
        rig.step()
        return False, str(refusal)
    rig.step()
    assert request.is_done
    return request.is_successful, request.reason


class TestLoading:
    def test_order_states_and_claims(self, rig):
        load(rig, "jsc", "ab", "a1")
        infos = rig.manager.list()
        assert [(i.name, i.state, i.type) for i in infos] == [
            ("jsc", "initialized", PARAMETERS["jsc"]["type"]),
            ("ab", "initialized", PARAMETERS["ab"]["type"]),
            ("a1", "initialized", EFFORT),
        ]
        claims = [(c.hardware_interface, c.resources)
                  for i in infos for c in i.controller.claimed_resources]
        assert claims == [
            ("hardware_interface::JointStateInterface", ()),
            ("hardware_interface::EffortJointInterface", ("a", "b")),
            ("hardware_interface::EffortJointInterface", ("a",)),
        ]

    def test_what_cannot_be_loaded_leaves_nothing_behind(self, rig):
        load(rig, "a1")
        for name, text in (
            ("a1", "already loaded"),
            ("nobody", "/robot/nobody/type is missing"),
            ("", "type is missing"),
            ("r_init", "RuntimeError: no luck"),
            ("q_init", "SystemExit: enough"),
        ):
            with pytest.raises(ControllerError, match=text):
                rig.manager.load(name)
        assert list(states(rig)) == ["a1"]

    def test_the_newest_parameters_count(self, rig):
        rig.manager.parameters = {"new": {"type": EFFORT, "joint": "b"}}
        rig.manager.load("new")
        assert states(rig) == {"new": "initialized"}

    def test_unload_refuses_running_and_unknown(self, rig):
        load(rig, "a1")
        switch(rig, ["a1"])
        with pytest.raises(ControllerError, match="'a1'.*running"):
            rig.manager.unload("a1")
        with pytest.raises(ControllerError, match="'zz'.*not loaded"):
            rig.manager.unload("zz")
        switch(rig, (), ["a1"])
        rig.manager.unload("a1")
        assert states(rig) == {}

    def test_types_are_sorted_with_their_base_class(self, rig):
        types = rig.manager.list_types()
        assert (EFFORT, "controller_interface::ControllerBase") in types
        assert [t for t, _ in types] == sorted(ControllerTypes().list_types())

    def test_reload_refuses_while_something_is_loaded_unless_forced(self, rig):
        (recorder,) = load(rig, "r")
        switch(rig, ["r"])
        with pytest.raises(ControllerError, match="r are loaded"):
            rig.manager.reload_libraries()
        rig.manager.reload_libraries(force_kill=True)
        assert states(rig) == {}
        assert recorder.calls[-1] == "stopping"
        rig.manager.reload_libraries()

    def test_shutdown_stops_unloads_and_refuses_what_is_open(self, rig):
        (recorder, _) = load(rig, "r", "a1")
        switch(rig, ["r"])
        request = rig.manager.switch(["a1"], [], STRICT)
        rig.manager.shutdown()
        assert recorder.calls[-1] == "stopping"
        assert states(rig) == {}
        assert request.is_done and not request.is_successful

    def test_who_is_not_loaded_is_named(self, rig):
        with pytest.raises(ControllerError, match="'zz' is not loaded"):
            rig.manager.get("zz")


class TestSwitching:
    def test_it_happens_at_the_end_of_the_next_update(self, rig):
        (recorder,) = load(rig, "r")
        request = rig.manager.switch(["r"], [], STRICT)
        assert not request.is_done and states(rig) == {"r": "initialized"}
        rig.step()
        assert request.is_done and request.is_successful
        assert recorder.calls == ["starting"]
        rig.step(2)
        assert recorder.calls == ["starting", "update", "update"]
        request = rig.manager.switch([], ["r"], STRICT)
        rig.step()
        assert recorder.calls[3:] == ["update", "stopping"]
        assert states(rig) == {"r": "stopped"}

    def test_it_may_be_carried_out_while_time_stands_still(self, rig):
        load(rig, "a1")
        request = rig.manager.switch(["a1"], [], STRICT)
        rig.manager.carry_out_switches(rig.time_ns)
        assert request.is_successful and states(rig) == {"a1": "running"}

    def test_nothing_blocks_while_paused(self, rig):
        load(rig, "a1")
        request = rig.manager.switch(["a1"], [], STRICT)
        assert not request.is_done
        request.finish("paused")
        assert (request.is_done, request.is_successful, request.reason) == (True, False, "paused")
        rig.step()
        assert states(rig) == {"a1": "initialized"}

    def test_listener_is_told(self, rig):
        load(rig, "a1")
        request = rig.manager.switch(["a1"], [], STRICT)
        seen = []
        request.on_done = seen.append
        rig.step()
        assert seen == [request]

    @pytest.mark.parametrize(
        ("start", "stop", "text"),
        [
            (["zz"], [], "'zz': it is not loaded"),
            ([], ["zz"], "'zz': it is not loaded"),
            ([""], [], "'': it is not loaded"),
            ([], ["b1"], "'b1': it is initialized, not running"),
            (["a1"], [], "'a1': it is running already"),
        ],
    )
    def test_strict_refuses_at_once_and_changes_nothing(self, rig, start, stop, text):
        load(rig, "a1", "b1")
        switch(rig, ["a1"])
        with pytest.raises(ControllerError, match=text):
            rig.manager.switch(start, stop, STRICT)
        rig.step()
        assert states(rig) == {"a1": "running", "b1": "initialized"}

    def test_best_effort_does_what_it_can(self, rig):
        load(rig, "a1", "b1")
        assert switch(rig, ["zz", "a1"], ["b1", "yy"], BEST_EFFORT) == (True, "")
        assert states(rig) == {"a1": "running", "b1": "initialized"}

    def test_best_effort_starts_a_running_one_again_unless_asap(self, rig):
        (recorder,) = load(rig, "r")
        switch(rig, ["r"])
        assert switch(rig, ["r"], (), BEST_EFFORT) == (True, "")
        assert recorder.calls == ["starting", "update", "starting"]
        assert switch(rig, ["r"], (), BEST_EFFORT, start_asap=True) == (True, "")
        assert recorder.calls == ["starting", "update", "starting", "update"]

    @pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
    def test_no_restart_in_one_switch(self, rig, strictness):
        load(rig, "a1")
        switch(rig, ["a1"])
        ok, reason = switch(rig, ["a1"], ["a1"], strictness)
        assert not ok and "both stopped and started" in reason
        assert states(rig) == {"a1": "running"}

    @pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
    @pytest.mark.parametrize("start", [["a2"], ["ab"]])
    def test_conflicts_name_joint_and_controllers(self, rig, strictness, start):
        load(rig, "a1", "a2", "ab", "jsc")
        switch(rig, ["a1", "jsc"])
        ok, reason = switch(rig, start, (), strictness)
        assert not ok
        assert "'a' by a1, " in reason and start[0] in reason

    def test_conflicts_go_across_interfaces(self, make_rig, make_joint):
        rig = make_rig([make_joint("a")], PARAMETERS)
        rig.hardware.interfaces["PositionJointInterface"].add("a")
        parameters = {**PARAMETERS, "p": {
            "type": "position_controllers/JointPositionController", "joint": "a"}}
        rig.manager.parameters = parameters
        load(rig, "a1", "p")
        ok, reason = switch(rig, ["a1", "p"])
        assert not ok and "'a' by a1, p" in reason

    def test_handing_a_joint_over_is_no_conflict(self, rig):
        load(rig, "a1", "a2")
        switch(rig, ["a1"])
        assert switch(rig, ["a2"], ["a1"]) == (True, "")
        assert states(rig) == {"a1": "stopped", "a2": "running"}

    def test_strictness_zero_is_best_effort_aloud_others_are_refused(self, rig):
        load(rig, "a1")
        assert switch(rig, ["a1", "zz"], (), 0) == (True, "")
        assert any("strictness 0" in line for line in rig.log)
        ok, reason = switch(rig, ["a1"], (), 7)
        assert not ok and "strictness" in reason

    def test_requests_wait_their_turn_and_are_checked_then(self, rig):
        load(rig, "a1", "a2")
        first = rig.manager.switch(["a1"], [], STRICT)
        second = rig.manager.switch(["a2"], ["a1"], STRICT)
        third = rig.manager.switch(["a1"], [], STRICT)
        assert not any(request.is_successful or request.is_done for request in (first, second))
        rig.step()
        assert first.is_successful and second.is_successful and not third.is_successful
        assert "'a' by a1, a2" in third.reason
        assert states(rig) == {"a1": "stopped", "a2": "running"}

    def test_unloading_what_a_request_waits_for_refuses_it(self, rig):
        load(rig, "a1")
        request = rig.manager.switch(["a1"], [], STRICT)
        rig.manager.unload("a1")
        rig.step()
        assert request.is_done and not request.is_successful


class TestFaults:
    def test_a_controller_that_raises_is_aborted_and_the_others_go_on(self, rig):
        load(rig, "r_update", "a1")
        switch(rig, ["r_update", "a1"])
        rig.hardware.handles["b"].effort_command = 5.0
        rig.manager.get("a1").set_command(3.0)
        rig.step(3)
        assert states(rig) == {"r_update": "aborted", "a1": "running"}
        assert rig.model.tau == [3.0, 0.0]
        assert [line for line in rig.log if "no luck" in line] == [
            "controller 'r_update' raised RuntimeError in update(): no luck; it is aborted and its "
            "joints b are released"
        ]
        rig.manager.unload("r_update")

    def test_one_that_fails_to_start_makes_the_switch_fail(self, rig):
        load(rig, "r_starting")
        ok, reason = switch(rig, ["r_starting"])
        assert not ok and "r_starting" in reason
        assert states(rig) == {"r_starting": "aborted"}

    def test_one_that_fails_to_stop_is_no_longer_updated(self, rig):
        (recorder,) = load(rig, "r_stopping")
        switch(rig, ["r_stopping"])
        switch(rig, (), ["r_stopping"])
        assert states(rig) == {"r_stopping": "aborted"}
        n = len(recorder.calls)
        rig.step(3)
        assert len(recorder.calls) == n

    @pytest.mark.parametrize("verb", ["starting", "update", "stopping", "reset"])
    def test_sys_exit_ends_the_controller_alone(self, rig, verb):
        load(rig, f"q_{verb}", "a1")
        switch(rig, [f"q_{verb}", "a1"])
        rig.step()
        rig.loop.reset()
        switch(rig, (), [f"q_{verb}"], BEST_EFFORT)
        assert states(rig) == {f"q_{verb}": "aborted", "a1": "running"}
        assert any(f"SystemExit in {verb}(): enough" in line for line in rig.log)

    def test_an_aborted_one_may_be_started_again(self, rig):
        (recorder,) = load(rig, "r_update")
        switch(rig, ["r_update"])
        rig.step()
        recorder.raises = None
        assert switch(rig, ["r_update"]) == (True, "")
        assert states(rig) == {"r_update": "running"}


class TestEmergencyStop:
    def test_release_stops_and_starts_what_runs(self, rig):
        recorder, idle = load(rig, "r", "r_update")
        switch(rig, ["r"])
        rig.hardware.e_stop = True
        rig.step(2)
        assert recorder.calls == ["starting", "update", "update"]
        rig.hardware.e_stop = False
        rig.step(2)
        assert recorder.calls[3:] == ["stopping", "starting", "update", "update"]
        assert idle.calls == []

    def test_release_does_not_start_what_failed_to_stop(self, rig):
        (recorder,) = load(rig, "r_stopping")
        switch(rig, ["r_stopping"])
        rig.hardware.e_stop = True
        rig.step()
        rig.hardware.e_stop = False
        rig.step(2)
        assert recorder.calls == ["starting", "update", "stopping"]
        assert states(rig) == {"r_stopping": "aborted"}
