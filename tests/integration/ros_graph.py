"""ROS graph for tests: starts a master and launch files, waits for nodes, and stops everything.

Everything started here carries a mark in its environment, which children inherit even where they
make a session of their own, as roslaunch's nodes do. What is left behind is found by it.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
import uuid
import xmlrpc.client
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rosgraph
import rosnode

from aras_visual_servo_ros.shutdown import SUBSCRIBED_PARAMETER

MARK = "ARAS_TEST_GRAPH"
WATCH = Path(__file__).parent / "watch"  # names who touches the simulation from another thread
SLOW_CAMERA = Path(__file__).with_name("slow_camera.yaml")
TOUCHED = "another thread touched"
# What roslaunch and the master themselves keep on the parameter server.
OWN_PARAMETERS = ("run_id", "rosdistro", "rosversion", "roslaunch")
# How many times longer than on a machine of one's own everything may take: other graphs beside this
# one (pytest -n) take their part of it, and who knows of more sets ARAS_PATIENCE.
PATIENCE = float(os.environ.get("ARAS_PATIENCE") or 1 + ("PYTEST_XDIST_WORKER" in os.environ))
SIGINT_AFTER = 15.0 * max(PATIENCE / 2.0, 1.0)  # s that roslaunch gives a node; its own are 15


class GraphError(AssertionError):
    """The graph did not reach an expected state, or processes were left."""


def wait_for(predicate: Callable[[], Any], timeout: float, what: str,
             interval: float = 0.02) -> Any:
    """Return the first true value of `predicate()`; polled every `interval` seconds of wall time.

    Raises GraphError, naming `what`, after `timeout` times PATIENCE seconds.
    """
    timeout *= PATIENCE
    end = time.monotonic() + timeout
    while True:
        value = predicate()
        if value:
            return value
        if time.monotonic() > end:
            raise GraphError(f"waited {timeout:g} s in vain for {what}")
        time.sleep(interval)


def wait_for_message(topic: str, message_type: type, timeout: float = 10.0,
                     where: Callable[[Any], bool] | None = None) -> Any:
    """Return the first message on `topic` (for which `where(message)` holds); needs `ros_node`."""
    with Collector(topic, message_type) as collector:
        return collector.wait(timeout=timeout, where=where)


def senders(topic: str) -> int:
    """Return how many publishers send a topic to this process, confirmed by both ends: a subscriber
    counts those it has only set out to, a publisher those that are gone until it sends again."""
    import rospy

    master = rosgraph.Master(rospy.get_name())
    publishers = dict(master.getSystemState()[0]).get(topic, [])
    here = {near for near, _ in _links(master, master.caller_id, "i", topic)}
    return sum(any(far in here for _, far in _links(master, node, "o", topic))
               for node in publishers)


class Collector:
    """Subscriber that stores every message, in order of arrival, in `messages`."""

    def __init__(self, topic: str, message_type: type, queue_size: int | None = None) -> None:
        import rospy

        self.topic, self.message_type = topic, message_type
        self.messages: list[Any] = []
        self._subscriber = rospy.Subscriber(topic, message_type, self.messages.append,
                                            queue_size=queue_size, tcp_nodelay=True)

    def wait(self, count: int = 1, timeout: float = 10.0, where: Callable[[Any], bool]
             | None = None) -> Any:
        """Wait for the `count`-th message (for which `where` holds), and return it."""

        def fitting() -> list[Any]:
            found = [m for m in list(self.messages) if where is None or where(m)]
            return found[count - 1 : count]

        what = f"message {count} on {self.topic} ({self.message_type._type})"
        try:
            return wait_for(fitting, timeout, what + (" that fits" if where else ""))[0]
        except GraphError as error:
            raise GraphError(
                f"{error}; {len(self.messages)} arrived, from {self.connected()} publishers"
            ) from None

    def connected(self) -> int:
        """Return how many publishers send to the subscribers of this topic in this process."""
        return senders(self._subscriber.resolved_name)

    def clear(self) -> None:
        self.messages.clear()

    def close(self) -> None:
        self._subscriber.unregister()

    def __enter__(self) -> Collector:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RosMaster:
    """A rosmaster on a free port of this machine; it ends with `stop()`."""

    def __init__(self, directory: Path, watched: bool = True) -> None:
        """`watched`: nodes `gazebo` tell of touches from other threads; it costs them some time."""
        self.directory = directory
        self.port = _free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.mark = uuid.uuid4().hex
        self.environment = {
            **{k: v for k, v in os.environ.items() if k not in ("ROS_HOSTNAME", "ROS_NAMESPACE")},
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(directory),
            "ROS_LOG_DIR": str(directory / "log"),
            "PYTHONUNBUFFERED": "1",
            "PYTHONPATH": (f"{WATCH}{os.pathsep}" if watched else "")
            + os.environ.get("PYTHONPATH", ""),
            # some of Debian's ROS tools start with `env python3`, which must be one that knows ROS
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            MARK: self.mark}
        self.api = rosgraph.Master("/test_graph", self.uri)
        self.start()

    def start(self) -> None:
        """Start the master, always on the same port, without any registration."""
        self.output = (self.directory / f"master-{self.port}.txt").open("a")
        self.process = subprocess.Popen(["rosmaster", "--core", "-p", str(self.port)],
                                        env=self.environment, stdin=subprocess.DEVNULL,
                                        stdout=self.output, stderr=subprocess.STDOUT,
                                        start_new_session=True)
        wait_for(self.api.is_online, 20.0, f"rosmaster at {self.uri} (output: {self.output.name})")

    def kill(self) -> None:
        """Kill the master with SIGKILL."""
        self.process.kill()
        self.process.wait()
        self.output.close()

    def nodes(self) -> set[str]:
        """Return the names of all registered nodes."""
        return {name for kind in self.api.getSystemState() for _, names in kind for name in names}

    def knows(self, name: str) -> bool:
        """Return whether the master has a node's address, also as subscriber of a parameter."""
        try:
            return bool(self.api.lookupNode(name))
        except rosgraph.MasterException:
            return False

    def run(self, command: Sequence[str], timeout: float = 30.0,
            check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run a command in this graph; GraphError, with its output, when it takes too long or (with
        `check`) fails."""
        timeout *= PATIENCE
        try:
            done = subprocess.run(command, env=self.environment, stdin=subprocess.DEVNULL,
                                  capture_output=True, text=True, timeout=timeout)
        except subprocess.TimeoutExpired as error:
            raise GraphError(
                f"{' '.join(command)}: not finished after {timeout:g} s; output: {error.stdout!r}"
            ) from None
        if check and done.returncode:
            raise GraphError(f"{' '.join(command)}: status {done.returncode}\n"
                             f"{done.stdout}{done.stderr}")
        return done

    def clean(self, parameters: bool = True) -> None:
        """Remove dead nodes and `parameters`, so that the next launch finds an empty graph."""
        for name in {name.split("/")[1] for name in self.api.getParamNames()}:
            if parameters and name not in OWN_PARAMETERS:
                self.api.deleteParam("/" + name)
        os.environ["ROS_MASTER_URI"], before = self.uri, os.environ.get("ROS_MASTER_URI")
        try:
            dead = [name for name in self.nodes() if not _answers(self.api, name)]
            for name in dead:
                with contextlib.suppress(rosgraph.MasterException):  # it has just taken itself off
                    address = self.api.lookupNode(name)
                    rosgraph.Master(name).unsubscribeParam(address, SUBSCRIBED_PARAMETER)
            rosnode.cleanup_master_blacklist(self.api, dead)
        finally:
            if before is None:
                del os.environ["ROS_MASTER_URI"]
            else:
                os.environ["ROS_MASTER_URI"] = before

    def stop(self) -> None:
        """Stop the master; GraphError if a process of this graph is still running."""
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.output.close()
        end_leftovers(MARK, self.mark, f"the graph at {self.uri}")


class Launch:
    """A running launch file; its output and that of its nodes is in the file `log`."""

    def __init__(self, master: RosMaster, target: Sequence[str], arguments: dict[str, Any]) -> None:
        self.master = master
        self.name = " ".join(target)
        self.id = uuid.uuid4().hex
        self.log = master.directory / f"launch-{self.id[:8]}.txt"
        self._output = self.log.open("w")
        # It asks the master twice for each time it publishes, 50 a second if nothing is said.
        master.api.setParam("/robot_state_publisher/publish_frequency", 1.0)
        self.process = subprocess.Popen(["roslaunch", "--screen",
                                         f"--sigint-timeout={SIGINT_AFTER}", *target,
                                         *(_argument(k, v) for k, v in arguments.items())],
                                        env={**master.environment, MARK + "_LAUNCH": self.id},
                                        stdin=subprocess.DEVNULL, stdout=self._output,
                                        stderr=subprocess.STDOUT, start_new_session=True)

    def output(self) -> str:
        """Return the complete output."""
        return self.log.read_text(errors="replace")

    def wait_for_nodes(self, names: Sequence[str], timeout: float = 60.0) -> None:
        """Wait until all `names` (absolute) are registered; GraphError if roslaunch ends first."""
        timeout *= PATIENCE
        end = time.monotonic() + timeout
        while missing := set(names) - self.master.nodes():
            if self.process.poll() is not None:
                trouble = f"ended with status {self.process.returncode} before"
            elif time.monotonic() > end:
                trouble = f"took more than {timeout:g} s until"
            else:
                time.sleep(0.1)
                continue
            raise GraphError(
                f"{self.name}: {trouble} {', '.join(sorted(missing))} came up:\n{self.tail()}")

    def interrupt(self) -> None:
        """Stop it as with Ctrl-C, without deleting parameters."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(25.0 + SIGINT_AFTER)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def stop(self, clean: bool = True) -> None:
        """Stop it as with Ctrl-C; GraphError if a node had to be killed or does not end.

        clean: forget all parameters.
        """
        if self._output.closed:
            return
        self.interrupt()
        self._output.close()
        try:
            end_leftovers(MARK + "_LAUNCH", self.id, self.name)
            stubborn = [line for line in self.output().splitlines() if "escalating to SIG" in line]
            if stubborn:
                raise GraphError(f"{self.name}: nodes did not end at Ctrl-C: {'; '.join(stubborn)}")
            output = self.output()
            if TOUCHED in output:
                begin = output.index(TOUCHED)
                raise GraphError(
                    f"{self.name}: {output.count(TOUCHED)} touches of the simulation from other "
                    f"threads; the first:\n{output[begin : begin + 2000]}")
        finally:
            self.master.clean(parameters=clean)

    def tail(self) -> str:
        """Return the last lines of the output."""
        return "\n".join(self.output().splitlines()[-40:])


def end_leftovers(variable: str, value: str, what: str) -> None:
    """Kill every process marked `variable=value`; GraphError names them if there were any."""
    needle = f"{variable}={value}".encode()

    def alive() -> dict[int, str]:
        found = {}
        for entry in Path("/proc").iterdir():
            try:
                if not entry.name.isdigit() or needle not in (entry / "environ").read_bytes():
                    continue
                arguments = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:  # it has just ended, or is not ours
                continue
            command = b" ".join(arguments).decode(errors="replace").strip()
            if command and int(entry.name) != os.getpid():  # a zombie has no command line
                found[int(entry.name)] = command
        return found

    # A child may need a moment longer than its parent.
    end = time.monotonic() + 2.0
    while (left := alive()) and time.monotonic() < end:
        time.sleep(0.05)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    if left:
        text = "; ".join(f"{pid}: {command}" for pid, command in left.items())
        raise GraphError(f"{what} left processes behind (now killed): {text}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _argument(name: str, value: Any) -> str:
    return f"{name}:={str(value).lower() if isinstance(value, bool) else value}"


def _links(api: rosgraph.Master, node: str, direction: str, topic: str) -> list[tuple[str, str]]:
    """Return the ports (its own, the other's) of a node's connections of a topic, "i"n or "o"ut."""
    try:
        with xmlrpc.client.ServerProxy(api.lookupNode(node)) as slave:
            _, _, links = slave.getBusInfo(api.caller_id)
    except (OSError, xmlrpc.client.Error, rosgraph.MasterException):
        return []  # it is gone, or not there yet
    # identity, whom it is with, direction, transport, topic, whether it is connected, in words
    # such as "TCPROS connection on port 41374 to [127.0.0.1:40623 on socket 6]"
    return [ends.groups() for link in links if (link[2], link[4], link[5])
            == (direction, topic, True)
            and (ends := re.search(r"on port (\d+) to \[.*:(\d+) on socket", link[6]))]


def _answers(api: rosgraph.Master, node: str) -> bool:
    try:
        host, port = rosgraph.network.parse_http_host_and_port(api.lookupNode(node))
        with socket.create_connection((host, port), timeout=2.0 * PATIENCE):
            return True
    except (OSError, rosgraph.MasterException):
        return False
