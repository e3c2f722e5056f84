"""Outcome campaign: its kinds of faults, events and sums."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from aras_visual_servo_bench.experiment.experiment import Experiment
from outcome_campaign import cli
from outcome_campaign.kinds import KINDS, Event
from outcome_campaign.table import (
    TITLE,
    by_faults,
    failures,
    markdown,
    section,
    section_of,
    summary,
)
from outcome_campaign.trial import Judged, carried_out, judged

RIGHT = Judged("pictures", 0, "converged", "", "", 1e-4, 2e-3, 3e-4, 5e-3, True)
LOST = Judged("target_leaves", 1, "target_lost", "gone", "teach", 0.4, 0.1, math.nan, math.nan,
              True, True)  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_draws_experiments_that_there_are(name):
    kind = KINDS[name]
    trials = [kind.trial(5, number) for number in range(3)]
    for trial in trials:
        Experiment.from_mapping(trial.keys)
    assert kind.text and kind.right and len(KINDS) >= 25
    assert len({json.dumps(trial.keys, sort_keys=True) for trial in trials}) == 3
    assert kind.trial(5, 2) == trials[2] != kind.trial(6, 2)


@pytest.mark.parametrize(("plant", "what", "said"), [
    ("bullet", "joints_end", "no_joint_states"), ("chain", "joints_stick", "joints_do_not_follow"),
    ("chain", "images_end", "too_few_images"),
])  # fmt: skip
def test_an_event_reaches_the_loop_whatever_the_plant_joins_with_its_cycles(plant, what, said):
    keys = {"plant": plant, "features": "exact", "gain": 1.0, "duration": 5.0, "noise": 0.0}
    _, outcome = carried_out(keys, Event(what, 0.4))
    assert outcome.kind == said, outcome.reason


def test_the_sums_are_those_of_the_runs(capsys):
    wrong = replace(RIGHT, distance=6e-4, right=False)
    numbers = summary([RIGHT, RIGHT, wrong, LOST])
    assert numbers["right"] == 0.75 and numbers["least_kind"] == pytest.approx(2 / 3)
    assert numbers["converged"] == 3 and numbers["exceeded"] == pytest.approx(1 / 3)
    assert numbers["worst"] == pytest.approx(2.0)
    assert numbers["median_distance"] == 1e-4 and numbers["median_open_angle"] == 5e-3
    assert numbers["remedies_followed"] == 1 and numbers["remedies_helped"] == 1.0
    assert len(failures(numbers)) == 4 and failures(summary([RIGHT, LOST])) == []
    wide = replace(RIGHT, open_distance=3.1e-4)
    assert failures(summary([wide])) == ["uncertainty of distance within 3 times the median error"]
    beyond, name = replace(RIGHT, angle=5.1e-3), "uncertainty exceeded in 0.5% at most"
    for count, is_exceeded in ((150, True), (250, False)):
        assert (name in failures(summary([beyond] + [RIGHT] * count))) == is_exceeded
    assert cli.main(["cold"]) == 2 and "no kind 'cold'" in capsys.readouterr().err


def test_right_runs_are_counted_by_the_faults_provoked():
    up_to = replace(RIGHT, said="converged up to the target's distance")
    both = replace(LOST, kind="moving_target_and_high_gain", right=False)
    numbers = by_faults([RIGHT, up_to, replace(RIGHT, right=False), LOST, both])
    assert numbers == {
        "fault_free": pytest.approx(2 / 3), "plain": pytest.approx(1 / 3),
        "one_fault": 1.0, "two_faults": 0.0,
    }  # fmt: skip
    alike = replace(up_to, kind="same_from_four_sides")  # of no one heading
    assert by_faults([alike]) == {"fault_free": 1.0}
    assert "100.0% of the runs without a fault." in markdown([alike])


def test_the_section_takes_the_place_of_the_one_before_and_is_kept_by_other_tables():
    page = section("# What is true\n\nrows\n", [RIGHT], (1, 2))
    assert page.count(TITLE) == 1 and "seeds 1 and 2" in page and "1 of 1" in page
    again = section(page, [replace(RIGHT, right=False)], (3,))
    assert again.count(TITLE) == 1 and "0 of 1" in again and again.startswith("# What is true")
    assert again == f"# What is true\n\nrows\n{section_of(again)}"
    assert section_of("# nothing here") == ""
    assert "converged 1" in markdown([RIGHT])


@pytest.mark.parametrize(
    ("name", "number", "said", "besides"),
    [
        ("moving_target_and_high_gain", 0, "gain_too_high", "features moved steadily"),
        ("slow_joints_and_a_limit", 0, "joint_limit", "speed or acceleration limit"),
        ("goal_read_wrongly", 0, "ambiguous", "the image differs from the goal's"),
    ],
)
def test_of_two_causes_both_are_named_and_the_remedy_is_for_both(name, number, said, besides):
    found = judged(KINDS[name].trial(cli.KEPT, number), follow=True)
    assert found.right and found.said == said, found.reason
    assert besides in found.reason and found.helped


def test_runs_of_the_kept_seed_are_told_right():
    """`tests/outcomes` runs each kind often enough to judge it."""
    found = list(cli.carried_out(cli.trials((cli.KEPT,), 1, [*KINDS][:40:8]), workers=1))
    numbers = summary(found)
    wrong = [f"{f.kind} {f.number}: {f.said} ({f.reason})" for f in found if not f.right]
    assert numbers["right"] >= 0.95, wrong
    assert numbers["converged"] >= 2 and numbers["worst"] <= 1.0
    assert numbers["remedies_helped"] >= 0.7
