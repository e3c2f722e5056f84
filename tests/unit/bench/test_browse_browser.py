"""The results browser in a real browser: filter, cell, run, report, at two widths."""

import os
import shutil
from pathlib import Path

import pandas as pd
import pytest
import yaml
from made_study import made_study, write_chunk
from statsmodels.stats.proportion import proportion_confint

from aras_visual_servo_bench.studies.pools import InProcessPool
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_execution import run_missing
from aras_visual_servo_bench.studies.study_folder import StudyFolder
from aras_visual_servo_bench.web.browse.server import serve

SIZES = (1440, 390)
HOSTILE = "<img src=x onerror='window.hit=1'>"
GRID = {"vary": {"delay": [0.015, 0.1, 0.2, 0.3], "gain": [1.0, 2.0, 4.0, 8.0]}}
READY = ("window.arasBrowser && arasBrowser.page.rows.length > 0 "
         "&& !document.body.hasAttribute('aria-busy')")  # fmt: skip
COUNTED = "document.getElementById('run-count').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study that was run, one with made-up rows, and one of a hostile name and hostile words."""
    path = tmp_path_factory.mktemp("results")
    study = Study.from_mapping({
        "experiment": {"plant": "free", "duration": 0.4, "lag": 0.0}, "vary": {"gain": [2.0, 4.0]},
    })  # fmt: skip
    run = StudyFolder.create(path / "run", study, yaml.safe_dump(study.to_mapping()))
    run_missing(run, InProcessPool, None)
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
    tab.js("document.getElementById('studies')")
    yield tab
    assert tab.js("[wrong, window.hit]") == [[], None]
    tab.close()


def only(tab, name):
    """Leave one study alone."""
    tab.js(f"""for (const b of document.querySelectorAll("#studies button"))
        if (b.firstChild.textContent !== {name!r} && b.getAttribute("aria-pressed") === "true")
            b.click()""")
    settle(tab)


def settle(tab):
    tab.js("new Promise((go) => setTimeout(go, 50))")
    tab.wait(READY.replace("arasBrowser.page.rows.length > 0", "true"))


def add_filter(tab, column, operator, value):
    tab.js(f"""(() => {{ const $ = (id) => document.getElementById(id);
        $("column").value = {column!r}; $("column").dispatchEvent(new Event("change"));
        $("operator").value = {operator!r}; $("value").value = {value!r};
        document.querySelector("#filter button").click(); }})()""")
    settle(tab)


@pytest.mark.parametrize("page", SIZES, indirect=True)
def test_a_filter_a_cell_and_a_run(page, browser, served):
    only(page, "made")
    page.wait(f"{COUNTED}.startsWith('160 runs of 1 study')")
    add_filter(page, "gain", "≥", "2")
    page.wait(f"{COUNTED}.startsWith('120 of 160 runs')")
    assert page.js("document.querySelector('#filters button').innerText").startswith("gain ≥ 2 1")
    # The cell of delay 0.3 and gain 8 has no success.
    button = "[...document.querySelectorAll('#cells button')]"
    titles = page.js(f"{button}.map((b) => b.title)")
    assert "100%" in page.js(f"{button}.map((b) => b.textContent)")
    assert len(titles) == 12
    where = [t for t in titles if t.startswith("delay 0.3, gain 8:")]
    assert where == ["delay 0.3, gain 8: success 0 %, 10 runs"]
    page.js(f"{button}.find((b) => b.title === {where[0]!r}).click()")
    page.wait(f"{COUNTED}.startsWith('10 of 160 runs')")
    ends = page.js("[...document.querySelectorAll('#rows .end')].map((e) => e.textContent)")
    assert ends == ["oscillating"] * 10
    page.js("document.querySelector('#rows tbody button').click()")
    page.wait("!document.getElementById('run').hidden")
    text = page.js("document.getElementById('run').innerText")
    assert "Reason:" in text and "Remedy: lower the gain" in text and "goal_missed" in text
    page.js("document.querySelector('#filters button:last-child').click()")  # all of them
    page.wait(f"{COUNTED}.startsWith('160 runs')")


def test_the_report_of_a_run_is_computed_and_shown(page, browser, served, folder):
    only(page, "run")
    page.wait("document.querySelectorAll('#rows tbody tr').length === 2")
    page.js("document.querySelectorAll('#rows tbody tr')[1].click()")
    page.wait("!document.getElementById('run').hidden")
    address = page.js("document.querySelector('#run a').href")
    shutil.rmtree(folder / "run" / "show-1", ignore_errors=True)
    tab = browser.open(address)
    tab.wait("document.getElementById('waiting') "
             "&& document.body.innerText.includes('Repeating the run')")  # fmt: skip
    tab.wait("!!window.arasReport", 90.0)
    assert tab.js("document.querySelector('h1').textContent").startswith("moments, plant free")
    assert tab.js("document.querySelector('.meta').textContent").startswith("run:1 · ")
    assert tab.js("arasReport.charts.length") > 3
    tab.close()
    assert (folder / "run" / "show-1" / "report.html").is_file()


