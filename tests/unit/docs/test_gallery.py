"""The gallery's examples do what they say, and its page and the front page show them all."""

import os
import subprocess
import sys

import pytest
from blocks import ROOT
from PIL import Image

sys.path.append(str(ROOT / "docs"))

import gallery_page  # noqa: E402

PAGE = ROOT / "docs" / "gallery.md"


@pytest.mark.parametrize("name", gallery_page.NAMES)
def test_an_example_of_the_gallery(name, tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "gallery" / f"{name}.py"), str(tmp_path / "out")],
        capture_output=True, text=True, timeout=300, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    with Image.open(tmp_path / "out" / "picture.png") as picture:
        assert min(picture.size) > 200


def test_the_page_shows_each_with_picture_time_and_one_command():
    scripts = {path.stem for path in (ROOT / "docs" / "gallery").glob("*.py")} - {"keeping"}
    assert scripts == set(gallery_page.NAMES) and len(scripts) == 15
    text = PAGE.read_text(encoding="utf-8")
    for name in gallery_page.NAMES:
        short, words = gallery_page.title(name)
        part = text.partition(f"## {short}\n")[2].partition("\n## ")[0]
        assert words in part and " s. [The script]" in part, f"run docs/gallery_page.py: {name}"
        assert part.count(f"python docs/gallery/{name}.py") == 1
        assert (ROOT / "docs" / "images" / f"gallery_{name}.png").is_file()
    front = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "](docs/images/gallery.png)](docs/gallery.md)" in front
