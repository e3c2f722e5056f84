"""Fixtures that several tests of the bench use."""

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(one) for one in (HERE.parent / "world", HERE) if str(one) not in sys.path]

from aras_visual_servo_bench.experiment import cameras  # noqa: E402
from aras_visual_servo_bench.experiment.robots import Robot, RobotSpec  # noqa: E402


@pytest.fixture(scope="session")
def robot():
    return Robot(RobotSpec())


@pytest.fixture(scope="session")
def arm(robot):
    return robot.make_arm()


@pytest.fixture(scope="module")
def host(robot, pinhole):
    from page_host import OfflineHost

    return OfflineHost(robot, pinhole)


@pytest.fixture
def reports(host):
    """Function that sets how the host finds the file of a report, until the test ends."""
    yield lambda find_report: setattr(host, "find_report", find_report)
    del host.find_report


@pytest.fixture(scope="module")
def server(host):
    from aras_visual_servo_bench.web.live.server import serve

    found = serve(host, "127.0.0.1", 18300 + os.getpid() % 1000, say=lambda _: None)
    yield found
    found.close()


@pytest.fixture(scope="session")
def preset(robot):
    return cameras.read_preset("original", robot.packages, "aras_visual_servo_gazebo")


@pytest.fixture(scope="session")
def pinhole(preset):
    return cameras.make_camera_model(preset)


@pytest.fixture(params=[False, True], ids=["screen", "paper"])
def paper(request):
    """Run the test with figures in the style of a paper and in that of the screen."""
    yield from apply_style(request.param)


@pytest.fixture
def screen():
    yield from apply_style(False)


def apply_style(paper):
    import matplotlib.pyplot as plt

    from aras_visual_servo_bench.plots import style

    with style.apply_style(paper):
        yield paper
    plt.close("all")


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium; without one the test is skipped, but not in CI."""
    from browser import HOW, Browser, chromium

    if chromium() is None:
        if os.environ.get("CI"):
            pytest.fail(HOW)
        pytest.skip(HOW)
    with Browser() as found:
        yield found


@pytest.fixture(scope="module")
def watched(browser):
    """Function that opens a tab, in which `wrong` lists errors, `one` and `all` find elements."""

    def open_watched(address, width, ready):
        tab = browser.open("about:blank")
        tab.resize(width)
        tab.call("Page.addScriptToEvaluateOnNewDocument", source="window.wrong = []; "
                 "addEventListener('error', (e) => wrong.push(e.message)); "
                 "addEventListener('unhandledrejection', (e) => wrong.push(String(e.reason))); "
                 "window.one = (s) => document.querySelector(s); "
                 "window.all = (s) => [...document.querySelectorAll(s)];")  # fmt: skip
        tab.call("Page.navigate", url=address)
        tab.wait(ready)
        return tab

    return open_watched
