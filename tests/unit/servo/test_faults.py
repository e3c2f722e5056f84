"""An error in a user's scheme stops the arm at the next image and is reported once."""

import re
from dataclasses import replace

import numpy as np
import pytest
from loop_rig import CAMERA, STARTS, TICK, Rig, the_limits, the_servo

from aras_visual_servo_controller import Feature, JointController, JointSample, Task, errors
from aras_visual_servo_controller.laws import Law, Proportional
from aras_visual_servo_controller.records.outcomes import REMEDIES
from aras_visual_servo_controller.records.state import HOLDING, SERVOING
from aras_visual_servo_controller.schemes import FeatureScheme, Scheme, SchemeOutput, create_scheme
from aras_visual_servo_controller.schemes.scheme_call import check_goal, compute
from aras_visual_servo_controller.schemes.time_limit import call_user_code

GOOD_FROM, GOOD_TO = 0.1, 0.4  # s between which the scheme goes wrong


class Spoiled(Scheme):
    def __init__(self, fault):
        super().__init__(Proportional(3.0))
        self.inner, self.fault = create_scheme("moments", self.law), fault
        self.names, self.tolerances = self.inner.names, self.inner.tolerances
        self.needs, self.check = self.inner.needs, self.inner.check

    def compute(self, observation, goal, t):
        decision = self.inner.compute(observation, goal, t)
        if GOOD_FROM <= observation.stamp < GOOD_TO:
            return self.fault(self, decision)
        self.tolerances = self.inner.tolerances
        return decision


def spoiled(fault, seconds):
    return Rig(the_servo("2016", Spoiled(fault)), STARTS["2016"]).run(seconds)


def raising(error):
    def fault(scheme, decision):
        raise error

    return fault


def answering(**changes):
    return lambda scheme, decision: replace(decision, **changes)


def with_task(**changes):
    def fault(scheme, decision):
        fields = {key: getattr(decision.task, key) for key in ("L", "desired_rate", "modelled")}
        return answering(task=Task(**{**fields, **changes}))(scheme, decision)

    return fault


FAULTS = {
    "value error": (raising(ValueError("no such thing")), "raised ValueError: no such thing"),
    "system exit": (raising(SystemExit(3)), "raised SystemExit: 3"),
    "assertion": (raising(AssertionError()), "raised AssertionError"),
    "two lines": (raising(RuntimeError("one\ntwo")), "raised RuntimeError: one two"),
    "nothing": (lambda scheme, decision: None, "NoneType instead of a SchemeOutput"),
    "tall twist": (lambda s, d: answering(task=Task.from_twist(np.zeros((6, 1))))(s, d), "(6, 1)"),
    "NaN in L of its own Task": (with_task(L=np.full((4, 6), np.nan)), "rate is not finite"),
    "inf in the rate": (with_task(desired_rate=np.full(4, np.inf)), "rate is not finite"),
    "L of five columns": (with_task(L=np.zeros((4, 5))), "(4, 5)"),
    "rate of another length": (with_task(desired_rate=np.zeros(3)), "(3,)"),
    "modelled of four": (with_task(modelled=np.ones(4, bool)), "have the shape (6,), got (4,)"),
    "few names": (answering(names=("x",)), "one number for each of the 1 names"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_holds_the_arm_within_the_image(name):
    fault, words = FAULTS[name]
    rig = Rig(the_servo("2016", Spoiled(fault)), STARTS["2016"])
    states = rig.run(0.5)
    bad = [s for s in states if GOOD_FROM <= s.stamp < GOOD_TO]
    assert {(s.phase, s.outcome) for s in bad} == {(HOLDING, "scheme_fault")}
    assert all(s.reason.startswith("scheme Spoiled ") and words in s.reason for s in bad)
    assert all("\n" not in s.reason for s in bad)
    assert [bool(s.fault) for s in bad] == [True] + [False] * (len(bad) - 1)  # traceback once
    assert "raised" not in words or "Traceback" in bad[0].fault
    assert np.isfinite([c.positions for c in rig.commands]).all()
    held = [c.positions for c in rig.commands if GOOD_FROM + 0.2 <= c.stamp < GOOD_TO]
    np.testing.assert_array_equal(held, np.broadcast_to(held[0], np.shape(held)))
    assert (states[-1].phase, states[-1].outcome) == (SERVOING, "running")


def test_whole_numbers_and_lists_are_numbers_too_and_a_record_may_have_any_shape():
    L = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]])
    task = Task(L, np.zeros(2, int), [True, True, *[False] * 4])

    def in_lists(scheme, decision):
        told = {key: getattr(decision, key).tolist() for key in ("features", "desired", "error")}
        return replace(decision, L=[[0] * 6] * 4, **told)

    for odd in (answering(task=task), answering(L=np.zeros((4, 5))), in_lists):
        states = spoiled(odd, 0.3)
        assert {s.phase for s in states if s.stamp > GOOD_FROM} == {SERVOING}


