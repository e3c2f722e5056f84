"""Compiled control of the simulated arm between two images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, nan
from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.control.controllers.joint_control_loop import set_loop_commands
from aras_sim_bridge.control.joints import HANDLE_COLUMNS, Q, V
from aras_sim_bridge.control_cycle import ALL_MADE, CYCLE_TYPES, PHYSICS_TYPES, run_cycles
from aras_visual_servo_base.compiled import jit
from aras_visual_servo_controller.observation.frame import NANOSECONDS
from aras_visual_servo_controller.runner.compiled_updates import (
    LOOP_ROWS,
    LOOP_TYPE,
    NEEDS_PYTHON,
    NEW_COMMAND,
    SENT_VALUES,
    LoopStateConverter,
    process_joint_state,
)

if TYPE_CHECKING:
    from aras_sim_bridge.control.controllers.joint_state import JointStateController
    from aras_sim_bridge.controlled_model import ControlledModel
    from aras_visual_servo_controller.runner.loop_runner import LoopRunner

    from .base import JointListener


@jit(f"i8, i8, i8, f8, i8[::1], i8, b1, i8[:,::1], i8[::1], f8[::1], f8[::1], f8[:,:,::1], "
     f"{CYCLE_TYPES}, Tuple(({PHYSICS_TYPES})), {LOOP_TYPE}")
def run_cycles_with_loop(
    time_ns,
    ends_ns,
    step_ns,
    last_ns,
    due,
    taken,
    has_command,
    measured,
    columns,
    commands,
    stamps,
    samples,
    loops,
    handles,
    drives,
    physics,
    loop,
):
    """Run control cycles, and update the control loop with each joint state.

    Stop at a joint state that Python has to process, and after a command beyond a joint's limits.

    Args:
        time_ns, ends_ns, step_ns: present time, time of the last cycle, and period of the cycles,
            ns.
        last_ns: end of the run, after which the loop is not updated, ns.
        due: (m,) times of the joint states, ns.
        taken: number of joint states that have been processed.
        has_command: whether the command of the last one must still be set.
        measured: (2, n) indices of the joints' positions and velocities in the flattened `handles`.
        columns: (k,) for each row of `loops`, the index of its joint among the loop's joints; n if
            the loop does not have this joint.
        commands: (k,) output, the latest commands of the rows of `loops`; NaN for none.
        stamps, samples: (m,) and (m, 3, n) outputs: stamps (s) of the joint states, their positions
            and velocities, and the resulting commands.
        loops, handles, drives, physics: see `run_cycles`.
        loop: see `process_joint_state`.

    Returns:
        Six values: the time, ns; the number of processed joint states; why `run_cycles` stopped and
        where (its second and third result); whether a command exceeds the limits; and
        `has_command` for the next call.
    """
    flat, n = handles.reshape(handles.size), samples.shape[2]
    while time_ns < ends_ns:
        if has_command:
            for k in range(len(columns)):
                if columns[k] < n:
                    commands[k] = samples[taken - 1, 2, columns[k]]
            if set_loop_commands(loops, commands, time_ns + step_ns):
                return time_ns, taken, ALL_MADE, -1, True, False
        is_due = taken < len(due) and due[taken] <= ends_ns
        next_ns = due[taken] if is_due else ends_ns
        if next_ns == time_ns:  # Python has not yet processed the joint state of the last cycle
            break
        made, end, bad = run_cycles(
            (next_ns - time_ns) // step_ns, time_ns, step_ns, loops, handles, drives, *physics
        )
        time_ns += made * step_ns
        has_command = False
        if end != ALL_MADE or not is_due or time_ns > last_ns:
            return time_ns, taken, end, bad, False, False
        sample = samples[taken]
        for i in range(n):
            sample[0, i], sample[1, i] = flat[measured[0, i]], flat[measured[1, i]]
        stamps[taken] = float(time_ns // NANOSECONDS) + (time_ns % NANOSECONDS) / 1e9
        result = process_joint_state(sample[0], sample[1], stamps[taken], loop)
        if result == NEEDS_PYTHON:
            return time_ns, taken, ALL_MADE, -1, False, False
        taken += 1
        for i in range(n):
            sample[2, i] = loop[LOOP_ROWS][SENT_VALUES, i]
        has_command = result == NEW_COMMAND
    return time_ns, taken, ALL_MADE, -1, False, has_command


class CompiledArmController:
    """Control loop of an arm that runs inside the compiled control cycles of the simulation.

    This class implements the interface `controlled_model.CompiledController`.
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
        self._read_last_ns, self._sampler = last_ns, robot.manager.get(sampler)
        self._updates = (
            LoopStateConverter(driver) if driver.servo.arm.names == tuple(joints) else None
        )
        handles = list(robot.hardware.handles)
        offsets = np.array([handles.index(name) for name in joints]) * HANDLE_COLUMNS
        self._measured = np.array([offsets + Q, offsets + V])
        self._count = len(joints)
        self._joints = {name: k for k, name in enumerate(joints)}
        # Rows of the loops of the running controllers, and for each row the index of its joint.
        self._loops, self._columns = np.zeros((0, 0)), np.zeros(0, int)
        self._commands = np.zeros(0)

    def start_cycles(
        self, time_ns: int, until_ns: int, step_ns: int
    ) -> JointStateController | None:
        """Return the joint state controller if compiled code can make the next loop updates.

        Return None if Python code has to process the next joint states.
        """
        due = self._updates is not None and -inf < self._sampler.idle_until(time_ns) < until_ns
        self._state = self._updates.make_loop() if due else None
        if self._state is None:
            return None
        self._due = np.array(self._sampler.list_due_cycles(time_ns, until_ns, step_ns), int)
        self._taken, self._has_command, self._last_ns = 0, False, self._read_last_ns()
        count = len(self._due)
        self._stamps, self._samples = np.empty(count), np.empty((count, 3, self._count))
        return self._sampler

    def run_cycles(
        self, count: int, time_ns: int, step_ns: int, loops: np.ndarray, handles: np.ndarray,
        drives: np.ndarray, *physics: np.ndarray | float | bool,
    ) -> tuple[int, int, int]:
        """Run up to `count` control cycles, and update the loop at each joint state.

        The arguments and the result are those of `control_cycle.run_cycles`.
        """
        start_ns, ends_ns = time_ns, time_ns + count * step_ns
        if loops is not self._loops:
            names, self._loops = self._robot.loop.joint_names, loops
            self._columns = np.array([self._joints.get(name, self._count) for name in names])
            self._commands = np.full(len(loops), nan)
        is_beyond = True
        while is_beyond:
            time_ns, self._taken, end, bad, is_beyond, self._has_command = run_cycles_with_loop(
                time_ns, ends_ns, step_ns, self._last_ns, self._due, self._taken,
                self._has_command, self._measured, self._columns, self._commands, self._stamps,
                self._samples, loops, handles, drives, physics, self._state,
            )  # fmt: skip
            if is_beyond:
                self._robot.loop.warn_beyond_limits(self._commands, time_ns + step_ns)
        return (time_ns - start_ns) // step_ns, end, bad

    def end_cycles(self) -> None:
        """Apply the results of the updates to the control loop."""
        taken = self._taken
        if self._has_command:
            self._send(self._samples[taken - 1, 2])
        stamps, samples = self._stamps[:taken].tolist(), self._samples[:taken]
        self._sampler.count_samples(taken)
        self._updates.apply_results(stamps, samples)
        self._listener.on_updates(stamps, samples)
