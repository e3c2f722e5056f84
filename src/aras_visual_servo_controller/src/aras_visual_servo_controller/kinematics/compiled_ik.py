"""Compiled solution of the differential inverse kinematics for one image.

In all twists, rotations are multiplied by a length (`IKSettings.length`), so that all six
components are in m/s.
"""

import numpy as np

from aras_visual_servo_base.compiled import jit

from .algebra import ROUNDING_TOLERANCE, has_singular_values_above, multiply, multiply_vector, svd
from .chain import CHAIN_SIGNATURE, compute_pose_and_jacobian
from .command_limits import compute_velocity_ranges, limit_velocities
from .held_directions import compute_held_directions

# A camera direction gets a smaller weight if its singular value in L is below this fraction of the
# largest one.
WELL_CONDITIONED = 0.05
# A joint motion that hardly moves the camera (near a singularity) is damped in proportion to the
# part, 0 to 1, of this camera motion that the task controls. Here is the lower bound of this part.
MIN_DEMAND = 0.3
# Singular values of the equations below this fraction of the largest one are rounding errors.
SINGULAR_TOLERANCE = 1e-9
# if an elbow is bent by less than this, rad, the side of the bend depends on rounding errors
STRAIGHT_TOLERANCE = 1e-9
# A joint motion of less than this, in rad or m, hardly changes the Jacobian, even near a straight
# elbow.
SMALL_MOTION = 0.002
# longest time for which velocities are reused, s: the image period of a slow camera
REUSE_TIME = 0.05


@jit("f8[:]")
def _norm(a):
    """Compute the norm of a."""
    square = 0.0
    for value in a:
        square += value * value
    return np.sqrt(square)


@jit("f8[:,:], f8[:], f8[:,:], f8[:], f8[:,:], f8[:,:], f8, f8")
def _build_rows(
    L, rate, held_directions, held_speeds, free, scaled_jacobian, hold_onset, hold_full
):
    """Combine the task and the held directions into one list of desired camera velocities.

    The task does not determine the held directions; in these, the camera is to move back to its
    goal. The task is solved only in the other directions, so that it does not affect the held ones.

    Args:
        L: (k, 6) interaction matrix of the task.
        rate: (k,) desired rate of the error.
        held_directions: (p, 6) orthonormal camera directions that are held.
        held_speeds: (p,) desired velocities along the held directions, m/s.
        free: (6 - p, 6) orthonormal camera directions that are not held.
        scaled_jacobian: (6, n) Jacobian of the arm.
        hold_onset, hold_full: bounds of the speed that the arm reaches along a held direction per
            unit of joint speed. The weight of the direction is 0 below hold_onset, rises above it,
            and is 1 above hold_full.

    Returns:
        Orthonormal camera directions (m, 6); the desired velocities (m,) along them; the weights
        (m,), 0 to 1, of these velocities in the least squares.
    """
    # Among the held camera directions, find orthonormal ones along which the arm moves the camera
    # independently, and how far it moves it for a joint motion of length 1.
    u_held, reach, _ = svd(multiply(held_directions, scaled_jacobian))
    along, hold = multiply(u_held.T, held_directions), multiply_vector(u_held.T, held_speeds)
    weights = np.empty(len(reach))
    for i in range(len(reach)):
        part = min(max((reach[i] - hold_onset) / (hold_full - hold_onset), 0.0), 1.0)
        weights[i] = part * part * (3.0 - 2.0 * part)
    # Compute the motion along the held directions. Its effect on the features is then subtracted
    # from their desired rate.
    weighted = np.empty(len(reach))
    for i in range(len(reach)):
        weighted[i] = weights[i] * hold[i]
    rest = multiply_vector(L, multiply_vector(along.T, weighted))
    for i in range(len(rest)):
        rest[i] = rate[i] - rest[i]
    u, s, vt = svd(multiply(L, free.T))
    rank = 0
    while rank < len(s) and s[rank] > ROUNDING_TOLERANCE * s[0]:
        rank += 1
    projected = multiply_vector(u.T, rest)
    basis = np.empty((rank + len(reach), 6))
    others = multiply(vt[:rank], free)
    speed, weight = np.empty(len(basis)), np.empty(len(basis))
    for i in range(len(reach)):
        speed[rank + i], weight[rank + i] = hold[i], weights[i]
        for j in range(6):
            basis[rank + i, j] = along[i, j]
    for i in range(rank):
        for j in range(6):
            basis[i, j] = others[i, j]
        speed[i] = projected[i] / s[i]
        # A camera motion that hardly changes the features gets a smaller weight.
        weight[i] = min(1.0, s[i] / (WELL_CONDITIONED * s[0]))
    return basis, speed, weight


