"""Rules of joint_limits_interface; each expected value is computed by hand."""

import random
from math import inf

import pytest

from aras_sim_bridge.control.joints import (
    EFFORT,
    POSITION,
    VELOCITY,
    JointBounds,
    JointHandle,
    resolve_limits,
)
from aras_sim_bridge.control.limits import (
    EFFORT_SATURATION,
    EFFORT_SOFT,
    POSITION_SATURATION,
    POSITION_SOFT,
    VELOCITY_SATURATION,
    VELOCITY_SOFT,
    LimitRule,
    enforce_limits,
    make_rule,
)
from aras_sim_bridge.description import SoftLimits
from aras_sim_bridge.errors import HardwareError

LIMITS = JointBounds(-2.0, 2.0, 5.0, None, 100.0)
DT = 0.1


def handle(soft=None, position=0.0, velocity=0.0, interface=EFFORT):
    joint = JointHandle("J", "revolute", None, soft, interface)
    joint.position, joint.velocity = position, velocity
    return joint


def enforce(rule, joint):
    """Limit the joint's command once, DT after the last time."""
    enforce_limits(rule.row, joint.row, DT)


@pytest.mark.parametrize(
    ("proves", "position", "velocity", "command", "expected"),
    [
        ("inside passes", 0, 0, 60, 60),
        ("clamped to max_effort", 0, 0, 160, 100),
        ("clamped to -max_effort", 0, 0, -160, -100),
        ("no push further below the lower limit", -2.1, 0, -60, 0),
        ("pull back from below the lower limit", -2.1, 0, 60, 60),
        ("no push further above the upper limit", 2.1, 0, 60, 0),
        ("pull back from above the upper limit", 2.1, 0, -60, -60),
        ("no speeding up beyond vmax", 0, 5.1, 60, 0),
        ("braking beyond vmax", 0, 5.1, -60, -60),
        ("no speeding up beyond -vmax", 0, -5.1, -60, 0),
        ("on the limit counts as inside", 2.0, 5.0, 60, 60),
        ("on the lower limit too", -2.0, -5.0, -60, -60),
    ],
)
def test_effort_saturation(proves, position, velocity, command, expected):
    joint = handle(position=position, velocity=velocity)
    joint.effort_command = command
    enforce(LimitRule(EFFORT_SATURATION, LIMITS, joint), joint)
    assert joint.effort_command == expected, proves


@pytest.mark.parametrize(
    ("proves", "position", "velocity", "command", "expected"),
    [
        # k_position 10, k_velocity 20, soft limits +-1.5, vmax 5, emax 100.
        ("far inside: only emax", 0.0, 0.0, 160, 100),
        ("vhi = -10 (1.4 - 1.5) = 1: effort <= -20 (0 - 1) = 20", 1.4, 0.0, 60, 20),
        ("vhi = 1 and vel 2: must brake with 20", 1.4, 2.0, 60, -20),
        ("beyond the soft limit: vhi = -1, so effort <= -20", 1.6, 0.0, 60, -20),
        ("vlo = -10 (-1.4 + 1.5) = -1: effort >= -20", -1.4, 0.0, -60, -20),
        ("vlo saturates at -vmax: -20 (-4 + 5) = -20", 0.0, -4.0, -60, -20),
    ],
)
def test_effort_soft(make_soft, proves, position, velocity, command, expected):
    joint = handle(make_soft(), position, velocity)
    joint.effort_command = command
    enforce(LimitRule(EFFORT_SOFT, LIMITS, joint), joint)
    assert joint.effort_command == pytest.approx(expected), proves


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_soft_limit_that_is_not_given_does_not_bind(make_soft, side):
    for soft, bound in (({}, 60.0), ({side: 1.5 * side}, 20.0), ({-side: -1.5 * side}, 60.0)):
        joint = handle(make_soft(lower=soft.get(-1.0), upper=soft.get(1.0)), position=1.4 * side)
        joint.effort_command = 60.0 * side
        enforce(LimitRule(EFFORT_SOFT, LIMITS, joint), joint)
        assert joint.effort_command == pytest.approx(bound * side)


