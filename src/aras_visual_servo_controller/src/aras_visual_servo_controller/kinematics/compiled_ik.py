"""One answer of the resolver, compiled.

Twists are scaled: the rotations by a length, so that all six numbers are in m/s.
"""

import numpy as np

from aras_visual_servo_base.compiled import jit

from .algebra import ROUNDING_TOLERANCE, has_singular_values_above, multiply, multiply_vector, svd
from .chain import CHAIN_SIGNATURE, compute_pose_and_jacobian
from .held_directions import compute_held_directions
from .limits import compute_velocity_ranges

# From this part of L's greatest singular value on all twists are seen alike.
WELL_CONDITIONED = 0.05
# A weak joint motion is damped at least as if the demand saw so much of it.
MIN_DEMAND = 0.3
SINGULAR_TOLERANCE = 1e-9  # part of the greatest singular value below which one is a rounding error
STRAIGHT_TOLERANCE = 1e-9  # rad; where an elbow is bent less, rounding would choose its side
# Joints that move less than this leave the Jacobian as it is, beside an elbow too, rad or m.
SMALL_MOTION = 0.002
REUSE_TIME = 0.05  # s that steady velocities may be kept; a slow camera's image period


@jit("f8[:]")
def _norm(a):
    """|a|."""
    square = 0.0
    for value in a:
        square += value * value
    return np.sqrt(square)


@jit("f8[:,:], f8[:], f8[:,:], f8[:], f8[:,:], f8[:,:], f8, f8")
def _build_rows(
    L, rate, held_directions, held_speeds, free, scaled_jacobian, hold_onset, hold_full
):
    """Rows for a task, and those for what it does not model.

    What is held leaves the other twists; in those the task is inverted, so that its wishes for what
    it does not model do not weigh.

    Args:
        L, rate: (k, 6), (k,) of the task.
        held, speeds: (p, 6) directions that are held, (p,) wanted along them.
        free: (6 - p, 6) the other directions.
        scaled: (6, n) the arm's Jacobian.
        least, fully: singular value from which the arm moves a held direction at all, and fully.

    Returns:
        basis (m, 6), orthonormal directions; wanted (m,) along them; weights (m,), 0 to 1, where
        the arm has to choose.
    """
    # Along which of the held directions can the arm move?
    turned, reach, _ = svd(multiply(held_directions, scaled_jacobian))
    along, wanted = multiply(turned.T, held_directions), multiply_vector(turned.T, held_speeds)
    weights = np.empty(len(reach))
    for i in range(len(reach)):
        part = min(max((reach[i] - hold_onset) / (hold_full - hold_onset), 0.0), 1.0)
        weights[i] = part * part * (3.0 - 2.0 * part)
    # What holding does to the features on its way is not the rest's to do.
    weighted = np.empty(len(reach))
    for i in range(len(reach)):
        weighted[i] = weights[i] * wanted[i]
    rest = multiply_vector(L, multiply_vector(along.T, weighted))
    for i in range(len(rest)):
        rest[i] = rate[i] - rest[i]
    u, s, vt = svd(multiply(L, free.T))
    rank = 0
    while rank < len(s) and s[rank] > ROUNDING_TOLERANCE * s[0]:
        rank += 1
    seen = multiply_vector(u.T, rest)
    basis = np.empty((rank + len(reach), 6))
    others = multiply(vt[:rank], free)
    speed, weight = np.empty(len(basis)), np.empty(len(basis))
    for i in range(len(reach)):
        speed[rank + i], weight[rank + i] = wanted[i], weights[i]
        for j in range(6):
            basis[rank + i, j] = along[i, j]
    for i in range(rank):
        for j in range(6):
            basis[i, j] = others[i, j]
        speed[i] = seen[i] / s[i]
        # A twist that the features hardly show weighs less where the arm has to choose.
        weight[i] = min(1.0, s[i] / (WELL_CONDITIONED * s[0]))
    return basis, speed, weight


