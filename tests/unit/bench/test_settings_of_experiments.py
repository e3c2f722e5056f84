"""Every setting of an experiment: its default, its bounds, and its name before it was renamed."""

import json
from functools import partial

import pytest
import yaml

from aras_visual_servo_bench import BenchError, Study
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.camera_specs import CalibrationOffset, CameraSpec
from aras_visual_servo_bench.experiment.experiment import (
    Experiment,
    IdealPlantSpec,
    RandomStart,
    SunSpec,
)
from aras_visual_servo_bench.experiment.loop_settings import make_loop_settings
from aras_visual_servo_bench.experiment.starts import RelativeStart
from aras_visual_servo_bench.studies.study_folder import MANIFEST, StudyFolder
from aras_visual_servo_bench.targets.geometry import TargetMotion
from aras_visual_servo_bench.targets.target_spec import SupportBoxSpec, TargetSpec
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal

ZERO = (0.0, 0.0, 0.0)


DEFAULTS = {
    Experiment: {
        "plant": "bullet", "friction": True, "lag": 0.04, "camera": "original", "features": "auto",
        "noise": 0.0, "jitter": 0.0, "delay": 0.015, "commands": "joint_states", "start": "2016",
        "goal": "auto", "scheme": "moments", "law": "proportional", "gain": None, "duration": 8.0,
        "time_after_convergence": 0.5, "seed": 0, "renderer": "auto", "record_peak_speeds": False},
    RandomStart: {"height": (0.15, 0.5), "side": 0.1, "turn": 2.967, "tilt": 0.0, "margin": 2.0,
                  "attempts": 500},
    SunSpec: {"diffuse": 0.8, "exposure": "unclipped", "shines": None},
    CalibrationOffset: {"focal": 1.0, "centre": (0.0, 0.0), "xyz": ZERO, "rpy": ZERO, "depth": 1.0},
    CameraSpec: {"model": "original", "rate": None, "pose": None, "delay": 0.0},
    TargetSpec: {"shape": "aras", "size": None, "scale": None, "perturbed": False},
    TargetMotion: {"frequency": 0.0, "circle": 0.0, "hold": 0.0, "begin": 0.0},
    partial(SupportBoxSpec, (0.1, 0.1, 0.1)): {"mass": 0.2, "friction": 1.0},
    partial(RelativeStart, "turned"): {
        "angle": 0.0, "axis": (0.0, 0.0, 1.0), "distance": 0.0, "box": (0.6, 0.6, 0.15),
        "radii": (0.08, 0.16, 0.24, 0.32), "turn": 120.0, "of": 100, "scatter": (0.0, 0.0)}}


@pytest.mark.parametrize("kind", DEFAULTS)
def test_where_nothing_is_said_it_is_as_documented(kind):
    made = kind()
    assert {key: getattr(made, key) for key in DEFAULTS[kind]} == DEFAULTS[kind]