def test_position_saturation_steps_from_the_measured_position_then_from_its_own_command():
    joint = handle(position=1.0, interface=POSITION)
    rule = LimitRule(POSITION_SATURATION, LIMITS, joint)
    given = []
    for _ in range(4):
        joint.position_command = 9.0
        enforce(rule, joint)
        given.append(joint.position_command)
    # vmax dt = 0.5 from the measured 1.0, then the range's end; the measured position is forgotten.
    assert given == [1.5, 2.0, 2.0, 2.0]
    joint.position_command = -9.0
    enforce(rule, joint)
    assert joint.position_command == 1.5


def test_position_soft_slows_down_towards_the_soft_limit(make_soft):
    joint = handle(make_soft(k_position=2.0), position=1.0, interface=POSITION)
    rule = LimitRule(POSITION_SOFT, LIMITS, joint)
    given = []
    for _ in range(3):
        joint.position_command = 9.0
        enforce(rule, joint)
        given.append(joint.position_command)
    # vhi = -2 (x - 1.5): each step goes 0.2 of the way that is left to 1.5.
    assert given == pytest.approx([1.1, 1.18, 1.244])


RULES = {EFFORT_SATURATION: EFFORT, EFFORT_SOFT: EFFORT, POSITION_SATURATION: POSITION,
         POSITION_SOFT: POSITION, VELOCITY_SATURATION: VELOCITY, VELOCITY_SOFT: VELOCITY}
COMMANDS = {EFFORT: "effort_command", POSITION: "position_command", VELOCITY: "velocity_command"}


@pytest.mark.parametrize("rule", RULES)
def test_what_holds_upwards_holds_downwards(rule):
    """A joint turned round, with its limits, its motion and its commands, is treated alike."""
    draw, changed = random.Random(3), 0
    for _ in range(200):
        lower, upper = -draw.uniform(0.5, 2.0), draw.uniform(0.5, 2.0)
        soft = SoftLimits(0.8 * lower, 0.7 * upper, draw.uniform(1.0, 4.0), draw.uniform(1.0, 9.0))
        acceleration = draw.choice([None, draw.uniform(1.0, 9.0)])
        rest = (draw.uniform(0.5, 3.0), acceleration, 10.0)
        back = SoftLimits(-soft.upper, -soft.lower, soft.k_position, soft.k_velocity)
        joint = handle(soft, interface=RULES[rule])
        mirrored = handle(back, interface=RULES[rule])
        one = LimitRule(rule, JointBounds(lower, upper, *rest), joint)
        other = LimitRule(rule, JointBounds(-upper, -lower, *rest), mirrored)
        field = COMMANDS[RULES[rule]]
        for _ in range(6):
            joint.position, joint.velocity = draw.uniform(-2.5, 2.5), draw.uniform(-4.0, 4.0)
            if field != "effort_command":  # bounds that cross: the upper wins, as upstream
                joint.position = draw.uniform(soft.lower, soft.upper)
                joint.velocity = draw.uniform(-0.1, 0.1)
            mirrored.position, mirrored.velocity = -joint.position, -joint.velocity
            command = draw.uniform(-20.0, 20.0)
            setattr(joint, field, command)
            setattr(mirrored, field, -command)
            enforce(one, joint)
            enforce(other, mirrored)
            assert getattr(mirrored, field) == pytest.approx(-getattr(joint, field), abs=1e-12)
            changed += getattr(joint, field) != command
    assert changed > 100


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_that_was_reset_is_as_new(make_soft, rule):
    joint = handle(make_soft(), 0.5, 0.0, RULES[rule])
    limits, field = JointBounds(-2.0, 2.0, 5.0, 10.0, 100.0), COMMANDS[RULES[rule]]
    used, new = LimitRule(rule, limits, joint), LimitRule(rule, limits, joint)
    given = []
    for one, command in ((used, -9.0), (used, -9.0), (used, 9.0), (new, 9.0)):
        if command > 0.0:
            one.reset()
        setattr(joint, field, command)
        enforce(one, joint)
        given.append(getattr(joint, field))
    assert given[2] == given[3]


