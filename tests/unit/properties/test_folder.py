"""An interrupted study, continued from any state of its folder, gives identical files."""

import hashlib
import shutil

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.studies import study_execution as engine
from aras_visual_servo_bench.studies.pools import InProcessPool
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_folder import StudyFolder

STUDY = Study.from_mapping({
    "experiment": {"plant": "free", "duration": 0.1, "lag": 0.0},
    "vary": {"gain": [1.0, 2.0, 4.0]}, "repeats": 2, "chunk": 2,
    "metrics": ["success", "final_distance"],
})  # fmt: skip


def carry_out(folder):
    engine.run_missing(folder, InProcessPool, None)


def rows(path):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest()
            for file in sorted((path / "parts").iterdir())}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "whole"
    carry_out(StudyFolder.create(path, STUDY, ""))
    return path


@settings(max_examples=6)
@given(data=st.data())
def test_it_goes_on_to_the_same_bytes(whole, data, tmp_path):
    """Parts lost, cut, grown, swapped, or written half when the power went."""
    cut = tmp_path / "cut"
    shutil.rmtree(cut, ignore_errors=True)
    shutil.copytree(whole, cut)
    parts = sorted((cut / "parts").iterdir())
    for part in parts:
        harm = data.draw(st.sampled_from(["none", "lost", "cut", "grown", "other", "half"]))
        content = part.read_bytes()
        if harm == "lost":
            part.unlink()
        elif harm == "cut":
            part.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
        elif harm == "grown":
            part.write_bytes(content + data.draw(st.binary(min_size=1, max_size=9)))
        elif harm == "other":
            part.write_bytes(data.draw(st.sampled_from(parts)).read_bytes()
                             if all(p.exists() for p in parts) else b"")  # fmt: skip
        elif harm == "half":
            (part.parent / f".{part.name}.new").write_bytes(content[:100])
    left, right = rows(cut), rows(whole)
    wrong = {part.name for part in parts if left.get(part.name) != right[part.name]}
    made = StudyFolder.open(cut)
    assert {made.find_part(k).name for k in made.find_missing_chunks()} == wrong
    if wrong & left.keys():
        with pytest.raises(StudyError, match="was changed since it was written"):
            StudyFolder.open(cut).read_results()
    carry_out(made)
    assert rows(cut) == rows(whole)
    assert StudyFolder.open(cut).read_results()["run"].to_pylist() == list(range(STUDY.run_count))
