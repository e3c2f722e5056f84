"""A scheme whose code never returns ends its run as a fault of that scheme."""

import multiprocessing
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_controller.errors import UnresponsiveSchemeError
from aras_visual_servo_controller.schemes.time_limit import call_user_code

LIMIT = 0.5  # s


def keys(scheme, plant="free"):
    return {"plant": plant, "features": "exact", "duration": 3.0, "seed": 3, "gain": 1.0,
            "scheme": f"outcome_campaign.schemes:{scheme}",
            "controller_parameters": {"scheme_timeout": LIMIT}}  # fmt: skip


def outcome_of(given):
    found = run(given)
    return found.outcome, found.reason, str(found.remedy)


@pytest.mark.parametrize(("plant", "scheme"), [
    ("free", "Hanging"), ("chain", "Sleeping"), ("bullet", "Waiting")])  # fmt: skip
def test_a_scheme_that_hangs_ends_its_run_as_its_fault(plant, scheme):
    began = time.monotonic()
    outcome, reason, remedy = outcome_of(keys(scheme, plant))
    assert time.monotonic() - began < 30.0
    assert outcome == "scheme_fault"
    assert f":{scheme}" in reason and ".compute" in reason and "0.5 s" in reason
    assert "image of 0.2" in reason, reason  # the first after 0.2 s
    assert "scheme_timeout" in remedy and "scheme to points" in remedy


def test_it_does_so_in_a_thread_and_in_a_worker_process():
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(outcome_of, keys("Hanging")).result(timeout=60)[0] == "scheme_fault"
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply_async(outcome_of, (keys("Hanging"),)).get(timeout=60)[0] == "scheme_fault"
        healthy = {**keys("Hanging"), "scheme": "points"}
        assert pool.apply_async(outcome_of, (healthy,)).get(timeout=60)[0] != "scheme_fault"


def test_a_wait_is_interrupted_where_scripts_run_in_the_background():
    """There the shell has Ctrl-C ignored."""
    code = (
        "import queue\n"
        "from aras_visual_servo_controller.schemes.time_limit import call_user_code\n"
        "try: call_user_code(queue.Queue().get, limit=0.2)\n"
        "except BaseException as error: print(type(error).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    assert done.stdout == "UnresponsiveSchemeError\n", done.stderr


def test_a_call_beyond_its_limit_says_where_it_was():
    """One within its limit is as without one."""
    def busy():
        while True:
            pass

    def asleep():
        while True:
            time.sleep(0.05)

    def waits():
        queue.Queue().get()

    assert call_user_code(max, 2, 3, limit=LIMIT) == 3
    with pytest.raises(KeyError):
        call_user_code({}.__getitem__, 1, limit=LIMIT)
    # Looks are 0.25 s apart: a limit is a least.
    assert call_user_code(time.sleep, 0.02, limit=0.01) is None
    for hang in (busy, asleep, waits):
        with pytest.raises(UnresponsiveSchemeError, match="did not end within 0.2 s") as error:
            call_user_code(hang, limit=0.2)
        assert "Traceback" in error.value.trace and hang.__name__ in error.value.trace
    time.sleep(1.6)  # nothing is raised afterwards
    assert all(thread.name != "time limits" for thread in threading.enumerate())
