"""A ROS master that answers, does not answer, or was replaced, on a clock that the test sets."""

import threading

import pytest

from aras_visual_servo_ros import master_watch
from aras_visual_servo_ros.master_watch import MasterWatch


class Master:
    """Gives its process id; None: it does not answer."""

    def __init__(self, _name: str) -> None:
        self.pid = 7
        self.asked = 0
        Master.watched = self

    def getPid(self) -> int:
        self.asked += 1
        if self.pid is None:
            raise OSError("nobody there")
        return self.pid


@pytest.fixture
def wall(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(master_watch.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(master_watch.rosgraph, "Master", Master)
    return now


@pytest.mark.parametrize("said", [{}, {"period": 2.0}])
def test_a_master_that_answers_is_asked_no_more_often_than_said(wall, said):
    watch = MasterWatch("/node", **said)
    for _ in range(20):
        assert watch.find_loss_reason() == ""
        wall[0] += 0.5
    assert Master.watched.asked == 5


@pytest.mark.parametrize(("answers", "why"), [
    ([(7, 2.1), (None, 0.6), (None, 0.0)], "does not answer any more"),  # it is asked again soon
    ([(7, 2.1), (None, 2.1), (7, 2.1), (None, 2.1), (7, 2.1)], ""),
    ([(7, 2.1), (8, 0.0)], "was restarted")])
def test_two_missed_answers_or_another_master_are_a_loss(wall, answers, why):
    watch = MasterWatch("/node", period=2.0)
    found = []
    for Master.watched.pid, wait in answers:
        found.append(watch.find_loss_reason())
        wall[0] += wait
    assert not any(found[:-1]) and why in found[-1] and bool(found[-1]) is bool(why)


def test_a_loss_is_told_once(wall, monkeypatch):
    monkeypatch.setattr(
        master_watch.time, "sleep", lambda seconds: wall.__setitem__(0, wall[0] + seconds))
    told, lost, thread = [], threading.Event(), threading.current_thread
    watch = MasterWatch("/node", period=2.0)
    assert watch.find_loss_reason() == ""
    Master.watched.pid = None
    watch.watch(lambda why: (told.append((why, thread().daemon)), lost.set()))
    assert lost.wait(10.0)
    assert told == [("the ROS master does not answer any more", True)]
