"""Signals end a node from a thread of their own."""

import signal
import threading

import rospy


def end_on_signals() -> None:
    """Take Ctrl-C and SIGTERM over from rospy; call it after init_node, in the main thread.

    rospy ends the node inside the signal handler, and Python runs that in the main thread, wherever
    it is. In the middle of a log line that holds the lock on the master's proxy, for which the
    handler then waits for ever.
    """

    def end(number: int, _frame: object) -> None:
        reason = signal.Signals(number).name
        threading.Thread(target=rospy.signal_shutdown, args=(reason,), name="shutdown").start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
