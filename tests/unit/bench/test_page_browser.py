"""Live page in a real browser: it is drawn and updated, and sends requests."""

import json
import re
import time

import numpy as np
import pytest

from aras_visual_servo_bench.visualization.drawing_shapes import LINES, DrawingShape
from aras_visual_servo_bench.web.live.server import serve

COLOURS = """(() => {{ const c = document.querySelector("#{0} canvas, canvas#{0}");
  if (!c) return 0;
  const d = document.createElement("canvas"); d.width = c.width; d.height = c.height;
  const x = d.getContext("2d"); x.drawImage(c, 0, 0);
  const p = x.getImageData(0, 0, d.width, d.height).data, found = new Set();
  for (let i = 0; i < p.length; i += 4)
    found.add((p[i] >> 4) * 256 + (p[i + 1] >> 4) * 16 + (p[i + 2] >> 4));
  return found.size; }})()"""


#: The page says that a report has been under way for some seconds: a starved page skips some.
REPORTS = """/^Report: [1-9][0-9]* s$/.test(document.getElementById('running').textContent)"""


@pytest.fixture(scope="module")
def page(browser, server, host):
    tab = browser.open(server.access.address)
    tab.wait("window.arasPage && arasPage.scene && arasPage.scene.meshes.length > 5")
    for _ in range(40):
        host.move()
    tab.wait("arasPage.state.samples.length >= 41")
    return tab


def wait_until(is_true):
    end = time.monotonic() + 30.0
    while not is_true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_all_is_drawn(page):
    page.wait(f"({COLOURS.format('scene')}) > 40")
    page.wait(f"({COLOURS.format('image')}) > 2")
    page.wait(f"({COLOURS.format('plot-error')}) > 4")
    # WebGL refuses to draw while any enabled array lies in a deleted buffer.
    assert page.js("""(() => { const { scene } = arasPage; scene.draw();
        scene.setShapes({}, true); scene.gl.getError(); scene.draw();
        return scene.gl.getError(); })()""") == 0
    page.call("Page.reload")  # what was taken away comes back
    page.wait("window.arasPage && arasPage.scene && arasPage.scene.meshes.length > 5")
    page.wait("arasPage.state.samples.length > 0")


def test_links_stand_where_the_arm_has_them(page, host):
    """The page's own forward kinematics against Pinocchio's."""
    joints = dict(zip(host.arm.names, host.q.tolist(), strict=True))
    shown = page.js("import('/scene.js').then((m) => m.linkPoses(arasPage.scene.robot, "
                    f"{joints})['camera_optical_frame'])")  # fmt: skip
    np.testing.assert_allclose(np.reshape(shown, (4, 4)), host.arm.pose(host.q), atol=1e-6)


def test_words_and_joints_are_shown(page, host):
    page.wait("document.getElementById('phase').textContent === 'servoing'")
    page.wait("document.getElementById('factor').textContent === '1.00'")
    last = f"{np.degrees(host.q[-1]):.1f}°"
    page.wait(f"[...document.querySelectorAll('.joint output')].at(-1).textContent === '{last}'")
    arm, shown = host.arm, page.js("[...document.querySelectorAll('.joint')].map((r) => "
                                   "[r.querySelector('output').textContent, r.title])")  # fmt: skip
    assert {*arm.is_prismatic} == {True, False}
    for q, low, high, slides, (value, title) in zip(
        host.q, arm.lower, arm.upper, arm.is_prismatic, shown, strict=True):
        assert value == (f"{q:.3f} m" if slides else f"{q * 180 / np.pi:.1f}°")
        found = re.match(r"(\S+) (m|rad), 0.000 \2/s, limits (\S+) to (\S+)$", title).groups()
        assert found[1] == ("m" if slides else "rad")
        assert [float(found[k]) for k in (0, 2, 3)] == pytest.approx([q, low, high], abs=6e-4)


def test_what_is_pressed_is_asked_for_and_answered(page, host):
    host.asked.clear()
    assert page.js("document.querySelector('#gains output').textContent") == "5.00"
    page.js("document.querySelector('[data-do=start]').click()")
    page.wait("document.getElementById('answer').textContent === 'done: start'")
    page.js("""(() => { const s = document.querySelector("#gains input"); s.value = Math.log10(2);
        s.dispatchEvent(new Event("change")); })()""")
    page.wait("document.getElementById('answer').textContent === 'done: gain'")
    page.js("document.querySelector('[data-do=hold]').click()")
    page.wait("document.getElementById('answer').classList.contains('refused')")
    assert [request.do for request in host.asked] == ["start", "gain", "hold"]
    assert host.asked[1].arguments == {"name": "gain", "value": pytest.approx(2.0, rel=0.05)}


