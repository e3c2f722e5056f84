"""Every documented key changes the run on every plant, or is refused in one line where it has no
physical meaning. A new key fails here until it is in a table."""

import contextlib
import functools
import hashlib
import json
from dataclasses import dataclass, field, fields

import numpy as np
import pytest

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.effects import EFFECTS, AutoExposure, Effects, SensorModel
from aras_sim_bridge.camera.vibration import Shake
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.camera_specs import CalibrationOffset, CameraSpec
from aras_visual_servo_bench.experiment.experiment import (
    PLANTS,
    Experiment,
    IdealPlantSpec,
    SunSpec,
)
from aras_visual_servo_bench.experiment.overrides import with_override
from aras_visual_servo_bench.experiment.refused_parameters import (
    EXPERIMENT_KEYS,
    GRAPH_PARAMETERS,
)
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.geometry import TargetMotion
from aras_visual_servo_bench.targets.target_spec import SupportBoxSpec, TargetSpec
from aras_visual_servo_controller.laws import LAWS
from aras_visual_servo_controller.parameters import ControllerParameters

BOTH, IMAGES, EXACT = ("exact", "images"), ("images",), ("exact",)
ARMS, LOOPS = ("bullet", "chain"), ("bullet", "chain", "free")
GOAL, START = [0.0, 0.0, 0.82, 3.14159, 0.0, 0.3], [0.008, -0.006, 0.84, 3.14159, 0.0, 0.2]
BASE = {
    "features": "exact", "scheme": "points", "gain": 2.0, "duration": 0.22,
    "camera": {"width": 96, "height": 72, "horizontal_fov": 1.3, "update_rate": 30.0},
    "target": {"shape": "l_shape", "size": [0.08, 0.06], "pose": [0.0, 0.0, 0.591, 0.0, 0.0, 0.3]},
    "goal": {"pose": GOAL}, "start": {"pose": START}}  # fmt: skip
# The same poses, which no inverse kinematics needs to find.
JOINTS = {"goal": [0.0, -0.287, 0.34, -0.888, 0.547, -0.011],
          "start": [0.007, -0.185, 0.401, -1.104, 0.703, -0.013]}  # fmt: skip
FISHEYE = {"camera": {"lens": "equidistant"}}


@dataclass(frozen=True)
class Key:
    """A changed value of a dotted key, and where it must act.

    given: what must be there for it to act, changed or not. plants, features: where it acts; it is
    refused elsewhere. tried: with which features a short run shows it.
    """

    value: object
    given: dict = field(default_factory=dict)
    plants: tuple[str, ...] = PLANTS
    features: tuple[str, ...] = BOTH
    tried: tuple[str, ...] = BOTH


def effects(**keys):
    return {"camera": {"effects": keys}}


LIGHT = {"features": IMAGES}
MOTION = {"velocity": [0.02, 0, 0, 0, 0, 0], "amplitude": [0.005, 0, 0], "frequency": 2.0,
          "step": [0.001, 0.0, 0.0]}  # fmt: skip