SMALL, MAT = 1e-3, {"shape": "square", "pose": (0, 0, 0.6, 0, 0, 0)}
PLACED = (0.0, 0.0, 0.591, 0.0, 0.0, 0.0)
BOX, COVER, TRIANGLE = {"size": (0.1, 0.1, 0.1)}, ((0, 0), (1, 1)), ((0, 0), (1, 0), (0, 1))
# The last value that is taken, and the first that is not.
BOUNDS = [
    *((Experiment, {}, key, 0.0, -SMALL) for key in ("lag", "noise", "delay")),
    (Experiment, {"plant": "free"}, "jitter", 0.0, -SMALL),
    (Experiment, {}, "seed", 0, -1),
    *((Experiment, {}, key, SMALL, 0.0) for key in ("gain", "duration")),
    (Experiment, {}, "reached", (SMALL, SMALL), (SMALL, 0.0)),
    *((IdealPlantSpec, {}, key, SMALL, 0.0) for key in ("stop", "enough", "farthest")),
    (IdealPlantSpec, {}, "speed", (SMALL, SMALL), (0.0, SMALL)),
    *((RandomStart, {}, key, 0.0, -SMALL) for key in ("side", "turn", "tilt", "margin")),
    (RandomStart, {}, "attempts", 1, 0),
    (RandomStart, {}, "height", (SMALL, SMALL), (0.0, SMALL)),
    (RandomStart, {}, "height", (0.2, 0.2), (0.2, 0.19)),
    (SunSpec, {}, "diffuse", 0.0, -SMALL),
    (SunSpec, {}, "diffuse", 1.0, 1.0 + SMALL),
    (SunSpec, {}, "direction", (0.0, SMALL, 0.0), ZERO),
    (SunSpec, {}, "shines", ((0.0, SMALL),), ((SMALL, SMALL),)),
    (SunSpec, {}, "exposure", "gazebo", "gazeb"),
    *((CalibrationOffset, {}, key, SMALL, 0.0) for key in ("focal", "depth")),
    (CameraSpec, {}, "rate", SMALL, 0.0),
    (CameraSpec, {}, "delay", 0.0, -SMALL),
    (RelativeStart, {"kind": "looking"}, "of", 1, 0),
    (RelativeStart, {"kind": "looking"}, "scatter", (0.0, 0.0), (0.0, -SMALL)),
    (RelativeStart, {}, "kind", "plane", "plan"),
    (TargetSpec, {"shape": "square"}, "size", (SMALL, 2.0), (0.0, 2.0)),
    (TargetSpec, {"shape": "a.stl"}, "scale", SMALL, 0.0),
    (Experiment, {}, "target", TargetSpec("square", (2.0, 2.0), PLACED),
     TargetSpec("square", (2.0, 2.01), PLACED)),
    (TargetSpec, {"shape": "square", "occluder": COVER}, "occluded", ((0.0, SMALL),),
     ((-SMALL, 1.0),)),
    (TargetSpec, {"shape": "square"}, "occluded", None, ((0.1, 0.2),)),
    (SupportBoxSpec, {}, "size", (SMALL, 2.0, 2.0), (0.0, 2.0, 2.0)),
    (SupportBoxSpec, {}, "size", (2.0, 2.0, 2.0), (2.0, 2.0, 2.01)),
    (SupportBoxSpec, BOX, "mass", SMALL, 0.0),
    (SupportBoxSpec, BOX, "friction", 0.0, -SMALL),
    *((TargetMotion, {}, key, 0.0, -SMALL) for key in ("frequency", "hold", "begin")),
    (TargetMotion, {"frequency": 1.0}, "circle", 0.0, -SMALL),
    (TargetMotion, {"amplitude": (0.0, 1.0, 0.0)}, "frequency", SMALL, 0.0),
    (TargetMotion, {"circle": 1.0}, "frequency", SMALL, 0.0),
    # what belongs together
    (Experiment, {"world": "a"}, "sun", SunSpec(exposure="gazebo"), SunSpec(diffuse=0.7)),
    (Experiment, {"world": "a"}, "target", {"model": "m"}, {**MAT, "model": "m"}),
    *((Experiment, {}, "target", MAT, target) for target in ({"model": "m"}, {"shape": "square"})),
    (Experiment, {}, "target", {"shape": TRIANGLE},
     {"shape": TRIANGLE, "motion": {"circle": 1.0, "frequency": 1.0}}),
    *((Experiment, {}, "target", {**MAT, "occluder": COVER}, {"shape": shape, "occluder": COVER})
      for shape in ("aras", TRIANGLE)),
    (Experiment, {"robot": {"target_frame": "hand"}}, "target", MAT, {**MAT, "box": BOX}),
    (Experiment, {}, "target", {**MAT, "box": BOX}, {"shape": "aras", "box": BOX}),
    (Experiment, {"plant": "free"}, "sun", SunSpec(), SunSpec(exposure="gazebo")),
    (Experiment, {"plant": "free"}, "world", "", "workbench"),
    (Experiment, {"plant": "free"}, "record_peak_speeds", False, True),
    (Experiment, {"plant": "free"}, "noise", 0.0, 1.0),
    (Experiment, {"plant": "free", "features": "images"}, "noise", 1.0, -1.0),
    (Experiment, {"plant": "free", "features": "images"}, "jitter", 0.0, 1.0),
    (Experiment, {"features": "exact"}, "jitter", 1.0, -1.0),
    (Experiment, {"cameras": {"a": {}}}, "camera", "original", "wide"),
    (Experiment, {"cameras": {"a": {}}}, "calibration_offset", CalibrationOffset(),
     CalibrationOffset(focal=1.1)),
    (Experiment, {"cameras": {"a": {}}}, "plant", "free", "ideal"),
    (Experiment, {}, "cameras", {"a_1": {}}, {"1a": {}}),
    (CameraSpec, {"frame": "f"}, "pose", None, (*ZERO, *ZERO)),
    (CameraSpec, {"frame": "f"}, "xyz", ZERO, (0.0, 0.0, SMALL)),
    (CameraSpec, {"pose": (*ZERO, *ZERO)}, "rpy", ZERO, (0.0, SMALL, 0.0)),
    (TargetSpec, {}, "shape", "circle", "circl"),
    (TargetSpec, {}, "shape", "a.png", "a"),
    (TargetSpec, {"shape": "a.stl"}, "perturbed", False, True),
    (TargetSpec, {"shape": "a.stl"}, "occluder", None, ((0, 0), (1, 1))),
    *((TargetSpec, kind, "box", None, SupportBoxSpec(**BOX))
      for kind in ({"shape": "box"}, {"model": "l"})),
    (TargetSpec, {"link": "l"}, "shape", "aras", "square"),
    (TargetSpec, {"link": "l"}, "motion", TargetMotion(), TargetMotion(circle=1.0, frequency=1.0)),
    (TargetSpec, {"model": "l"}, "occluder", None, ((0, 0), (1, 1))),
    (TargetSpec, {"shape": "square", "box": SupportBoxSpec(**BOX)}, "motion", TargetMotion(),
     TargetMotion(begin=1.0))]  # fmt: skip


