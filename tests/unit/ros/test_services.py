"""Table of services: each is served by a function, one call at a time where necessary."""

import threading

import pytest
import rospy
from gazebo_msgs.srv import DeleteLight
from std_srvs.srv import Empty, SetBool, Trigger

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.services import ServiceTable, service_handler


@pytest.mark.parametrize(("turn", "most"), [(None, 2), (threading.Lock(), 1)])
def test_calls_wait_for_their_turn_where_there_is_one(graph, turn, most):
    inside, greatest = [], []
    two = threading.Barrier(2)

    @service_handler(Trigger, in_caller_thread=True)
    def ask(_thread: object, _request: object) -> None:
        inside.append(1)
        greatest.append(len(inside))
        if most == 2:
            two.wait(30.0)
        else:
            threading.Event().wait(0.02)
        inside.pop()

    ServiceTable("/x", None, ask, call_lock=turn)
    callers = [threading.Thread(target=graph.call, args=("/x/ask",)) for _ in range(2)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(60.0)
    assert max(greatest) == most


def test_an_answer_is_what_the_handler_says_and_else_that_it_went_well(graph, thread):
    @service_handler(SetBool, "done")
    def plain(_simulation: object, _request: object) -> None:
        """Return no answer."""

    @service_handler(SetBool)
    def honest(simulation: object, request: object) -> dict:
        assert simulation is thread.simulation and request.data is True
        return {"success": False, "message": "no"}

    table = ServiceTable("/x/", thread, plain, honest)
    assert graph.call("/x/plain", True).success is True
    answer = graph.call("/x/honest", True)
    assert (answer.success, answer.message) == (False, "no")
    table.shutdown()
    assert not graph.services
    assert plain.policy.type_name == "SetBool"


def test_a_fault_is_an_answer_or_a_failed_call_and_a_line(graph, thread):
    @service_handler(Trigger)
    def refuses(_simulation: object, _request: object) -> None:
        raise SimError("not so")

    @service_handler(Empty, call_fails=True)
    def fails(_simulation: object, _request: object) -> None:
        raise KeyError("x")

    @service_handler(DeleteLight)
    def breaks(_simulation: object, _request: object) -> None:
        raise SystemExit("gone")

    ServiceTable("/x", thread, refuses, fails, breaks)
    assert graph.call("/x/refuses").success is False
    assert graph.lines[-1] == "/x/refuses: not so"
    with pytest.raises(rospy.ServiceException, match="Empty: internal error, KeyError: 'x'"):
        graph.call("/x/fails")
    answer = graph.call("/x/breaks")
    assert answer.success is False
    assert answer.status_message == "DeleteLight: internal error, SystemExit: gone"
    assert "please report it" in graph.lines[-1]