@pytest.mark.parametrize(
    ("proves", "acceleration", "commands", "expected"),
    [
        ("clamped to +-vmax", None, [9.0, -9.0, 3.0], [5.0, -5.0, 3.0]),
        ("amax dt = 1 from 0, then from the last command", 10.0, [9.0, 9.0, -9.0], [1.0, 2.0, 1.0]),
    ],
)
def test_velocity_saturation(proves, acceleration, commands, expected):
    joint = handle(interface=VELOCITY)
    rule = LimitRule(VELOCITY_SATURATION, JointBounds(-2.0, 2.0, 5.0, acceleration), joint)
    given = []
    for command in commands:
        joint.velocity_command = command
        enforce(rule, joint)
        given.append(joint.velocity_command)
    assert given == pytest.approx(expected), proves


@pytest.mark.parametrize(
    ("proves", "acceleration", "position", "velocity", "command", "expected"),
    [
        ("far inside: vmax", None, 0.0, 0.0, 9.0, 5.0),
        ("vhi = -10 (1.4 - 1.5) = 1", None, 1.4, 0.0, 9.0, 1.0),
        ("beyond the soft limit it must come back", None, 1.6, 0.0, 9.0, -1.0),
        ("amax dt = 1 around the measured velocity", 10.0, 0.0, 2.0, 9.0, 3.0),
        ("amax dt = 1 below the measured velocity", 10.0, 0.7, 2.0, -9.0, 1.0),
        ("-vmax", None, 0.0, 0.0, -9.0, -5.0),
        ("what is within passes", 10.0, 0.0, 2.0, 1.5, 1.5),
    ],
)
def test_velocity_soft(make_soft, proves, acceleration, position, velocity, command, expected):
    joint = handle(make_soft(), position, velocity, VELOCITY)
    joint.velocity_command = command
    enforce(LimitRule(VELOCITY_SOFT, JointBounds(-2.0, 2.0, 5.0, acceleration), joint), joint)
    assert joint.velocity_command == pytest.approx(expected), proves


def test_rules_name_the_limit_they_lack(make_soft):
    for interface, limits, soft, lacking in (
        (EFFORT, JointBounds(max_effort=1.0), None, "max_velocity"),
        (EFFORT, JointBounds(max_velocity=1.0), None, "max_effort"),
        (EFFORT, JointBounds(max_velocity=1.0), make_soft(), "max_effort"),
        (VELOCITY, JointBounds(), None, "max_velocity"),
        (POSITION, JointBounds(-1.0, 1.0), make_soft(), "max_velocity"),
    ):
        with pytest.raises(HardwareError, match=f"'J'.*{lacking}"):
            make_rule(handle(soft, interface=interface), limits)
    assert make_rule(handle(), None) is None
    rule = make_rule(handle(interface=POSITION), JointBounds(-1.0, 1.0))
    assert rule.kind == POSITION_SATURATION