@pytest.mark.parametrize(("kind", "others", "key", "taken", "refused"), BOUNDS)
def test_a_bound_is_where_it_is(kind, others, key, taken, refused):
    kind(**others, **{key: taken})
    with pytest.raises(ExperimentError):
        kind(**others, **{key: refused})


@pytest.mark.parametrize(("camera", "plant", "why"), [
    ({"target": MAT}, "bullet", ""),
    ({"target": {"shape": "square"}, "target_frame": "hand"}, "bullet", ""),
    ({"target": {"shape": "square"}}, "chain", ""),
    ({"target": {**MAT, "motion": {"circle": 1.0, "frequency": 1.0}}}, "free", ""),
    ({"target": {"shape": "square"}}, "bullet", "needs a shape and a pose"),
    ({"target": {"shape": "aras", "pose": MAT["pose"]}}, "bullet", "shape \\(not 'aras'\\) and"),
    ({"target": {**MAT, "perturbed": True}}, "free", "pose and motion: leave out the other keys"),
    ({"target": {**MAT, "motion": {"circle": 1.0, "frequency": 1.0}}, "target_frame": "hand"},
     "chain", "its link moves it"),
    ({"target": MAT, "target_frame": "hand"}, "free", "plant 'free' has no arm: use plant"),
    ({"target_frame": "hand"}, "chain", "cameras.b.target.shape, and .pose relative to the link")])
def test_what_a_camera_of_its_own_target_may_look_at(camera, plant, why):
    given = {"plant": plant, "cameras": {"a": {}, "b": camera}}
    if not why:
        Experiment(**given)
        return
    with pytest.raises(ExperimentError, match=why):
        Experiment(**given)


@pytest.mark.parametrize(("target", "plain", "carried", "brought", "described"), [
    ({"shape": "square"}, True, True, False, False),
    ({"shape": "square", "motion": TargetMotion(step=(0, 0, 1.0))}, True, False, False, False),
    ({"shape": "square", "box": SupportBoxSpec((0.1, 0.1, 0.1))}, False, False, False, False),
    ({"shape": "square", "occluder": ((0, 0), (1, 1))}, False, False, False, False),
    ({"shape": "poster", "perturbed": True}, False, False, False, False),
    ({"model": "m"}, False, False, True, False), ({"link": "l"}, False, False, True, False),
    ({"shape": ((0, 0), (1, 0), (0, 1))}, True, True, True, True),
    ({"shape": ((0, 0), (1, 0), (0, 1)), "pose": MAT["pose"]}, True, True, False, False)])
def test_what_kind_of_target_it_is(target, plain, carried, brought, described):
    spec = TargetSpec(**target)
    assert (spec.is_plain, spec.is_mountable, spec.is_provided, spec.is_in_description) == (
        plain, carried, brought, described)
    assert spec.is_link is ("model" in target or "link" in target)


@pytest.mark.parametrize(("plant", "features", "images"), [
    ("bullet", "auto", True), ("bullet", "exact", False), ("free", "auto", False),
    ("ideal", "images", True), ("chain", "auto", False)])
def test_pictures_are_the_bullet_arms_unless_something_else_is_said(plant, features, images):
    assert Experiment(plant=plant, features=features).has_images is images