@jit("f8[:,:], f8[:,:], f8[:], f8[:], f8[:], b1[:], f8[:], f8, f8, f8[:]")
def _solve_damped(
    scaled_jacobian, basis, desired, weights, preferred, free, fixed, damping, damping_below, units
):
    """Compute joint velocities for the desired twist, and velocities that do not change this twist.

    Args:
        scaled_jacobian: (6, n) Jacobian of the arm.
        basis, desired, weights: directions, velocities and weights that `_build_rows` returns.
        preferred: (n,) velocities that secondary tasks prefer.
        free: (n,) whether the velocity of each joint is to be computed.
        fixed: (n,) given velocities of the joints that are not free; 0 for the others.
        damping: maximum damping, m per rad or m of joint motion.
        damping_below: singular value of the Jacobian below which a joint motion is damped.
        units: (n,) joint motions, rad or m, that have the same weight in the least squares.

    Returns:
        The velocities (n,) for the desired twist; the part (n,) of `preferred` that does not affect
        the twist.
    """
    joints = np.flatnonzero(free)
    arm = np.empty((6, len(joints)))
    for column, joint in enumerate(joints):
        for i in range(6):
            arm[i, column] = scaled_jacobian[i, joint] * units[joint]
    rows = np.empty(basis.shape)
    for i in range(len(basis)):
        for j in range(6):
            rows[i, j] = weights[i] * basis[i, j]
    rates = multiply_vector(rows, multiply_vector(scaled_jacobian, fixed))
    for i in range(len(rates)):
        rates[i] = weights[i] * desired[i] - rates[i]
    task = multiply(rows, arm)
    m, damped = len(task), task
    if not has_singular_values_above(arm, damping_below):
        u_arm, s, weak = svd(arm)
        strong = 0
        while strong < len(s) and s[strong] >= damping_below:
            strong += 1
        damped = np.empty((m + len(s) - strong, len(joints)))
        for i in range(m):
            for j in range(len(joints)):
                damped[i, j] = task[i, j]
        # For joint motion i, the camera moves along u_arm[:, i]. The norm of sensitivity[:, i] is
        # the part of this direction, 0 to 1, that the task controls.
        sensitivity = multiply(rows, u_arm)
        for i in range(strong, len(s)):
            strength = max(_norm(sensitivity[:, i]), MIN_DEMAND)
            ratio = s[i] / damping_below
            factor = damping * np.sqrt(1.0 - ratio * ratio) * strength
            for j in range(len(joints)):
                damped[m + i - strong, j] = factor * weak[i, j]
    u, s, vt = svd(damped)
    scaled_preferred = np.empty(len(joints))
    for column, joint in enumerate(joints):
        scaled_preferred[column] = preferred[joint] / units[joint]
    towards, against = (
        multiply_vector(u[:m].T, rates),
        multiply_vector(u[:m].T, multiply_vector(task, scaled_preferred)),
    )
    for i in range(len(s)):
        inverse = 1.0 / s[i] if s[i] >= SINGULAR_TOLERANCE * s[0] and s[i] > 0.0 else 0.0
        towards[i] *= inverse
        against[i] *= inverse
    moved, task_part = multiply_vector(vt.T, towards), multiply_vector(vt.T, against)
    primary, secondary = fixed.copy(), np.zeros(len(free))
    for column, joint in enumerate(joints):
        primary[joint] = moved[column] * units[joint]
        secondary[joint] = (scaled_preferred[column] - task_part[column]) * units[joint]
    return primary, secondary


@jit("f8[:], f8[:], f8[:], f8, f8")
def _passes_straight(q, elbow, velocities, reach_bend, dt):
    """Return whether one step removes more than half the bend of a nearly straight elbow.

    The step is a motion with `velocities` for dt (s).
    """
    bend, speed = q[int(elbow[0])] - elbow[1], velocities[int(elbow[0])]
    side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else elbow[2]
    return abs(bend) < reach_bend and speed * side < 0.0 and abs(speed) * dt > 0.5 * abs(bend)


@jit("f8[:,:], f8[:,:], f8[:,:], f8[:], f8[:], f8[:], f8[:], f8[:], f8[:,:], f8[:,:], "
          "f8[:], f8, f8, f8[:]")