@pytest.fixture
def state(page, host):
    before = host.page.state

    def change(**more):
        host.page.state = {**host.page.state, **more, "mark": time.monotonic()}
        page.wait(f"arasPage.state.values.mark === {host.page.state['mark']}")

    yield change
    host.page.state = before
    page.wait("!('mark' in arasPage.state.values)")


def button(do: str) -> str:
    return f"document.querySelector('[data-do={do}]')"


def test_what_is_carried_out_is_said_and_no_older_answer_stands_beside_it(page, host, state):
    answer = "document.getElementById('answer').textContent"
    running = "document.getElementById('running').textContent"
    host.waited.clear()
    state(last_bag="one.bag")
    assert page.js(f"{button('report')}.getAttribute('aria-disabled')") == "false"
    page.js(f"{button('hold')}.click()")
    page.wait(f"{answer} === 'no controller here'")
    host.asked.clear()
    # read at once, before any time goes by in the page
    assert page.js(f"({button('report')}.click(), [{answer}, {running}])") == ["", "Report: 0 s"]
    assert page.js(f"{button('report')}.getAttribute('aria-busy')") == "true"
    page.wait(REPORTS)
    page.js(f"{button('report')}.click()")  # once is enough
    assert page.js(answer) == "this request is in progress"
    page.js(f"{button('pause')}.click()")  # which lets the report end
    page.wait(f"{running} === '' && {answer}.startsWith('done: ')")
    assert page.js(f"{button('report')}.getAttribute('aria-busy')") == "false"
    assert sorted(request.do for request in host.asked) == ["pause", "report"]


NO_CONTROLLER = "no controller is running: start the nodes with a scheme"


@pytest.mark.parametrize(("do", "told", "why"), [
    ("start", {"controller": False}, NO_CONTROLLER),
    ("stop", {"controller": False}, NO_CONTROLLER),
    ("target", {}, "there are no targets to choose from"),
    ("teach", {}, "give the goal a name first"),
    ("record", {"open_bag": "one.bag"}, "a bag is already being recorded"),
    ("stop_record", {}, "nothing is being recorded"),
    ("report", {}, "nothing has been recorded yet"),
    ("report", {"open_bag": "two.bag", "last_bag": "one.bag"},
     "a bag is being recorded: stop the recording first")])  # fmt: skip
def test_a_button_that_cannot_act_says_why(page, host, state, do, told, why):
    state(**told)
    assert page.js(f"{button(do)}.title") == why
    host.asked.clear()
    assert page.js(f"{button(do)}.getAttribute('aria-disabled')") == "true"
    page.js(f"{button(do)}.click()")
    assert page.js("document.getElementById('answer').textContent") == why
    page.js(f"{button('reset')}.click()")  # which can
    page.wait("document.getElementById('answer').textContent.startsWith('reset failed')")
    assert [request.do for request in host.asked] == ["reset"]
    state(controller=True, open_bag="one.bag", recording_error="the disk is full")
    page.js("""(() => { const name = document.getElementById("teach-name"); name.value = "mine";
        name.dispatchEvent(new Event("input")); })()""")  # what hindered it is over
    able = [page.js(f"{button(one)}.getAttribute('aria-disabled')") == "false"
            for one in ("start", "record", "stop_record", "teach")]
    page.js("document.getElementById('teach-name').value = ''")
    assert all(able)


def test_without_a_phase_it_is_said_what_is_missing(page, state):
    words = "document.getElementById('controller-message').textContent"
    page.js("window.before = arasPage.state.controller; arasPage.state.controller = {}")
    said = page.js(f"{button('servo')}.click(); {words}")
    assert said == "the nodes are being started"
    page.wait(f"{button('servo')}.getAttribute('aria-busy') === 'false'")
    state(controller=False)
    assert page.js(words) == NO_CONTROLLER
    state(controller=True)
    assert page.js(words) == "the controller is running and has not processed an image yet"
    page.js("arasPage.state.controller = window.before")
    missing, why = "document.getElementById('missing')", "There is no robot: start one."
    assert page.js(f"{missing}.hidden")
    state(missing=why, controller=False)
    assert page.js(f"[{missing}.hidden, {missing}.textContent]") == [False, why]
    assert page.js(f"{button('start')}.title") == why


