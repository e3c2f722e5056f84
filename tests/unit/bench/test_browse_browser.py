"""The results browser in a real browser: filter, cell, run, report, at two widths."""

import os
import shutil
from pathlib import Path

import pandas as pd
import pytest
from made_study import made_study, write_chunk
from statsmodels.stats.proportion import proportion_confint

from aras_visual_servo_bench import run_study
from aras_visual_servo_bench.web.browse.server import serve

SIZES = (1440, 390)
HOSTILE = "<img src=x onerror='window.hit=1'>"
GRID = {"vary": {"delay": [0.015, 0.1, 0.2, 0.3], "gain": [1.0, 2.0, 4.0, 8.0]}}
READY = ("window.arasBrowser && arasBrowser.page.rows.length > 0 "
         "&& !document.body.hasAttribute('aria-busy')")  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study that was run, one with made-up rows, and one of a hostile name and hostile words."""
    path = tmp_path_factory.mktemp("results")
    run_study({"experiment": {"plant": "free", "duration": 0.4, "lag": 0.0},
               "vary": {"gain": [2.0, 4.0]}}, path / "run", progress=False)  # fmt: skip
    made_study(path / "made", experiment={"plant": "free"}, repeats=10, **GRID)
    named = {"scheme": [{"name": HOSTILE}, {"name": "points"}]}
    made_study(path / HOSTILE.replace("/", ""), experiment={"plant": "free"}, cases=named)
    return path


@pytest.fixture(scope="module")
def served(folder):
    found = serve([folder], "127.0.0.1", 20300 + os.getpid() % 1000, say=lambda _: None)
    yield found
    found.close()


@pytest.fixture
def page(request, watched, served):
    tab = watched(served.access.address, getattr(request, "param", SIZES[0]), READY)
    yield tab
    assert tab.js("[wrong, window.hit]") == [[], None]
    tab.close()


def only(tab, name):
    tab.js(f"""all("#studies button").filter((b) => b.firstChild.textContent !== {name!r}
        && b.getAttribute("aria-pressed") === "true").forEach((b) => b.click())""")
    settle(tab)


def settle(tab):
    tab.js("new Promise((go) => setTimeout(go, 50))")
    tab.wait(READY.replace("arasBrowser.page.rows.length > 0", "true"))


def choose(tab, **values):
    for name, value in values.items():
        field = f"one({'#' + name.replace('_', '-')!r})"
        tab.js(f"{field}.value = {value!r}; {field}.dispatchEvent(new Event('change'))")


def add_filter(tab, column, operator, value):
    choose(tab, column=column, operator=operator, value=value)
    press(tab, "#filter button")
    settle(tab)


def press(tab, selector, at=0):
    tab.js(f"all({selector!r})[{at}].click()")


def wait_for_count(tab, text):
    tab.wait(f"one('#run-count').textContent.startsWith({text!r})")


@pytest.mark.parametrize("page", SIZES, indirect=True)
def test_a_filter_a_cell_and_a_run(page):
    only(page, "made")
    wait_for_count(page, "160 runs of 1 study")
    add_filter(page, "gain", "≥", "2")
    wait_for_count(page, "120 of 160 runs")
    assert page.js("one('#filters button').innerText").startswith("gain ≥ 2 1")
    cells = page.js("all('#cells button').map((b) => [b.title, b.textContent])")
    assert len(cells) == 12 and "100%" in [text for _, text in cells]
    (at,) = [i for i, (title, _) in enumerate(cells) if title.startswith("delay 0.3, gain 8:")]
    assert cells[at][0] == "delay 0.3, gain 8: success 0 %, 10 runs"
    press(page, "#cells button", at)
    wait_for_count(page, "10 of 160 runs")
    assert page.js("all('#rows .end').map((e) => e.textContent)") == ["oscillating"] * 10
    press(page, "#rows tbody button")
    page.wait("!one('#run').hidden")
    text = page.js("one('#run').innerText")
    assert "Reason:" in text and "Remedy: lower the gain" in text and "goal_missed" in text
    press(page, "#filters button:last-child")  # all of them
    wait_for_count(page, "160 runs")


def test_the_report_of_a_run_is_computed_and_shown(page, watched, folder):
    only(page, "run")
    page.wait("all('#rows tbody tr').length === 2")
    press(page, "#rows tbody tr", 1)
    page.wait("!one('#run').hidden")
    shutil.rmtree(folder / "run" / "show-1", ignore_errors=True)
    tab = watched(page.js("one('#run a').href"), SIZES[0],
                  "one('#waiting')?.textContent.includes('Repeating the run')")  # fmt: skip
    tab.wait("!!window.arasReport", 90.0)
    assert tab.js("one('h1').textContent").startswith("moments, plant free")
    assert tab.js("one('.meta').textContent").startswith("run:1 · ")
    assert tab.js("arasReport.charts.length") > 3
    tab.close()
    text = (folder / "run" / "show-1" / "report.html").read_text()
    assert "differs from the stored result" not in text


def test_distances_are_filtered_in_the_unit_that_is_shown(page, folder):
    only(page, "made")
    table = pd.read_parquet(folder / "made" / "parts")
    middle = table.final_distance.median()
    texts = page.js("all('#column option').map((o) => o.text)")
    assert texts.count("final_distance (mm)") == 1
    add_filter(page, "final_distance", "≤", f"{1e3 * middle:.6f}")
    wait_for_count(page, f"{(table.final_distance <= middle + 1e-9).sum()} of 160 runs")
    chip = page.js("one('#filters button').innerText")
    assert chip.startswith("final_distance ≤ ") and " mm" in chip
    assert float(chip.split()[2]) == pytest.approx(1e3 * middle, rel=1e-3)
    shown = page.js("""(() => { const at = all("#rows th").findIndex((h) =>
        h.innerText.startsWith("final_distance (mm)"));
        return all("#rows tbody tr").map((r) => [+r.dataset.run, +r.cells[at].innerText]); })()""")
    known = table.set_index("run").final_distance
    assert [v for _, v in shown] == pytest.approx([1e3 * known[run] for run, _ in shown], rel=1e-2)
    press(page, "#rows tbody tr")
    page.wait("!one('#run').hidden")
    rows = page.js("all('#run tr').map((r) => r.innerText.split(/\\s+/))")
    (found,) = (row for row in rows if row[0] == "final_distance")
    assert found[2] == "mm" and float(found[1]) == pytest.approx(shown[0][1], rel=1e-2)


def place_points(page):
    """Show the chart of points, and return the left, top, width and height of its area, px."""
    page.js("one('#points').scrollIntoView({block: 'center'})")
    settle(page)
    return page.js("(({x, y, width, height}) => [x, y, width, height])"
                   "(arasBrowser.points.plot.over.getBoundingClientRect())")  # fmt: skip


def test_points_are_pressed_and_boxed(page):
    only(page, "made")
    x, y, *_ = place_points(page)
    at = page.js("""(() => { const p = arasBrowser.points, u = p.plot, k = devicePixelRatio;
        return [(p.px[7] - u.bbox.left) / k, (p.py[7] - u.bbox.top) / k]; })()""")
    at = x + at[0], y + at[1]
    page.mouse("Moved", *at)
    page.wait("one('#point').textContent.includes('made, run ')")
    page.mouse("Pressed", *at)
    page.mouse("Released", *at)
    page.wait("!one('#run').hidden")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape", code="Escape")
    page.wait("one('#run').hidden")
    x, y, width, height = place_points(page)
    page.mouse("Pressed", x + 0.6 * width, y + 2)
    page.mouse("Moved", x + 0.8 * width, y + 0.5 * height, held=True)
    page.mouse("Moved", x + 0.99 * width, y + height - 2, held=True)
    page.mouse("Released", x + 0.99 * width, y + height - 2)
    page.wait("arasBrowser.view.filters.length === 4")
    wait_for_count(page, "80 of 160 runs")  # delays of 0.2 and 0.3


def test_columns_sort_group_and_hide(page, folder):
    only(page, "made")
    header = "all('#rows th').find((h) => h.innerText.startsWith('final_distance'))"
    for order, worse in (("ascending", "<="), ("descending", ">=")):
        page.js(f"{header}.firstChild.click()")
        settle(page)
        assert page.js(f"{header}.getAttribute('aria-sort')") == order
        at = page.js(f"{header}.cellIndex")
        assert page.js(f"all('#rows tbody tr').map((r) => +r.cells[{at}].innerText).every("
                       f"(v, i, values) => !i || values[i - 1] {worse} v)")  # fmt: skip
    choose(page, by_0="gain", by_1="")
    settle(page)
    page.wait("all('#group-table tbody tr').length === 4")
    table = pd.read_parquet(folder / "made" / "parts")
    head, *rows = page.js(
        "all('#group-table tr').map((r) => [...r.cells].map((c) => c.innerText))")
    assert head[:4] == ["gain (1/s)", "runs", "success (%)", "95 % interval"]
    at = head.index("final_distance (mm)")
    for cells, (gain, group) in zip(rows, table.groupby("gain"), strict=True):
        assert [float(cells[0]), int(cells[1])] == [gain, len(group)]
        wilson = proportion_confint(group.success.sum(), len(group), method="wilson")
        told = [float(text) for text in (cells[2], *cells[3].split(" – "))]
        wanted = [100 * part for part in (group.success.mean(), *wilson)]
        assert told == pytest.approx(wanted, abs=0.501), cells
        assert float(cells[at]) == pytest.approx(1e3 * group.final_distance.median(), rel=6e-3)
    press(page, "#group-table tbody tr", 3)
    wait_for_count(page, "40 of 160 runs")
    page.js("""all("#columns label").find((l) => l.textContent === " final_distance")
        .firstChild.click()""")
    assert not page.js(f"!!{header}")
    page.call("Page.reload")  # what was chosen is in the address
    page.wait(READY)
    wait_for_count(page, "40 of 160 runs")
    assert not page.js(f"!!{header}")


def test_two_studies_are_compared(page):
    choose(page, first="made", second="run")
    press(page, "#chance")
    press(page, "#pair button")
    page.wait("all('#differences tbody tr').length > 3", 60.0)
    assert page.js("/ significant difference/.test(one('#comparison').textContent)")


def test_what_is_wrong_is_said_and_a_study_that_grows_and_goes_is_followed(page, folder):
    add_filter(page, "gain", "=", "much")
    assert page.js("one('#error').textContent") == "gain = needs a number"
    add_filter(page, "gain", "=", "2")
    assert page.js("one('#error').hidden")
    wait_for_count(page, "41 of 164 runs")
    grows = made_study(folder / "grows", range(1), experiment={"plant": "free"}, repeats=10, **GRID)
    try:
        page.wait("/grows\\s*4 of 160/.test(one('#studies').innerText)")
        write_chunk(grows, 1)
        page.wait("/grows\\s*8 of 160/.test(one('#studies').innerText)")
    finally:
        shutil.rmtree(folder / "grows")
    page.wait("one('#error').textContent.includes('grows was removed')")
    add_filter(page, "gain", "≥", "2")
    wait_for_count(page, "41 of 164 runs")


@pytest.mark.parametrize(("width", "theme"), [(SIZES[0], "Light"), (SIZES[1], "Dark")])
def test_nothing_hinders_readers_nor_sticks_out(watched, served, width, theme):
    tab = watched(served.access.address, width, READY)
    tab.js(f"one('#theme').textContent === '{theme}' && one('#theme').click()")
    settle(tab)
    tab.js("one('details').open = true")
    press(tab, "#pair button")
    for run in (False, True):
        tab.js(f"one('{'#rows tbody tr' if run else '#run button'}')?.click()")
        tab.wait(f"one('#run').hidden !== {str(run).lower()}")
        settle(tab)
        assert tab.js("document.documentElement.scrollWidth") == width
        assert tab.audit() == []
        if keep := os.environ.get("ARAS_SCREENSHOTS"):
            name = f"browse_{width}_{theme}_{'run' if run else 'all'}.png"
            Path(keep, name).write_bytes(tab.screenshot())
    assert tab.js("[wrong, window.hit]") == [[], None]
    tab.close()


@pytest.mark.parametrize("page", [SIZES[1]], indirect=True)
def test_the_outcome_is_on_a_narrow_screen_and_the_reason_is_complete(page):
    only(page, "made")
    add_filter(page, "outcome", "=", "oscillating")
    left, right = page.js("(({left, right}) => [left, right])"
                          "(one('#rows tbody .end').getBoundingClientRect())")  # fmt: skip
    assert left >= 0 and right <= SIZES[1]
    cells = page.js("all('#rows td.long').filter((c) => c.innerText !== '–')"
                    ".map((c) => [c.scrollWidth, c.clientWidth, c.clientHeight])")  # fmt: skip
    assert all(content <= width for content, width, _ in cells)
    assert max(height for *_, height in cells) > 40  # a long reason has several lines


def test_a_program_that_has_ended_is_said(watched, folder):
    own = serve([folder], "127.0.0.1", 21300 + os.getpid() % 1000, say=lambda _: None)
    tab = watched(own.access.address, SIZES[0], READY)
    own.close()
    tab.wait("one('#error').textContent.includes('has ended')")
    tab.close()
