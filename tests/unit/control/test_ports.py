"""Publishing of controllers and cameras never delays the simulation."""

from __future__ import annotations

import struct

import pytest
from std_msgs.msg import Float64

from aras_sim_bridge.control.pid import Pid, PidGains
from aras_sim_bridge.ros.control.state_publisher import StatePublisher
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation


@pytest.fixture(scope="module")
def thread():
    """A thread whose simulation is paused; a call comes after all that was posted before."""
    made = SimulationThread(Simulation, Pacer(1.0), paused=True)
    made.start()
    yield made
    made.stop()


class AtOnce(SimulationThread):
    """A thread that is not started: jobs are run where they are posted."""

    def __init__(self) -> None:
        super().__init__(Simulation, Pacer(1.0))

    def post(self, job) -> None:
        job()


@pytest.fixture
def advertise(ros, thread):
    """make() gives a PID, and the topic of its outputs."""

    def make(thread=thread):
        pid = Pid(PidGains(2.0))
        return pid, StatePublisher("/state", Float64, 1, pid, lambda message, state: setattr(
            message, "data", state.output), thread)

    return make


def is_heard(pid, thread) -> bool:
    return thread.call(lambda: pid.on_state is not None)


def test_nothing_is_built_while_nobody_listens(advertise, ros, thread):
    pid, topic = advertise()
    assert not is_heard(pid, thread)
    listener = ros.join()
    thread.call(lambda: None)
    thread.call(lambda: pid.compute(1.5, 0.1))
    assert struct.unpack("<d", *listener.bodies(1)) == (3.0,)
    topic.shutdown()
    assert not is_heard(pid, thread)


def test_a_listener_that_leaves_does_not_take_the_callback_from_a_running_update(
    advertise, ros, thread
):
    pid, _ = advertise()
    listener = ros.join()
    assert is_heard(pid, thread)

    def update():
        ros.leave(listener)  # in a thread of rospy's, between look and call
        pid.compute(1.5, 0.1)
        return pid.on_state is not None

    assert thread.call(update)
    assert not is_heard(pid, thread)


def test_who_comes_while_another_leaves_is_heard_in_whatever_order_it_is_told(
    advertise, ros, thread
):
    pid, _ = advertise()
    first = ros.join()
    tell, ros.tell = ros.tell, lambda: None
    ros.join()
    ros.leave(first)
    tell()  # both are told late
    tell()
    assert is_heard(pid, thread)


def test_a_listener_that_was_quicker_than_the_constructor_is_heard(advertise, ros):
    ros.tell = lambda: None
    ros.join()
    pid, _ = advertise(AtOnce())
    assert pid.on_state is not None
