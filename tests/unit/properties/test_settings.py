"""Settings: any value of a key is accepted, or one line names the key."""

import copy
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aras_visual_servo_bench.errors import ExperimentError, StudyError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.studies.study import Study

WHOLE = {
    "plant": "chain", "lag": 0.05, "duration": 2.5, "gain": 3.0, "law": "pi", "scheme": "points",
    "target": {"shape": "square", "size": [0.06, 0.04], "pose": [0.1, 0.0, 0.6, 0.1, 0.0, 0.3],
               "occluder": [[0.0, 0.01], [0.02, 0.03]], "occluded": [[1.0, 1.5]],
               "motion": {"velocity": [0.01, 0.0, 0.0, 0.0, 0.0, 0.1]}},
    "camera": "wide", "calibration_offset": {"focal": 1.02}, "jitter": 0.5, "delay": 0.02,
    "seed": 7,
    "start": {"height": [0.2, 0.3], "side": 0.05}, "goal": [0.1, 0.0, -0.1, 0.05, 0.05, 0.0],
    "controller_parameters": {"smoothing": 0.1}, "reached": [0.001, 0.01],
}  # fmt: skip
JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 10**30) | st.floats() | st.text(max_size=5)
    | st.sampled_from(["bullet", "images", "square", "none"]),
    lambda inner: st.lists(inner, max_size=6)
    | st.dictionaries(st.text(max_size=4) | st.integers(), inner, max_size=3),
    max_leaves=7,
)  # fmt: skip


def places(tree, above=()):
    """Every place of a tree of mappings and lists."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in inner:
        yield (*above, key)
        if isinstance(value, dict | list):
            yield from places(value, (*above, key))


def replaced(tree, place, value):
    made = copy.deepcopy(tree)
    node = made
    for key in place[:-1]:
        node = node[key]
    node[place[-1]] = value
    return made


def is_one_line_that_names(error, place):
    """Return whether an error is one line that names the key or the key above it."""
    text = str(error)
    assert "\n" not in text and len(text) < 700, text
    assert any(str(key) in text for key in place), (place, text)


@settings(max_examples=250)
@given(st.sampled_from(list(places(WHOLE))), JUNK)
def test_an_experiment_is_made_or_the_key_is_named(place, junk):
    try:
        made = Experiment.from_mapping(replaced(WHOLE, place, junk))
    except ExperimentError as error:
        is_one_line_that_names(error, place)
        return
    assert made.with_changes() == made
    given = replaced(WHOLE, place, junk)
    given.pop("seed", None)  # a study has its own
    study = Study.from_mapping({"experiment": given, "vary": {"gain": [1.0, 2.0]}})
    again = json.loads(json.dumps(study.to_mapping()))
    assert Study.from_mapping(again).digest == study.digest


@given(st.text(min_size=1, max_size=12), JUNK)
def test_a_key_that_there_is_not_is_named(key, junk):
    if key in {name for name in Experiment.__dataclass_fields__}:
        return
    with pytest.raises(ExperimentError, match="unknown key"):
        Experiment.from_mapping({key: junk})


STUDY = {
    "experiment": {"plant": "free", "duration": 0.1, "lag": 0.0},
    "vary": {"gain": [1.0, 2.0], "seed": {"integers": [1, 9]}},
    "samples": 3, "sampling": "sobol", "repeats": 2, "chunk": 2, "limit": 4.0, "traces": True,
    "metrics": ["success", "final_distance"],
}  # fmt: skip


@settings(max_examples=150)
@given(st.sampled_from(list(places(STUDY))), JUNK)
def test_a_study_is_made_or_the_key_is_named(place, junk):
    try:
        made = Study.from_mapping(replaced(STUDY, place, junk))
    except StudyError as error:
        is_one_line_that_names(error, place)
        return
    assert made.run_count >= 1
    assert Study.from_mapping(made.to_mapping()).digest == made.digest
