"""Public functions of bench and bridge in a program, from a run to its figure."""

from __future__ import annotations

import contextlib
import io
import sys
from dataclasses import replace
from pathlib import Path

import distributed
import numpy as np
import pytest

from aras_sim_bridge import SimError, Simulation, load_description, load_world, populate
from aras_visual_servo_bench import BenchError, Study, run, run_study

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
QUICK = {"plant": "free", "duration": 0.3}
STUDY = {"experiment": QUICK, "vary": {"gain": [1.0, 2.0]}, "repeats": 2,
         "metrics": ["final_distance"]}  # fmt: skip
BOX = """<sdf version='1.6'><model name='box'><pose>1 0 2 0 0 0</pose><link name='l'>
  <inertial><mass>2</mass></inertial><collision name='c'><geometry><box><size>1 1 1</size></box>
  </geometry></collision></link></model></sdf>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "mine"
    results = run_study(STUDY, path)
    assert results.read_column("gain") == [1.0, 1.0, 2.0, 2.0] and results.name == "mine"
    return path


def test_a_study_runs_itself(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = Study.from_mapping(STUDY)
    stored, alone = study.run(folder, progress=False), study.run(progress=False)
    assert capsys.readouterr().err == ""
    assert stored.name == "mine" and alone.name == "study"
    assert stored.read_column("final_distance") == alone.read_column("final_distance")
    again = study.run(tmp_path / "again")
    assert "4/4 runs" in capsys.readouterr().err
    assert again.read_column("final_distance") == alone.read_column("final_distance")
    monkeypatch.setattr(distributed, "LocalCluster", lambda n_workers, **_: 1 / (n_workers - 2))
    with pytest.raises(ZeroDivisionError):  # two workers are started; real ones: test_cluster
        study.run(tmp_path / "parallel", workers=2)
    frame = stored.to_pandas()
    assert list(frame["gain"]) == stored.read_column("gain")
    assert frame.attrs["units"] == {"gain": "1/s", "final_distance": "m"}
    with pytest.raises(BenchError, match="must be stored: give a folder"):
        Study.from_mapping({**STUDY, "traces": True}).run()


def test_the_progress_of_a_run_goes_from_0_to_1(
    capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    watched = run(QUICK, told.append)
    assert told == sorted(told) and told[0] < 0.2 and told[-1] == 1.0
    assert len(told) >= len(watched.stamp)
    assert np.array_equal(watched.error, run(QUICK).error, equal_nan=True)
    assert capsys.readouterr().err == ""  # no terminal: no bar
    told.clear()
    early = run({"plant": "free", "duration": 60.0, "time_after_convergence": 0.1}, told.append)
    assert early.end_stamp - early.start_stamp < 30.0 and told[-2] < 0.5 and told[-1] == 1.0
    out = io.StringIO()
    out.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", out)
    run(QUICK, progress=True)  # a bar is drawn where it can be overwritten
    assert "% of 0.3 s" in out.getvalue() and out.getvalue().endswith("\r\x1b[K")


def test_studies_and_their_results_are_described_in_few_lines(folder: Path) -> None:
    study = Study.from_mapping(STUDY)
    assert repr(study).splitlines() == [
        "Study: 4 runs: 2 points, 2 of each", "  experiment: plant free, duration 0.3",
        "  varies: gain (2 values)", "  metrics: final_distance"]  # fmt: skip
    many = repr(Study(repeats=10_000, cases=[{"scheme": "points"}, {"scheme": "moments"}], vary={
        "gain": [float(n + 1) for n in range(1000)], "start.side": {"uniform": [0.0, 0.1]}}))
    assert "20000000 runs: 2000 points, 2 cases, 10000 of each" in many.splitlines()[0]
    assert "gain (1000 values), start.side (random)" in many and len(many) < 300
    assert repr(Study()).splitlines() == ["Study: 1 run: 1 point, 1 of each"]
    assert repr(study.run(folder)).splitlines()[:3] == [
        "Results of mine: 4 of 4 runs", "  ends: timed_out (4)", "  settings: gain"]  # fmt: skip
    judged = Study.from_mapping({**STUDY, "metrics": ["success"]}).run(progress=False)
    assert repr(judged).startswith("Results of study: 4 of 4 runs, 0 with success\n")


def test_the_results_of_two_studies_are_compared(folder: Path) -> None:
    base = {**STUDY, "repeats": 8, "seeds": "repeats"}
    first = Study.from_mapping(base).run(progress=False)
    longer = {**QUICK, "duration": 0.5}
    second = Study.from_mapping({**base, "experiment": longer}).run(progress=False)
    found = first.compare(second, metrics=["final_distance"])
    lines = repr(found).splitlines()
    assert len(lines) == 3 and lines[-1].startswith("2 of 4 differences are significant")
    assert all(line.split()[:2] == ["better", "final_distance"] for line in lines[:2])
    assert set(found.to_pandas()["verdict"]) == {"better", "chance"}
    renamed = replace(second, name="longer")
    assert repr(first.compare(renamed, by=["gain"])).startswith("study -> longer\n")
    long = replace(found, differences=found.differences * 100)
    assert len(repr(long).splitlines()) == 22 and "… and 180 more" in repr(long)


def test_a_description_is_read_by_what_it_is_and_the_models_of_a_world_are_spawned(
    tmp_path: Path) -> None:
    arm = load_description(EXAMPLES / "my_arm.urdf")
    (tmp_path / "box.sdf").write_text(BOX)
    box = load_description(tmp_path / "box.sdf")
    world = BOX.replace("<model", "<world name='w'><model").replace("</model>", "</model></world>")
    (tmp_path / "box.world").write_text(world)
    with contextlib.closing(Simulation()) as simulation:
        simulation.spawn(arm, "arm")
        simulation.spawn(box, "other")
        populate(simulation.spawn, load_world(tmp_path / "box.world"))
        assert simulation.world.model("arm").joint_names and not box.joints
        assert simulation.world.model("box").pose().xyz == pytest.approx((1.0, 0.0, 2.0))
        simulation.step()


def test_a_mesh_is_found_beside_its_description(tmp_path: Path) -> None:
    mesh = "<mesh filename='{}.obj'/>"
    for name, found in (("there", True), ("gone", False)):
        urdf = ("<robot name='r'><link name='l'><visual><geometry>" + mesh.format(name)
                + "</geometry></visual></link></robot>")  # fmt: skip
        (tmp_path / "there.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        (tmp_path / f"{name}.urdf").write_text(urdf)
        warnings = load_description(tmp_path / f"{name}.urdf").warnings
        assert any("gone.obj" in warning for warning in warnings) is not found


@pytest.mark.parametrize(("text", "said"), [
    (None, "description .*x.urdf cannot be read"), ("", "the description is empty"),
    ("<mujoco/>", "the root element is <mujoco>; it must be <robot> .URDF. or <sdf>"),
    ("<robot name='r'/>", "description .*x.urdf: ")])  # fmt: skip
def test_what_is_no_description_is_refused(tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "x.urdf").write_text(text)
    with pytest.raises(SimError, match=said):
        load_description(tmp_path / "x.urdf")