def test_distances_are_filtered_in_the_unit_that_is_shown(page, folder):
    only(page, "made")
    table = pd.read_parquet(folder / "made" / "parts")
    middle = table.final_distance.median()
    assert page.js("[...document.querySelectorAll('#column option')].map((o) => o.text)").count(
        "final_distance (mm)") == 1  # fmt: skip
    add_filter(page, "final_distance", "≤", f"{1e3 * middle:.6f}")
    count = (table.final_distance <= middle + 1e-9).sum()
    page.wait(f"{COUNTED}.startsWith('{count} of 160 runs')")
    chip = page.js("document.querySelector('#filters button').innerText")
    assert chip.startswith("final_distance ≤ ") and " mm" in chip
    assert float(chip.split()[2]) == pytest.approx(1e3 * middle, rel=1e-3)
    shown = page.js("""(() => { const head = [...document.querySelectorAll("#rows th")];
        const at = head.findIndex((h) => h.innerText.startsWith("final_distance (mm)"));
        return [...document.querySelectorAll("#rows tbody tr")]
            .map((r) => [+r.dataset.run, +r.cells[at].innerText]); })()""")
    known = table.set_index("run").final_distance
    assert [v for _, v in shown] == pytest.approx([1e3 * known[run] for run, _ in shown], rel=1e-2)
    page.js("document.querySelector('#rows tbody button').click()")
    page.wait("!document.getElementById('run').hidden")
    run, distance = shown[0]
    rows = page.js("""[...document.querySelectorAll("#run tr")]
        .map((r) => r.innerText.split(/\\s+/))""")
    (found,) = (row for row in rows if row[0] == "final_distance")
    assert found[2] == "mm" and float(found[1]) == pytest.approx(distance, rel=1e-2)


def test_points_are_pressed_and_boxed(page):
    only(page, "made")
    page.js("document.getElementById('points').scrollIntoView({block: 'center'})")
    x, y, width, height = page.js("""(() => { const r = arasBrowser.points.plot.over
        .getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()""")
    at = page.js("""(() => { const p = arasBrowser.points, u = p.plot, k = devicePixelRatio;
        return [(p.px[7] - u.bbox.left) / k, (p.py[7] - u.bbox.top) / k]; })()""")
    page.mouse("Moved", x + at[0], y + at[1])
    page.wait("document.getElementById('point').textContent.includes('made, run ')")
    page.mouse("Pressed", x + at[0], y + at[1])
    page.mouse("Released", x + at[0], y + at[1])
    page.wait("!document.getElementById('run').hidden")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape", code="Escape")
    page.wait("document.getElementById('run').hidden")
    page.js("document.getElementById('points').scrollIntoView({block: 'center'})")
    settle(page)
    x, y, width, height = page.js("""(() => { const r = arasBrowser.points.plot.over
        .getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()""")
    page.mouse("Pressed", x + 0.6 * width, y + 2)
    page.mouse("Moved", x + 0.8 * width, y + 0.5 * height, held=True)
    page.mouse("Moved", x + 0.99 * width, y + height - 2, held=True)
    page.mouse("Released", x + 0.99 * width, y + height - 2)
    page.wait("arasBrowser.view.filters.length === 4")
    settle(page)
    page.wait(f"{COUNTED}.startsWith('80 of 160 runs')")  # delays of 0.2 and 0.3


def check_groups(page, folder):
    """The table of groups by gain, recomputed from the rows."""
    table = pd.read_parquet(folder / "made" / "parts")
    head, *rows = page.js("[...document.querySelectorAll('#group-table tr')].map((r) => "
                          "[...r.cells].map((c) => c.innerText))")  # fmt: skip
    assert head[:4] == ["gain (1/s)", "runs", "success (%)", "95 % interval"]
    at = head.index("final_distance (mm)")
    for cells, (gain, group) in zip(rows, table.groupby("gain"), strict=True):
        assert [float(cells[0]), int(cells[1])] == [gain, len(group)]
        assert abs(float(cells[2]) - 100 * group.success.mean()) <= 0.5
        wilson = proportion_confint(group.success.sum(), len(group), method="wilson")
        told = [float(text) for text in cells[3].split(" – ")]
        assert told == pytest.approx([100 * end for end in wilson], abs=0.501), cells
        assert float(cells[at]) == pytest.approx(1e3 * group.final_distance.median(), rel=6e-3)


