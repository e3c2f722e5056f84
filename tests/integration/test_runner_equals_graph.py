"""The same experiment in the runner, on a graph in lockstep and from its bag gives equal runs, with
bit-identical images."""

import pytest
from one_run import CASES, differences


@pytest.mark.parametrize("case", ["points/one process", "moments/original"])
def test_runner_graph_and_bag_are_one(launch, ros_node, ros_master, tmp_path, case):
    """`tests/one_run` compares all."""
    assert differences(CASES[case], launch, ros_master, tmp_path) == []