@pytest.mark.parametrize(("outcome", "reason", "said"), [
    ("target_lost", "target lost at 3.20 s: no target", "target lost at 3.20 s: no target — look"),
    ("no_joint_states", "no joint states yet", "no joint states yet — look"),
    ("held", "held", "held — look"),
    ("timed_out", "not converged after 4.0 s", "timed out: not converged after 4.0 s — look")])
def test_the_outcome_is_not_said_twice(page, state, outcome, reason, said):
    found = json.dumps({"phase": "holding", "outcome": outcome, "reason": reason, "remedy": "look"})
    page.js(f"window.before = arasPage.state.controller; arasPage.state.controller = {found}")
    state()  # shows it
    assert page.js("document.getElementById('controller-message').textContent") == said
    page.js("arasPage.state.controller = window.before")


def test_what_may_be_chosen_shows_what_runs_until_another_is_chosen(page, host):
    def shown(what: str) -> str:
        return page.js(f"document.getElementById('choose-{what}').value")

    assert (shown("scheme"), shown("start"), shown("camera")) == ("moments", "2016", "original")
    page.js("""(() => { const s = document.getElementById("choose-scheme"); s.value = "points";
        s.dispatchEvent(new Event("change")); })()""")
    host.page.choices = {**host.page.choices, "goals": ["auto", "2016", "mine"]}
    page.wait("document.getElementById('choose-goal').length === 3")
    assert (shown("scheme"), shown("start")) == ("points", "2016")
    # Somebody else, or the button, has begun another: that is shown.
    host.page.state = {**host.page.state, "scheme": "points", "start": "2015"}
    page.wait("document.getElementById('choose-start').value === '2015'")
    host.page.state = {**host.page.state, "scheme": "moments"}
    page.wait("document.getElementById('choose-scheme').value === 'moments'")


PLOT = """import('/plots.js').then(async (m) => {{
    const box = document.createElement("div"); box.className = "curves";
    box.style = "width: {width}px; height: 170px; position: fixed; left: 0; top: 0";
    document.body.append(box);
    const time = new m.TimeRange(() => {{}}), samples = {samples};
    const plot = new m.Plot(box, time, (s) => s[1]); plot.names = {names}; plot.units = {units};
    plot.draw(samples);
    await new Promise(requestAnimationFrame);
    const answer = await (async () => {{ {answer} }})(); box.remove(); return answer; }})"""


def test_what_has_another_unit_has_another_axis(page):
    """Errors in m and in rad on one axis would leave the smaller ones without a shape."""
    charts = page.js(PLOT.format(
        width=300, names=["xn", "alpha"], units=["m", "rad"],
        samples="[[0, [0.01, -1.5]], [1, [0.02, -1.7]]]",
        answer="""return plot.charts.map(({ plot: u, members }) => [members, u.axes[1].label,
            u.scales.y.min, u.scales.y.max, u.data[1], u.axes[0].show]);"""))  # fmt: skip
    (first, second) = charts
    assert first[:2] == [[0], "m"] and second[:2] == [[1], "rad"]
    assert 0.0 < first[2] < 0.01 and 0.02 < first[3] < 0.05
    assert -1.8 < second[2] < -1.7 and -1.5 < second[3] < -1.4
    assert first[4] == [0.01, 0.02] and [first[5], second[5]] == [False, True]
    page.wait("arasPage.state.controller.units.join() === 'm,m,m,rad'")


def test_the_whole_run_is_shown_and_its_newest_part_only_when_asked_for(page):
    shown = page.js(PLOT.format(
        width=300, names=["xn"], units=[],
        samples="Array.from({ length: 61 }, (_, i) => [0.5 * i, [i === 30 ? null : i]])",
        answer="""const u = plot.charts[0].plot, answer = [], note = async () => {
                plot.draw(samples);
                await new Promise(requestAnimationFrame);
                answer.push([u.scales.x.min, u.scales.x.max, time.part]);
            };
            await note(); time.show("newest"); await note(); time.select(2, 3); await note();
            samples.push([30.5, [0]]); await note();  // a selection stays where it is
            samples.splice(0, samples.length, [100, [1]]); await note();  // another run
            return answer;"""))  # fmt: skip
    assert shown == [[0, 30, "whole"], [20, 30, "newest"], [2, 3, "selected"], [2, 3, "selected"],
                     [100, 104, "whole"]]  # fmt: skip


