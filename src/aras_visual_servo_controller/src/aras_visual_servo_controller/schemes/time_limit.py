"""Time limits for user-defined code.

A watchdog thread checks all running calls every CHECK_PERIOD. It raises an exception in a call that
exceeds its limit. The time of a call is counted in checks, so it does not include the time in which
the process is suspended or at a debugger's prompt. The thread ends when there are no calls to
check.

Python raises the exception between two bytecode instructions. A call that blocks outside of Python
can be interrupted only in the main thread, by a signal. Compiled code that holds the interpreter
lock cannot be interrupted, nor can code that catches all exceptions and continues.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType, TracebackType
from typing import TypeVar

from aras_visual_servo_base.names import format_error

from ..errors import MeasurementError, SchemeError, UnresponsiveSchemeError

T = TypeVar("T")

CHECK_PERIOD = 0.25  # time between two checks of the running calls, s
RETRY_CHECKS = 4  # number of checks between two interruptions of the same call
IDLE_CHECKS = 4  # number of checks after which the thread ends if no call is running
PYTHON_FOLDER = str(Path(os.__file__).parent)
# Signal that interrupts a blocking call in the main thread. SIGINT is not used, because a process
# that a script has started in the background ignores SIGINT.
WAKE_SIGNAL = signal.SIGRTMAX
# modules whose code is running while a debugger waits at its prompt
DEBUGGERS = ("bdb", "pydevd", "_pydevd_bundle")


class TimeLimitExceeded(BaseException):
    """Exception raised in a call that takes too long.

    It is not an `Exception`, so that `except Exception` in user code does not catch it.
    """


class _Call:
    """A running call: its thread, the number of checks left until its limit, and its state."""

    __slots__ = ("is_done", "is_interrupted", "is_interrupting", "remaining_checks", "thread")

    def __init__(self, limit: float) -> None:
        self.thread, self.remaining_checks = threading.get_ident(), limit / CHECK_PERIOD
        self.is_interrupting = self.is_interrupted = self.is_done = False


_calls: set[_Call] = set()
_watch_thread: threading.Thread | None = None
_thread_lock = threading.Lock()


def call_user_code(
    call: Callable[..., T], *arguments: object, limit: float, scheme: str = ""
) -> T:
    """Call a function of user-defined code within a time limit, and return its result.

    Args:
        limit: wall time that the call may take, s. The call may be interrupted up to two
            CHECK_PERIODs later.
        scheme: name of the scheme, for messages; with '', exceptions are passed on unchanged.

    Raises:
        UnresponsiveSchemeError: the call took longer; the message names the function and its line.
        MeasurementError: the call raised it, because this image cannot be used for control.
        SchemeError: any other exception of the call, including SystemExit, if `scheme` is given.
    """
    here = _Call(limit)
    try:
        try:
            _calls.add(here)
            if _watch_thread is None:
                _start_watch()
            return call(*arguments)
        finally:
            _end_call(here)
    # This also catches an exception that an interrupted call raises in its own clean-up code.
    except BaseException as error:
        _end_call(here)
        if here.is_interrupted:
            place = _find_place(error.__traceback__)
            owner = getattr(call, "__self__", None)
            name = call.__name__ if owner is None else f"{type(owner).__name__}.{call.__name__}"
            text = f"{name} did not end within {limit:g} s: it was in {place}"
            raise UnresponsiveSchemeError(
                f"scheme {scheme}: {text}" if scheme else text, traceback.format_exc()
            ) from None
        if not scheme or isinstance(error, (MeasurementError, SchemeError, KeyboardInterrupt)):
            raise
        raise SchemeError(
            f"scheme {scheme} raised {format_error(error)}", traceback.format_exc()
        ) from error


def _end_call(here: _Call) -> None:
    """Mark a call as finished, and cancel an exception that is still pending for it."""
    here.is_done = True
    _calls.discard(here)
    while here.is_interrupting:
        time.sleep(0.0)
    if here.is_interrupted:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(here.thread), None)


def _find_place(trace: TracebackType) -> str:
    """Return the function and line in which an exception occurred, outside the standard library."""
    place = ""
    while trace is not None:
        code = trace.tb_frame.f_code
        if not code.co_filename.startswith(PYTHON_FOLDER):
            place = f"{code.co_qualname} ({Path(code.co_filename).name}, line {trace.tb_lineno})"
        trace = trace.tb_next
    return place


def _start_watch() -> None:
    global _watch_thread
    if threading.current_thread() is threading.main_thread():
        signal.signal(WAKE_SIGNAL, _wake)
    with _thread_lock:
        if _watch_thread is None:
            _watch_thread = threading.Thread(target=_watch_calls, name="time limits", daemon=True)
            _watch_thread.start()


def _watch_calls() -> None:
    """Check the running calls periodically; end after IDLE_CHECKS checks without a call."""
    global _watch_thread
    known: set[_Call] = set()
    # time.sleep is not used, because user code or a test can replace it.
    idle, pause = 0, threading.Event()
    while True:
        pause.wait(CHECK_PERIOD)
        now = set(_calls)
        for call in now & known:
            call.remaining_checks -= 1
            if call.remaining_checks <= 0:
                _interrupt(call)
        known, idle = now, 0 if now else idle + 1
        if idle >= IDLE_CHECKS:
            with _thread_lock:
                if not _calls:  # end this thread; the next call starts a new one
                    _watch_thread = None
                    return


def _interrupt(call: _Call) -> None:
    """Raise the Interruption in a call that is still running."""
    frame = sys._current_frames().get(call.thread)
    if _is_debugged(frame):
        return
    call.remaining_checks += RETRY_CHECKS
    again = call.is_interrupted
    # Set the flag before reading `is_done`. `_end_call` sets `is_done` before reading the flag, so
    # at least one of the two threads notices the other.
    call.is_interrupting = True
    if not call.is_done:
        call.is_interrupted = True
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(call.thread), ctypes.py_object(TimeLimitExceeded)
        )
        main = threading.main_thread().ident == call.thread
        if again and main and signal.getsignal(WAKE_SIGNAL) is _wake:
            with contextlib.suppress(OSError):
                signal.pthread_kill(call.thread, WAKE_SIGNAL)
    call.is_interrupting = False


def _wake(*_: object) -> None:
    """Raise the Interruption in the main thread, unless the call has ended meanwhile."""
    here = threading.main_thread().ident
    if any(call.is_interrupted and not call.is_done and call.thread == here for call in _calls):
        raise TimeLimitExceeded


def _is_debugged(frame: FrameType | None) -> bool:
    """Return whether a thread is at a debugger's prompt."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in DEBUGGERS:
            return True
        frame = frame.f_back
    return False


def _reset_after_fork() -> None:
    """Remove the calls and the thread in a forked child process, in which they do not exist."""
    global _thread_lock, _watch_thread
    _thread_lock, _watch_thread = threading.Lock(), None
    _calls.clear()


os.register_at_fork(after_in_child=_reset_after_fork)
