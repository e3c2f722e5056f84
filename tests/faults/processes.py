"""Faults of processes: killed nodes, a killed master, and repeated starts of the whole graph."""

from __future__ import annotations

import os
import signal
import time
from itertools import takewhile

from ros_graph import GraphError, Launch, wait_for

from .bed import NODES, Bed
from .outcome import Outcome
from .traffic import judged


def nodes_killed(bed: Bed, scale: float, seed: int) -> Outcome:
    """kill -9 of the simulator, which comes back by itself with its robot, and of the nodes, which
    are started again by hand."""
    with bed.group("nodes killed") as outcome:
        for _ in range(max(round(4 * scale), 1)):
            outcome.injected += 1
            _killed(bed, "/gazebo")
            judged(bed, outcome, 1, "after kill -9 of /gazebo")
            for node in NODES[1:]:
                outcome.injected += 1
                nodes = bed.launches.pop()
                _killed(bed, node)
                try:
                    nodes.stop(clean=False)
                except GraphError as error:  # the other one did not end
                    outcome.hung.append(f"after kill -9 of {node}: {error}")
                bed.launch("aras_visual_servo_nodes.launch", NODES[1:])
                judged(bed, outcome, 1, f"after kill -9 of {node}")
    outcome.leaked = [what for what in outcome.leaked if "MB" in what]  # other processes by now
    return outcome


def _killed(bed: Bed, node: str) -> None:
    process = bed.pid(node)
    os.kill(process, signal.SIGKILL)
    wait_for(lambda: not _lives(process), 5.0, f"the end of {node}")


def _lives(process: int) -> bool:
    try:
        return "Z" not in open(f"/proc/{process}/stat").read().rpartition(")")[2].split()[0]
    except OSError:
        return False


def master_gone(bed: Bed, scale: float, seed: int) -> Outcome:
    """kill -9 of the master: the nodes end by themselves, and a new graph comes up on its port."""
    outcome = Outcome("master gone and back")
    for _ in range(max(round(2 * scale), 1)):
        outcome.injected += 1
        began = time.monotonic()
        processes = {node: bed.pid(node) for node in NODES}
        bed.master.kill()
        for node, process in processes.items():
            try:
                wait_for(lambda process=process: not _lives(process), 30.0, f"the end of {node}")
            except GraphError as error:
                outcome.hung.append(str(error))
        bed.master.start()
        for launched in reversed(bed.launches):
            launched.stop()
        bed.launches.clear()
        bed.connect()
        bed.start()
        judged(bed, outcome, 1, "after the master came back")
        outcome.recovered = max(outcome.recovered, time.monotonic() - began)
    return outcome


def _wait_until_started(robot: Launch) -> None:
    def started() -> bool:
        lines = [line for line in robot.output().splitlines() if "started with pid" in line]
        return any("robot_state_publisher" in line for line in lines)

    wait_for(started, 30.0, "roslaunch's processes")


def starts_and_stops(bed: Bed, scale: float, seed: int) -> Outcome:
    """Stop the graph at different times during its start: quickly and without a traceback."""
    outcome = Outcome("starts and stops")
    count, unborn = max(round(20 * scale), 2), 0
    bed.stop()
    for k in range(count):
        outcome.injected += 1
        began = time.monotonic()
        robot = bed.start_only("aras_visual_servo.launch")
        # roslaunch itself, ended while it starts processes, leaves some of them behind
        _wait_until_started(robot)
        time.sleep(4.0 * k / count)
        ended = time.monotonic()
        try:
            robot.stop()
        except GraphError as error:
            outcome.lost.append(f"ended {ended - began:.1f} s after the start: {error}")
            continue
        outcome.recovered = max(outcome.recovered, time.monotonic() - ended)
        found, before = tracebacks(robot.output())
        unborn += before
        outcome.lost += [f"ended {ended - began:.1f} s after the start: {what}" for what in found]
        outcome.survived += not found
    if unborn:
        outcome.note = f"{unborn} processes ended while Python itself began, and said so"
    bed.start()
    return outcome


def tracebacks(text: str) -> tuple[list[str], int]:
    """Tracebacks in what processes printed, by their first frame and last line; and how many more
    there are of Python's own beginning, when no line of a program has run that could keep quiet."""
    found, unborn = [], 0
    for piece in text.split("Traceback (most recent call last):")[1:]:
        lines = piece.splitlines()
        frames = [line.strip() for line in lines if line.lstrip().startswith("File ")]
        frozen = takewhile(lambda frame: frame.startswith('File "<frozen '), frames)
        last = next((line for line in lines[1:] if line and not line.startswith(" ")), "")
        if any(frame.startswith('File "<frozen site>"') for frame in frozen):
            unborn += 1
        else:
            found.append(f"traceback, {(frames or [''])[0]}: {last}")
    return found, unborn


GROUPS = (nodes_killed, master_gone, starts_and_stops)
