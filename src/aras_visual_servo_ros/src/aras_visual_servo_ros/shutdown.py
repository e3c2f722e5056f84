"""Start and shutdown of a node; signals and the loss of the ROS master end it."""

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

from .log_folder import check_log_folder
from .master_watch import MasterWatch
from .rospy_patches import accept_in_threads, find_publishers, send_directly

SIGNALS = (signal.SIGINT, signal.SIGTERM)
HELP_OPTIONS = {"-h", "--help"}
# Longest time, s, that rospy's shutdown may take if a signal arrives during rospy.init_node. Then
# the process is ended, because the shutdown never finishes if there is no master.
PATIENCE = 2.0
_started = threading.Event()
_started.set()
# part of the error message with which rospy refuses to publish after shutdown
CLOSED_TOPIC_MESSAGE = "publish() to a closed topic"
# Parameter to which rospy subscribes when a node logs its first message.
SUBSCRIBED_PARAMETER = "/rosout_disable_topics_generation"


class _ShutdownLogFilter(logging.Filter):
    """Log filter that drops the errors of callbacks that publish during shutdown.

    These errors occur because rospy closes the topics while callbacks are still running.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        return not (rospy.is_shutdown() and CLOSED_TOPIC_MESSAGE in record.getMessage())


def init_node(name: str, about: str = "", **options: bool) -> None:
    """Call rospy.init_node(name, **options), and let Ctrl-C and SIGTERM end the node at any time.

    Call this in the main thread. If Ctrl-C is pressed during rospy.init_node, the program ends
    without waiting for rospy's locks or printing rospy's exceptions. If `about` is not empty, the
    program takes no options, and prints `about` for --help.

    Raises:
        SystemExit: after --help, or after Ctrl-C or SIGTERM.
    """
    if about and HELP_OPTIONS & set(sys.argv[1:]):
        print(f"{about.strip()}\n\nTakes no options; set ROS parameters with _name:=value.")
        sys.exit(0)
    _started.clear()
    end_on_signals()
    find_publishers()
    send_directly()
    check_log_folder(name)
    try:
        rospy.init_node(name, disable_signals=True, **options)
    except Exception:  # init_node fails if a signal shuts rospy down meanwhile
        if not rospy.core.is_shutdown_requested():
            raise
    if rospy.core.is_shutdown_requested():
        sys.exit(128 + signal.SIGINT)
    rospy.core.add_shutdown_hook(_unregister)
    _started.set()


def _unregister(_reason: str) -> None:
    """Unregister this node's subscription to the parameter SUBSCRIBED_PARAMETER.

    rospy does not do this when the node ends, so the master would keep the node's address. When a
    node of the same name starts later, the master would ask the process at this address to shut
    down, which may be a different node by then.
    """
    with contextlib.suppress(OSError, rosgraph.MasterException):  # no master
        rosgraph.Master(rospy.get_name()).unsubscribeParam(
            rospy.get_node_uri(), SUBSCRIBED_PARAMETER
        )


def end_on_signals() -> None:
    """Handle Ctrl-C and SIGTERM in a separate thread instead of rospy's signal handler.

    Call this in the main thread. rospy's handler has two errors. It shuts the node down while the
    main thread is interrupted, and waits forever if the main thread holds a lock that the shutdown
    needs, such as the lock of the log. Moreover, a main thread that waits does not notice a signal
    that the kernel delivers to another thread.
    """
    logging.getLogger("rosout").addFilter(_ShutdownLogFilter())
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    for number in SIGNALS:
        signal.signal(number, lambda _number, _frame: None)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    thread = threading.Thread(
        target=_wait_for_signal, args=(read_end,), name="signals", daemon=True
    )
    thread.start()


def _wait_for_signal(read_end: int) -> None:
    while (number := os.read(read_end, 1)[0]) not in SIGNALS:
        pass
    # Shut rospy down in a new thread that is not a daemon, because Python waits for such a thread
    # at exit. All shutdown hooks can therefore finish.
    reason = signal.Signals(number).name
    thread = threading.Thread(target=rospy.signal_shutdown, args=(reason,), name="shutdown")
    # The current thread is a daemon, and a new thread inherits this flag.
    thread.daemon = False
    thread.start()
    if not _started.is_set():
        thread.join(PATIENCE)
        # The shutdown has not finished: without a master, it waits for a lock that init_node does
        # not release.
        if thread.is_alive():
            os._exit(128 + number)


def end_without_master(watch: MasterWatch) -> bool:
    """Return whether the ROS master is lost; if it is, print the reason and end the node."""
    if not (reason := watch.find_loss_reason()):
        return False
    # The reason is printed, because the log topic /rosout needs the master.
    print(f"{rospy.get_name()[1:]}: {reason}: ending", file=sys.stderr)
    rospy.signal_shutdown(reason)
    return True


def iterate_at_period(period: float) -> Iterator[None]:
    """Yield every `period` s of wall time until ROS shuts down.

    If the ROS master is lost, the node ends and the iteration stops.
    """
    master = MasterWatch(rospy.get_name())
    while not (rospy.is_shutdown() or end_without_master(master)):
        yield
        time.sleep(period)


def node_main(
    name: str, about: str, run: Callable[[], object],
    fault: type[Exception] | tuple[type[Exception], ...], **options: bool,
) -> int:  # fmt: skip
    """Start a node, call `run` and return the exit status.

    If `run` raises an exception of type `fault`, the function logs it in one line and returns 1.
    """
    init_node(name, about, **options)
    accept_in_threads()
    try:
        run()
    except fault as error:
        rospy.logfatal("%s", error)
        return 1
    return 0
