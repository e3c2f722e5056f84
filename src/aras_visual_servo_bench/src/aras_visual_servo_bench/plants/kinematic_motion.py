"""Compiled motion of plants without physics, together with the updates of the control loop."""

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_controller.kinematics.algebra import solve_linear
from aras_visual_servo_controller.kinematics.chain import CHAIN_SIGNATURE, compute_pose_and_jacobian
from aras_visual_servo_controller.kinematics.free_body_kinematics import move_freely
from aras_visual_servo_controller.observation.frame import NANOSECONDS
from aras_visual_servo_controller.runner.compiled_updates import (
    LOOP_ROWS,
    LOOP_TYPE,
    NEEDS_PYTHON,
    SENT_VALUES,
    process_joint_state,
)

# Row indices of the state (7, n) of a plant: coordinates, their velocities, commanded coordinates,
# lower limits, upper limits, velocity of the motion, and its command. With velocity commands, the
# last two rows contain joint velocities, or the twist of a free camera.
Q, V, COMMAND, LOWER, UPPER, MOTION, MOTION_COMMAND = range(7)
CHAIN = f"Tuple(({CHAIN_SIGNATURE}))"


@jit("f8[:,::1], f8, f8", allocates=False)
def follow_position(state, lag, dt):
    """Move the coordinates for dt (s) towards the commanded ones.

    Each coordinate follows its command with the time constant `lag` (s), and stays within its
    limits. The motion is the exact solution for a constant command.
    """
    decay = np.exp(-dt / lag) if lag > 0.0 else 0.0
    for i in range(state.shape[1]):
        before, command = state[Q, i], state[COMMAND, i]
        after = command + decay * (before - command)
        state[Q, i] = min(max(after, state[LOWER, i]), state[UPPER, i])
        state[V, i] = (state[Q, i] - before) / dt


@jit(f"{CHAIN}, f8[:,::1], f8[::1], f8[::1]")
def convert_to_motion(chain, state, rates, motion):
    """Convert rates (n,) of the coordinates to a velocity (n,), and write it into `motion`.

    For an arm, the velocity is that of the joints; for a free camera, it is the camera's twist.
    """
    n = state.shape[1]
    if len(chain[0]) > 0:
        for i in range(n):
            motion[i] = rates[i]
        return
    jacobian = np.empty((6, n))
    compute_pose_and_jacobian(*chain, state[Q], np.empty((4, 4)), jacobian)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += jacobian[i, j] * rates[j]
        motion[i] = total


@jit(f"{CHAIN}, f8[:,::1], f8, f8")
def follow_velocity(chain, state, lag, dt):
    """Move for dt (s) with the commanded velocity.

    The velocity follows its command with the time constant `lag` (s). A free camera moves along the
    exponential of its twist; a joint stays within its limits.
    """
    decay = np.exp(-dt / lag) if lag > 0.0 else 0.0
    n = state.shape[1]
    path = np.empty(n)
    for i in range(n):
        speed, command = state[MOTION, i], state[MOTION_COMMAND, i]
        path[i] = command * dt + (speed - command) * lag * (1.0 - decay)
        state[MOTION, i] = command + decay * (speed - command)
    if len(chain[0]) > 0:
        for i in range(n):
            free = state[Q, i] + path[i]
            state[Q, i] = min(max(free, state[LOWER, i]), state[UPPER, i])
            if state[Q, i] != free:
                state[MOTION, i] = 0.0
            state[V, i] = state[MOTION, i]
        return
    move_freely(state[Q], path)
    jacobian = np.empty((6, n))
    compute_pose_and_jacobian(*chain, state[Q], np.empty((4, 4)), jacobian)
    for i in range(n):
        state[V, i] = state[MOTION, i]
    solve_linear(jacobian, state[V])


@jit(f"i8[::1], i8, f8, b1, {CHAIN}, f8[:,::1], f8[::1], f8[:,:,::1], {LOOP_TYPE}")
def update_loop(
    due_ns,
    time_ns,
    lag,
    has_velocity_commands,
    plant_chain,
    state,
    stamps,
    samples,
    loop,
):
    """Move the plant from joint state to joint state, and update the control loop with each.

    Stop at a joint state that Python has to process.

    Args:
        due_ns: (m,) times of the joint states, ns.
        time_ns: present time, ns.
        lag: time constant of the coordinates, s.
        has_velocity_commands: whether velocities are commanded.
        plant_chain: kinematics of the plant, as the fields of a Chain.
        state: (7, n) state of the plant; modified.
        stamps: (m,) output, stamps of the joint states, s.
        samples: (m, 3, n) output, their positions and velocities, and the resulting commands.
        loop: see `process_joint_state`.

    Returns:
        The number of joint states that the loop has processed, and the number of joint states that
        the plant has reached.
    """
    for k in range(len(due_ns)):
        dt = (due_ns[k] - time_ns) / NANOSECONDS
        if dt > 0.0 and has_velocity_commands:
            follow_velocity(plant_chain, state, lag, dt)
        elif dt > 0.0:
            follow_position(state, lag, dt)
        time_ns = due_ns[k]
        stamps[k] = float(time_ns // NANOSECONDS) + (time_ns % NANOSECONDS) / 1e9
        for i in range(state.shape[1]):
            samples[k, 0, i], samples[k, 1, i] = state[Q, i], state[V, i]
        result = process_joint_state(samples[k, 0], samples[k, 1], stamps[k], loop)
        if result == NEEDS_PYTHON:
            return k, k + 1
        for i in range(state.shape[1]):
            samples[k, 2, i] = loop[LOOP_ROWS][SENT_VALUES, i]
        if has_velocity_commands:
            convert_to_motion(plant_chain, state, samples[k, 2], state[MOTION_COMMAND])
        else:
            for i in range(state.shape[1]):
                state[COMMAND, i] = samples[k, 2, i]
    return len(due_ns), len(due_ns)
