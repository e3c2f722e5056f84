"""The same experiment in the runner, on a graph in lockstep and from its bag gives equal runs."""

from __future__ import annotations

from one_run import CASES, differences


def test_there_are_forty_experiments_and_two_more():
    assert len(CASES) == 42


def test_runner_graph_and_bag_are_one(launch, ros_node, ros_master, tmp_path):
    """`tests/one_run` compares all."""
    assert differences(CASES["points/delay 0.02 s"], launch, ros_master, tmp_path) == []
