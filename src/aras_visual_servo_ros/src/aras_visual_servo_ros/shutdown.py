"""What ends a node: signals, from a thread of their own, or while it begins; and a master that has
gone."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator

import rosgraph
import rospy

from .connections import accept_in_threads, find_publishers
from .log_folder import check_log_folder
from .master_watch import MasterWatch

SIGNALS = (signal.SIGINT, signal.SIGTERM)
HELP_OPTIONS = {"-h", "--help"}
# What rospy may need to take down what begin_node began [s]: without a master it never comes to it.
PATIENCE = 2.0
_started = threading.Event()
_started.set()
CLOSED_TOPIC_MESSAGE = "publish() to a closed topic"  # what rospy says of it
# the parameter that rospy hears once a node has logged
SUBSCRIBED_PARAMETER = "/rosout_disable_topics_generation"


class _ShutdownLogFilter(logging.Filter):
    """Keeps back what rospy logs, with a traceback, of callbacks that publish while the node ends:
    it closes topics under them."""

    def filter(self, record: logging.LogRecord) -> bool:
        return not (rospy.is_shutdown() and CLOSED_TOPIC_MESSAGE in record.getMessage())


def init_node(name: str, about: str = "", **options: bool) -> None:
    """rospy.init_node(name, **options) that may be interrupted at any moment; in the main thread.

    `about`, of a program without options of its own, answers --help, and the program ends there.
    A Ctrl-C in the middle of it ends the program as one just before or after does: it waits for no
    lock that rospy holds there, and what rospy raises then, which no program awaits, is not told.
    """
    if about and HELP_OPTIONS & set(sys.argv[1:]):
        print(f"{about.strip()}\n\nTakes no options: its parameters are ROS's (_name:=value).")
        sys.exit(0)
    _started.clear()
    end_on_signals()
    find_publishers()
    check_log_folder(name)
    try:
        rospy.init_node(name, disable_signals=True, **options)
    except Exception:  # of what is half made and taken down again
        if not rospy.core.is_shutdown_requested():
            raise
    if rospy.core.is_shutdown_requested():
        sys.exit(128 + signal.SIGINT)
    rospy.core.add_shutdown_hook(_unregister)
    _started.set()


def _unregister(_reason: str) -> None:
    """Let the master forget this node, which rospy does for topics and services alone.

    The master keeps the address of a node that hears a parameter. When a node of the same name
    begins, it tells whoever has that address by then, which may be any other node, to end.
    """
    with contextlib.suppress(OSError, rosgraph.MasterException):  # the master has gone
        rosgraph.Master(rospy.get_name()).unsubscribeParam(
            rospy.get_node_uri(), SUBSCRIBED_PARAMETER
        )


def end_on_signals() -> None:
    """Hear Ctrl-C and SIGTERM in rospy's place; in the main thread.

    rospy ends the node inside the signal handler, which Python runs in the main thread, wherever
    that is: in the middle of a log line it waits for locks that this line holds. And the kernel may
    hand a signal to any thread, so that a waiting main thread does not even wake for its handler.
    Here the kernel's own handler writes the number into a pipe, and a thread reads it.
    """
    logging.getLogger("rosout").addFilter(_ShutdownLogFilter())
    hear, tell = os.pipe()
    os.set_blocking(tell, False)
    for number in SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    threading.Thread(target=_wait_for_signal, args=(hear,), name="signals", daemon=True).start()


def _wait_for_signal(read_end: int) -> None:
    while (number := os.read(read_end, 1)[0]) not in SIGNALS:
        pass
    # In a thread that Python waits for: what is done on shutdown must come to its end.
    reason = signal.Signals(number).name
    ending = threading.Thread(target=rospy.signal_shutdown, args=(reason,), name="shutdown")
    ending.daemon = False  # as this one is, it would be by default
    ending.start()
    if not _started.is_set():
        ending.join(PATIENCE)
        if ending.is_alive():  # for the lock that init_node holds while it waits for a master
            os._exit(128 + number)


def end_without_master(watch: MasterWatch) -> bool:
    """Whether the master has gone; then this node says so and ends."""
    if not (reason := watch.find_loss_reason()):
        return False
    # Logging goes through rosout, which needs the master: say it directly.
    print(f"{rospy.get_name()[1:]}: {reason}: ending", file=sys.stderr)
    rospy.signal_shutdown(reason)
    return True


def iterate_at_period(period: float) -> Iterator[None]:
    """Every so many seconds of wall time, until ROS shuts down, or the master has gone, with which
    this node ends."""
    master = MasterWatch(rospy.get_name())
    while not (rospy.is_shutdown() or end_without_master(master)):
        yield
        time.sleep(period)


def node_main(
    name: str, about: str, run: Callable[[], object], fault: type[Exception], **options: bool
) -> int:
    """Begin a node, and run it to its end; a fault is one fatal line. Returns the exit status."""
    init_node(name, about, **options)
    accept_in_threads()
    try:
        run()
    except fault as error:
        rospy.logfatal("%s", error)
        return 1
    return 0
