"""End of runs: of the ideal camera by its criteria, of every loop by its duration."""

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench import Experiment, Loop, assemble
from aras_visual_servo_bench.runner.ideal_run_termination import IdealRunTermination
from aras_visual_servo_controller.records.outcomes import Outcome
from aras_visual_servo_controller.records.state import CONVERGED, SERVOING, ServoState
from aras_visual_servo_controller.schemes import SchemeOutput

EYE = {"width": 320, "height": 240, "horizontal_fov": 1.2}


def looks_down(z, x=0.0, turn=0.0):
    return matrix_from_xyz_rpy((x, 0.0, z), (np.pi, 0.0, turn))


def ending(ideal=None, first=(2.0, 0.400001), goal=(1.0, 0.0), motion=None, **keys):
    """Ten images a second, from 2 m above a target to 1 m; (depth, turn) and (depth, x)."""
    keys = {"duration": 0.5, "time_after_convergence": None, **keys}
    target = {"shape": [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1]], "pose": [0.0] * 6}
    experiment = Experiment.from_mapping({
        "plant": "ideal", "features": "exact", "scheme": "points", "ideal": ideal or {},
        "camera": {**EYE, "update_rate": 10.0}, "target": {**target, "motion": motion or {}},
        "start": {"pose": [0.0, 0.0, first[0], np.pi, 0.0, first[1]]},
        "goal": {"pose": [goal[1], 0.0, goal[0], np.pi, 0.0, 0.0]}, **keys})  # fmt: skip
    return IdealRunTermination(experiment, assemble(experiment))


def state(error=(1.0, 1.0), phase=SERVOING, outcome="running", stamp=0.0):
    nothing = np.zeros(2)
    output = None if error is None else SchemeOutput(
        ("a", "b"), np.array(error), nothing, np.array(error))  # fmt: skip
    return ServoState(stamp, phase, outcome=outcome, reason="it is dark", scheme_output=output)


THERE, BLIND = state(phase=CONVERGED), state(None)
AFTER = {"time_after_convergence": 0.3, "duration": 9.0}
SMALLER = [state((1.0, y)) for y in (0.6, 0.5, 0.4)]


@pytest.mark.parametrize(("keys", "images", "count", "kind"), [
    ({}, [state()] * 9, 6, None),  # at 0.5 s
    (AFTER, [state()] * 2 + [THERE] * 9, 6, None),  # at 0.2 s and 0.3 s more
    (AFTER, [THERE] * 3 + [state()] + [THERE] * 9, 8, None),
    ({"duration": 1.0}, [THERE] * 20, 11, None),
    (AFTER | {"ideal": {"stop": 1e-9}, "duration": 1.0}, [THERE] * 20, 11, None),
    ({"ideal": {"stop": 1.25}}, SMALLER, 3, "converged"), ({}, SMALLER, None, None),
    ({"duration": 9.0}, [BLIND] * 4 + [state()] + [BLIND] * 9, 10, "target_lost"),
    ({"duration": 9.0}, [state(None, outcome="no_progress")] * 9, 5, None),
    ({"ideal": {"stop": 9.0}, "duration": 9.0}, [state(outcome="scheme_fault")], 1, None),
    # by the true pose
    ({"ideal": {"enough": 0.5}}, [looks_down(1.51, turn=0.1), looks_down(1.4, turn=0.21),
                                  looks_down(1.5, turn=0.2)], 3, "converged"),
    ({"ideal": {"enough": 0.5}}, [looks_down(0.6, turn=-0.1)], 1, "converged"),
    ({"ideal": {"farthest": 1.5}}, [looks_down(1.0, x=1.499), looks_down(1.0, x=1.501)],
     2, "no_progress"),
    ({"ideal": {"enough": 0.1, "farthest": 5.0}}, [looks_down(1.05, turn=0.01)], 1, "converged"),
])  # fmt: skip
def test_it_is_over_by_time_error_pose_or_five_images_without_a_measurement(
    keys, images, count, kind
):
    found, over = ending(**keys), None
    for i, one in enumerate(images):
        is_pose = isinstance(one, np.ndarray)
        found.add_image(replace(state() if is_pose else one, stamp=0.1 * i),
                        one if is_pose else looks_down(2.0))  # fmt: skip
        if found.is_over:
            over = i + 1
            break
    assert over == count and getattr(found.outcome, "kind", None) == kind
    why = {"target_lost": "no measurement any more: it is dark",
           "no_progress": "the camera is 1.50 m from its goal, more than at its start"}  # fmt: skip
    assert kind not in why or found.outcome.reason == why[kind]