@jit("f8[:,:], f8[:,:], f8[:], f8[:], f8[:], b1[:], f8[:], f8, f8, f8[:]")
def _solve_damped(
    scaled_jacobian, basis, desired, weights, preferred, free, fixed, damping, damping_below, units
):
    """Joint velocities for a demand, the others at their fixed ones, and what is free.

    Args:
        scaled: (6, n) the arm's Jacobian.
        basis, wanted, weights: as `_build_rows` answers them.
        wish: (n,) velocities where the demand leaves a choice.
        free, fixed: (n,) joints that may move, velocities (n,) of the others.
        damping, below: greatest damping, and singular value of the Jacobian where it sets in.
        units: (n,) motion of each joint that counts as much as any other's.

    Returns:
        (n,) for the demand; (n,) of the wish, what the demand does not see.
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
        turned, s, weak = svd(arm)
        strong = 0
        while strong < len(s) and s[strong] >= damping_below:
            strong += 1
        damped = np.empty((m + len(s) - strong, len(joints)))
        for i in range(m):
            for j in range(len(joints)):
                damped[i, j] = task[i, j]
        # As strong as the demand is in that direction, whatever the units of its rows.
        seen = multiply(rows, turned)
        for i in range(strong, len(s)):
            strength = max(_norm(seen[:, i]), MIN_DEMAND)
            ratio = s[i] / damping_below
            factor = damping * np.sqrt(1.0 - ratio * ratio) * strength
            for j in range(len(joints)):
                damped[m + i - strong, j] = factor * weak[i, j]
    u, s, vt = svd(damped)
    wishes = np.empty(len(joints))
    for column, joint in enumerate(joints):
        wishes[column] = preferred[joint] / units[joint]
    towards, against = (
        multiply_vector(u[:m].T, rates),
        multiply_vector(u[:m].T, multiply_vector(task, wishes)),
    )
    for i in range(len(s)):
        inverse = 1.0 / s[i] if s[i] >= SINGULAR_TOLERANCE * s[0] and s[i] > 0.0 else 0.0
        towards[i] *= inverse
        against[i] *= inverse
    moved, seen_wish = multiply_vector(vt.T, towards), multiply_vector(vt.T, against)
    primary, secondary = fixed.copy(), np.zeros(len(free))
    for column, joint in enumerate(joints):
        primary[joint] = moved[column] * units[joint]
        secondary[joint] = (wishes[column] - seen_wish[column]) * units[joint]
    return primary, secondary


@jit("f8[:], f8[:]")
def _find_scale(desired, room):
    """Greatest part, up to 1, of wanted (n,) that the rooms (n,) >= 0 allow; and who limits it."""
    part, joint = 1.0, 0
    for i in range(len(desired)):
        size = abs(desired[i])
        if size > room[i] and max(room[i], 0.0) / size < part:
            part, joint = max(room[i], 0.0) / size, i
    return part, joint


@jit("f8[:], f8[:], f8[:], f8[:], f8[:,:], f8, b1, f8[:], f8[:], f8[:]")
def _limit_velocities(desired, secondary, low, high, limits, dt, is_limited, previous, total, task):
    """Velocities within all limits.

    Args:
        wanted, secondary: (n,) for the task; those that it does not see.
        low, high: of `compute_velocity_ranges`.
        limited: by acceleration, from the previous velocities (n,) on, of which `task` (n,) served
            the task if they are the total (n,).

    Returns:
        Velocities (n,), their part for the task (n,), its scale, the joint that slowed it or -1.
    """
    count, fastest, acceleration = len(desired), limits[2], limits[3]
    part, slowest = _find_scale(desired, fastest)
    if part == 1.0:
        slowest = -1
    primary, others = np.empty(count), np.zeros(count)
    for i in range(count):
        primary[i] = part * desired[i]
    if is_limited:
        unchanged, change = True, np.empty(count)
        for i in range(count):
            unchanged &= abs(previous[i] - total[i]) < 1e-9
        before, steps = task if unchanged else previous, np.empty(count)
        for i in range(count):
            others[i] = previous[i] - before[i]
            steps[i] = primary[i] - before[i]
            change[i] = acceleration[i] * dt
        part, joint = _find_scale(steps, change)
        if part < 1.0:
            slowest = joint
            for i in range(count):
                primary[i] = before[i] + part * steps[i]
    towards, room, velocities = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        lowest, highest = max(low[i], -fastest[i]), min(high[i], fastest[i])
        if is_limited:
            # A joint that has to brake for its range, and cannot brake harder, does what it can.
            slower, faster = previous[i] - acceleration[i] * dt, previous[i] + acceleration[i] * dt
            lowest = min(max(lowest, slower), faster)
            highest = min(max(highest, slower), faster)
        velocities[i] = min(max(primary[i] + others[i], lowest), highest)
        # What the task leaves of the limits; the secondary tasks change as far as it goes.
        towards[i] = secondary[i] - others[i]
        room[i] = highest - velocities[i] if towards[i] > 0.0 else velocities[i] - lowest
    part, _ = _find_scale(towards, room)
    along, whole = 0.0, 0.0
    for i in range(count):
        velocities[i] += part * towards[i]
        along += primary[i] * desired[i]
        whole += desired[i] * desired[i]
    return velocities, primary, along / whole if slowest >= 0 else 1.0, slowest


@jit("f8[:], f8[:], f8[:], f8, f8")
def _passes_straight(q, elbow, velocities, reach_bend, dt):
    """Whether this step would take more than half of an elbow's small bend away."""
    bend, speed = q[int(elbow[0])] - elbow[1], velocities[int(elbow[0])]
    side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else elbow[2]
    return abs(bend) < reach_bend and speed * side < 0.0 and abs(speed) * dt > 0.5 * abs(bend)


