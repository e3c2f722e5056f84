"""Rules of joint_limits_interface; each expected value is computed by hand."""

import random

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
WHERE = "/r/joint_limits/J"


def soft_limits(lower=-1.5, upper=1.5, k_position=10.0, k_velocity=20.0):
    return SoftLimits(lower, upper, k_position, k_velocity)


def handle(soft=None, position=0.0, velocity=0.0, interface=EFFORT):
    joint = JointHandle("J", "revolute", None, soft, interface)
    joint.position, joint.velocity = position, velocity
    return joint


RULES = {EFFORT_SATURATION: EFFORT, EFFORT_SOFT: EFFORT, POSITION_SATURATION: POSITION,
         POSITION_SOFT: POSITION, VELOCITY_SATURATION: VELOCITY, VELOCITY_SOFT: VELOCITY}
COMMANDS = {EFFORT: "effort_command", POSITION: "position_command", VELOCITY: "velocity_command"}


def limited(joint, rule, command, limits=LIMITS):
    """The command that is left, DT after the last; `rule`: a LimitRule, or a new one's kind."""
    rule = rule if isinstance(rule, LimitRule) else LimitRule(rule, limits, joint)
    setattr(joint, COMMANDS[joint.interface], command)
    enforce_limits(rule.row, joint.row, DT)
    return getattr(joint, COMMANDS[joint.interface])


@pytest.mark.parametrize(("proves", "position", "velocity", "command", "expected"), [
    ("inside passes", 0, 0, 60, 60), ("clamped to -max_effort", 0, 0, -160, -100),
    ("no push further above the upper limit", 2.1, 0, 60, 0),
    ("pull back from above the upper limit", 2.1, 0, -60, -60),
    ("no speeding up beyond vmax", 0, 5.1, 60, 0), ("braking beyond vmax", 0, 5.1, -60, -60),
    ("on the limit counts as inside", 2.0, 5.0, 60, 60)])
def test_effort_saturation(proves, position, velocity, command, expected):
    joint = handle(position=position, velocity=velocity)
    assert limited(joint, EFFORT_SATURATION, command) == expected, proves


@pytest.mark.parametrize(("proves", "position", "velocity", "command", "expected"), [
    # k_position 10, k_velocity 20, soft limits +-1.5, vmax 5, emax 100.
    ("far inside: only emax", 0.0, 0.0, 160, 100),
    ("vhi = -10 (1.4 - 1.5) = 1: effort <= -20 (0 - 1) = 20", 1.4, 0.0, 60, 20),
    ("vhi = 1 and vel 2: must brake with 20", 1.4, 2.0, 60, -20),
    ("beyond the soft limit: vhi = -1, so effort <= -20", 1.6, 0.0, 60, -20),
    ("vhi saturates at vmax: -20 (4 - 5) = 20", 0.0, 4.0, 60, 20),
])
def test_effort_soft(proves, position, velocity, command, expected):
    joint = handle(soft_limits(), position, velocity)
    assert limited(joint, EFFORT_SOFT, command) == pytest.approx(expected), proves


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_soft_limit_that_is_not_given_does_not_bind(side):
    for soft, bound in (({}, 60.0), ({side: 1.5 * side}, 20.0), ({-side: -1.5 * side}, 60.0)):
        joint = handle(soft_limits(lower=soft.get(-1.0), upper=soft.get(1.0)), position=1.4 * side)
        assert limited(joint, EFFORT_SOFT, 60.0 * side) == pytest.approx(bound * side)


def test_position_rules_step_by_step():
    joint = handle(position=1.0, interface=POSITION)
    rule = LimitRule(POSITION_SATURATION, LIMITS, joint)
    # vmax dt = 0.5 from the measured 1.0, then the range's end; the measured position is forgotten.
    assert [limited(joint, rule, 9.0) for _ in range(4)] == [1.5, 2.0, 2.0, 2.0]
    assert limited(joint, rule, -9.0) == 1.5
    joint = handle(soft_limits(k_position=2.0), position=1.0, interface=POSITION)
    rule = LimitRule(POSITION_SOFT, LIMITS, joint)
    # vhi = -2 (x - 1.5): each step goes 0.2 of the way that is left to 1.5.
    assert [limited(joint, rule, 9.0) for _ in range(3)] == pytest.approx([1.1, 1.18, 1.244])