def _solve_within_ranges(
    scaled_jacobian, bent_jacobian, basis, desired, weights, preferred, low, high, elbows, limits,
    q, dt, reach_bend, damping,
):
    """Compute joint velocities with which no joint leaves its range and no elbow becomes straight.

    A joint that would do so gets a fixed velocity, and `_solve_damped` is called again for the
    others.

    Returns:
        The result of `_solve_damped`; whether each joint (n,) may move freely; the indices of the
        joints that are stopped at a limit; whether an elbow was kept from becoming straight.
    """
    count = len(q)
    free, fixed = np.ones(count, np.bool_), np.zeros(count)
    stopped, stops, straight = np.empty(count, np.int64), 0, False
    solution, spare = fixed, fixed
    for _ in range(count + 1):
        near, back = False, True
        for elbow in elbows:
            near |= free[int(elbow[0])] and abs(q[int(elbow[0])] - elbow[1]) < reach_bend
        # Near a straight elbow, the Jacobian of bent elbows is tried first. Its solution is used if
        # it bends the elbows further.
        if near:
            solution, spare = _solve_damped(
                bent_jacobian, basis, desired, weights, preferred, free, fixed, damping[0],
                damping[1], limits[4],
            )  # fmt: skip
            for elbow in elbows:
                joint = int(elbow[0])
                bend = q[joint] - elbow[1]
                if free[joint] and abs(bend) < reach_bend:
                    side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else elbow[2]
                    back &= solution[joint] * side > 0.0
        if not (near and back):
            solution, spare = _solve_damped(
                scaled_jacobian, basis, desired, weights, preferred, free, fixed, damping[0],
                damping[1], limits[4],
            )  # fmt: skip
        done = True
        for elbow in elbows:
            joint = int(elbow[0])
            if free[joint] and _passes_straight(q, elbow, solution, reach_bend, dt):
                fixed[joint] = -0.5 * (q[joint] - elbow[1]) / dt
                free[joint], straight, done = False, True, False
        if not done:
            continue
        for i in range(count):
            inside = min(max(solution[i], low[i]), high[i])
            if free[i] and inside != solution[i]:
                fixed[i], free[i], done = inside, False, False
                stopped[stops] = i
                stops += 1
        if done:
            break
    return solution, spare, free, stopped[:stops], straight


@jit("f8[:,:], f8")
def _scale_rotations(twists, length):
    """Return twists (6, n) with their rotations multiplied by the length, so that all are in m/s.
    """
    scaled = np.empty(twists.shape)
    for i in range(6):
        factor = length if i > 2 else 1.0
        for j in range(twists.shape[1]):
            scaled[i, j] = factor * twists[i, j]
    return scaled


@jit("f8[:], f8[:,:], f8")
def _bend_elbows(q, elbows, reach_bend):
    """Return the joints (n,) with elbows bent by at least `reach_bend`, and whether any changed.

    `elbows` is an array (m, 7) whose rows are the fields of the m elbows; see Elbow.
    """
    bent, other = q.copy(), False
    for elbow in elbows:
        joint = int(elbow[0])
        bend = q[joint] - elbow[1]
        if abs(bend) < reach_bend:
            side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else elbow[2]
            more, other = side * reach_bend - bend, True
            bent[joint] += more
            bent[int(elbow[3])] += elbow[5] * more
            bent[int(elbow[4])] += elbow[6] * more
    return bent, other


SOLVER_SIGNATURE = (
    "f8[:,:], f8[:,:], f8[:], b1[:], f8[:], f8[:,:,:], f8[:,:], f8[:,:], f8, b1, f8[:], "
    "f8[:,:], f8[:], f8[:,::1], f8[:,::1]"
)
# Indices of the rows of two outputs of `solve_velocities`: `joints` (4, n) and `twists` (3, 6).
VELOCITIES, PRIMARY, MARGINS, STOPPED = range(4)
DESIRED, ACHIEVED, INFEASIBLE = range(3)


