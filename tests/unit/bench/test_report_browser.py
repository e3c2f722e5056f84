"""Report in a real browser: zoom, scrubbing, hidden runs, two window widths."""

import json
from dataclasses import replace

import pytest
from long_run import make_long_run

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.studies.replay import run_with_images
from aras_visual_servo_bench.web.report.write import write_report

SIZES = (1440, 390)
HOSTILE = "<img src=x onerror='window.hit=1'>"
READY = "!!window.arasReport"


@pytest.fixture(scope="module")
def runs():
    asked = Experiment(plant="chain", start="2016", duration=2.0, time_after_convergence=None)
    slow = run_with_images(asked.with_changes(gain=2.0), "slow")
    return [run_with_images(asked, "quick"), replace(slow, name=f"slow {HOSTILE}")]


@pytest.fixture(scope="module")
def opened(watched, runs, tmp_path_factory):
    """A tab with the report of 1, 2 or 12 runs, of which some failed, in a window so wide."""
    lost = replace(runs[0], name="lost", outcome="target_lost", reason="over the left border",
                   remedy="begin nearer", notes=["the bag was cut off"],
                   verdict=replace(runs[0].verdict, name="goal_missed"))  # fmt: skip
    open_ = replace(runs[0], name="open", outcome="converged up to 0.6 mm", reason="noise")
    all_ = [*runs, lost, open_, *(replace(runs[i % 2], name=f"more {i}") for i in range(8))]
    pages = {count: write_report(all_[:count], tmp_path_factory.mktemp("report"), ())[0]
             for count in (1, 2, 12)}  # fmt: skip
    return lambda count, width: watched(pages[count].as_uri(), width, READY)


@pytest.fixture
def page(request, opened):
    tab = opened(1, getattr(request, "param", SIZES[0]))
    yield tab
    assert tab.js("wrong") == []
    tab.close()


@pytest.fixture
def both(opened):
    tab = opened(2, SIZES[0])
    yield tab
    assert tab.js("wrong") == [] and tab.js("window.hit") is None
    tab.close()


def over(tab, chart=0):
    """Place and size (x, y, width, height) of a chart's plot in the window, scrolled to."""
    tab.js(f"arasReport.charts[{chart}].box.scrollIntoView({{block: 'center'}})")
    tab.wait(f"!!arasReport.charts[{chart}].plot")
    return tab.js(f"""(() => {{ const r = arasReport.charts[{chart}].plot.over
        .getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; }})()""")


def test_a_chart_is_zoomed_by_dragging_and_all_others_with_it(page, runs):
    end = page.js("arasReport.page.contents.end")
    assert end == pytest.approx(runs[0].time[-1])
    x, y, width, height = over(page)
    page.mouse("Moved", x + 0.25 * width, y + 0.5 * height)
    page.mouse("Pressed", x + 0.25 * width, y + 0.5 * height)
    page.mouse("Moved", x + 0.6 * width, y + 0.5 * height, held=True)
    page.mouse("Released", x + 0.6 * width, y + 0.5 * height)
    page.wait(f"arasReport.page.range[1] < {0.9 * end}")
    low, high = page.js("arasReport.page.range")
    assert (low, high) == pytest.approx((0.25 * end, 0.6 * end), abs=0.02 * end)
    shown = page.js("arasReport.charts.filter((c) => c.plot)"
                    ".map((c) => [c.plot.scales.x.min, c.plot.scales.x.max])")  # fmt: skip
    assert len(shown) > 1 and all(pair == pytest.approx([low, high]) for pair in shown)
    page.js("document.getElementById('zoom-in').click()")
    assert page.js("arasReport.page.range[1] - arasReport.page.range[0]") == pytest.approx(
        0.5 * (high - low))  # fmt: skip
    page.js("document.getElementById('zoom-all').click()")
    assert page.js("arasReport.page.range") == [0, pytest.approx(end)]


@pytest.mark.parametrize("page", SIZES, indirect=True)
def test_one_cursor_goes_through_all_curves_film_path_and_words(page, runs):
    (run, _), told = runs, "document.getElementById"
    camera = "JSON.stringify(arasReport.space.scene.shapes['0 camera edges'].points)"
    before = page.js(camera)
    x, y, width, height = over(page)
    page.mouse("Moved", x + 0.31 * width, y + 0.4 * height)
    page.wait("arasReport.page.time > 0")
    time = page.js("arasReport.page.time")
    assert time == pytest.approx(0.31 * run.time[-1], rel=0.02)
    page.wait(f"{told}('now').textContent === '{time:.3f} s'")
    lefts = page.js("""arasReport.charts.filter((c) => c.isVisible).map(
        (c) => c.plot.posToVal(c.plot.cursor.left, "x"))""")
    assert len(lefts) > 1 and lefts == pytest.approx([time] * len(lefts), abs=0.02)
    image = int(abs(run.time - time).argmin())
    value = page.js("arasReport.charts[0].entries[0].value.textContent")
    assert float(value) == pytest.approx(run.error[image, 0], rel=2e-3)
    page.wait(f"{told}('films').innerText.includes('image {image + 1} of {len(run.time)}')")
    edges = json.loads(page.js(camera))
    assert json.dumps(edges) != before
    joint = int(abs(run.joint_time - time).argmin())
    assert edges[:3] == pytest.approx(run.true_pose[joint, :3, 3], abs=1e-4)
    assert run.phases[image] in page.js(f"{told}('state').textContent")


