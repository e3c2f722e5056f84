"""Study files: variations, numbers and seeds of runs, and errors."""

from __future__ import annotations

import copy
import dataclasses
import datetime
import pickle

import numpy as np
import pyarrow as pa
import pytest
import yaml
from scipy import stats

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.experiment import overrides
from aras_visual_servo_bench.studies import run_rows as rows
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_execution import check_study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

FREE = {"plant": "free"}


def drawn(n, sampling="random", **vary):
    study = Study.from_mapping(
        {"experiment": FREE, "vary": vary, "samples": n, "sampling": sampling}
    )
    rows = [study.make_settings(point) for point in range(study.point_count)]
    return {key: [row[key] for row in rows] for key in vary}


def test_a_grid_has_every_combination_once_and_the_last_key_changes_first():
    study = Study.from_mapping({
        "experiment": FREE, "vary": {"law": ["proportional", "adaptive"], "gain": [1, 2, 3]},
        "cases": [{"scheme": "moments"}, {"scheme": "points", "delay": 0.1}], "repeats": 2,
    })  # fmt: skip
    assert (study.point_count, study.run_count) == (12, 24)
    assert study.keys == ("scheme", "delay", "law", "gain")
    settings = [{**case, "law": law, "gain": gain}
                for case in ({"scheme": "moments"}, {"scheme": "points", "delay": 0.1})
                for law in ("proportional", "adaptive") for gain in (1, 2, 3)]  # fmt: skip
    assert [study.make_settings(p) for p in range(12)] == settings
    made = [study.make_experiment(run) for run in range(24)]
    assert [(e.law, e.gain) for e in made] == [
        (one["law"], one["gain"]) for one in settings for _ in range(2)]


def test_values_are_drawn_as_numpy_says_so_that_anyone_can_work_them_out():
    """From a stream of their own, `poin` in ASCII, for each sample by its number."""
    found = drawn(3, seed={"integers": [0, 10**6]}, delay={"uniform": [0.01, 0.03]})
    for k in range(3):
        state = np.random.SeedSequence(0, spawn_key=(int.from_bytes(b"poin", "big"), k))
        first, second = np.random.default_rng(state).random(2)
        assert found["seed"][k] == int(first * (10**6 + 1))
        assert found["delay"][k] == pytest.approx(0.01 + 0.02 * second, rel=1e-12)
    state = np.random.SeedSequence(0, spawn_key=(int.from_bytes(b"poin", "big"),))
    points = stats.qmc.Sobol(1, rng=np.random.default_rng(state)).random(4)
    found = drawn(4, "sobol", delay={"uniform": [0.01, 0.03]})["delay"]
    assert found == pytest.approx((0.01 + 0.02 * points[:, 0]).tolist(), rel=1e-12)


def test_seeds_are_of_the_runs_number_and_the_studys_seed():
    def of(count=1000, **changes):
        study = Study.from_mapping({"experiment": FREE, "repeats": 1000, **changes})
        assert study.make_experiment(3).seed == study.compute_seed(3)
        return [study.compute_seed(run) for run in range(count)]

    one = of()
    assert len(set(one)) == 1000 and min(one) >= 0 and max(one) < 2**63
    assert of() == one and not set(of(seed=1)) & set(one)
    # As numpy says it, so that anyone can work a run's seed out.
    state = np.random.SeedSequence(0, spawn_key=(7,)).generate_state(1, np.uint64)[0]
    assert one[7] == int(state) >> 1
    same = of(6, vary={"gain": [1.0, 2.0]}, repeats=3, seeds="repeats")
    assert same[:3] == same[3:] and len(set(same)) == 3


def test_chunks_cover_all_runs_once(tiny):
    for repeats, chunk in ((7, 4), (1, 100), (20, 60)):
        study = tiny(repeats=repeats, chunk=chunk)
        covered = [run for c in range(study.chunk_count) for run in study.list_chunk_runs(c)]
        assert covered == list(range(study.run_count))
    assert [tiny(repeats=n, chunk=None).chunk_size for n in (1, 410, 100_000)] == [1, 31, 100]
    pictured = {"experiment": {**FREE, "features": "images"}, "repeats": 400, "chunk": None}
    for pictures, size in (("all", 4), ("first", 30)):  # pictures are kept in memory
        assert tiny(**pictured, pictures=pictures).chunk_size == size


@pytest.mark.parametrize(("values", "kind"), [
    ([True, False], pa.bool_()), ([1, 2], pa.int64()), ([1, 2.5], pa.float64()),
    ([None, 2.5], pa.float64()), ([1, True], pa.string()), (["a", 1], pa.string()),
    ({"integers": [1, 3]}, pa.int64()), ({"normal": [1, 3]}, pa.float64()),
    ({"choice": [[1], [2]]}, pa.string()), ([np.int64(1), np.int64(2)], pa.int64()),
])  # fmt: skip
def test_a_column_has_the_type_of_what_varies(tiny, values, kind):
    study = tiny(vary={"controller_parameters.mine": values})
    assert rows.make_schema(study, {}).field("controller_parameters.mine").type == kind


