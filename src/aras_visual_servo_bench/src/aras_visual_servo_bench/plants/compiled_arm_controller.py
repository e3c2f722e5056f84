"""Compiled control of the simulated arm between two images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.control.joints import HANDLE_COLUMNS, Q, V
from aras_sim_bridge.cycle import ALL_MADE, run_cycles
from aras_visual_servo_controller.observation.frame import to_seconds
from aras_visual_servo_controller.runner.compiled_updates import (
    NEEDS_PYTHON,
    NEW_COMMAND,
    CompiledUpdates,
    process_joint_state,
)

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController
    from aras_sim_bridge.simulation import ControlledModel
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

    from .base import JointListener


class CompiledArmController:
    """Control loop of an arm that runs inside the compiled control cycles of the simulation.

    This class implements the interface `simulation.CompiledController`.
    """

    def __init__(
        self,
        driver: LoopRunner,
        listener: JointListener,
        robot: ControlledModel,
        sampler: str,
        joints: Sequence[str],
        send: Callable[[np.ndarray], None],
        last_ns: Callable[[], float],
    ) -> None:
        """Prepare the compiled updates of a loop.

        Args:
            driver: control loop.
            listener: object that receives the joint states and the commands.
            robot: simulated robot with its controllers.
            sampler: name of the joint state controller.
            joints: names of the n joints, in the order of the commands.
            send: function that sends a command (n,) to the controllers.
            last_ns: function that returns the currently known end of the run, ns.
        """
        self._listener, self._robot, self._send = listener, robot, send
        self._last_ns, self._sampler = last_ns, robot.manager.get(sampler)
        self._updates = CompiledUpdates(driver) if driver.servo.arm.names == tuple(joints) else None
        handles = list(robot.hardware.handles)
        offsets = np.array([handles.index(name) for name in joints]) * HANDLE_COLUMNS
        self._measured = np.array([offsets + Q, offsets + V])
        self._command = np.full(len(joints) + 1, nan)
        self._joints = {name: k for k, name in enumerate(joints)}

    def start_cycles(self, time_ns: int, until_ns: int) -> JointStateController | None:
        """Return the joint state controller if compiled code can make the next loop updates.

        Return None if Python code has to process the next joint states.
        """
        due = self._updates is not None and -inf < self._sampler.idle_until(time_ns) < until_ns
        self._state = self._updates.make_arguments() if due else None
        return None if self._state is None else self._sampler

    def run_cycles(
        self, count: int, time_ns: int, step_ns: int, loops: np.ndarray, handles: np.ndarray,
        drives: np.ndarray, *physics: np.ndarray | float,
    ) -> tuple[int, int, int]:
        """Run up to `count` control cycles, and update the loop at each joint state.

        The arguments and the result are those of `cycle.run_cycles`.
        """
        ends_ns, last_ns, n = time_ns + count * step_ns, self._last_ns(), len(self._joints)
        due = self._sampler.list_due_cycles(time_ns + step_ns, ends_ns, step_ns)
        samples = np.empty((len(due), 3, n))
        start_ns, stamps, end, bad = time_ns, [], ALL_MADE, -1
        columns = [self._joints.get(name, n) for name in self._robot.loop.joint_names]
        while time_ns < ends_ns:
            k = len(stamps)
            next_ns = due[k] if k < len(due) else ends_ns
            made, end, bad = run_cycles(
                (next_ns - time_ns) // step_ns, time_ns, step_ns, loops, handles, drives, *physics
            )
            time_ns += made * step_ns
            if end != ALL_MADE or k == len(due) or time_ns > last_ns:
                break
            stamp, (q, v) = to_seconds(time_ns), handles.take(self._measured, out=samples[k, :2])
            result = process_joint_state(q, v, stamp, *self._state)
            if result == NEEDS_PYTHON:
                break
            command = samples[k, 2]
            command[:] = self._command[:n] = self._updates.command
            stamps.append(stamp)
            if result == NEW_COMMAND and time_ns < ends_ns:
                self._robot.loop.set_commands(self._command.take(columns), time_ns + step_ns)
            elif result == NEW_COMMAND:
                self._send(command)
        self._sampler.count_samples(len(stamps))
        self._updates.apply_results(stamps, samples[: len(stamps)])
        self._listener.on_updates(stamps, samples[: len(stamps)])
        return (time_ns - start_ns) // step_ns, end, bad