COVER = [[-0.05, -0.05], [-0.02, 0.05]]
NOT_IDEAL = LOOPS
SENSOR = {"gain": 0.05, "full_well": 5e3, "read_noise": 20.0}
KEYS = {
    "camera.width": Key(112),
    "camera.height": Key(84),
    "camera.horizontal_fov": Key(1.5),
    "camera.update_rate": Key(20.0),
    "camera.lens": Key("equidistant"),
    "camera.camera_matrix": Key({"fx": 70.0, "fy": 60.0, "cx": 47.0, "cy": 35.0}),
    "camera.distortion_model": Key("equidistant"),
    "camera.distortion_coefficients": Key([-0.1, 0.01, 0.0, 0.0, 0.0]),
    "camera.cutoff_angle": Key(0.7, FISHEYE, tried=IMAGES),
    "camera.legacy_camera_info": Key(True),
    "camera.declared": Key([60.0, 0, 0, 0, 0, 0, 0, 0], {"camera": {"legacy_camera_info": True}}),
    "camera.format": Key("BAYER_RGGB8", **LIGHT),
    "camera.shake": Key({"frequency": 7.0, "xyz": [0.002, 0.002, 0.002]}),
    "camera.latency": Key(0.05, plants=NOT_IDEAL),
    "camera.seed": Key(7, {"camera": {"shake": {"frequency": 7.0, "xyz": [0.002, 0.002, 0.002]}}}),
    "camera.xyz": Key([0.0, 0.004, 0.0], plants=("bullet",), **LIGHT),
    "camera.rpy": Key([0.0, 0.01, 0.0], plants=("bullet",), **LIGHT),
    "camera.far": Key(0.24),
    "camera.near": Key(0.22, {"start": {"pose": [*START[:2], 0.8, *START[3:]]}}),
    "camera.link": Key("wrist", plants=()),
    "camera.trigger_topic": Key("go", plants=()),
    "camera.effects": Key({"drop_probability": 0.5}),
    **{
        f"camera.effects.{name}": Key(value, **LIGHT)
        for name, value in {
            "noise_mean": -20.0, "noise_stddev": 8.0, "shot_noise": 2.0, "exposure": 0.8,
            "gain": 0.8, "vignetting": 0.2}.items()},
    "camera.effects.exposure_time": Key(0.02, plants=NOT_IDEAL, **LIGHT),
    "camera.effects.exposure_samples": Key(2, effects(exposure_time=0.03), NOT_IDEAL, IMAGES),
    "camera.effects.drop_probability": Key(0.5),
    "camera.effects.sensor": Key(SENSOR, **LIGHT),
    "camera.effects.auto_exposure": Key({"target": 120.0}, **LIGHT),
    "camera.effects.further": Key({"defocus": {"stddev": 2.0}}, **LIGHT),
    **{
        f"camera.effects.further.{name}.{one.name}": Key(
            3.0, effects(further={name: {one.name: 1.5}}), PLANTS, IMAGES)
        for name in EFFECTS
        for one in EFFECTS.list_parameters(name)},
    "camera.effects.row_time": Key(3e-4, plants=NOT_IDEAL),
    "camera.effects.rows_together": Key(24, effects(row_time=3e-4), NOT_IDEAL),
    **{
        f"camera.effects.sensor.{name}": Key(
            value, effects(sensor=SENSOR, exposure_time=0.01), NOT_IDEAL, IMAGES)
        for name, value in {
            "gain": 0.04, "full_well": 4e3, "read_noise": 5.0, "dark_current": 5e4}.items()},
    **{
        f"camera.effects.auto_exposure.{name}": Key(
            value, effects(exposure=0.8, auto_exposure={"target": target, "speed": 0.2}), **LIGHT)
        for name, value, target in (("target", 140.0, 120.0), ("speed", 0.4, 120.0),
                                    ("least", 0.95, 60.0), ("most", 1.005, 250.0))},
    **{
        f"camera.shake.{name}": Key(
            value, {"camera": {"shake": {"frequency": 7.0, "xyz": [0.002, 0.0, 0.0]}}})
        for name, value in {"frequency": 9.0, "xyz": [0.0, 0.002, 0.0], "rpy": [0.01, 0.0, 0.0],
                            "bandwidth": 4.0}.items()},
    "calibration_offset.focal": Key(1.1),
    "calibration_offset.centre": Key([2.0, 1.0]),
    "calibration_offset.distortion": Key([-0.1, 0.0, 0.0, 0.0, 0.0]),
    "calibration_offset.xyz": Key([0.01, 0.0, 0.0]),
    "calibration_offset.rpy": Key([0.0, 0.0, 0.1]),
    "calibration_offset.depth": Key(1.2),
    "target.shape": Key([[0.0, 0.0], [0.05, 0.0], [0.04, 0.03], [0.0, 0.05]]),
    "target.marker": Key(
        "3", {"target": {"shape": "marker", "marker": "5"}, "duration": 0.06}, **LIGHT),
    "target.size": Key([0.07, 0.07]),
    "target.pose": Key([0.01, 0.0, 0.591, 0.0, 0.0, 0.3]),
    "target.occluder": Key(COVER, **LIGHT),
    "target.occluded": Key([[0.1, 0.2]], {"target": {"occluder": COVER}}, **LIGHT),
    "target.motion": Key({"velocity": [0.02, 0.0, 0.0, 0.0, 0.0, 0.0]}),
    "target.perturbed": Key(True, {"target": {"shape": "poster"}, "scheme": "luminance",
                                   "camera": {"width": 48, "height": 36}}, **LIGHT),
    **{
        f"target.motion.{name}": Key(value, {"target": {"motion": MOTION}})
        for name, value in {
            "velocity": [0, 0.02, 0, 0, 0, 0], "amplitude": [0, 0.005, 0], "frequency": 3.0,
            "circle": 0.004, "step": [0, 0.002, 0], "hold": 0.05, "begin": 0.05,
            "path": [[0.1, 0.005, 0.0, 0.0]],
        }.items()},
    "lag": Key(0.1, plants=("chain", "free")),
    "delay": Key(0.06, plants=LOOPS),
    "friction": Key(False, plants=("bullet",)),
    "camera_xyz": Key([0.004, 0.003, 0.0], plants=ARMS),
    "camera_rpy": Key([0.0, 0.02, 0.0], plants=ARMS),
    "noise": Key(6.0, **LIGHT),
    "jitter": Key(0.3, features=EXACT),
    "commands": Key("images", plants=LOOPS),
    "start": Key({"pose": [0.0, 0.01, *START[2:]]}),
    "goal": Key({"pose": [0.0, 0.01, *GOAL[2:]]}),
    "scheme": Key("pose"),
    "law": Key("pi"),
    "gain": Key(3.0),
    "duration": Key(0.07),
    "reached": Key([1.0, 1.0]),
    "seed": Key(5, {"camera": {"effects": {"drop_probability": 0.5}}}),
    "controller_parameters": Key({"interaction": "desired"}),
    "controller_parameters.interaction": Key("desired"),
    "controller_parameters.smoothing": Key(0.1),
    "controller_parameters.continuous_start": Key(1.0),
    "controller_parameters.ramp": Key(0.5),
    "controller_parameters.weights": Key([1.0, 3.0], {"scheme": "points+depth"}),
    "controller_parameters.max_velocity": Key(1e-3, plants=LOOPS),
    "controller_parameters.max_acceleration": Key(1e-2, plants=LOOPS),
    "controller_parameters.lower": Key(0.5, plants=LOOPS),
    "controller_parameters.upper": Key(-0.5, plants=LOOPS, tried=EXACT),
    "controller_parameters.hold_gain": Key(0.5, {"scheme": "gravity_centre"}, LOOPS),
    "controller_parameters.stop_time": Key(1.0, plants=LOOPS),
    "controller_parameters.watchdog": Key(0.005, plants=LOOPS),
    # Tests of the controller show the effects of these.
    "controller_parameters.hold": Key(0.1, tried=()),
    **{
        f"controller_parameters.{name}": Key(value, tried=(), **where)
        for where, values in (
            ({"plants": LOOPS}, {
                "approach_speed": 0.1, "lag": 0.01, "lead": 0.001, "output": "effort",
                "posture": {"J1": 0.1}, "posture_gain": 3.0, "start": [0.0] * 6}),
            ({"plants": ARMS}, {
                "damping": 5.0, "elbow": 1.0, "joints": ["J1"], "singularity_avoidance": True,
                "stiffness": 5.0}),
            ({"features": IMAGES}, {
                "depth_image": True, "marker": "5", "model": "mesh.stl", "model_scale": 2.0,
                "model_start": {"pose": [0.0] * 6}, "segmentation": {"method": "otsu"},
                "tracker": "marker", "tracker_options": {"minimum": 3}}))
        for name, value in values.items()},
    "features": Key("images", features=EXACT),
    "sun": Key({"diffuse": 0.2}, plants=("bullet",), **LIGHT),
    "sun.diffuse": Key(0.2, plants=("bullet",), **LIGHT),
    "sun.direction": Key([0.5, 0.0, -0.5], plants=("bullet",), **LIGHT),
    "sun.exposure": Key("gazebo", plants=("bullet",), **LIGHT),
    "sun.shines": Key([[0.0, 0.1]], plants=("bullet",), **LIGHT),
    # It acts where something touches it: test_target_files.
    "target.box": Key({"size": [0.1, 0.1, 0.02]}, plants=("bullet",), tried=()),
    "camera": Key({"preset": "fisheye", "width": 96, "height": 72}),
    "plant": Key("free", plants=("bullet", "chain", "ideal")),
    "record_peak_speeds": Key(True, plants=("bullet",)),
    "ideal": Key({"speed": [1e-3, 1e-3]}, plants=("ideal",)),
    "robot": Key({"camera_frame": "tool0"}, plants=ARMS, tried=()),  # test_robots has its keys
    **{
        f"controller_parameters.law_options.{one.name}": Key(
            {"zero": 3.0, "bound": 1e-3}.get(one.name, 0.7), {"law": law, "gain": None})
        for law in LAWS
        for one in LAWS.list_parameters(law)
        if one.name not in ("gain", "values")}}