class TestResolving:
    """URDF first, parameters over it."""

    @pytest.fixture
    def resolve(self, log_lines):
        """Return the limits of a joint, and what was logged."""
        return lambda joint, overrides: (
            resolve_limits(joint, overrides, "/r/joint_limits/J"), log_lines)

    @pytest.mark.parametrize(("kind", "limits", "overrides", "expected"), [
        ("revolute", None, {}, JointBounds(-2.0, 2.0, 5.0, None, 100.0)),
        ("continuous", None, {}, JointBounds(None, None, 5.0, None, 100.0)),
        ("revolute", "none", {}, None),
        ("revolute", None, {
            "has_position_limits": True, "min_position": -1, "max_position": 1,
            "has_velocity_limits": False, "has_acceleration_limits": True,
            "max_acceleration": 3.0, "has_effort_limits": True, "max_effort": 7.0,
        }, JointBounds(-1.0, 1.0, None, 3.0, 7.0)),
    ])
    def test_parameters_win_and_may_take_away(
        self, resolve, make_joint, kind, limits, overrides, expected
    ):
        joint, _ = make_joint("J", kind, limits=limits)
        assert resolve(joint, overrides) == (expected, [])

    def test_values_without_their_switch_are_ignored_aloud(self, resolve, make_joint):
        limits, said = resolve(make_joint("J")[0], {"max_effort": 7.0})
        assert limits.max_effort == 100.0
        assert "has_effort_limits" in said[0]

    def test_switch_without_values_keeps_the_urdf_aloud(self, resolve, make_joint):
        limits, said = resolve(
            make_joint("J")[0], {"has_position_limits": True, "min_position": 0.0}
        )
        assert limits.min_position == -2.0
        assert "max_position" in said[0]

    @pytest.mark.parametrize(
        "overrides",
        [
            {"has_effort_limits": True, "max_effort": -1.0},
            {"has_effort_limits": True, "max_effort": float("nan")},
            {"has_effort_limits": "yes"},
            {"has_position_limits": True, "min_position": 1.0, "max_position": -1.0},
        ],
    )
    def test_impossible_limits_are_refused(self, resolve, make_joint, overrides):
        with pytest.raises(HardwareError, match="/r/joint_limits/J"):
            resolve(make_joint("J")[0], overrides)


@pytest.mark.parametrize("quantity", ["max_velocity", "max_acceleration", "max_effort"])
def test_a_limit_of_zero_is_one(make_joint, quantity):
    joint, _ = make_joint("J")
    switch = f"has_{quantity.removeprefix('max_')}_limits"
    limits = resolve_limits(joint, {switch: True, quantity: 0.0}, "/limits/J")
    assert getattr(limits, quantity) == 0.0
    with pytest.raises(HardwareError, match="must not be negative"):
        resolve_limits(joint, {switch: True, quantity: -0.1}, "/limits/J")


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_range_that_the_urdf_leaves_out_is_zero(make_joint, make_limits, kind):
    joint, _ = make_joint("J", kind, limits=make_limits(lower=None, upper=None))
    limits = resolve_limits(joint, {}, "/limits/J")
    assert (limits.min_position, limits.max_position) == (0.0, 0.0)
    assert JointHandle("J", kind, joint.limits).position_limits == (0.0, 0.0)


@pytest.mark.parametrize("command", [9.0, -9.0])
def test_position_rules_without_a_range_limit_speed_alone(make_soft, command):
    limits = JointBounds(max_velocity=5.0)
    for rule in (POSITION_SATURATION, POSITION_SOFT):
        joint = JointHandle("J", "continuous", None, make_soft(), POSITION)
        joint.position = 3.0  # beyond the soft limits, which need a range
        joint.position_command = command
        enforce_limits(LimitRule(rule, limits, joint).row, joint.row, 0.1)
        assert joint.position_command == pytest.approx(3.0 + (0.5 if command > 0 else -0.5))
    free = JointHandle("J", "continuous", None, None, POSITION)
    free.position_command = command
    enforce_limits(LimitRule(POSITION_SATURATION, JointBounds(), free).row, free.row, 0.1)
    assert free.position_command == command


@pytest.mark.parametrize("command", [9.0, -9.0])
@pytest.mark.parametrize("limits", [JointBounds(max_velocity=5.0), JointBounds(-2.0, 2.0, 5.0)])
def test_soft_velocity_without_soft_limits_is_the_hard_one(make_soft, limits, command):
    """Even with a gain of zero, times an infinite distance."""
    joint = JointHandle("J", "revolute", None, make_soft(None, None, 0.0, 0.0), VELOCITY)
    joint.position = 0.3
    joint.velocity_command = command
    enforce_limits(LimitRule(VELOCITY_SOFT, limits, joint).row, joint.row, 0.1)
    assert joint.velocity_command == (5.0 if command > 0 else -5.0)
    assert abs(joint.velocity_command) < inf