def test_dragging_in_a_plot_zooms_all_plots_until_a_double_click(page):
    pressed = "document.getElementById('show-whole').getAttribute('aria-pressed')"
    page.wait(f"{pressed} === 'true'")
    left, top, wide, high = page.js("""((plot) => { const r = plot.getBoundingClientRect();
        return [r.left, r.top, r.width, r.height]; })(
            document.querySelector("#plot-error .u-over"))""")
    y = top + high / 2
    page.mouse("Moved", left + 0.2 * wide, y)
    page.mouse("Pressed", left + 0.2 * wide, y)
    page.mouse("Moved", left + 0.4 * wide, y, held=True)
    page.mouse("Released", left + 0.4 * wide, y)
    page.wait("arasPage.timeRange.part === 'selected'")
    page.wait(f"{pressed} === 'false' && document.getElementById('shown-part').textContent")
    first, last = page.js("arasPage.plots[2].charts[0].plot.scales.x.min"), page.js(
        "arasPage.plots[2].charts[0].plot.scales.x.max")  # fmt: skip
    start, end = page.js("[arasPage.state.samples[0][0], arasPage.state.samples.at(-1)[0]]")
    duration = max(4.0, end - start)
    assert first == pytest.approx(start + 0.2 * duration, abs=0.03 * duration)
    assert last == pytest.approx(start + 0.4 * duration, abs=0.03 * duration)
    page.js("""document.querySelector('#plot-turn .u-over')
        .dispatchEvent(new MouseEvent('dblclick'))""")
    page.wait(f"{pressed} === 'true'")


INSIDE = """((links) => { const scene = arasPage.scene; scene.draw();
    const m = scene.computeProjection(), r = (i, p) =>
        m[4 * i] * p[0] + m[4 * i + 1] * p[1] + m[4 * i + 2] * p[2] + m[4 * i + 3];
    const points = Object.values(scene.shapes).flatMap(({ points: p }) =>
        Array.from({ length: p.length / 3 }, (_, k) => p.slice(3 * k, 3 * k + 3)));
    for (const name of links || Object.keys(scene.poses))
        points.push([3, 7, 11].map((k) => scene.poses[name][k]));
    return Math.max(...points.flatMap((p) =>
        [0, 1].map((i) => Math.abs(r(i, p) / r(3, p))))); })"""


@pytest.mark.parametrize("width", [1440, 390])
def test_robot_camera_and_target_stay_inside_the_view(page, host, width):
    page.resize(width)
    goal = host.run_trace.goal
    try:
        for what, links in (("run", ["camera_optical_frame"]), ("all", None)):
            for distance in (0.2, 3.0):
                points = goal[:3, 3] + np.array([[0.0], [distance]]) * goal[:3, 0]
                host.run_trace.target = (
                    DrawingShape("target", LINES, points, (1.0, 0.0, 0.0, 1.0)),
                )
                page.js(f"document.getElementById('view-{what}').click()")
                there = "arasPage.scene.shapes.target && arasPage.scene.shapes.target.points[3]"
                page.wait(f"Math.abs(({there}) - {points[1, 0]}) < 1e-4")
                assert 0.2 < page.js(f"{INSIDE}({json.dumps(links)})") < 1.0
        before = page.js("arasPage.scene.view.distance")
        page.js("arasPage.scene.canvas.dispatchEvent(new WheelEvent('wheel', {deltaY: -500}))")
        page.js("arasPage.scene.draw()")
        assert page.js("arasPage.scene.view.distance") < 0.8 * before  # the user's view stays
    finally:
        host.run_trace.target = ()
        page.resize(1440)
        page.js("document.getElementById('view-run').click()")