PARTS = ("camera.effects.", "camera.shake.", "controller_parameters.law_options.",
         "target.motion.")  # fmt: skip
TIMED = ("camera.effects.exposure_time", "camera.effects.row_time")
# Keys that no run can be changed by, or that other tests change, and why.
EXEMPT = {
    # names on the graph; figures of CameraInfo; delivered where somebody reads them; of triggers
    "CameraConfig": {
        "name", "camera_name", "robot_namespace", "image_topic", "info_topic", "frame_name",
        "optical_frame_name", "depth_topics", "hack_baseline", "rectification_matrix",
        "projection_matrix", "depth", "segmentation", "shutter"},
    "CalibrationOffset": {"hand_eye"},  # test_calibrated_places
    # test_several_cameras, test_robots
    "CameraSpec": {"model", "rate", "xyz", "rpy", "pose", "frame", "delay", "calibration_offset",
                   "target", "target_frame", "hand_eye"},
    # Of meshes, and of links: test_links_as_targets.
    "TargetSpec": {"model", "link", "scale"},
    "SupportBoxSpec": {"size", "mass", "friction"},  # of target.box
    # Their own keys are here; test_robots, test_surroundings; an end after convergence; all names
    # of renderers mean one.
    "Experiment": {"cameras", "target", "calibration_offset", "world", "hand_eye",
                   "time_after_convergence", "renderer"},
    "IdealPlantSpec": {f.name for f in fields(IdealPlantSpec)},  # test_ending
    # Refused on every plant; acts near a limit that is given; below; test_hanging_scheme.
    "ControllerParameters": {*EXPERIMENT_KEYS, *GRAPH_PARAMETERS, "limit_avoidance", "law_options",
                             "package", "scheme_timeout"}}  # fmt: skip
