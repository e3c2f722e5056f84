"""Signals end a node in any state of its main thread; shutdown functions are completed."""

import ctypes
import logging
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from aras_visual_servo_ros import shutdown


def start(code, *words, **environment):
    """Start Python code as a node."""
    path = os.pathsep.join(filter(None, sys.path))
    return subprocess.Popen(
        [sys.executable, "-c", code, *words], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", **environment})


def run(code, *words, **environment):
    """Return status, output and errors of Python code."""
    node = start(code, *words, **environment)
    out, errors = node.communicate(timeout=60.0)
    return node.returncode, out, errors


NODE = """
import os, sys, threading, time, rospy
from aras_visual_servo_ros.shutdown import end_on_signals

def last_words():
    time.sleep(0.5)  # the main thread is gone by then
    print("done", flush=True)

begun = threading.Event()
rospy.on_shutdown(begun.set)
rospy.on_shutdown(last_words)
end_on_signals()
print("up", flush=True)
begun.wait()  # without a limit
print("main ends", flush=True)
"""


@pytest.mark.parametrize(("number", "thread"), [
    (signal.SIGINT, 0), (signal.SIGTERM, 0), (signal.SIGINT, 1)])
def test_a_signal_ends_a_waiting_main_thread_and_hooks_come_to_their_end(number, thread):
    """The kernel gives a process's signal to any of its threads."""
    node = start(NODE)
    try:
        assert node.stdout.readline() == "up\n"
        threads = sorted(int(task.name) for task in Path(f"/proc/{node.pid}/task").iterdir())
        assert ctypes.CDLL(None).tgkill(node.pid, threads[thread], number) == 0
        output, _ = node.communicate(timeout=30.0)
    finally:
        node.kill()
    assert (output, node.returncode) == ("main ends\ndone\n", 0)


def test_a_topic_closed_under_a_callback_is_a_fault_only_before_the_end(monkeypatch):
    logger, pipe = logging.getLogger("rosout"), os.pipe()
    monkeypatch.setattr(logger, "filters", [])
    monkeypatch.setattr(os, "pipe", lambda: pipe)
    heard, began, told_of = {}, [], []
    monkeypatch.setattr(signal, "signal", heard.__setitem__)
    monkeypatch.setattr(signal, "set_wakeup_fd", lambda *given, **more: told_of.append(
        (*given, os.get_blocking(given[0]), more)))
    monkeypatch.setattr(threading, "Thread", lambda **more: SimpleNamespace(
        start=lambda: began.append(more)))
    shutdown.end_on_signals()
    assert told_of == [(pipe[1], False, {"warn_on_full_buffer": False})]
    (began,) = began
    assert (began["args"], began["name"], began["daemon"]) == ((pipe[0],), "signals", True)
    assert set(heard) == {signal.SIGINT, signal.SIGTERM} and os.get_blocking(pipe[0])
    assert not any(handler(2, None) for handler in heard.values())  # the kernel's has told already
    for end in pipe:
        os.close(end)
    closed = "publish() to a closed topic"
    for ends, text, told in ((False, closed, True), (True, closed, False), (True, "other", True)):
        monkeypatch.setattr(shutdown.rospy, "is_shutdown", lambda ends=ends: ends)
        fault = logging.LogRecord("rosout", 40, "", 0, "bad callback: %s", (text,), None)
        assert bool(logger.filter(fault)) is told


BEGINS = """
import sys
from types import SimpleNamespace
import rospy, rospy.impl.init
from aras_visual_servo_ros.shutdown import init_node

def start_node(*_, **__):
    if "interrupted" in sys.argv:
        rospy.signal_shutdown("as rospy's handler of Ctrl-C does")
        return SimpleNamespace(uri="", shutdown=lambda reason: None)
    raise rospy.ROSInitException("another fault")

rospy.impl.init.start_node = start_node
init_node("begins")
print("up")
"""


@pytest.mark.parametrize(("words", "status", "told"), [
    (["interrupted"], 130, ""), ([], 1, "another fault")])
def test_a_node_that_is_interrupted_while_it_begins_ends_without_a_traceback(
    words, status, told, tmp_path
):
    *ended, errors = run(BEGINS, *words, ROS_LOG_DIR=str(tmp_path))
    assert ended == [status, ""]
    assert told in errors and ("Traceback" in errors) == bool(told)


LOGS = """
import rospy.core
from aras_visual_servo_ros.log_folder import check_log_folder
check_log_folder("begins")
rospy.core.configure_logging("/begins")
print("up")
"""


@pytest.mark.parametrize(("folder", "words"), [
    ("/proc", []), ("/proc/logs", []), ("/dev/null/logs", []), ("", ["__log:=/proc/begins.log"])])
def test_a_node_whose_log_cannot_be_written_says_so_in_one_line(folder, words, tmp_path):
    *ended, errors = run(LOGS, *words, ROS_LOG_DIR=folder or str(tmp_path), TMPDIR=str(tmp_path))
    assert ended == [0, "up\n"]
    (line,) = errors.splitlines()
    assert line.startswith(f"begins: cannot write the log to {folder or '/proc'} (")
    assert "set ROS_LOG_DIR" in line and list(tmp_path.glob("ros_log_*/begins*.log"))


LOCKED = """
import os, signal, threading, time
from types import SimpleNamespace
import rospy, rospy.impl.init, rospy.impl.rosout
from aras_visual_servo_ros.shutdown import init_node

lock = threading.Lock()  # as some of rospy's own are

def init_rosout():
    with lock:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)

def end(reason):
    with lock:
        print("ended", flush=True)

rospy.impl.init.start_node = lambda *_, **__: SimpleNamespace(uri="http://x:1/", shutdown=end)
rospy.impl.rosout.init_rosout = init_rosout
init_node("begins")
print("up")
"""


def test_an_interruption_waits_for_no_lock_that_the_beginning_holds(tmp_path):
    """rospy ends the node in the signal's handler: in the thread that holds the lock."""
    *ended, errors = run(LOCKED, ROS_LOG_DIR=str(tmp_path), ROS_MASTER_URI="http://127.0.0.1:1")
    assert ended == [130, "ended\n"] and "Traceback" not in errors


BEGINNING = """
from aras_visual_servo_ros.shutdown import init_node

print("up", flush=True)
init_node("waits", about="Waits for a master.")
print("begun", flush=True)
"""


NO_MASTER = {"ROS_MASTER_URI": "http://127.0.0.1:1"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_that_waits_for_its_master(number):
    node = start(BEGINNING, **NO_MASTER)
    try:
        assert node.stdout.readline() == "up\n"
        assert "Will keep trying" in node.stdout.readline()
        node.send_signal(number)
        output, _ = node.communicate(timeout=60.0)
    finally:
        node.kill()
    assert (output, node.returncode) == ("", 128 + number)


def test_help_is_given_without_a_master():
    for flag in ("-h", "--help"):
        status, output, _ = run(BEGINNING, flag, **NO_MASTER)
        assert status == 0 and "Waits for a master." in output and "begun" not in output
