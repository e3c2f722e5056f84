"""The palette: legible contrast, and no colours outside it."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from aras_visual_servo_bench.plots import palette
from aras_visual_servo_bench.plots.palette import (
    LIVE,
    LIVE_LIGHT,
    REPORT,
    REPORT_DARK,
    choose_text_colour,
    contrast_ratio,
    to_rgb,
)

BENCH = Path(palette.__file__).parents[1]
WHITE = "#ffffff"
PAIRS = [
    *((letters, ground) for letters in (palette.INK, palette.SOFT_INK, palette.GOOD, palette.BAD,
                                        palette.WARN) for ground in (WHITE, palette.GROUND)),
    *((report[letters], report[ground]) for report in (REPORT, REPORT_DARK)
      for letters, grounds in (
          ("badge", ("good", "bad", "warn", "soft")), ("ink", ("bad-ground", "warn-ground")),
          *((name, ("box", "ground")) for name in ("ink", "soft", "good", "bad", "warn", "mark")),
      ) for ground in grounds),
    *((live[name], live[ground]) for live in (LIVE, LIVE_LIGHT)
      for name in ("text", "quiet", "label", "message", "address", "red")
      for ground in ("back", "box")),
    *((live["text"], live[ground]) for live in (LIVE, LIVE_LIGHT)
      for ground in ("line", "well", "button", "over")),
    *((live["white"], live[ground]) for live in (LIVE, LIVE_LIGHT) for ground in ("active", "bad")),
    *((colour, LIVE["box"]) for colour in palette.LIVE_CURVES)]  # fmt: skip


def test_letters_and_marks_stand_out_from_what_is_behind_them():
    marks = [(live[mark], live[ground]) for live in (LIVE, LIVE_LIGHT)
             for mark in ("ok", "caution", "red", "address", "edge") for ground in ("back", "box")]
    for pairs, least in ((PAIRS, 4.5), (marks, 3.0)):
        for letters, ground in pairs:
            assert contrast_ratio(to_rgb(letters), to_rgb(ground)) >= least, (letters, ground)


def test_contrast_is_that_of_wcag():
    assert contrast_ratio(to_rgb("#000000"), to_rgb(WHITE)) == pytest.approx(21.0)
    assert contrast_ratio(to_rgb("#0000ff"), to_rgb(WHITE)) == pytest.approx(8.59, abs=0.01)
    assert contrast_ratio(to_rgb("#777777"), to_rgb(WHITE)) == pytest.approx(4.48, abs=0.01)
    assert to_rgb("#3366ff") == (0.2, 0.4, 1.0)


@pytest.mark.parametrize("name", ["viridis", "RdBu_r"])
def test_letters_on_a_map_can_be_read_on_each_of_its_colours(name):
    for colour in plt.get_cmap(name)(np.linspace(0.0, 1.0, 101)):
        assert contrast_ratio(to_rgb(choose_text_colour(colour)), colour) >= 4.5


def test_colours_stand_in_the_palette_alone():
    paths = [path for folder in ("plots", "visualization", "web")
             for path in (BENCH / folder).rglob("*")
             if path.suffix in (".py", ".js", ".css", ".html") and path.name != "palette.py"]
    assert len(paths) > 60
    for path in paths:
        assert not re.findall(r"#[0-9a-f]{3,8}\b|rgba?\(\d", path.read_text(encoding="utf-8")), path


def test_what_the_page_asks_for_is_in_the_palette():
    page = BENCH / "web" / "live" / "page"
    asked = set(re.findall(r"var\(--([\w-]+)\)", (page / "style.css").read_text())) - {"mark"}
    plots = (page / "plots.js").read_text()
    asked |= set(re.findall(r'colour\("([\w-]+)"\)', plots))
    assert "colour(`curve-${i % 8}`)" in plots and {"quiet", "grid"} <= asked
    asked |= {f"curve-{i}" for i in range(8)}
    assert asked <= set(LIVE) == set(LIVE_LIGHT) and len(palette.LIVE_CURVES) == 8
    shared = BENCH / "web" / "page"
    asked = set(re.findall(r"var\(--([\w-]+)\)", (shared / "style.css").read_text())) - {"shade"}
    for script in (shared / "charts.js", *(BENCH / "web" / "report" / "page").glob("*.js")):
        asked |= set(re.findall(r'colour\("([\w-]+)"\)', script.read_text()))
    asked |= {f"curve-{i}" for i in range(8)}
    assert asked <= set(REPORT) and set(REPORT) == set(REPORT_DARK)