def test_the_loop_is_told_what_the_experiment_says():
    asked = {"delay": 0.02, "duration": 3.0, "commands": "images", "gain": 2.5, "law": "pi",
             "scheme": "points"}
    for plant in ("chain", "free", "ideal"):
        found = make_loop_settings(Experiment(plant=plant, **asked))
        assert (found.scheme, found.law, found.duration, found.start) == (
            "points", "pi", 3.0, "none")
        assert found.tracker == "outline" and found.gain == 2.5
        ideal = plant == "ideal"
        assert (found.delay, found.lockstep) == ((0.0, False) if ideal else (0.02, True))
        if ideal:
            assert (found.stop_time, found.lead) == (1e-6, 1e6)
        flies = plant != "chain"
        assert (found.limit_avoidance, found.output) == (
            (False, "velocity") if flies else (True, "position"))
    own = make_loop_settings(Experiment(controller_parameters={"lead": 2.0}))
    assert own.lead == 2.0


@pytest.mark.parametrize(("target", "world", "own", "label"), [
    ({"link": "crate"}, "", {}, "robot::crate"), ({"model": "m"}, "a.world", {}, "m"),
    ({"model": "m", "link": "l"}, "a.world", {}, "m::l"),
    ({"link": "crate"}, "", {"label": "mine"}, "mine")])
def test_a_link_that_is_the_target_is_told_by_its_label(target, world, own, label):
    told = {"segmentation": {"method": "label", **own}}
    experiment = Experiment(target=target, world=world, controller_parameters=told)
    assert make_loop_settings(experiment).make_segmentation().label == label


def test_two_targets_have_one_tracker():
    two = {"a": {}, "b": {"target": {"shape": "marker"}}}
    given = {"plant": "free", "target": {"shape": "square"}, "cameras": two}
    with pytest.raises(ExperimentError, match="needs the tracker 'marker' and the experiment's t"):
        make_loop_settings(Experiment(**given))
    make_loop_settings(Experiment(**given, controller_parameters={"tracker": "outline"}))
    other = {"a": {}, "b": {"target": {"shape": "sphere", "size": (0.1, 0.1, 0.1)}}}
    box = {"shape": "box", "size": (0.1, 0.1, 0.1)}
    with pytest.raises(ExperimentError, match="is another solid than the experiment's target"):
        make_loop_settings(Experiment(plant="free", target=box, cameras=other))


OLD_KEYS = [
    ({"linger": 1.0}, "key 'linger' is now called 'time_after_convergence'"),
    ({"believed": {"focal": 1.1}}, "key 'believed' is now called 'calibration_offset'"),
    ({"options": {"hold": 1.0}}, "key 'options' is now called 'controller_parameters'"),
    ({"traced": True}, "key 'traced' is now called 'record_peak_speeds'"),
    ({"features": "pictures"}, "features: 'pictures' is now called 'images'")]


@pytest.mark.parametrize(("values", "text"), [
    *OLD_KEYS,
    ({"cameras": {"left": {"believed": {}}}}, "believed' is now called 'calibration_offset'")])
def test_an_old_key_is_named_with_its_new_name(values, text, tmp_path):
    path = tmp_path / "experiment.yaml"
    path.write_text(yaml.safe_dump(values))
    ((key, value),) = values.items()
    studies = [{"experiment": values}, {"vary": {key: [value]}}, {"cases": [values]}]
    for make in (lambda: Experiment.from_yaml(path), lambda: Experiment(**values),
                 *(lambda one=one: Study.from_mapping(one).make_trials() for one in studies)):
        with pytest.raises(BenchError) as error:
            make()
        assert text in str(error.value) and "\n" not in str(error.value)


def test_an_old_key_of_a_folder_or_a_goal_is_named_with_its_new_name(tmp_path):
    with pytest.raises(BenchError, match="'believed' is now called 'calibration_offset'"):
        Study.from_mapping({"vary": {"believed.focal": [1.0, 1.1]}})
    study = Study.from_mapping({"experiment": {"plant": "free"}})
    StudyFolder.create(tmp_path / "runs", study, "")
    manifest = json.loads((tmp_path / "runs" / MANIFEST).read_text())
    manifest["study"]["experiment"] = {"plant": "free", "linger": 1.0}
    (tmp_path / "runs" / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(BenchError, match=f"{tmp_path / 'runs'}.* key 'linger' is now called 'time"):
        StudyFolder.open(tmp_path / "runs")
    with pytest.raises(ConfigurationError, match="goal.yaml: key 'seen_by' is now called 'camera_"):
        Goal.from_mapping({"seen_by": "left"}, "goal.yaml")