def test_columns_sort_group_and_hide(page, folder):
    only(page, "made")
    header = "[...document.querySelectorAll('#rows th')].find((h) => h.innerText.startsWith('{}'))"
    for order, worse in (("ascending", "<="), ("descending", ">=")):
        page.js(f"{header.format('final_distance')}.firstChild.click()")
        settle(page)
        assert page.js(f"{header.format('final_distance')}.getAttribute('aria-sort')") == order
        at = page.js(f"{header.format('final_distance')}.cellIndex")
        assert page.js(f"[...document.querySelectorAll('#rows tbody tr')].every((r, i, all) => !i "
                       f"|| +all[i - 1].cells[{at}].innerText {worse} +r.cells[{at}].innerText)")
    page.js("""(() => { const s = document.getElementById("by-0"); s.value = "gain";
        s.dispatchEvent(new Event("change")); const t = document.getElementById("by-1");
        t.value = ""; t.dispatchEvent(new Event("change")); })()""")
    settle(page)
    page.wait("document.querySelectorAll('#group-table tbody tr').length === 4")
    check_groups(page, folder)
    page.js("document.querySelectorAll('#group-table tbody tr')[3].click()")
    page.wait(f"{COUNTED}.startsWith('40 of 160 runs')")
    page.js("""[...document.querySelectorAll("#columns label")]
        .find((l) => l.textContent === " final_distance").firstChild.click()""")
    assert not page.js(f"!!{header.format('final_distance')}")
    page.call("Page.reload")  # what was chosen is in the address
    page.wait(READY)
    page.wait(f"{COUNTED}.startsWith('40 of 160 runs')")
    assert not page.js(f"!!{header.format('final_distance')}")


def test_two_studies_are_compared(page):
    page.js("""(() => { const $ = (id) => document.getElementById(id); $("first").value = "made";
        $("second").value = "run"; $("chance").checked = true;
        document.querySelector("#pair button").click(); })()""")
    page.wait("document.querySelectorAll('#differences tbody tr').length > 3", 60.0)
    assert "comparisons show a significant difference" in page.js(
        "document.getElementById('comparison').textContent")  # fmt: skip


def test_what_is_wrong_is_said_and_the_page_goes_on(page, folder):
    add_filter(page, "gain", "=", "much")
    assert page.js("document.getElementById('error').textContent") == "gain = needs a number"
    add_filter(page, "gain", "=", "2")
    assert page.js("document.getElementById('error').hidden")
    assert page.js(f"{COUNTED}").startswith("41 of 164 runs")


def test_a_study_that_appears_grows_and_goes_is_followed(page, folder):
    grows = made_study(folder / "grows", range(1), experiment={"plant": "free"}, repeats=10, **GRID)
    names = "document.getElementById('studies').innerText"
    try:
        page.wait(f"/grows\\s*4 of 160/.test({names})")
        write_chunk(grows, 1)
        page.wait(f"/grows\\s*8 of 160/.test({names})")
    finally:
        shutil.rmtree(folder / "grows")
    page.wait("document.getElementById('error').textContent.includes('grows was removed')")
    add_filter(page, "gain", "≥", "2")
    assert "of 164 runs" in page.js(COUNTED)


@pytest.mark.parametrize(("width", "theme"), [(SIZES[0], "Light"), (SIZES[1], "Dark")])
def test_nothing_hinders_readers_nor_sticks_out(watched, served, width, theme):
    tab = watched(served.access.address, width, READY)
    tab.js(f"document.getElementById('theme').textContent === '{theme}' "
           "&& document.getElementById('theme').click()")  # fmt: skip
    settle(tab)
    tab.js("document.querySelector('details').open = true")
    tab.js("document.querySelector('#pair button').click()")
    for run in (False, True):
        pressed = "#rows tbody tr" if run else "#run button"
        tab.js(f"document.querySelector('{pressed}')?.click()")
        tab.wait(f"document.getElementById('run').hidden !== {str(run).lower()}")
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
    box = "document.querySelector('#rows tbody .end').getBoundingClientRect()"
    assert page.js(f"{box}.left") >= 0 and page.js(f"{box}.right") <= SIZES[1]
    cells = "[...document.querySelectorAll('#rows td.long')].filter((c) => c.innerText !== '–')"
    assert page.js(f"{cells}.length") > 0
    assert page.js(f"{cells}.every((c) => c.scrollWidth <= c.clientWidth)")
    assert page.js(f"{cells}.some((c) => c.clientHeight > 40)")  # a long reason has several lines


def test_what_is_said_instead_of_a_report_can_be_read(watched, served):
    address = served.access.address.replace("/?", f"/run?study={'x' * 150}&run=1&")
    tab = watched(address, SIZES[1], "document.readyState === 'complete' && !!window.waiting")
    assert "there is no study" in tab.js("document.body.innerText")
    assert tab.js("document.documentElement.scrollWidth") == SIZES[1]
    assert tab.audit() == []
    tab.close()


def test_a_program_that_has_ended_is_said(watched, folder):
    own = serve([folder], "127.0.0.1", 21300 + os.getpid() % 1000, say=lambda _: None)
    tab = watched(own.access.address, 1440, READY)
    own.close()
    tab.wait("document.getElementById('error').textContent.includes('has ended')")
    tab.close()
