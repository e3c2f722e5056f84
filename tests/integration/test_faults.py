"""Short selection of the fault injection (./test.sh --faults runs all of it)."""

import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from gazebo_msgs.srv import SetPhysicsPropertiesRequest
from ros_graph import GraphError

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS))
from faults import campaign, clocks, services  # noqa: E402
from faults.bed import UnansweredError  # noqa: E402
from faults.outcome import Outcome  # noqa: E402
from faults.processes import tracebacks  # noqa: E402

CHOICE = "garbage|bytes|fuzzed|hostile|games"


def test_nothing_is_lost_hung_or_leaked():
    ended = subprocess.run(
        [sys.executable, campaign.__file__, "--scale", "0.02", "--only", CHOICE],
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr[-3000:]}"


def test_a_group_that_cannot_go_on_is_told_and_the_next_one_has_a_new_graph(monkeypatch, tmp_path):
    done = []

    class PlayedBed:
        def __init__(self, directory):
            assert directory == tmp_path

        def __getattr__(self, name):
            return lambda: done.append(name)

    def stuck(bed, scale, seed):
        raise GraphError("the camera did not end at Ctrl-C")

    def quiet(bed, scale, seed):
        done.append((scale, seed))
        return Outcome("quiet", 3, 3)

    monkeypatch.setattr(campaign, "Bed", PlayedBed)
    first, second = campaign.run(tmp_path, (stuck, quiet), 0.5, 7)
    assert not first.clean and "did not end at Ctrl-C" in first.hung[0]
    assert second.clean and done == ["start", "start_anew", (0.5, 7), "close"]


def test_a_traceback_of_pythons_own_beginning_is_told_from_those_of_programs():
    python = (
        "Fatal Python error: init_import_site: Failed to import the site module\n"
        'Traceback (most recent call last):\n  File "<frozen site>", line 638, in <module>\n'
        "KeyboardInterrupt\n"
    )
    importing = '  File "<frozen importlib._bootstrap>", line 1178, in _find_and_load\n  File'
    nested = python.replace("  File", importing, 1)
    ours = (
        'Traceback (most recent call last):\n  File "/ws/devel/lib/gazebo", line 15, in <module>\n'
        '    exec(x)\n  File "<frozen site>", line 3, in main\nKeyboardInterrupt\n'
    )
    found, unborn = tracebacks(f"[INFO] up\n{python}words\n{ours}{python}{nested}")
    assert unborn == 3 and len(found) == 1
    assert "/ws/devel/lib/gazebo" in found[0] and found[0].endswith("KeyboardInterrupt")
    assert tracebacks("all is well") == ([], 0)


@pytest.mark.parametrize(
    ("refused", "asked"),
    [("", ["reset_world"]),
     ("the simulation diverged; then call reset_simulation", ["reset_world", "reset_simulation"])],
)  # fmt: skip
@pytest.mark.parametrize("group", ["fuzzed", "games"])
def test_a_world_that_diverged_is_reset_as_it_says_itself(monkeypatch, refused, asked, group):
    called = []

    class PlayedBed:
        def calm(self):
            pass

        def group(self, name):
            return nullcontext(Outcome(name))

        def call(self, name, request=None):
            if name.startswith("/gazebo/reset"):
                called.append(name.rpartition("/")[2])
            if name == "/gazebo/reset_world" and refused:
                raise UnansweredError(refused)
            return SetPhysicsPropertiesRequest()

    if group == "fuzzed":
        assert services.put_back(PlayedBed(), SetPhysicsPropertiesRequest()) == bool(refused)
        assert called == asked
    else:
        monkeypatch.setattr(clocks, "judged", lambda *_: None)
        outcome = clocks.games(PlayedBed(), 0.1, 0)
        assert outcome.injected == 3 and called[-len(asked):] == asked
        assert outcome.note == ("reset_simulation was needed after 3 of them" if refused else "")