@pytest.mark.parametrize("rule", RULES)
def test_what_holds_upwards_holds_downwards(rule):
    """A joint turned round, with its limits, its motion and its commands, is treated alike."""
    draw, changed = random.Random(3), 0
    for _ in range(200):
        lower, upper = -draw.uniform(0.5, 2.0), draw.uniform(0.5, 2.0)
        soft = SoftLimits(0.8 * lower, 0.7 * upper, draw.uniform(1.0, 4.0), draw.uniform(1.0, 9.0))
        rest = (draw.uniform(0.5, 3.0), draw.choice([None, draw.uniform(1.0, 9.0)]), 10.0)
        back = SoftLimits(-soft.upper, -soft.lower, soft.k_position, soft.k_velocity)
        joint, mirrored = (handle(one, interface=RULES[rule]) for one in (soft, back))
        one = LimitRule(rule, JointBounds(lower, upper, *rest), joint)
        other = LimitRule(rule, JointBounds(-upper, -lower, *rest), mirrored)
        for _ in range(6):
            joint.position, joint.velocity = draw.uniform(-2.5, 2.5), draw.uniform(-4.0, 4.0)
            if RULES[rule] != EFFORT:  # bounds that cross: the upper wins, as upstream
                joint.position = draw.uniform(soft.lower, soft.upper)
                joint.velocity = draw.uniform(-0.1, 0.1)
            mirrored.position, mirrored.velocity = -joint.position, -joint.velocity
            command = draw.uniform(-20.0, 20.0)
            found = limited(joint, one, command)
            assert limited(mirrored, other, -command) == pytest.approx(-found, abs=1e-12)
            changed += found != command
    assert changed > 100


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_that_was_reset_is_as_new(rule):
    joint = handle(soft_limits(), 0.5, 0.0, RULES[rule])
    limits = JointBounds(-2.0, 2.0, 5.0, 10.0, 100.0)
    used = LimitRule(rule, limits, joint)
    for _ in range(2):
        limited(joint, used, -9.0)
    used.reset()
    assert limited(joint, used, 9.0) == limited(joint, rule, 9.0, limits)


@pytest.mark.parametrize(("proves", "acceleration", "commands", "expected"), [
    ("clamped to +-vmax", None, [9.0, -9.0, 3.0], [5.0, -5.0, 3.0]),
    ("amax dt = 1 from 0, then from the last command", 10.0, [9.0, 9.0, -9.0], [1.0, 2.0, 1.0]),
])
def test_velocity_saturation(proves, acceleration, commands, expected):
    joint = handle(interface=VELOCITY)
    rule = LimitRule(VELOCITY_SATURATION, JointBounds(-2.0, 2.0, 5.0, acceleration), joint)
    found = [limited(joint, rule, command) for command in commands]
    assert found == pytest.approx(expected), proves


@pytest.mark.parametrize(
    ("proves", "acceleration", "position", "velocity", "command", "expected"),
    [
        ("far inside: vmax", None, 0.0, 0.0, 9.0, 5.0),
        ("vhi = -10 (1.4 - 1.5) = 1", None, 1.4, 0.0, 9.0, 1.0),
        ("beyond the soft limit it must come back", None, 1.6, 0.0, 9.0, -1.0),
        ("amax dt = 1 around the measured velocity", 10.0, 0.0, 2.0, 9.0, 3.0),
        ("what is within passes", 10.0, 0.0, 2.0, 1.5, 1.5)],
)
def test_velocity_soft(proves, acceleration, position, velocity, command, expected):
    joint, limits = handle(soft_limits(), position, velocity, VELOCITY), JointBounds(
        -2.0, 2.0, 5.0, acceleration)
    assert limited(joint, VELOCITY_SOFT, command, limits) == pytest.approx(expected), proves


def test_rules_name_the_limit_they_lack():
    for interface, limits, soft, lacking in (
        (EFFORT, {"max_effort": 1.0}, None, "max_velocity"),
        (EFFORT, {"max_velocity": 1.0}, None, "max_effort"),
        (EFFORT, {"max_velocity": 1.0}, soft_limits(), "max_effort"),
        (VELOCITY, {}, None, "max_velocity"),
        (POSITION, {"min_position": -1.0, "max_position": 1.0}, soft_limits(), "max_velocity")):
        with pytest.raises(HardwareError, match=f"'J'.*{lacking}"):
            make_rule(handle(soft, interface=interface), JointBounds(**limits))
    assert make_rule(handle(), None) is None
    assert make_rule(handle(interface=POSITION), JointBounds(-1, 1)).kind == POSITION_SATURATION