RISING = {"velocity": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]}  # towards the camera


@pytest.mark.parametrize(("first", "goal", "images", "keys", "word"), [
    (2.0, 1.0, [(0.0, 5.99), (0.0, 3.0)], {}, "timed_out"),
    (2.0, 1.0, [(0.0, 3.0), (0.0, 6.01), (0.0, 2.0)], {}, "camera_retreat"),
    (1.0, 2.0, [(0.0, 6.01)], {}, "camera_retreat"), (1.0, 2.0, [(0.0, 5.99)], {}, "timed_out"),
    (2.0, 1.0, [(3.0, 6.5)], {"motion": RISING}, "timed_out"),  # 3.5 m above it
    (2.0, 1.0, [(0.0, 9.0)], {"ideal": {"stop": 9.0}}, "converged"),  # its own word
])  # fmt: skip
def test_a_camera_that_went_far_back_has_retreated(first, goal, images, keys, word):
    found = ending(first=(first, 0.4), goal=(goal, 0.05), duration=9.0, **keys)
    for stamp, depth in images:
        found.add_image(state(stamp=stamp), looks_down(depth, x=0.2))
    said = found.decide_outcome(Outcome("timed_out", "late"))
    assert said.kind == word
    if word == "camera_retreat":
        assert said.reason == "the camera went back to 6.01 m from its target"
    if not keys:
        assert found.decide_outcome(Outcome("converged up to 180°")).kind == "converged up to 180°"


POSE = {"pose": [0.0, 0.0, 0.85, np.pi, 0.0, 0.0]}
BASE = {"plant": "free", "scheme": "points", "features": "exact", "lag": 0.0, "delay": 0.0,
        "target": {"shape": "l_shape", "size": [0.06, 0.05], "pose": [0, 0, 0.59, 0, 0, 0]},
        "goal": POSE, "start": {"pose": [0.03, 0.0, 0.9, np.pi, 0.0, 0.2]}}  # fmt: skip


def looped(on_frame=None, **keys):
    experiment = Experiment.from_mapping({**BASE, **keys})
    return Loop(experiment, assemble(experiment), on_frame=on_frame)


def eyes(left, right):
    return {"left": {"model": {**EYE, "update_rate": 20.0}, **left},
            "right": {"model": {**EYE, "update_rate": 20.0}, "xyz": [0.0, -0.02, 0.0], **right}}


@pytest.mark.parametrize(("left", "right"), [(0.03, 0.03), (0.04, 0.0), (0.0, 0.12), (0.12, 0.04)])
def test_late_images_are_answered_when_those_of_both_cameras_are_there(left, right):
    loop = looped(cameras=eyes({"delay": left}, {"delay": right}), duration=0.4, camera="original",
                  scheme="points@left+points@right")  # fmt: skip
    came = {}
    while loop.plant.time_ns < 330_000_000:
        answer = loop.run_to_image()
        came.setdefault(round(answer.stamp, 6), loop.plant.time_ns * 1e-9)
    assert list(came)[:4] == [0.05, 0.1, 0.15, 0.2]
    for stamp, at in came.items():
        assert at - stamp == pytest.approx(max(left, right), abs=2e-3)


