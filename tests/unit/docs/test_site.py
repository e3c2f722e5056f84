"""The documentation site is built whole, offline, with warnings as errors."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from blocks import PAGES, ROOT

sys.path.append(str(ROOT / "docs"))

import make_site  # noqa: E402


@pytest.mark.filterwarnings("ignore:'myst_parser")  # it uses what the next Sphinx will not have
def test_the_site_is_built_whole(tmp_path, monkeypatch, capsys):
    """One test, as each process of several would build it again."""
    monkeypatch.setattr(sys, "path", list(sys.path))  # docs/conf.py extends it
    monkeypatch.setenv("LC_ALL", "C")  # Sphinx sets the locale of the process
    status = make_site.main(["--fresh", "--out", str(tmp_path)])
    assert status == 0, f"a warning is an error:\n{capsys.readouterr().err[-3000:]}"
    every_page_is_there_and_in_the_contents(tmp_path)
    nothing_is_fetched_from_elsewhere(tmp_path)
    docstrings_are_shown_as_they_are_written(tmp_path)
    formulas_are_typeset_by_files_of_the_site(tmp_path)


def every_page_is_there_and_in_the_contents(site: Path) -> None:
    first = (site / "index.html").read_text(encoding="utf-8")
    for page in PAGES:
        name = page.relative_to(ROOT).with_suffix(".html")
        if name.parts[0] == "src" and "upstream" in name.parts[1]:
            continue
        assert (site / name).is_file(), f"{page} is in no chapter of docs/conf.py"
        assert name.name == "README.html" and len(name.parts) == 1 or f'href="{name}"' in first


def nothing_is_fetched_from_elsewhere(site: Path) -> None:
    """A page opened without a network looks as with one."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|link|img)\b[^>]*(?:src|href)="https?:[^"]*"', text), page


def docstrings_are_shown_as_they_are_written(site: Path) -> None:
    text = (site / "docs" / "api" / "bench.html").read_text(encoding="utf-8")
    shown = re.sub(r"<[^>]+>", "", text)
    # fields, each on its own line, and an error with its condition
    assert "height: minimum and maximum height of the camera above the target, m." in shown
    assert "side: maximum offset of the camera" in shown and "problematic" not in text
    assert "Raises" in shown and "ExperimentError: the experiment cannot be run" in shown


def formulas_are_typeset_by_files_of_the_site(site: Path) -> None:
    page = site / "docs" / "moments.html"
    text = page.read_text(encoding="utf-8")
    files = re.findall(r'(?:src|href)="([^"]*(?:katex|math)[^"?]*\.(?:js|css))', text)
    assert {Path(file).name for file in files} == {"katex.min.js", "katex.min.css", "math.js"}
    assert all((page.parent / file).is_file() for file in files)
    assert list((site / "_static" / "katex" / "fonts").glob("*.woff2"))
    assert text.count('class="math ') > 50 and "$$" not in text
    assert "katex" not in (site / "docs" / "topics.html").read_text(encoding="utf-8")