class Wanting(Scheme):
    names, tolerances, needs = ("a", "b"), (0.1, 0.2), frozenset()

    def compute(self, observation, goal, t):
        return observation  # which the tests make the decision


GIVEN = {"features": [1, 2], "desired": [3, 4], "error": [-2, -2]}


def test_a_decision_is_made_of_arrays_whatever_was_answered():
    numbers = {name: np.array(value, float) for name, value in GIVEN.items()}
    task = Task.from_twist(np.ones(6))
    made = SchemeOutput(("a", "b"), **numbers, task=task)
    assert compute(Wanting(), made, None) is made
    for name in GIVEN:
        found = compute(Wanting(), replace(made, **{name: GIVEN[name]}), None)
        for one, value in numbers.items():
            np.testing.assert_array_equal(getattr(found, one), value)
            assert getattr(found, one).dtype == float
        assert found.task is task and found.names == ("a", "b")


@pytest.mark.parametrize(("scheme", "decision", "words"), [
    ({}, {"features": [1.0]}, r"returned features of shape \(1,\), must return one number for"),
    ({}, {"desired": "far"}, "returned desired of no numbers, must return one number for"),
    ({}, {"error": None}, "returned error of no numbers, must return one number for"),
    ({}, {"error": [1.0, np.inf]}, r"returned error that are not finite: \[1.0, inf\]"),
    ({}, {"desired": [np.nan, 0.0]}, r"returned desired that are not finite: \[nan, 0.0\]"),
    ({"tolerances": (0.1, -0.1)}, {}, r"has tolerances \(0.1, -0.1\), must have 2 numbers above 0"),
    ({"tolerances": (0.0, 0.1)}, {}, r"has tolerances \(0.0, 0.1\), must have 2 numbers above 0"),
    ({"tolerances": (0.1,)}, {}, r"has tolerances \(0.1,\), must have 2 numbers above 0"),
    ({"tolerances": None}, {}, "has tolerances None, must have 2 numbers above 0"),
    ({}, {"error_drift": [1.0, np.nan]}, "returned the error_drift .*, must return one finite"),
    ({}, {"error_drift": [1.0]}, "returned the error_drift .*, must return one finite"),
    ({}, {"error_drift": None}, "returned the error_drift None, must return one finite number"),
    ({}, {"task": 3}, "returned the task int instead of a Task"),
])  # fmt: skip
def test_what_is_wrong_with_a_decision_is_told(scheme, decision, words):
    asked = Wanting()
    vars(asked).update(scheme)
    given = {**GIVEN, "task": Task.from_twist(np.ones(6)), **decision}
    with pytest.raises(errors.SchemeError, match=f"^scheme mine {words}"):
        compute(asked, SchemeOutput(("a", "b"), **given), None, name="mine")
    for rate in (0.5, [0.5, -0.5]):
        fine = SchemeOutput(("a", "b"), **GIVEN, task=Task.from_twist(np.ones(6)), error_drift=rate)
        assert compute(Wanting(), fine, None).error_drift is rate


