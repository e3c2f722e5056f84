"""controller_manager: states, strictness, conflicts, time of a switch, errors of users' code."""

from functools import partialmethod

import pytest

from aras_sim_bridge.control.controllers import Controller
from aras_sim_bridge.control.switching import BEST_EFFORT, STRICT
from aras_sim_bridge.errors import ControllerError

EFFORT = "effort_controllers/JointEffortController"
POSITION = "effort_controllers/JointPositionController"
PARAMETERS = {
    "a1": {"type": EFFORT, "joint": "a"}, "a2": {"type": POSITION, "joint": "a", "pid": {"p": 1.0}},
    "b1": {"type": EFFORT, "joint": "b"},
    "ab": {"type": "effort_controllers/JointGroupEffortController", "joints": ["b", "a"]},
    "jsc": {"type": "joint_state_controller/JointStateController", "publish_rate": 100}}


class Recorder(Controller):
    interface = "EffortJointInterface"

    def init(self, hardware, parameters, context):
        # Deliberately without super().init().
        self.calls, self.raises = [], parameters.get("raises")
        self.fault = SystemExit("enough") if parameters.get("quits") else RuntimeError("no luck")
        self.joints = tuple(parameters.get("joints", ()))
        self._note("init")
        self.calls.clear()

    def _note(self, verb, *_):
        self.calls.append(verb)
        if self.raises == verb:
            raise self.fault

    starting = partialmethod(_note, "starting")
    update = partialmethod(_note, "update")
    stopping = partialmethod(_note, "stopping")
    reset = partialmethod(_note, "reset")


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
    try:
        request = rig.manager.switch(start, stop, strictness, **more)
    except ControllerError as refusal:
        rig.step()
        return False, str(refusal)
    rig.step()
    assert request.is_done
    return request.is_successful, request.reason


class TestLoading:
    def test_order_states_and_claims_and_what_cannot_be_loaded(self, rig):
        load(rig, "jsc", "ab", "a1")
        found = [(i.name, i.state, i.type, claim.hardware_interface, claim.resources)
                 for i in rig.manager.list() for claim in i.controller.claimed_resources]
        effort = "hardware_interface::EffortJointInterface"
        assert found == [
            ("jsc", "initialized", PARAMETERS["jsc"]["type"],
             "hardware_interface::JointStateInterface", ()),
            ("ab", "initialized", PARAMETERS["ab"]["type"], effort, ("a", "b")),
            ("a1", "initialized", EFFORT, effort, ("a",))]
        for name, text in (
            ("a1", "already loaded"), ("nobody", "/robot/nobody/type is missing"),
            ("", "type is missing"), ("r_init", "RuntimeError: no luck"),
            ("q_init", "SystemExit: enough")):
            with pytest.raises(ControllerError, match=text):
                rig.manager.load(name)
        assert list(states(rig)) == ["jsc", "ab", "a1"]

    def test_unloading_and_reloading_refuse_what_runs_unless_forced(self, rig):
        load(rig, "a1")
        switch(rig, ["a1"])
        with pytest.raises(ControllerError, match="'a1'.*running"):
            rig.manager.unload("a1")
        for call in (rig.manager.unload, rig.manager.get):
            with pytest.raises(ControllerError, match="'zz'.*not loaded"):
                call("zz")
        switch(rig, (), ["a1"])
        rig.manager.unload("a1")
        assert states(rig) == {}
        (recorder,) = load(rig, "r")
        switch(rig, ["r"])
        with pytest.raises(ControllerError, match="r are loaded"):
            rig.manager.reload_libraries()
        rig.manager.reload_libraries(force_kill=True)
        assert states(rig) == {} and recorder.calls[-1] == "stopping"
        rig.manager.reload_libraries()

    def test_shutdown_stops_unloads_and_refuses_what_is_open(self, rig):
        (recorder, _) = load(rig, "r", "a1")
        switch(rig, ["r"])
        request = rig.manager.switch(["a1"], [], STRICT)
        rig.manager.shutdown()
        assert states(rig) == {} and recorder.calls[-1] == "stopping"
        assert request.is_done and not request.is_successful