@pytest.mark.parametrize("width", [1440, 1081, 1080, 820, 390, 320])
def test_nothing_hinders_readers_in_either_theme_nor_is_wider_than_the_screen(page, width):
    page.js("""arasPage.isFrozen = true;
        document.getElementById("controller-message").textContent =
            "a reason of many words, ".repeat(20);
        for (const part of document.querySelectorAll("details")) part.open = true""")
    page.resize(width)
    page.js("new Promise((go) => setTimeout(go, 200))")  # curves follow their box
    themes = []
    try:
        assert page.js("document.documentElement.scrollWidth") == width
        assert page.js("""[...document.querySelectorAll("body *")]
            .filter((e) => e.getBoundingClientRect().right > document.documentElement.clientWidth)
            .map((e) => `${e.tagName} ${e.id} ${e.getBoundingClientRect().right}`)""") == []
        hidden = page.js("""((e) => Math.max(e.scrollWidth - e.clientWidth,
            e.scrollHeight - e.clientHeight))(document.getElementById('controller-message'))""")
        assert hidden <= 1
        for _ in range(2 if width in (1440, 390) else 0):
            assert page.audit() == []
            themes.append(page.js("document.documentElement.dataset.theme"))
            page.js("document.getElementById('theme').click()")
            assert page.js("document.getElementById('theme').textContent").lower() == themes[-1]
            drawn = page.js("arasPage.plots[0].charts[0].plot.series[1].stroke()")
            assert drawn == page.js("getComputedStyle(document.documentElement)"
                                    ".getPropertyValue('--curve-0').trim()")  # fmt: skip
    finally:
        page.resize(1440)
        page.js("arasPage.isFrozen = false")
    assert not themes or sorted(themes) == ["dark", "light"]


def test_a_key_drives_the_camera_as_long_as_it_is_held(page, host):
    page.js(f"{button('hold')}.click()")
    page.wait("document.getElementById('answer').classList.contains('refused')")
    host.asked.clear()
    assert page.js("""(() => { document.getElementById("scene").dispatchEvent(
        new KeyboardEvent("keydown", {key: "r", bubbles: true}));
        return document.getElementById("answer").textContent; })()""") == ""
    wait_until(lambda: len(host.asked) >= 3)
    page.js('dispatchEvent(new KeyboardEvent("keyup", {key: "r"}))')
    wait_until(lambda: not any(host.asked[-1].arguments.values()))  # the server may lag
    page.js("new Promise((go) => setTimeout(go, 300))")
    asked = [request.arguments for request in host.asked]
    assert all(given["vz"] > 0.0 for given in asked[:-1])
    assert not any(asked[-1].values())  # and nothing is asked for after that


def test_a_second_browser_a_reload_and_a_closed_tab(browser, page, server, host):
    second = browser.open(server.access.address)
    second.wait("window.arasPage && arasPage.state.samples.length >= 41")
    assert len(server.viewers) == 2
    host.move()
    count = len(host.page.make_full_message()["samples"])
    for tab in (page, second):
        tab.wait(f"arasPage.state.samples.length === {count}")
    page.call("Page.reload")
    page.wait("window.arasPage && document.getElementById('phase').textContent === 'servoing'")
    page.wait(f"arasPage.state.samples.length === {count}")
    second.close()
    page.wait("true")
    wait_until(lambda: len(server.viewers) == 1)


def test_a_page_that_is_there_before_the_robot_waits_for_it_without_a_word(browser, host, server):
    before = host.page.state
    host.page.state = {}
    host.has_robot = False
    try:
        tab = browser.open(server.access.address)
        tab.wait("window.arasPage && document.getElementById('link').textContent === 'connected'")
        host.move()
        tab.wait("document.getElementById('time').textContent !== '–'")
        hidden = "document.getElementById('error').hidden"
        assert tab.js(hidden) and not tab.js("arasPage.scene.meshes.length")
    finally:
        host.has_robot = True
        host.page.state = before
    tab.wait("arasPage.scene.meshes.length > 5")
    assert tab.js(hidden)
    tab.close()


def test_a_simulator_started_again_is_found_again(browser, host, server):
    port, token = server.access.port + 1000, "a-token-of-sixteen"
    host.waited.clear()
    again = serve(host, "127.0.0.1", port, token, lambda _: None)
    tab = browser.open(again.access.address)
    tab.wait("window.arasPage && document.getElementById('link').textContent === 'connected'")
    tab.js(f"arasPage.state.values.last_bag = 'one.bag'; {button('report')}.click()")
    tab.wait(REPORTS)
    again.close()
    tab.wait("document.getElementById('link').textContent === 'no connection'")
    assert tab.js("document.getElementById('running').textContent") == ""
    assert "shows the last values" in tab.js("document.getElementById('missing').innerText")
    assert tab.js(f"{button('start')}.title") == "no connection to the simulator"
    host.waited.set()
    third = serve(host, "127.0.0.1", again.access.port, token, lambda _: None)
    try:
        tab.wait("document.getElementById('link').textContent === 'connected'")
        tab.wait("arasPage.state.samples.length > 0")
    finally:
        tab.close()
        third.close()