@jit("f8[:,:], f8[:,:], f8[:,:], f8[:], f8[:], f8[:], f8[:], f8[:], f8[:,:], f8[:,:], "
          "f8[:], f8, f8, f8[:]")
def _solve_within_ranges(
    scaled_jacobian,
    bent_jacobian,
    basis,
    desired,
    weights,
    preferred,
    low,
    high,
    elbows,
    limits,
    q,
    dt,
    reach_bend,
    damping,
):
    """Solve again and again, until no joint passes its range and no elbow its straight.

    Returns:
        As `_solve_damped`; the joints that may move (n,), those that a limit stops, and whether an
        elbow is kept from becoming straight.
    """
    count = len(q)
    free, fixed = np.ones(count, np.bool_), np.zeros(count)
    stopped, stops, straight = np.empty(count, np.int64), 0, False
    solution, spare = fixed, fixed
    for _ in range(count + 1):
        near, back = False, True
        for fold in elbows:
            near |= free[int(fold[0])] and abs(q[int(fold[0])] - fold[1]) < reach_bend
        if near:  # with slightly bent elbows, when that is the way back from straight
            solution, spare = _solve_damped(
                bent_jacobian,
                basis,
                desired,
                weights,
                preferred,
                free,
                fixed,
                damping[0],
                damping[1],
                limits[4],
            )
            for fold in elbows:
                joint = int(fold[0])
                bend = q[joint] - fold[1]
                if free[joint] and abs(bend) < reach_bend:
                    side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else fold[2]
                    back &= solution[joint] * side > 0.0
        if not (near and back):
            solution, spare = _solve_damped(
                scaled_jacobian,
                basis,
                desired,
                weights,
                preferred,
                free,
                fixed,
                damping[0],
                damping[1],
                limits[4],
            )
        done = True
        for fold in elbows:
            joint = int(fold[0])
            if free[joint] and _passes_straight(q, fold, solution, reach_bend, dt):
                fixed[joint] = -0.5 * (q[joint] - fold[1]) / dt
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
    """Twists (6, n) with their rotations times the length, m/s."""
    scaled = np.empty(twists.shape)
    for i in range(6):
        factor = length if i > 2 else 1.0
        for j in range(twists.shape[1]):
            scaled[i, j] = factor * twists[i, j]
    return scaled


@jit("f8[:], f8[:,:], f8")
def _bend_elbows(q, elbows, reach_bend):
    """The posture (n,) with elbows bent by `reach_bend` at least, see Fold, and whether it differs.
    """
    bent, other = q.copy(), False
    for fold in elbows:
        joint = int(fold[0])
        bend = q[joint] - fold[1]
        if abs(bend) < reach_bend:
            side = np.sign(bend) if abs(bend) > STRAIGHT_TOLERANCE else fold[2]
            more, other = side * reach_bend - bend, True
            bent[joint] += more
            bent[int(fold[3])] += fold[5] * more
            bent[int(fold[4])] += fold[6] * more
    return bent, other


SOLVER_SIGNATURE = (
    "f8[:,:], f8[:,:], f8[:], b1[:], f8[:], f8[:,:,:], f8[:,:], f8[:,:], f8, b1, f8[:], "
    "f8[:,:], f8[:]"
)


