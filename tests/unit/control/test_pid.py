"""PID of control_toolbox; every expected value is computed by hand."""

from dataclasses import astuple
from math import inf, nan

import pytest

from aras_sim_bridge.control.pid import Pid, PidGains
from aras_sim_bridge.errors import ControllerError

# (what it proves, gains p i d i_max i_min antiwindup, [(error, dt, command), ...])
TABLE = [
    ("P alone multiplies", (2, 0, 0, 0, 0, False), [(1.5, 0.1, 3.0), (-1.5, 0.1, -3.0)]),
    ("the first derivative is error/dt, later ones are differences", (0, 0, 0.5, 0, 0, False),
     [(1.0, 0.1, 5.0), (0.5, 0.1, -2.5), (0.5, 0.1, 0.0)]),
    ("P, I and D add up; I is rectangular and includes the present error",
     (2, 3, 0.5, 10, -10, False), [(1.0, 0.1, 2 + 0.3 + 5), (0.5, 0.1, 1 + 0.45 - 2.5)]),
    ("without a clamp the integral term is 0 whatever i", (0, 7, 0, 0, 0, False), [(1, 1, 0)] * 3),
    ("so it is with antiwindup", (0, 7, 0, 0, 0, True), [(1, 1, 0)] * 3),
    ("no antiwindup: the term is clamped, the integral grows on and must be unwound",
     (0, 2, 0, 1, -1, False), [(10, 1, 1.0), (-4, 1, 1.0), (-5.9, 1, 0.2), (-1, 1, -1.0)]),
    ("antiwindup: the integral itself is clamped and leaves the limit at once",
     (0, 2, 0, 1, -1, True), [(10, 1, 1.0), (-0.1, 1, 0.8), (-10, 1, -1.0), (0.25, 1, -0.5)]),
    ("a negative i gain turns the bounds round but bounds the term alike",
     (0, -2, 0, 1, -1, True), [(10, 1, -1.0), (-0.1, 1, -0.8)]),
    ("bounds need not be symmetric", (0, 1, 0, 3, -0.5, False),
     [(2, 1, 2.0), (2, 1, 3.0), (-10, 1, -0.5)]),
    ("dt = 0 gives 0 and leaves everything as it was", (1, 1, 1, 10, -10, False),
     [(1, 1, 3.0), (5, 0, 0.0), (1, 1, 1 + 2 + 0)]),
    ("NaN and infinite errors give 0 and leave everything as it was", (1, 1, 1, 10, -10, False),
     [(1, 1, 3.0), (nan, 1, 0.0), (inf, 1, 0.0), (-inf, 1, 0.0), (1, 1, 3.0)]),
    ("negative dt integrates backwards and keeps the last derivative", (1, 1, 1, 10, -10, False),
     [(1, 1, 1 + 1 + 1), (2, -1, 2 - 1 + 1)]),
    ("the output is not clamped", (1e6, 0, 0, 1, -1, True), [(1e6, 0.001, 1e12)])]


@pytest.mark.parametrize(("proves", "gains", "cycles"), TABLE, ids=[row[0] for row in TABLE])
def test_golden_table(proves, gains, cycles):
    pid = Pid(PidGains(*gains))
    assert [pid.compute(error, dt) for error, dt, _ in cycles] == pytest.approx(
        [command for *_, command in cycles], abs=1e-12
    )


def test_integral_derivative_and_terms():
    pid = Pid(PidGains(0, 1, 1, 10, -10))
    for _ in range(2):
        assert pid.compute(1.0, 0.5) == 0.5 + 2.0
        pid.compute(1.0, 0.5)
        pid.reset()
        assert pid.integral == 0.0
    pid = Pid(PidGains(1, 1, 2, 10, -10))
    given = [(1.0, 3.0), (1.0, nan), (0.0, 3.0)]
    assert [pid.compute(1.0, dt, rate) for dt, rate in given] == [1 + 1 + 6, 0.0, 0.0]
    assert pid.integral == 1.0
    pid.set_gains(PidGains(0, 2, 0, 10, -10))  # which keep it
    assert pid.compute(1.0, 1.0) == 4.0
    pid, seen = Pid(PidGains(2, 3, 0.5, 10, -10)), []
    pid.on_state = seen.append
    pid.compute(1.5, 0.1)
    assert astuple(seen[0]) == pytest.approx(
        (0.1, 1.5, 15.0, 1.5, 0.15, 15.0, 3.0, 0.45, 7.5, 10.0, -10.0, 10.95))
    pid = Pid(PidGains(1))
    for gains in (PidGains(nan), PidGains(1, inf), PidGains(1, 1, 0, -1, 1)):
        with pytest.raises(ControllerError):
            pid.set_gains(gains)
    assert pid.gains == PidGains(1) and not pid.publish_state


@pytest.mark.parametrize(("parameters", "expected"), [
    ({"p": 15000}, PidGains(15000.0)),
    ({"p": 1, "i": 2, "d": 3, "i_clamp": -4}, PidGains(1, 2, 3, 4, -4)),
    ({"p": 1, "i_clamp": 4, "i_clamp_min": 2, "i_clamp_max": -6}, PidGains(1, 0, 0, 6, -2)),
    ({"p": 1, "antiwindup": True}, PidGains(1, antiwindup=True))])
def test_parameters_are_read_as_control_toolbox_does(parameters, expected):
    assert Pid.from_parameters(parameters, "/r/c/pid").gains == expected
    for told in (False, True):
        pid = Pid.from_parameters({**parameters, "publish_state": told}, "/r/c/pid")
        assert pid.publish_state is told


@pytest.mark.parametrize(("parameters", "text"), [
    ({}, "/r/c/pid/p"), ({"p": "much"}, "/r/c/pid/p is 'much', must be a finite number"),
    ({"p": 1, "i": nan}, "/r/c/pid/i is nan, must be a finite number"),
    ({"p": 1, "antiwindup": 1}, "/r/c/pid/antiwindup is 1, must be true or false")])
def test_bad_parameters_are_named(parameters, text):
    with pytest.raises(ControllerError, match=text):
        Pid.from_parameters(parameters, "/r/c/pid")


def test_a_misspelt_gain_is_told_with_the_nearest_name(caplog):
    Pid.from_parameters({"p": 1, "i_clmap": 2.0, "d": 3}, "/r/c/pid")
    (line,) = caplog.messages
    assert line == "parameter /r/c/pid/i_clmap is not used; did you mean 'i_clamp'?"