@jit(f"{CHAIN_SIGNATURE}, f8[:], f8[:,::1], f8[:,::1], {SOLVER_SIGNATURE}")
def solve_velocities(
    order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames, q, pose, jacobian,
    goal, L, rate, modelled, preferred, range_tasks, elbows, limits, dt, is_limited, previous, last,
    settings, joints, twists,
):
    """Compute the solution of `DifferentialIK.solve`.

    Args:
        order … tip_frames: fields of the Chain.
        q: (n,) joint positions.
        pose, jacobian: (4, 4) and (6, n) of the camera at q. They are inputs if `origins` is empty,
            otherwise outputs.
        goal: (4, 4) pose at which the directions that the task does not control are held.
        L, rate, modelled: (k, 6), (k,) and (6,) fields of the task.
        preferred: (n,) velocities of the secondary tasks, except the range tasks.
        range_tasks: (p, 3, n) arrays `rows` of the p JointRangeTasks.
        elbows: (m, 7) fields of the m Elbows.
        limits: (5, n) rows with the lower position, upper position, velocity and acceleration
            limits; the last row contains the joint motions, rad or m, that have the same weight in
            the least squares.
        dt, is_limited, previous: see `limit_velocities`.
        last: (2, n) velocities of the last solution, and their part for the task.
        settings: array of the fields of IKSettings.
        joints: (4, n) output: the velocities, their part for the task, the distances to the
            position limits, and whether each joint is stopped at a limit.
        twists: (3, 6) output: the desired, the achieved and the infeasible twist, in SI units.

    Returns:
        The factor by which limits slow the task; the index of the joint with the decisive limit, or
        -1; whether an elbow would become straight; whether the infeasible twist is large enough to
        be reported; whether the velocities can be reused; the number of joints that are stopped at
        a limit.
    """
    length, reach, bent = settings[0], settings[6], jacobian
    if len(origins) > 0:
        compute_pose_and_jacobian(
            order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames, q, pose,
            jacobian,
        )  # fmt: skip
        posture, other = _bend_elbows(q, elbows, reach)
        if other:
            bent = np.empty((6, len(q)))
            compute_pose_and_jacobian(
                order, parents, is_prismatic, signs, origins, axes, end_joints, tip_frames, posture,
                np.empty((4, 4)), bent,
            )  # fmt: skip
    held, errors, free = compute_held_directions(pose, goal, modelled, length)
    for i in range(len(errors)):
        errors[i] *= settings[3]
    preferred = preferred.copy()
    for task in range_tasks:
        for i in range(len(q)):
            preferred[i] += task[2, i] * (min(max(q[i], task[0, i]), task[1, i]) - q[i])
    scaled, scaled_L = _scale_rotations(jacobian, length), L.copy()
    for i in range(len(L)):
        for j in range(3, 6):
            scaled_L[i, j] /= length
    basis, desired, weights = _build_rows(
        scaled_L, rate, held, errors, free, scaled, length * settings[4], length * settings[5]
    )  # fmt: skip
    low, high = compute_velocity_ranges(q, limits, dt)
    solution, spare, moving, stopped, straight = _solve_within_ranges(
        scaled, _scale_rotations(bent, length), basis, desired, weights, preferred, low, high,
        elbows, limits,
        q, dt, reach, settings[1:3],
    )  # fmt: skip
    velocities, primary, part, slowest = limit_velocities(
        solution, spare, low, high, limits, dt, is_limited, previous, last[0], last[1]
    )
    short = multiply_vector(basis, multiply_vector(scaled, solution))
    for i in range(len(short)):
        short[i] = desired[i] - short[i]
    twist, missing = multiply_vector(basis.T, desired), multiply_vector(basis.T, short)
    bound = max(settings[7], settings[8] * _norm(twist))
    is_reported = _norm(missing) > bound
    achieved = multiply_vector(jacobian, velocities)
    for i in range(6):
        unit = length if i > 2 else 1.0
        twists[DESIRED, i], twists[INFEASIBLE, i] = twist[i] / unit, missing[i] / unit
        twists[ACHIEVED, i] = achieved[i]
    fast = 0.0
    for i in range(len(q)):
        fast = max(fast, abs(velocities[i]) / limits[4, i])
        joints[VELOCITIES, i], joints[PRIMARY, i], joints[STOPPED, i] = (
            velocities[i], primary[i], 0.0,
        )  # fmt: skip
        joints[MARGINS, i] = min(q[i] - limits[0, i], limits[1, i] - q[i])
    for joint in stopped:
        joints[STOPPED, joint] = 1.0
    reusable = (
        len(stopped) == 0 and not straight and slowest < 0 and fast * REUSE_TIME <= SMALL_MOTION
    )
    if reusable:
        low, high = compute_velocity_ranges(q, limits, REUSE_TIME)
        for i in range(len(q)):
            reusable &= low[i] <= velocities[i] <= high[i]
        for elbow in elbows:
            reusable &= not (
                moving[int(elbow[0])] and _passes_straight(q, elbow, velocities, reach, REUSE_TIME)
            )
    return part, slowest, straight, is_reported, reusable, len(stopped)