def test_a_mapping_makes_the_same_study_again(tiny):
    study = tiny(vary={"gain": {"uniform": [1.0, 2.0]}}, samples=3, cases=[{"delay": 0.0}])
    again = Study.from_mapping(study.to_mapping())
    assert again == study and again.digest == study.digest
    assert tiny(seed=1).digest != tiny().digest


def test_overrides_replace_what_varies_and_the_studys_own_keys(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump({
        "experiment": {**FREE, "start": {"side": 0.02}}, "repeats": 3,
        "vary": {"gain": [1, 2], "delay": [0.0, 0.1]}}))  # fmt: skip
    study = Study.from_yaml(
        file, overrides.parse_overrides(["gain=5", "repeats=4", "start.turn=0.3"])
    )
    assert study.run_count == 8 and study.keys == ("delay",)
    made = study.make_experiment(0)
    assert (made.gain, made.start.side, made.start.turn) == (5, 0.02, 0.3)
    study = Study.from_yaml(file, overrides.parse_overrides(["vary.gain=[3, 4, 5]"]))
    assert study.run_count == 18


def test_an_experiment_in_a_file_beside_the_study(tmp_path):
    (tmp_path / "base.yaml").write_text("plant: free\ngain: 3.0\n")
    (tmp_path / "study.yaml").write_text("experiment: base.yaml\nrepeats: 2\n")
    for study in (Study.from_yaml(tmp_path / "study.yaml"),
                  Study(experiment=str(tmp_path / "base.yaml"), repeats=2)):
        assert study.make_experiment(1).gain == 3.0
    (tmp_path / "base.yaml").write_text("- 3.0\n")
    with pytest.raises(StudyError, match="base.yaml is not a study"):
        Study.from_yaml(tmp_path / "base.yaml")
    with pytest.raises(StudyError, match="base.yaml is not an experiment"):
        Study.from_mapping({"experiment": str(tmp_path / "base.yaml")})


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"vary": {"gain": []}}, "vary.gain is an empty list: give at least one value"),
    ({"repeats": 10**12}, "e.12 runs are more than 1e.08"),
    ({"vary": {"start.heigth": [1.0]}}, "no 'start.heigth': did you mean start.height"),
    ({"vary": {"calibration_offset.focus": [1.0]}}, "no 'calibration_offset.focus'"),
    ({"cases": {"it": [{"name": "a", "set": {"laws": "PI"}}]}, "vary": {}}, "no 'laws': did you"),
    ({"cases": {"lens": [{"name": "a", "sett": {}}]}}, "'cases.lens.0..sett': did you mean 'set'"),
    ({"cases": [{"gain": 2.0}]}, "'gain' is both under vary and in cases"),
    ({"vary": {"gain": {"uniform": [float("nan"), 2.0]}}}, "uniform.0. is nan, must be a finite"),
    ({"vary": {"gain": {"normal": [1.0, 0.0]}}}, "deviation is 0, must be above 0"),
    ({"vary": {"gain": {"uniform": [1.0, 1.0]}}}, ".1, 1., must be .low, high. with low < high"),
    ({"vary": {"gain": {"loguniform": [0.0, 1.0]}}}, "must be .low, high. with 0 < low < high"),
    ({"vary": {"gain": {"unifrom": [1.0, 2.0]}}}, "unknown key 'unifrom': did you mean 'uniform'"),
    ({"vary": {"gain": {"linear": [1.0, 2.0, 1]}}}, "count is 1, must be from 2"),
    ({"vary": {"gain": {"log": [0.0, 2.0, 3]}}}, "above 0"),
    ({"vary": {"gain": {"integers": [1.5, 3]}}}, "whole numbers"),
    ({"vary": {"gain": {"choice": []}}}, "must be a list of values"),
    ({"vary": {"gain": 2.0}}, "put a constant value under experiment"),
    ({"samples": 2}, "samples is 2, but no key has a distribution"),
    ({"metrics": ["nowhere.at_all:it"]}, "nowhere"),
    ({"metrics": ["math:pi"]}, "math:pi is not a metric"),
    ({"experiment": {**FREE, "seed": 3}}, "seed belongs to the study"),
    ({"experiment": [1]}, "experiment is .1., must be a mapping or a text"),
])  # fmt: skip
def test_what_is_no_study_is_refused_in_a_line(tiny, changes, complaint):
    with pytest.raises(StudyError, match=complaint) as caught:
        tiny(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"experiment": {"plant": "fre"}}, "plant is 'fre'"),
    ({"vary": {"scheme": ["moments", "momments"]}}, "momments.*did you mean 'moments'"),
    ({"vary": {"controller_parameters.max_velocty": [0.1]}}, "max_velocty.*max_velocity"),
    ({"vary": {"goal": ["2015", "/nowhere.yaml"]}}, "cannot read the goal /nowhere.yaml"),
    ({"vary": {}, "cases": [{"delay": 0.0}, {"delay": -1.0}]}, "delay is -1"),
    ({"vary": {"delay": {"uniform": [-0.001, 9.0]}}}, "delay is -0.001"),
    ({"vary": {"delay": {"uniform": [-0.1, 0.1]}}}, "delay is -0.0"),
])  # fmt: skip
def test_every_value_is_tried_before_the_first_run(tiny, changes, complaint):
    study = tiny(**changes)
    with pytest.raises(StudyError, match=complaint) as caught:
        check_study(study)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("words", "complaint"), [
    (["gain"], "'gain' is not an override"), (["=2"], "not an override"),
    (["gain=[1"], "not valid YAML"),
])  # fmt: skip
def test_overrides_that_are_none(words, complaint):
    with pytest.raises(StudyError, match=complaint):
        overrides.parse_overrides(words)