class TestSwitching:
    def test_it_happens_at_the_end_of_the_next_update(self, rig):
        (recorder,) = load(rig, "r")
        request, seen = rig.manager.switch(["r"], [], STRICT), []
        request.on_done = seen.append
        assert not request.is_done and states(rig) == {"r": "initialized"}
        rig.step()
        assert request.is_done and request.is_successful and seen == [request]
        assert recorder.calls == ["starting"]
        rig.step(2)
        assert recorder.calls == ["starting", "update", "update"]
        request = rig.manager.switch([], ["r"], STRICT)
        rig.step()
        assert recorder.calls[3:] == ["update", "stopping"]
        assert states(rig) == {"r": "stopped"}

    def test_it_may_be_carried_out_or_given_up_while_time_stands_still(self, rig):
        load(rig, "a1", "b1")
        request = rig.manager.switch(["a1"], [], STRICT)
        rig.manager.carry_out_switches(rig.time_ns)
        assert request.is_successful
        request = rig.manager.switch(["b1"], [], STRICT)
        request.finish("paused")
        assert (request.is_done, request.is_successful, request.reason) == (True, False, "paused")
        rig.step()
        assert states(rig) == {"a1": "running", "b1": "initialized"}

    @pytest.mark.parametrize(("start", "stop", "text"), [
        (["zz"], [], "'zz': it is not loaded"), ([], ["zz"], "'zz': it is not loaded"),
        ([], ["b1"], "'b1': it is initialized, not running"),
        (["a1"], [], "'a1': it is running already")])
    def test_strict_refuses_at_once_and_best_effort_does_what_it_can(self, rig, start, stop, text):
        load(rig, "a1", "b1")
        switch(rig, ["a1"])
        with pytest.raises(ControllerError, match=text):
            rig.manager.switch(start, stop, STRICT)
        assert switch(rig, start, stop, BEST_EFFORT) == (True, "")
        assert states(rig) == {"a1": "running", "b1": "initialized"}

    def test_strictness_of_a_switch(self, rig):
        (recorder,) = load(rig, "r")
        switch(rig, ["r"])
        for asap, calls in ((False, ["starting", "update", "starting"]), (True, ["update"])):
            assert switch(rig, ["r"], (), BEST_EFFORT, start_asap=asap) == (True, "")
            assert recorder.calls == calls
            recorder.calls.clear()
        load(rig, "a1")
        assert switch(rig, ["a1", "zz"], (), 0) == (True, "")
        assert any("strictness 0" in line for line in rig.log)
        ok, reason = switch(rig, ["a1"], (), 7)
        assert not ok and "strictness" in reason

    @pytest.mark.parametrize("strictness", [BEST_EFFORT, STRICT])
    @pytest.mark.parametrize("start", [["a2"], ["ab"]])
    def test_conflicts_name_joint_and_controllers(self, rig, strictness, start):
        load(rig, "a1", "a2", "ab", "jsc")
        switch(rig, ["a1", "jsc"])
        ok, reason = switch(rig, start, (), strictness)
        assert not ok and "'a' by a1, " in reason and start[0] in reason
        ok, reason = switch(rig, ["a1"], ["a1"], strictness)  # no restart in one switch
        assert not ok and "both stopped and started" in reason and states(rig)["a1"] == "running"

    def test_conflicts_go_across_interfaces(self, rig):
        rig.hardware.interfaces["PositionJointInterface"].add("a")
        rig.manager.parameters = {**PARAMETERS, "p": {
            "type": "position_controllers/JointPositionController", "joint": "a"}}
        load(rig, "a1", "p")
        ok, reason = switch(rig, ["a1", "p"])
        assert not ok and "'a' by a1, p" in reason

    def test_requests_wait_their_turn_and_are_checked_then(self, rig):
        load(rig, "a1", "a2", "b1")
        requests = [rig.manager.switch([start], stop, STRICT) for start, stop in (
            ("a1", []), ("a2", ["a1"]), ("a1", []), ("b1", []))]
        assert not any(request.is_successful or request.is_done for request in requests)
        rig.manager.unload("b1")
        rig.step()
        assert [one.is_successful for one in requests] == [True, True, False, False]
        assert "'a' by a1, a2" in requests[2].reason and requests[3].is_done
        assert states(rig) == {"a1": "stopped", "a2": "running"}


class TestFaults:
    def test_a_controller_that_raises_is_aborted_and_the_others_go_on(self, rig):
        recorder, _ = load(rig, "r_update", "a1")
        switch(rig, ["r_update", "a1"])
        handle = rig.hardware.handles["b"]
        handle.effort_command, handle.velocity_command = 5.0, 2.0
        rig.manager.get("a1").set_command(3.0)
        rig.step(3)
        assert states(rig) == {"r_update": "aborted", "a1": "running"}
        assert rig.model.tau == [3.0, 0.0] and handle.velocity_command == 0.0
        assert [line for line in rig.log if "no luck" in line] == [
            "controller 'r_update' raised RuntimeError in update(): no luck; it is aborted and its "
            "joints b are released"
        ]
        recorder.raises = None
        assert switch(rig, ["r_update"]) == (True, "")
        assert states(rig) == {"r_update": "running", "a1": "running"}

    def test_one_that_fails_to_start_makes_the_switch_fail(self, rig):
        load(rig, "r_starting")
        ok, reason = switch(rig, ["r_starting"])
        assert not ok and "r_starting" in reason and states(rig) == {"r_starting": "aborted"}

    @pytest.mark.parametrize("verb", ["starting", "update", "stopping", "reset"])
    def test_sys_exit_ends_the_controller_alone(self, rig, verb):
        load(rig, f"q_{verb}", "a1")
        switch(rig, [f"q_{verb}", "a1"])
        rig.step()
        rig.loop.reset()
        switch(rig, (), [f"q_{verb}"], BEST_EFFORT)
        assert states(rig) == {f"q_{verb}": "aborted", "a1": "running"}
        assert any(f"SystemExit in {verb}(): enough" in line for line in rig.log)


@pytest.mark.parametrize(("name", "released"), [
    ("r", ["stopping", "starting", "update", "update"]),
    ("r_stopping", ["stopping"]),  # it is aborted and not started
])
def test_release_of_the_emergency_stop_stops_and_starts_what_runs(rig, name, released):
    recorder, idle = load(rig, name, "r_update")
    switch(rig, [name])
    rig.hardware.e_stop = True
    rig.step(2)
    assert recorder.calls == ["starting", "update", "update"]
    rig.hardware.e_stop = False
    rig.step(2)
    assert recorder.calls[3:] == released and idle.calls == []
    assert states(rig)[name] == ("running" if name == "r" else "aborted")
