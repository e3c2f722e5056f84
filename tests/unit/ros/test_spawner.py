"""Controller spawner: it stops and unloads its controllers at its end."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import rospy

from aras_sim_bridge.ros.cli.spawner import Spawner


@pytest.mark.parametrize(
    ("kept", "told"), [("", 0), ("a", 1), ("ab", 0)], ids=["all", "one", "with the simulator"]
)
def test_it_unloads_in_reverse_and_tells_what_stays(graph, monkeypatch, kept, told):
    asked = []

    def proxy(name: str, _kind: type):
        def call(*given: object) -> SimpleNamespace:
            asked.append((name.rpartition("/")[2], *given))
            return SimpleNamespace(ok=not ("unload" in name and given[0] in kept))

        return call

    monkeypatch.setattr(rospy, "ServiceProxy", proxy, raising=False)
    spawner = Spawner("/rig/")
    spawner.load(["a", "b"])
    assert spawner.start()
    del asked[:], graph.lines[:]
    spawner.unload()
    assert asked[0][:3] == ("switch_controller", [], ["a", "b"])
    assert asked[1:] == [("unload_controller", "b"), ("unload_controller", "a")]
    assert "Stopping and unloading" in graph.lines[0]
    assert len(graph.lines) == 1 + told and all("unload a" in line for line in graph.lines[1:])


@pytest.mark.parametrize("fault", [rospy.ServiceException, rospy.ROSException, OSError, None])
def test_a_simulator_that_went_first_is_no_fault_and_what_does_not_start_is_said(
    graph, monkeypatch, fault
):
    ends = []

    def call(*_given: object) -> SimpleNamespace:
        if ends:
            raise fault("gone")
        return SimpleNamespace(ok=fault is not None)

    monkeypatch.setattr(rospy, "ServiceProxy", lambda _name, _kind: call, raising=False)
    monkeypatch.setattr(rospy.rostime, "wallsleep", lambda _seconds: None)
    spawner = Spawner("/rig/")
    spawner.load(["a"])
    assert spawner.start() is (fault is not None)
    count = len(graph.lines)
    if fault is not None:
        ends.append(True)
        spawner.unload()
        assert [line for line in graph.lines[count:] if "Shutting down" not in line] == []
    else:
        assert graph.lines[-1].startswith("Failed to start controllers: ")
