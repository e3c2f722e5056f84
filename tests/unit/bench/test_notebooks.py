"""Display of runs in notebooks: short texts, cards, figures and tables."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_run import made_run

from aras_visual_servo_bench import BenchError, Experiment, Run, run, run_with_images
from aras_visual_servo_bench.recording.film import encode_frame

FIGURES = ("feature_errors", "pose_errors", "features", "camera_twist", "image_trajectory",
           "camera_path", "joint_positions", "conditioning", "timing", "filmstrip")  # fmt: skip
@pytest.fixture(scope="module")
def short() -> Run:
    """A run of a free camera that is too short to converge."""
    return run({"plant": "free", "duration": 0.3})


@pytest.fixture(scope="module")
def filmed() -> Run:
    """A run of rendered images with noise."""
    keys = {"camera": "noisy", "gain": 4.0, "time_after_convergence": 0.1}
    return run_with_images(Experiment(plant="chain", features="images", **keys), "noisy")


def without_measurements(done: Run, images: tuple[int, ...] = tuple(range(11))) -> Run:
    return replace(done, states=tuple(replace(s, scheme_output=None) if i in images else s
                                      for i, s in enumerate(done.states)))


def first_images(done: Run, count: int) -> Run:
    return replace(done, states=done.states[:count], pose=done.pose[:count])


def test_a_run_is_described_in_six_lines(short: Run, filmed: Run) -> None:
    lines = repr(short).splitlines()
    assert lines[0] == "run: timed_out" and len(lines) == 6
    assert re.fullmatch(r"  verdict: goal_missed, [\d.]+ mm and [\d.]+° from the goal", lines[1])
    assert lines[2] == f"  reason: {short.reason}" and lines[3] == f"  remedy: {short.remedy}"
    assert lines[4].endswith(f" s of simulated time, {len(short.stamp)} images processed, 0 stored")
    assert lines[5] == "  scheme: moments on plant free"
    lines = repr(filmed).splitlines()
    assert lines[0].startswith("run 'noisy': converged") and len(lines) == 4
    assert f", {len(filmed.stamp)} stored" in lines[2]
    assert repr(filmed.control_record) == (
        f"CameraRecord(320x240, {len(filmed.stamp)} exposures, {len(filmed.stamp)} images stored, "
        "0 frames of a film)")
    unknown = replace(short, verdict=replace(short.verdict, name="", distance=np.nan))
    assert "verdict: unknown, because the true poses are" in repr(unknown)
    assert "No verdict: the true poses are unknown." in unknown._repr_html_()


def test_a_card_has_outcome_image_curve_and_numbers(short: Run, filmed: Run) -> None:
    card = filmed._repr_html_()
    assert len(card) < 100_000
    assert card.count("data:image/jpeg;base64,") == 1 == card.count("data:image/png;base64,")
    for text in (filmed.outcome, "goal_reached", "final position error", "last image, "):
        assert text in card
    assert "No curve" not in card and "No image" not in card
    large = encode_frame(np.random.default_rng(1).integers(0, 256, (1200, 1600, 3), np.uint8))
    record = replace(filmed.control_record, images=(), film=((1.0, large),))
    card = replace(filmed, cameras={"camera": record})._repr_html_()
    assert "data:image/jpeg" in card and len(card) < 100_000
    notes = [f"<script>{n}</script>" for n in range(9)]
    card = replace(short, reason="<b>" + "long " * 10_000, notes=notes)._repr_html_()
    assert "<script>" not in card and "&lt;b&gt;" in card and "6 more notes" in card
    assert len(card) < 100_000


@pytest.mark.parametrize(("change", "told"), [
    (lambda r: first_images(r, 0), "No curve: the loop has processed no image."),
    (lambda r: first_images(r, 1), "No curve: only 1 of 1 images has a measurement."),
    (without_measurements, "No curve: none of the 11 images has a measurement."),
    (lambda r: without_measurements(r, (0, 3)),
     "The curve has gaps: 2 of 11 images have no measurement."),
    (lambda r: without_measurements(r, (7, 8, 9, 10)),
     "The last 4 of 11 images have no measurement."),
    (lambda r: replace(r, pose=np.tile(r.pose[:1], (len(r.pose), 1, 1))),
     "The camera has not moved."),
    (lambda r: r, "No image is stored: run_with_images stores them.")])  # fmt: skip
def test_a_card_says_what_is_missing_and_why(short: Run, change, told: str) -> None:
    changed = change(short)
    card = changed._repr_html_()
    assert told in card and changed.outcome in card
    assert "no measurement" in told or "no measurement" not in card
    assert ("data:image/png" in card) is not told.startswith("No curve")
    assert "no image" in told or ("The camera has not moved." in card) is ("moved" in told)


def test_a_figure_is_drawn_by_its_name_and_an_unknown_one_gets_the_list(
        short: Run, tmp_path: Path) -> None:
    figure = made_run(1, 0.9).plot(
        "pose_errors", tmp_path / "figure.svg", others=[made_run(2, 1.4)])
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "figure.svg").read_text()
    labels = {text.get_text() for axis in figure.axes
              for text in (axis.get_legend().get_texts() if axis.get_legend() else ())}
    assert labels == {"run 1", "run 2"}
    with pytest.raises(BenchError, match="did you mean 'features'") as error:
        short.plot("feature")
    assert all(name in str(error.value) for name in FIGURES)
    with pytest.raises(BenchError, match="figure 'filmstrip', which needs stored images"):
        short.plot("filmstrip")
    with pytest.raises(BenchError, match="'features', which needs a single run with images"):
        without_measurements(short).plot("features")


def test_a_table_has_a_row_per_image_and_units(short: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    done = made_run(1, 0.9)
    frame = done.to_pandas()
    assert len(frame) == len(done.stamp) and frame.index.name == "image"
    units = frame.attrs["units"]
    assert units["time"] == "s" and units["vx desired"] == "m/s" and units["turn error"] == "rad"
    assert "area" not in units and set(units) <= set(frame)
    np.testing.assert_array_equal(frame["turn error"], done.error[:, 2])
    assert list(frame["phase"]) == list(done.phases)
    assert pd.api.types.is_float_dtype(frame["scale"])
    assert first_images(short, 0).to_pandas().empty
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BenchError, match="pandas is not installed: run ./setup.sh"):
        short.to_pandas()