def test_the_film_goes_on_image_by_image_by_button_key_and_slider(page, runs):
    frame = "arasReport.films[0].frame"
    page.js("arasReport.page.setTime(0.5)")
    page.wait(f"Math.abs(arasReport.films[0].time[{frame}] - 0.5) < 0.02")
    first = page.js(frame)
    page.js("document.getElementById('next-image').click()")
    page.wait(f"{frame} === {first + 1}")
    page.js("document.getElementById('time').focus()")
    for key in ("ArrowLeft", "ArrowLeft"):
        page.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
        page.js("new Promise(requestAnimationFrame)")
    page.wait(f"{frame} === {first - 1}")
    page.js("""(() => { const t = document.getElementById("time"); t.value = 1.25;
        t.dispatchEvent(new Event("input")); })()""")
    page.wait(f"Math.abs(arasReport.films[0].time[{frame}] - 1.25) < 0.02")
    ink = """(() => { const c = arasReport.films[0].canvas; const d = c.getContext("2d")
        .getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let i = 0; i < d.length; i += 4) if (d[i + 1] > d[i] + 60) n++; return n; })()"""
    assert page.js(ink) > 20
    page.js("document.getElementById('overlay').click()")
    page.wait(f"{ink} === 0")
    page.wait("document.querySelectorAll('#strip button').length > 2")
    page.js("document.querySelectorAll('#strip button')[1].click()")
    page.wait("Math.abs(arasReport.page.time - arasReport.films[0].film.milestones[1]) < 1e-6")
    page.js("document.getElementById('play').click()")
    page.wait("arasReport.page.time > arasReport.films[0].film.milestones[1] + 0.2")
    page.js("document.getElementById('play').click()")