@pytest.mark.parametrize(("keys", "ends"), [
    # 0.05 s and one measurement more than the duration after the first image, at 1/30 s
    ({"duration": 0.5, "time_after_convergence": None}, 0.591),
    ({"duration": 0.25, "time_after_convergence": 0.1}, 0.341),
    ({"duration": 0.5, "start": {"pose": [3.0, 0.0, 0.9, np.pi, 0.0, 0.2]}}, 0.591),
    # 0.5 s after the first image that shows it to have converged: hold is 0.1 s of images
    ({"duration": 9.0, "time_after_convergence": 0.5, "start": POSE,
      "controller_parameters": {"hold": 0.1}}, None),
    ({"duration": 0.4, "time_after_convergence": 0.5, "start": POSE,
      "controller_parameters": {"hold": 0.1}}, 0.491),
    ({"camera": {**EYE, "update_rate": 0.15}}, 5.001),  # no image comes within 5 s
])  # fmt: skip
def test_a_loop_is_over_when_its_time_is(keys, ends):
    loop = looped(**keys)
    assert loop.servo_time == 0.0 and not loop.is_over
    converged = None
    while not loop.is_over:
        state = loop.run_to_image()
        if state is not None and converged is None and state.phase == CONVERGED:
            converged = loop.plant.time_ns * 1e-9
    end = loop.plant.time_ns * 1e-9
    if ends is None:
        assert 0.1 < converged < 0.3
        assert converged + 0.5 - 1e-9 <= end < converged + 0.511
    else:
        assert end == pytest.approx(ends, abs=1e-8) and bool(converged) is (ends == 0.491)
    if loop.state is not None:
        assert loop.servo_time == pytest.approx(end - 1.0 / 30.0, abs=1e-8)
    result = loop.make_run()
    assert result.outcome == "converged" if converged else result.outcome != "running"
    if keys.get("duration") == 0.25:
        assert result.outcome == "timed_out" and "0.2 s" in result.reason


def test_an_image_is_answered_once_and_whoever_watches_is_told_as_it_is_made():
    seen = []
    loop = looped(lambda of, one: seen.append((one.name, of.plant.time_ns - one.stamp_ns)),
                  camera="original", scheme="points@left", duration=0.3,
                  cameras=eyes({"delay": 0.1}, {}))  # fmt: skip
    assert loop.reading is None and loop.state is None
    states = [loop.run_to_image() for _ in range(3)]
    assert [round(s.stamp * 20) for s in states] == [1, 2, 3]
    assert loop.state is states[-1] and loop.reading.stamp == states[-1].stamp
    loop.run_to_end()
    assert loop.run_to_image() is None
    assert {name for name, _ in seen} == {"left", "right"} and all(late == 0 for _, late in seen)
    record = loop.make_run().cameras["right"]
    np.testing.assert_allclose(record.stamp[:4], [0.05, 0.1, 0.15, 0.2], atol=1e-9)
    place = loop.parts.placements["right"].pose
    np.testing.assert_allclose(place[:3, 3], [0.02, 0.0, 0.0], atol=1e-9)


def test_a_goal_goes_along_with_a_target_that_turns():
    moves = {**BASE["target"], "motion": {"velocity": [0.05, 0.02, 0.01, 0.1, 0.05, 0.4]}}
    loop = looped(target=moves, duration=0.4)
    loop.run_to_end()
    then = loop.parts.target.world_T_target(loop.plant.time_ns * 1e-9)
    first = matrix_from_xyz_rpy((0, 0, 0.59), (0, 0, 0))
    goal = matrix_from_xyz_rpy(POSE["pose"][:3], POSE["pose"][3:])
    moved = loop.compute_goal_pose()
    np.testing.assert_allclose(inverse(then) @ moved, inverse(first) @ goal, atol=1e-12)
    found, verdict = loop.make_run(), loop.compute_verdict()
    off = np.linalg.norm(moved[:3, 3] - loop.plant.read_rest_pose()[:3, 3])
    assert found.verdict.distance == pytest.approx(off) == verdict.distance and off > 1e-4
    np.testing.assert_array_equal(found.goal_pose, moved)