PREFIXES = {
    CameraConfig: "camera.", Effects: "camera.effects.", SensorModel: "camera.effects.sensor.",
    AutoExposure: "camera.effects.auto_exposure.", Shake: "camera.shake.",
    CalibrationOffset: "calibration_offset.",
    CameraSpec: "cameras.a.", TargetSpec: "target.", TargetMotion: "target.motion.",
    SupportBoxSpec: "target.box.", SunSpec: "sun.", IdealPlantSpec: "ideal.", Experiment: "",
    ControllerParameters: "controller_parameters."}  # fmt: skip


@pytest.mark.parametrize("kind", PREFIXES, ids=lambda kind: kind.__name__)
def test_every_declared_key_is_tried(kind):
    exempt = EXEMPT.get(kind.__name__, set())
    untried = {f.name for f in fields(kind)} - exempt - {
        key.removeprefix(PREFIXES[kind]) for key in KEYS if key.startswith(PREFIXES[kind])}
    assert not untried


@functools.cache
def _fingerprint(text):
    """Return a digest of a run's images and records; text: its experiment as JSON."""
    experiment = Experiment.from_mapping(json.loads(text))
    found = hashlib.md5()

    def watch(_, reading):
        for part in (reading.image, reading.outline, reading.points):
            found.update(b"-" if part is None else np.ascontiguousarray(part).tobytes())

    with contextlib.closing(Loop(experiment, assemble(experiment), on_frame=watch)) as loop:
        loop.run_to_end()
        run = loop.make_run()
    for part in (run.stamp, run.error, run.desired_twist, run.pose, run.measured_positions,
                 run.joint_commands):  # fmt: skip
        found.update(np.nan_to_num(np.asarray(part, float)).tobytes())
    found.update(f"{run.verdict} {run.outcome} {run.peak_speed}".encode())
    return found.hexdigest()


def fingerprint(values):
    return _fingerprint(json.dumps(values))


def find_tried(key, one, plant):
    """Return with which features a run shows the key on a plant."""
    tried = [name for name in one.features if name in one.tried]
    if key.startswith(PARTS) and key not in TIMED:  # of an object that each plant uses as a whole
        return tried[:1] if plant == "free" else []
    if key.startswith(("controller_parameters", "law", "gain", "reached", "duration")):
        return tried[:1]
    if plant == "bullet":
        return tried[-1:]  # its exact features are those of the other arm
    if plant == "free":
        return tried
    return [] if key.startswith(("camera.", "target.")) else tried[:1]  # as on `free`


@pytest.mark.parametrize("features", BOTH)
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("key", KEYS)
def test_a_key_acts_or_is_refused(key, plant, features):
    one = KEYS[key]
    values = BASE | {"plant": plant, "features": features} | (JOINTS if plant in ARMS else {})
    values = merge(values, one.given)
    if plant == "bullet":
        values["duration"] = min(values["duration"], 0.1)
    values = {name: value for name, value in values.items() if value is not None}
    changed = with_override(values, key, one.value)
    if plant in one.plants and features in one.features:
        tried = features in find_tried(key, one, plant)
        assert not tried or fingerprint(changed) != fingerprint(values)
        return
    if values.get(key) == one.value or (key, plant) == ("commands", "ideal"):
        return  # it is that already, or that plant is like that
    with pytest.raises(ExperimentError) as refused:
        fingerprint(changed)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", [*EXPERIMENT_KEYS, *GRAPH_PARAMETERS])
def test_a_parameter_that_concerns_no_experiment_is_refused(name):
    with pytest.raises(ExperimentError, match=f"controller_parameters.{name} "):
        Experiment(controller_parameters={name: None})