def test_a_goal_that_a_users_code_cannot_take_is_one_line():
    class Own(Wanting):
        def check(self, goal):
            raise goal

    for error, words in (
        (errors.ConfigurationError("of its own"), "^of its own$"),
        (KeyError("x"), "^scheme 'theirs' cannot use the goal: KeyError: 'x'"),
        (SystemExit(3), "^scheme 'theirs' cannot use the goal: SystemExit: 3"),
    ):
        with pytest.raises(errors.ConfigurationError, match=words):
            check_goal("theirs", Own(), error, 1.0)
    for error, expected, words in (
        (errors.MeasurementError("dark"), errors.MeasurementError, "dark"),
        (errors.SchemeError("own", ""), errors.SchemeError, "own"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
        (SystemExit(2), errors.SchemeError, "^scheme theirs raised "),
        (ValueError("no"), errors.SchemeError, "^scheme theirs raised "),
    ):  # fmt: skip
        with pytest.raises(expected, match=words):
            call_user_code(Own().check, error, limit=1.0, scheme="theirs")
    assert call_user_code(divmod, 7, 3, limit=1.0, scheme="theirs") == (2, 1)


def test_joints_of_another_arm_hold_it():
    rig = Rig(the_servo("2016"), STARTS["2016"])
    rig.run(0.3)
    names = rig.servo.arm.names
    short = JointSample.from_values(rig.now, names[:5], rig.q[:5])
    fast = JointSample.from_values(rig.now, names, rig.q, 1e9 * np.eye(6)[2])
    for ahead, joints, words in ((0.0, short, "must have (6,) for this arm"),
                                 (0.01, fast, " of J2 is impossible")):  # fmt: skip
        state = rig.show(rig.now, stamp=rig.now + ahead, joints=joints)
        assert state.phase == HOLDING and words in state.reason


def test_a_fault_is_told_once_more_after_the_clock_went_back():
    rig = Rig(the_servo("2016", Spoiled(FAULTS["value error"][0])), STARTS["2016"])
    for _ in range(2):
        state = rig.answer(GOOD_FROM)
        assert "no such thing" in state.fault
        assert (state.outcome, state.remedy) == ("scheme_fault", REMEDIES["scheme_fault"])
        rig.servo.reset()


def test_measurement_errors_are_the_images_and_not_the_schemes():
    last = spoiled(raising(errors.MeasurementError("a hand before the camera")), 0.3)[-1]
    assert (last.reason, last.fault) == ("a hand before the camera", "")
    assert last.outcome != "scheme_fault"
    with pytest.raises(KeyboardInterrupt):  # is not swallowed
        spoiled(raising(KeyboardInterrupt()), 0.5)


class Tired(Law):
    def desired_error_rate(self, error, L, pseudo_inverse_error, t, dt):
        self.tired = t > GOOD_FROM or getattr(self, "tired", False)
        return np.zeros(2) if self.tired else -error


def test_a_fault_of_a_users_law_is_the_schemes():
    last = Rig(the_servo("2016", law=Tired()), STARTS["2016"]).run(0.6)[-1]
    assert (last.phase, last.outcome) == (HOLDING, "scheme_fault")
    assert "Tired.desired_error_rate returned ndarray of shape (2,)" in last.reason


class Forgetful(Spoiled):
    broken = True

    def reset(self):
        if self.broken:
            raise KeyError("what was I doing?")
        super().reset()


def test_a_fault_in_reset_holds_the_arm_and_is_over_when_it_is():
    rig = Rig(the_servo("2016", Forgetful(lambda s, d: d)), STARTS["2016"])
    assert all(s.phase == HOLDING and "KeyError" in s.reason for s in rig.run(0.3))
    rig.servo.reset()
    assert rig.servo.phase == HOLDING
    rig.servo.scheme.broken = False
    assert rig.run(0.2)[-1].phase == SERVOING


class OwnJoints(JointController):
    """Answers the joints itself; `answer` is put in by the test."""

    names, tolerances = ("x",), (0.1,)
    answer = staticmethod(lambda controller, t, dt, joints: np.zeros(6))

    def process_image(self, observation, goal, t):
        zero = np.zeros(1)
        return SchemeOutput(("x",), zero + 1.0, zero, zero + 1.0)

    def update(self, t, dt, joints):
        return self.answer(self, t, dt, joints)


def controlled(answer, output, **options):
    controller = OwnJoints()
    controller.answer, controller.output = answer, output
    return Rig(the_servo("2016", controller, **options), STARTS["2016"])


def test_a_controllers_time_begins_with_servoing():
    asked = []

    def answer(controller, t, dt, joints):
        asked.append((t, dt))
        return np.zeros(6)

    rig = controlled(answer, "velocity")
    for t in (2.0, 2.125):
        rig.answer(t)
    rig.servo.update(2.1875, rig.sample(2.125))
    assert asked == [(0.125, 0.1), (0.1875, 0.0625)]  # no step is longer than 0.1 s


@pytest.mark.parametrize(("fault", "output", "words"), [
    (raising(ZeroDivisionError("division by zero")), "position", "raised ZeroDivisionError"),
    (raising(SystemExit()), "velocity", "raised SystemExit"),
    (lambda *_: None, "acceleration", "joints of no numbers"),
    (lambda *_: np.zeros(5), "velocity", "joints of shape (5,)"),
    (lambda *_: np.full(6, np.nan), "position", "not finite"),
    (lambda *_: np.full(6, np.nan), "acceleration", "not finite"),
])  # fmt: skip
def test_a_fault_between_images_holds_the_arm_at_once(fault, output, words):
    def answer(controller, t, dt, joints):
        if t < 0.2:
            return joints.positions + 0.01 if output == "position" else np.full(6, 0.05)
        return fault(controller, None)

    rig = controlled(answer, output)
    rig.run(0.2 + 0.02)
    assert rig.servo.phase == HOLDING and words in rig.servo.reason
    assert rig.servo.outcome.kind == "scheme_fault"
    assert np.isfinite([c.positions for c in rig.commands]).all()


@pytest.mark.parametrize("output", ["position", "velocity", "acceleration"])
def test_controllers_of_joints_are_under_the_same_limits_and_watchdog(output):
    def answer(controller, t, dt, joints):
        return joints.positions + np.arange(6.0) if output == "position" else np.arange(6.0) * 9.0

    limits = the_limits(velocity=0.5, acceleration=3.0, upper={"J1": 0.1})
    rig = controlled(answer, output, limits=limits, lead=10.0)
    rig.look = lambda observer, t, joints: observer.observe_moments(
        t, None, True, "", CAMERA, joints)
    rig.observer.needs = frozenset()
    rig.run(1.0)
    commands = np.array([c.positions for c in rig.commands])
    speed = np.diff(commands, axis=0) / TICK
    assert np.abs(speed).max() == pytest.approx(0.5, rel=1e-6)
    np.testing.assert_allclose(speed[10:40, 2] / speed[10:40, 5], 0.4, atol=0.2)  # direction kept
    inside = commands[2:, 1] < 0.1 - 0.02
    assert np.abs(np.diff(speed, axis=0))[inside].max() <= 3.0 * TICK * (1 + 1e-6)
    assert commands[:, 1].max() <= 0.1 + 1e-12
    rig.next_image = 100.0
    rig.run(0.6)
    assert rig.servo.phase == "waiting"
    still = [c.positions for c in rig.commands[-10:]]
    np.testing.assert_array_equal(still, np.broadcast_to(still[0], (10, 6)))


# -- what a scheme may say of its goal, and how it is named -----------------------------------
class Unnamed(Feature):
    tolerances = (1.0,)

    def measure(self, observation, goal):
        return None


class Picky(Unnamed):
    names = ("x",)

    def check(self, goal):
        raise KeyError("desired")


class Exits(Unnamed):
    names = ("x",)

    def __init__(self):
        raise SystemExit("no GPU")


class Loose(Unnamed):
    names, tolerances = ("x", "y"), (1.0,)


class Never(Unnamed):
    names, tolerances = ("x", "y"), (1.0, 0.0)


@pytest.mark.parametrize(("name", "words"), [
    ("momments", "unknown scheme 'momments': did you mean 'moments'? Or use one of alpha, "),
    ("no_such_package.x:Y", "cannot import no_such_package"),
    ("aras_visual_servo_controller.laws:Proportinal", "did you mean 'Proportional'?"),
    ("aras_visual_servo_controller.laws:Proportional", "not a class derived from Scheme"),
    ("test_faults:Exits", "its constructor raised SystemExit: no GPU"),
    ("test_faults:Unnamed", "Unnamed has no names"),
    ("test_faults:Loose", "2 names but the tolerances"),
    ("test_faults:Never", "give one number above 0 for each name"),
    ("moments+moments_2016", "'moments_2016' is not a feature"),
    ("moments:", "unknown scheme"),
])  # fmt: skip
def test_schemes_that_there_are_not(name, words):
    with pytest.raises(errors.ConfigurationError, match=re.escape(words)):
        create_scheme(name)


def test_what_a_scheme_does_not_take():
    for name, options, words in (
        ("moments_2016", {"interaction": "mean"}, "takes no interaction"),
        ("moments", {"interaction": "meen"}, "unknown interaction 'meen': did you mean 'mean'"),
        ("moments", {"smoothing": -1.0}, "smoothing"),
    ):
        with pytest.raises(errors.ConfigurationError, match=words):
            create_scheme(name, **options)
    for output, words in (("torque", "position, velocity, acceleration"), (None, "unknown output")):
        with pytest.raises(errors.ConfigurationError, match=words):
            controlled(lambda *_: np.zeros(6), output)
    with pytest.raises(errors.ConfigurationError, match="cannot use goal_2016.yaml: KeyError"):
        the_servo("2016", FeatureScheme(Picky()))


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Task.from_interaction(np.zeros((2, 5)), np.zeros(2)), "(k, 6)"),
    (lambda: Task.from_interaction(np.zeros((2, 6)), np.zeros(3)), "(3,)"),
    (lambda: Task.from_interaction(np.zeros((0, 6)), np.zeros(0)), "(0, 6)"),
    (lambda: Task.from_interaction([["a"] * 6], [1.0]), "not an array"),
    (lambda: Task.from_interaction(np.full((1, 6), np.inf), [1.0]), "not finite"),
    (lambda: Task.from_interaction(np.ones((2, 6)), np.ones(2), weights=[1.0, -1.0]), "weights"),
    (lambda: Task.from_twist(np.zeros(5)), "a twist must have the shape (6,), got (5,)"),
    (lambda: Task.from_twist(np.zeros(6), np.ones(5)), "modelled must have the shape (6,), got"),
])  # fmt: skip
def test_tasks_are_checked(make, words):
    with pytest.raises(errors.InvalidTaskError, match=re.escape(words)):
        make()


@pytest.mark.parametrize(("rows", "rank"), [(7, 6), (60, 4), (3000, 6)])
def test_tall_tasks_are_reduced_to_the_same_solution(rows, rank):
    random = np.random.default_rng(rows + rank)
    L = random.normal(size=(rows, rank)) @ random.normal(size=(rank, 6))
    rate, weights = random.normal(size=rows), random.uniform(0.1, 2.0, rows)
    task = Task.from_interaction(L, rate, weights=weights)
    assert task.L.shape == (6, 6)
    assert not any(array.flags.writeable for array in (task.L, task.desired_rate, task.modelled))
    scaled = weights[:, None] * L
    wanted = np.linalg.lstsq(scaled, weights * rate, rcond=1e-9)[0]
    found = np.linalg.lstsq(task.L, task.desired_rate, rcond=1e-5)[0]
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)
    expected = np.linalg.svd(scaled, compute_uv=False)[:rank]
    np.testing.assert_allclose(task.singular_values[:rank], expected, rtol=1e-6)
    assert task.rank == rank or rows > 512
