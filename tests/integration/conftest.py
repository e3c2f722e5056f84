"""Fixtures of the graph tests: a ROS master, launch files, and a node of the test process.

A rospy node can be initialised once per process, so the tests share one, on the session's master.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # tests write `from ros_graph import wait_for`
# Helpers that assert: their failures are explained as those of tests are.
pytest.register_assert_rewrite("gazebo_calls")

if TYPE_CHECKING:
    from ros_graph import Collector, Launch, RosMaster

ROOT = Path(__file__).parents[2]
FAILED = pytest.StashKey[bool]()
LONGEST = (  # files whose tests take longest, these first
    "test_dashboard", "test_demo", "test_faults", "test_solid_on_the_graph",
    "test_benchmarks", "test_controller_node", "test_runner_equals_graph",
    "test_several_cameras_on_the_graph", "test_any_arm", "test_bridge", "test_stock_robots")


def _is_sourced() -> bool:
    """Return whether ROS and Python use the devel space of this workspace."""
    return str(ROOT / "src") in os.environ.get("ROS_PACKAGE_PATH", "").split(":") and all(
        importlib.util.find_spec(name) for name in ("rospy", "controller_manager_msgs"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Record whether the test's body failed, for `launch`; show the output of nodes after a
    failure."""
    report = yield
    if call.when == "call":
        item.stash[FAILED] = report.failed
    if report.failed:
        for launched in getattr(item, "funcargs", {}).get("launches", ()):
            report.sections.append((f"Last lines of {launched.name}", launched.tail()))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print why a test was repeated: -r R only names it."""
    for report in terminalreporter.stats.get("rerun", ()):
        terminalreporter.section(f"tried again: {report.nodeid}")
        terminalreporter.line(report.longreprtext)
        for title, text in report.sections:
            terminalreporter.line(f"- {title}:\n{text}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.graph)
    # Side by side: what begins last must not be what takes longest.
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST
               else len(LONGEST))  # fmt: skip


if not _is_sourced():
    reason = "the workspace is not sourced: run ./test.sh, or source devel/setup.bash first"
    if os.environ.get("ARAS_REQUIRE_GRAPH"):
        raise RuntimeError(f"the graph tests cannot run: {reason}")
    # Imports of generated messages would fail at the top of the test files: nothing is collected.
    collect_ignore_glob = ["test_*.py"]
    sys.stderr.write(f"graph tests left out: {reason}\n")


@pytest.fixture(scope="session")
def ros_master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosMaster]:
    """Start the session's rosmaster on a free port; the ROS environment of this process uses it."""
    from ros_graph import RosMaster

    master = RosMaster(tmp_path_factory.mktemp("ros"))
    names = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOME", "ROS_LOG_DIR")
    before = {name: os.environ.get(name) for name in (*names, "ROS_HOSTNAME", "ROS_NAMESPACE")}
    for name in before:
        os.environ.pop(name, None)
    os.environ.update({name: master.environment[name] for name in names})
    yield master
    if "rospy" in sys.modules:
        sys.modules["rospy"].signal_shutdown("the tests are over")
    for name, value in before.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value
    master.stop()


@pytest.fixture(scope="session")
def ros_node(ros_master: RosMaster) -> str:
    """Make this process a node of the session's graph with wall time; return its name."""
    import rospy

    from aras_visual_servo_ros.rospy_patches import find_publishers

    find_publishers()
    # A launch file before may have set /use_sim_time: rospy would then hear /clock itself, and of
    # ticks that come at once keep only the newest, for the tests' own subscribers too.
    rospy.init_node("tests", anonymous=True, disable_signals=True, disable_rostime=True)
    return rospy.get_name()


@pytest.fixture(scope="module")
def launches() -> list[Launch]:
    """List of what `launch` has started for this module's tests, in order."""
    return []


@pytest.fixture(autouse=True)
def _end_with_failure(request: pytest.FixtureRequest, launches: list[Launch]) -> Iterator[None]:
    """Stop the nodes that a failed test has started, so that the next test does not use them."""
    shared = len(launches)  # those of the module's fixtures, which were made before
    yield
    if request.node.stash.get(FAILED, False):
        for launched in reversed(launches[shared:]):
            launched.stop()


@pytest.fixture(scope="module")
def launch(ros_master: RosMaster, launches: list[Launch]) -> Iterator[Callable[..., Launch]]:
    """Factory: `launch("package", "file.launch", nodes=["/gazebo"], gui=False)` → Launch.

    Returns when all `nodes` are registered. What is still running at the end of the module is
    ended as by Ctrl-C, and parameters are deleted; a process that stays behind is an error.
    """
    from ros_graph import GraphError, Launch

    def start(*target: str, nodes: Sequence[str] = (), **arguments: Any) -> Launch:
        launches.append(Launch(ros_master, target, arguments))
        launches[-1].wait_for_nodes(nodes)
        return launches[-1]

    yield start
    errors = []
    for started in reversed(launches):
        try:
            started.stop()
        except GraphError as error:
            errors.append(str(error))
    if errors:
        raise GraphError("\n".join(errors))


@pytest.fixture
def collect(ros_node: str) -> Iterator[Callable[..., Collector]]:
    """Factory: `collect(topic, type)` → Collector, unsubscribed at the end of the test."""
    from ros_graph import Collector

    collectors: list[Collector] = []

    def start(topic: str, message_type: type, queue_size: int | None = None) -> Collector:
        collectors.append(Collector(topic, message_type, queue_size))
        return collectors[-1]

    yield start
    for collector in collectors:
        collector.close()