def test_what_cannot_be_set_or_written_is_refused(tiny, tmp_path):
    with pytest.raises(StudyError, match="samples is 0, must be >= 1"):
        dataclasses.replace(tiny(), samples=0)
    study = Study.from_mapping({"experiment": {**FREE, "start": "2016"},
                                "vary": {"start.side": [0.1]}})  # fmt: skip
    with pytest.raises(StudyError, match="'start.side' cannot be set: start is '2016', which has"):
        study.make_experiment(0)
    cases = {"a": [{"name": "b", "published": {"outcome": datetime.date(2026, 2, 1)}}]}
    told = r"^datetime.date\(2026, 2, 1\) cannot be used in a study: use numbers, texts"
    with pytest.raises(StudyError, match=told):
        StudyFolder.create(tmp_path, Study.from_mapping({"experiment": FREE, "cases": cases}), "")


NOISY = {"preset": "noisy", "effects": {"drop_probability": 0.3}}
ORIGINAL = {"preset": "original"}
POSE, OTHER = {"pose": [0, 0, 0.3, 3.1, 0, 0]}, {"pose": [0, 0, 0.4, 3.1, 0, 0]}


@pytest.mark.parametrize(("here", "settings", "wanted"), [
    # A preset stays in force, the one that is there without a word included.
    ({"camera": "noisy"}, {"camera.effects.drop_probability": 0.3}, {"camera": NOISY}),
    ({}, {"camera.effects.gain": 2.0}, {"camera": {**ORIGINAL, "effects": {"gain": 2.0}}}),
    ({"cameras": {"a": {"rate": 9.0}}}, {"cameras.a.model.width": 64},
     {"cameras": {"a": {"model": {**ORIGINAL, "width": 64}, "rate": 9.0}}}),
    ({"camera": "noisy"}, {"camera": {"effects": {"drop_probability": 0.3}}}, {"camera": NOISY}),
    ({"cameras": {"a": {"model": "wide", "rate": 9.0}}}, {"cameras.a.model.effects.gain": 2.0},
     {"cameras": {"a": {"model": {"preset": "wide", "effects": {"gain": 2.0}}, "rate": 9.0}}}),
    # Wholes before their parts, in whatever order they are given.
    ({}, {"camera.effects.drop_probability": 0.3, "camera": "noisy"}, {"camera": NOISY}),
    ({"camera": NOISY}, {"camera": "wide"}, {"camera": "wide"}),
    # Which cameras there are is one value.
    ({"cameras": {"a": {}, "b": {}}}, {"cameras": {"b": {"rate": 9.0}}},
     {"cameras": {"b": {"rate": 9.0}}}),
    ({"cameras": {"a": {}, "b": {}}}, {"cameras.b": {"rate": 9.0}},
     {"cameras": {"a": {}, "b": {"rate": 9.0}}}),
    # Any mapping.
    ({"calibration_offset": {"focal": 0.9, "xyz": [0, 0, 1]}},
        {"calibration_offset": {"focal": 1.1}},
     {"calibration_offset": {"focal": 1.1, "xyz": [0, 0, 1]}}),
    ({"target": {"shape": "square", "motion": {"begin": 1.0}}}, {"target": {"motion": {"turn": 2}}},
     {"target": {"shape": "square", "motion": {"begin": 1.0, "turn": 2}}}),
    # A start of another kind, and one of the same.
    ({"start": {"side": 0.1, "turn": 0.2}}, {"start": POSE}, {"start": POSE}),
    ({"start": {"side": 0.1, "turn": 0.2}}, {"start": {"turn": 1}},
     {"start": {"side": 0.1, "turn": 1}}),
    ({"start": {"kind": "turned", "angle": 9.0}}, {"start": {"kind": "back", "distance": 0.1}},
     {"start": {"kind": "back", "distance": 0.1}}),
    ({"goal": POSE}, {"goal": OTHER}, {"goal": OTHER}), ({"goal": POSE}, {"goal": "a"},
     {"goal": "a"}), ({"start": "2016"}, {"start": POSE}, {"start": POSE}),
])  # fmt: skip
def test_an_override_changes_the_key_that_it_names_and_nothing_else(here, settings, wanted):
    before = copy.deepcopy(here)
    assert overrides.with_overrides(here, settings) == wanted
    assert here == before


def test_a_study_that_has_run_can_be_sent_to_another_process():
    study = Study.from_mapping({"experiment": {"plant": "free"}})
    assert study.goal_images is study.goal_images
    again = pickle.loads(pickle.dumps(study))
    assert again == study and again.goal_images is not study.goal_images