@jit(f"{CHAIN_SIGNATURE}, f8[:], f8[:,::1], f8[:,::1], {SOLVER_SIGNATURE}")
def solve_velocities(
    order,
    parents,
    is_prismatic,
    signs,
    origins,
    axes,
    end_joints,
    tip_frames,
    q,
    pose,
    jacobian,
    goal,
    L,
    rate,
    modelled,
    preferred,
    range_tasks,
    elbows,
    limits,
    dt,
    is_limited,
    previous,
    last,
    settings,
):
    """What Resolver.resolve answers, in numbers.

    Args:
        order … tips: of the Chain; one without joints: view and Jacobian are given.
        q: (n,) joints. view, jacobian: (4, 4), (6, n) there.
        goal: (4, 4) as Resolver's.
        L, rate, modelled: (k, 6), (k,), (6,) of the task.
        wish: (n,) of the secondary tasks; pulls: (p, 3, n) of those that are a Pull.
        folds: (m, 7) of each elbow, see Fold.
        limits: (5, n) lower, upper, velocity, acceleration; units, see `_solve_damped`.
        dt, limited, previous: see `_limit_velocities`; last: (2, n) the last velocities, and their
            part for the task.
        settings: length, damping, damping_below, hold_gain, held_from, held_fully, reach_bend,
            shortfall, lost_part; see IKSettings.

    Returns:
        velocities, primary (n,); twists asked, given and lost (6,), in SI units; scale; the joint
        that slowed the task or -1; joints that a limit stops; whether an elbow would be straight;
        whether so much is lost that it is worth a word; whether the velocities last; distances
        (n,) to the limits.
    """
    length, reach, bent = settings[0], settings[6], jacobian
    if len(order) > 0:
        compute_pose_and_jacobian(
            order,
            parents,
            is_prismatic,
            signs,
            origins,
            axes,
            end_joints,
            tip_frames,
            q,
            pose,
            jacobian,
        )
        posture, other = _bend_elbows(q, elbows, reach)
        if other:
            bent = np.empty((6, len(q)))
            compute_pose_and_jacobian(
                order,
                parents,
                is_prismatic,
                signs,
                origins,
                axes,
                end_joints,
                tip_frames,
                posture,
                np.empty((4, 4)),
                bent,
            )
    held, errors, free = compute_held_directions(pose, goal, modelled, length)
    for i in range(len(errors)):
        errors[i] *= settings[3]
    preferred = preferred.copy()
    for pull in range_tasks:
        for i in range(len(q)):
            preferred[i] += pull[2, i] * (min(max(q[i], pull[0, i]), pull[1, i]) - q[i])
    scaled, seen = _scale_rotations(jacobian, length), L.copy()
    for i in range(len(L)):
        for j in range(3, 6):
            seen[i, j] /= length
    basis, wanted, weights = _build_rows(
        seen, rate, held, errors, free, scaled, length * settings[4], length * settings[5]
    )  # fmt: skip
    low, high = compute_velocity_ranges(q, limits, dt)
    solution, spare, moving, stopped, straight = _solve_within_ranges(
        scaled, _scale_rotations(bent, length), basis, wanted, weights, preferred, low, high,
        elbows, limits,
        q, dt, reach, settings[1:3],
    )  # fmt: skip
    velocities, primary, part, slowest = _limit_velocities(
        solution, spare, low, high, limits, dt, is_limited, previous, last[0], last[1]
    )
    short = multiply_vector(basis, multiply_vector(scaled, solution))
    fast, margins = 0.0, np.empty(len(q))
    for i in range(len(short)):
        short[i] = wanted[i] - short[i]
    asked, missing = multiply_vector(basis.T, wanted), multiply_vector(basis.T, short)
    bound = max(settings[7], settings[8] * _norm(asked))
    worth_a_word = _norm(missing) > bound
    for i in range(3, 6):
        asked[i], missing[i] = asked[i] / length, missing[i] / length
    for i in range(len(q)):
        fast = max(fast, abs(velocities[i]) / limits[4, i])
        margins[i] = min(q[i] - limits[0, i], limits[1, i] - q[i])
    lasts = len(stopped) == 0 and not straight and slowest < 0 and fast * REUSE_TIME <= SMALL_MOTION
    if lasts:
        low, high = compute_velocity_ranges(q, limits, REUSE_TIME)
        for i in range(len(q)):
            lasts &= low[i] <= velocities[i] <= high[i]
        for fold in elbows:
            lasts &= not (
                moving[int(fold[0])] and _passes_straight(q, fold, velocities, reach, REUSE_TIME)
            )
    return (
        velocities, primary, asked, multiply_vector(jacobian, velocities), missing, part, slowest,
        stopped,
        straight, worth_a_word, lasts, margins,
    )  # fmt: skip