def test_a_run_is_switched_off_everywhere(both):
    assert both.js("document.querySelector('#runs button + button').textContent") == (
        f"slow {HOSTILE}")  # fmt: skip
    over(both)
    both.js("document.querySelector('#runs button + button').click()")
    drawn = "arasReport.charts[0].plot.series.slice(1).map((s) => s.show)"
    assert both.js(drawn) == [True, False]
    assert both.js("arasReport.films.map((f) => f.figure.hidden)") == [False, True]
    assert both.js("[...document.querySelectorAll('#comparison tr')].map((r) => r.cells[2].hidden)"
                   ".every(Boolean)")  # fmt: skip
    assert not both.js("Object.keys(arasReport.space.scene.shapes).some((k) => k[0] === '1')")
    both.js("document.querySelector('#runs button + button').click()")
    assert both.js(drawn) == [True, True]
    both.js("arasReport.charts[0].entries[0].button.click()")  # one curve alone
    assert both.js(drawn) == [False, True]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Page of a run of 8000 images and joint states, with one sample far from the others."""
    run = make_long_run(8000, 240.0)
    run.measured_velocities[3333, 0] = 50.0
    return write_report([run], tmp_path_factory.mktemp("bag"), ())[0]


def test_a_long_run_opens_at_its_settling_and_shows_the_whole_on_request(bag, watched):
    tab = watched(bag.as_uri(), SIZES[0], READY)
    label = "document.getElementById('{}').getAttribute('aria-pressed')"
    settled = tab.js("arasReport.page.contents.transient")
    assert 3.0 < settled < 10.0 and tab.js("arasReport.page.range") == [0, settled]
    assert tab.js("document.getElementById('shown').textContent").endswith(" of 240 s")
    assert [tab.js(label.format(f"zoom-{one}")) for one in ("settling", "all")] == ["true", "false"]
    tab.js("document.getElementById('zoom-all').click()")
    assert tab.js("arasReport.page.range") == [0, pytest.approx(240.0, abs=0.5)]
    tab.js("arasReport.page.setTime(200)")
    tab.js("document.getElementById('zoom-settling').click()")
    assert tab.js("arasReport.page.range") == [0, settled]
    assert tab.js("arasReport.page.time") == settled
    tab.js("arasReport.page.setTime(120)")  # the visible part follows the cursor
    assert tab.js("arasReport.page.range.map((t) => Math.abs(t - 120))") == pytest.approx(
        [0.5 * settled] * 2)  # fmt: skip
    for time, part in ((240.0, [240.0 - settled, 240.0]), (0.0, [0.0, settled])):
        tab.js(f"arasReport.page.setTime({time})")  # at its ends, the run is shown at this scale
        assert tab.js("arasReport.page.range") == pytest.approx(part, abs=0.5)
    assert tab.js("wrong") == []
    tab.close()


def test_a_long_run_draws_the_extremes_of_each_column(bag, watched):
    tab = watched(bag.as_uri(), SIZES[0], READY)
    tab.js("document.getElementById('zoom-all').click()")
    chart = tab.js("arasReport.charts.findIndex("
                   "(c) => c.curves.some((k) => k.values.includes(50)))")  # fmt: skip
    over(tab, chart)
    drawn = f"arasReport.charts[{chart}].plot.data"
    width = tab.js(f"arasReport.charts[{chart}].plotBox.clientWidth")
    assert tab.js(f"{drawn}[0].length") <= 3 * width
    assert tab.js(f"Math.max(...{drawn}.slice(1).flat().filter(Number.isFinite))") == 50.0
    at = tab.js(f"{drawn}[0][{drawn}.slice(1).map((c) => c.indexOf(50)).find((i) => i >= 0)]")
    curve = f"arasReport.charts[{chart}].curves.find((k) => k.values.includes(50))"
    assert at == pytest.approx(tab.js(f"{curve}.time[{curve}.values.indexOf(50)]"),
                               abs=240.0 / width)  # fmt: skip
    tab.close()


def test_of_many_runs_some_films_are_shown_and_the_tables_when_they_are_opened(opened):
    tab = opened(12, SIZES[0])
    shown = "arasReport.films.filter((f) => !f.figure.hidden).map((f) => f.number)"
    more = "document.getElementById('more-films')"
    assert tab.js(shown) == list(range(8))
    assert tab.js(f"{more}.textContent") == "Show the films of all 12 visible runs"
    tab.js("document.querySelectorAll('#runs button')[2].click()")
    assert tab.js(shown) == [0, 1, *range(3, 9)]
    tab.js(f"{more}.click()")
    assert tab.js(f"{shown}.length") == 11 and tab.js(f"{more}.hidden")
    tab.wait("arasReport.films[11].frame === 0")
    heights = tab.js("""[...document.querySelectorAll("#comparison tr")].filter((r) =>
        !r.querySelector(".long")).map((r) => r.getBoundingClientRect().height)""")
    assert len(heights) > 20 and max(heights) < 60  # each cell has one line
    details = "document.querySelectorAll('#numbers details')[1]"
    assert tab.js(f"{details}.querySelector('table')") is None
    tab.js(f"{details}.open = true")
    tab.wait(f"{details}.querySelectorAll('tr').length > 20")
    tab.js(f"{details}.querySelectorAll('fieldset input')[2].click()")
    assert tab.js(f"[...{details}.querySelectorAll('tr')].every((r) => r.cells[2].hidden)")
    assert tab.js("wrong") == [] and tab.js("window.hit") is None
    tab.close()


@pytest.mark.parametrize(
    ("count", "width", "theme"),
    [(1, 390, "Light"), (2, 1440, "Dark"), (12, 390, "Dark"), (12, 1920, "Light")])
def test_nothing_hinders_readers_nor_sticks_out_nor_is_fetched(opened, count, width, theme):
    tab = opened(count, width)
    tab.js(f"document.getElementById('theme').textContent === '{theme}' "
           "&& document.getElementById('theme').click()")  # fmt: skip
    tab.wait(f"document.getElementById('theme').textContent !== '{theme}'")
    assert tab.js("document.documentElement.scrollWidth") == width
    assert tab.audit() == []
    assert tab.js("performance.getEntriesByType('resource').filter("
                  "(e) => !/^(data|blob):/.test(e.name)).map((e) => e.name)") == []  # fmt: skip
    tab.close()


def test_the_live_page_serves_a_report_that_works(browser, server, reports, runs, tmp_path):
    """Its page allows no script that is not a file; a report carries its own."""
    page = write_report(runs[:1], tmp_path, ())[0]
    reports({"one/report.html": page}.get)
    tab = browser.open("about:blank")
    address = server.access.address
    tab.call("Page.navigate", url=address.replace("/?", "/report/one/report.html?") + "#at=0.5")
    tab.wait(READY)
    tab.wait("arasReport.films[0].frame > 5")
    over(tab)
    tab.wait("arasReport.charts[0].plot.cursor.left > 0")
    assert tab.js("getComputedStyle(document.querySelector('section')).borderRadius") == "10px"
    tab.close()