class TestResolving:
    @pytest.mark.parametrize(("kind", "limits", "overrides", "expected"), [
        ("revolute", None, {}, JointBounds(-2.0, 2.0, 5.0, None, 100.0)),
        ("continuous", None, {}, JointBounds(None, None, 5.0, None, 100.0)),
        ("revolute", "none", {}, None),
        ("revolute", None, {
            "has_position_limits": True, "min_position": -1, "max_position": 1,
            "has_velocity_limits": False, "has_acceleration_limits": True, "max_acceleration": 3.0,
            "has_effort_limits": True, "max_effort": 7.0}, JointBounds(-1.0, 1.0, None, 3.0, 7.0))])
    def test_parameters_win_and_may_take_away(
        self, make_joint, caplog, kind, limits, overrides, expected
    ):
        joint, _ = make_joint("J", kind, limits=limits)
        assert resolve_limits(joint, overrides, WHERE) == expected and not caplog.messages

    @pytest.mark.parametrize(("overrides", "word"), [
        ({"max_effort": 7.0}, "has_effort_limits"),
        ({"has_position_limits": True, "min_position": 0.0}, "max_position"),
    ])
    def test_values_and_switches_without_each_other_are_ignored_aloud(
        self, make_joint, caplog, overrides, word
    ):
        joint, _ = make_joint("J")
        assert resolve_limits(joint, overrides, WHERE) == resolve_limits(joint, {}, WHERE)
        assert word in caplog.messages[0]

    @pytest.mark.parametrize("overrides", [
        {"has_effort_limits": True, "max_effort": -1.0},
        {"has_effort_limits": True, "max_effort": float("nan")}, {"has_effort_limits": "yes"},
        {"has_position_limits": True, "min_position": 1.0, "max_position": -1.0}])
    def test_impossible_limits_are_refused(self, make_joint, overrides):
        with pytest.raises(HardwareError, match=WHERE):
            resolve_limits(make_joint("J")[0], overrides, WHERE)


@pytest.mark.parametrize("quantity", ["velocity", "acceleration", "effort"])
def test_a_limit_of_zero_is_one(make_joint, quantity):
    joint, _ = make_joint("J")
    given = {f"has_{quantity}_limits": True, f"max_{quantity}": 0.0}
    assert getattr(resolve_limits(joint, given, "/limits/J"), f"max_{quantity}") == 0.0
    with pytest.raises(HardwareError, match="must not be negative"):
        resolve_limits(joint, {**given, f"max_{quantity}": -0.1}, "/limits/J")


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_range_that_the_urdf_leaves_out_is_zero(make_joint, make_limits, kind):
    joint, _ = make_joint("J", kind, limits=make_limits(lower=None, upper=None))
    limits = resolve_limits(joint, {}, "/limits/J")
    assert (limits.min_position, limits.max_position) == (0.0, 0.0)
    assert JointHandle("J", kind, joint.limits).position_limits == (0.0, 0.0)


@pytest.mark.parametrize("rule", [POSITION_SATURATION, POSITION_SOFT])
def test_position_rules_without_a_range_limit_speed_alone(rule):
    joint = handle(soft_limits(), 3.0, 0.0, POSITION)  # beyond soft limits, which need a range
    assert limited(joint, rule, 9.0, JointBounds(max_velocity=5.0)) == pytest.approx(3.5)
    assert limited(handle(interface=POSITION), POSITION_SATURATION, -9.0, JointBounds()) == -9.0


@pytest.mark.parametrize("command", [9.0, -9.0])
@pytest.mark.parametrize("limits", [JointBounds(max_velocity=5.0), JointBounds(-2.0, 2.0, 5.0)])
def test_soft_velocity_without_soft_limits_is_the_hard_one(limits, command):
    joint = handle(soft_limits(None, None, 0.0, 0.0), 0.3, 0.0, VELOCITY)
    assert limited(joint, VELOCITY_SOFT, command, limits) == (5.0 if command > 0 else -5.0)
