"""The gallery's examples work, and the gallery and the front page show all of them."""

import runpy
import sys

import pytest
from blocks import ROOT
from PIL import Image

sys.path.append(str(ROOT / "docs"))

import gallery_page  # noqa: E402

PAGE = ROOT / "docs" / "gallery.md"
HOLD, SMALL = "controller_parameters.hold=0.3", ("camera.width=160", "camera.height=120")
# What makes the examples shorter, where it is not a short hold and a higher gain.
SHORTER = {
    "study": ["repeats=1", "duration=0.2", "vary.gain=[1.0,4.0]", "vary.delay=[0.05,0.2]"],
    "failure": [HOLD], "moving_target": ["--no-report"],
    **dict.fromkeys(("own_camera", "photometric"), ["--no-report", HOLD, "gain=4", *SMALL]),
}  # fmt: skip


@pytest.mark.parametrize("name", gallery_page.NAMES)
def test_an_example_of_the_gallery(name, tmp_path, monkeypatch):
    """In this process, which has imported everything already: most of a short one's time."""
    scripts = ROOT / "docs" / "gallery"
    monkeypatch.syspath_prepend(str(scripts))
    monkeypatch.chdir(tmp_path)
    if name == "public_robot":
        pytest.importorskip("cmeel", reason="example-robot-data is not installed")
    # One report of those that report_runs writes shows that it does.
    arguments = SHORTER.get(name, ["--no-report", HOLD, "gain=4"])
    monkeypatch.setattr(sys, "argv", [f"{name}.py", str(tmp_path / "out"), *arguments])
    modules = set(sys.modules)
    try:
        runpy.run_path(str(scripts / f"{name}.py"), run_name="__main__")
    finally:
        for new in set(sys.modules) - modules:
            if str(scripts.parent) in str(getattr(sys.modules[new], "__file__", "")):
                del sys.modules[new]
    with Image.open(tmp_path / "out" / "picture.png") as picture:
        assert min(picture.size) > 200
    if name == "failure":
        assert "<html" in (tmp_path / "out" / "report.html").read_text()
    if name == "study":
        table = (tmp_path / "out" / "study" / "table.md").read_text()
        assert table.startswith("| delay (s) | gain (1/s) | runs | success |"), table


def test_the_page_shows_each_with_picture_time_and_one_command():
    scripts = {path.stem for path in (ROOT / "docs" / "gallery").glob("*.py")} - {"output"}
    assert scripts == set(gallery_page.NAMES) and len(scripts) == 18
    text = PAGE.read_text(encoding="utf-8")
    for name in gallery_page.NAMES:
        short, words = gallery_page.title(name)
        part = text.partition(f"## {short}\n")[2].partition("\n## ")[0]
        assert words in part and " s. [The script]" in part, f"run docs/gallery_page.py: {name}"
        assert part.count(f"python docs/gallery/{name}.py") == 1
        assert (ROOT / "docs" / "images" / f"gallery_{name}.png").is_file()
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "](docs/images/gallery.png)](docs/gallery.md)" in front
