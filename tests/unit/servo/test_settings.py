"""Parameters and desired files: good ones build a loop, wrong ones are named in one line."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from aras_visual_servo_controller.before.laws import Adaptive
from aras_visual_servo_controller.before.settings import STARTS, Settings
from aras_visual_servo_controller.desired import Desired
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals import DESIRED_JOINTS, from_geometry
from aras_visual_servo_controller.teach import main as teach

PACKAGE = Path(__file__).parents[3] / "src" / "aras_visual_servo_controller"


def test_defaults_build_the_demo():
    loop = Settings.from_mapping({}, PACKAGE).build()
    assert loop.settings.start == STARTS["2016"]
    assert loop.scheme.desired.name == "desired_2016.yaml"


def test_roslaunch_hands_years_over_as_integers():
    settings = Settings.from_mapping({"start": 2015, "desired": 2016}, PACKAGE)
    assert settings.start_joints() == STARTS["2015"]
    assert settings.desired_path().name == "desired_2016.yaml"


def test_start_may_be_none_or_six_numbers():
    assert Settings.from_mapping({"start": "none"}, PACKAGE).start_joints() is None
    six = [0.1, 0, 0.1, -0.2, 0.1, 0]
    assert Settings.from_mapping({"start": six}, PACKAGE).start_joints() == tuple(six)


def test_adaptive_law_is_built():
    loop = Settings.from_mapping({"law": "adaptive", "gain_zero": 6.0}, PACKAGE).build()
    assert loop.scheme.law == Adaptive(zero=6.0)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ({"gian": 3.0}, "unknown parameter ~gian: did you mean 'gain'"),
        ({"xyzzy": 3.0}, "unknown parameter ~xyzzy: known are scheme"),
        ({"package": "/"}, "unknown parameter ~package"),
        ({"gain": "fast"}, "~gain is 'fast', must be a finite number"),
        ({"gain": True}, "~gain is True, must be a finite number"),
        ({"gain": float("nan")}, "~gain is nan, must be a finite number"),
        ({"gain": 0}, "~gain is 0.0, must be > 0"),
        ({"elbow": 3}, "~elbow is 3: use -1 or 1"),
        ({"law": "pid"}, "~law is 'pid': use proportional or adaptive"),
        ({"start": 2017}, "~start is '2017': use 2015, 2016, none"),
        ({"start": [1, 2]}, "must be six finite numbers in the order gantry, J1"),
        ({"start": [9, 0, 0, 0, 0, 0]}, "puts gantry at 9.0000, outside its limits"),
        ({"max_velocity": [1, 1, 1, 1, 1, 0]}, "limits of J6: velocity 0.0 must be positive"),
        ({"singularity_avoidance": 1}, "must be true or false"),
        ({"image_timeout": 0.0}, "must be at least 0.1 s"),
    ],
)
def test_wrong_parameters_are_named(raw, words):
    with pytest.raises(ConfigurationError) as caught:
        Settings.from_mapping(raw, PACKAGE)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_desired_file_is_named():
    settings = Settings.from_mapping({"desired": "/nowhere/x.yaml"}, PACKAGE)
    with pytest.raises(ConfigurationError, match="cannot read the desired features /nowhere"):
        settings.build()


@pytest.mark.parametrize("year", ["2015", "2016"])
def test_shipped_files_hold_what_an_exact_camera_sees(year):
    shipped = Desired.load(PACKAGE / "config" / f"desired_{year}.yaml")
    exact = from_geometry(DESIRED_JOINTS[year], year)
    np.testing.assert_allclose(shipped.joints, exact.joints)
    assert shipped.depth == pytest.approx(exact.depth)
    # Taught from rendered images: 0.5 % of the area, 0.3 mm of the place.
    assert shipped.m[0] == pytest.approx(exact.m[0], rel=5e-3)
    np.testing.assert_allclose(
        shipped.depth * shipped.m[1:3] / shipped.m[0],
        exact.depth * exact.m[1:3] / exact.m[0],
        atol=3e-4,
    )


def test_teach_writes_what_load_reads(tmp_path):
    path = tmp_path / "pose.yaml"
    assert teach(["--geometry", "2016", str(path)]) == 0
    desired = Desired.load(path)
    exact = from_geometry(DESIRED_JOINTS["2016"], "pose.yaml")
    np.testing.assert_array_equal(desired.m, exact.m)
    np.testing.assert_array_equal(desired.mu, exact.mu)
    np.testing.assert_array_equal(desired.kernel.features, exact.kernel.features)


def test_teach_says_when_it_cannot_write(capsys):
    assert teach(["--geometry", "2016", "/nowhere/pose.yaml"]) == 1
    assert "/nowhere/pose.yaml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("joints"), "'joints' is missing"),
        (lambda d: d["joints"].pop("J5"), "must name exactly gantry"),
        (lambda d: d.update(depth=-1.0), "must be above 0"),
        (lambda d: d["moments"].update(m=[1.0]), "'moments.m' must be 10 finite number"),
        (lambda d: d["moments"].update(order=1), "integer of at least 2"),
        (lambda d: d["moments"]["mu"].__setitem__(3, float("nan")), "'moments.mu' must be 10"),
        (lambda d: d.update(dpeth=1.0), "unknown key 'dpeth'"),
        (lambda d: d.update(kernel={"width": 3}), "'kernel' width, height"),
        (lambda d: d.update(mounting={"xyz": [0, 0, 0]}), "'mounting' must hold xyz and rpy"),
        (lambda d: d["mounting"].update(rpy=[0.0]), "'mounting.rpy' must be 3 finite number"),
    ],
)
def test_wrong_desired_files_are_named(change, words):
    data = yaml.safe_load(from_geometry(DESIRED_JOINTS["2016"], "x").to_yaml("x"))
    change(data)
    with pytest.raises(ConfigurationError) as caught:
        Desired.from_mapping(data, "pose.yaml")
    assert words in str(caught.value)
    assert str(caught.value).startswith("pose.yaml")


@pytest.mark.parametrize("content", [b"a: [", b"\xff\xfe", b"- 1"])
def test_files_that_are_no_yaml_are_refused(tmp_path, content):
    path = tmp_path / "pose.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"pose\.yaml"):
        Desired.load(path)
