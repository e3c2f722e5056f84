"""Renamed keys and values: one line gives the new name."""

import json

import pytest
import yaml

from aras_visual_servo_bench import BenchError, Experiment, Study
from aras_visual_servo_bench.studies.study_folder import MANIFEST, StudyFolder
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal

OLD_KEYS = [
    ({"linger": 1.0}, "key 'linger' is now called 'time_after_convergence'"),
    ({"believed": {"focal": 1.1}}, "key 'believed' is now called 'calibration_offset'"),
    ({"options": {"hold": 1.0}}, "key 'options' is now called 'controller_parameters'"),
    ({"traced": True}, "key 'traced' is now called 'record_peak_speeds'"),
    ({"features": "pictures"}, "features: 'pictures' is now called 'images'"),
]


def check_line(error, text):
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("values", "text"), [
    *OLD_KEYS,
    ({"cameras": {"left": {"believed": {}}}}, "believed' is now called 'calibration_offset'"),
])  # fmt: skip
def test_an_old_key_of_a_settings_file_is_named_with_its_new_name(values, text, tmp_path):
    path = tmp_path / "experiment.yaml"
    path.write_text(yaml.safe_dump(values))
    with pytest.raises(BenchError) as error:
        Experiment.from_yaml(path)
    check_line(error, text)
    with pytest.raises(BenchError) as error:
        Experiment(**values)
    check_line(error, text)


@pytest.mark.parametrize(("values", "text"), OLD_KEYS)
def test_an_old_key_of_a_study_is_named_with_its_new_name(values, text):
    ((key, value),) = values.items()
    for study in ({"experiment": values}, {"vary": {key: [value]}}, {"cases": [values]}):
        with pytest.raises(BenchError) as error:
            Study.from_mapping(study).make_trials()
        check_line(error, text)
    with pytest.raises(BenchError, match="'believed' is now called 'calibration_offset'"):
        Study.from_mapping({"vary": {"believed.focal": [1.0, 1.1]}})


def test_a_study_folder_with_old_keys_is_refused_in_one_line(tmp_path):
    study = Study.from_mapping({"experiment": {"plant": "free"}})
    StudyFolder.create(tmp_path / "runs", study, "")
    manifest = json.loads((tmp_path / "runs" / MANIFEST).read_text())
    manifest["study"]["experiment"] = {"plant": "free", "linger": 1.0}
    (tmp_path / "runs" / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(BenchError) as error:
        StudyFolder.open(tmp_path / "runs")
    check_line(error, "key 'linger' is now called 'time_after_convergence'")
    assert str(tmp_path / "runs") in str(error.value)


def test_an_old_key_of_a_goal_file_is_named_with_its_new_name():
    with pytest.raises(ConfigurationError) as error:
        Goal.from_mapping({"seen_by": "left"}, "goal.yaml")
    check_line(error, "goal.yaml: key 'seen_by' is now called 'camera_name'")
