"""A limit of the time that a user's code may take.

One thread looks every PERIOD at the calls under way, and raises in what runs beyond its limit. It
counts its own looks: a process that was stopped, or a person at a debugger's prompt, takes no time.
It ends while there is nothing to look at, so that a process at rest has no thread of it.

Python raises between two of its instructions. A call that waits without end outside of Python is
interrupted by a signal in the main thread, and in no other; compiled code that keeps the
interpreter, and code that catches everything and continues, are interrupted nowhere.
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

from ..errors import MeasurementError, SchemeError, SchemeTimeoutError

T = TypeVar("T")

CHECK_PERIOD = 0.25  # s between two looks
RETRY_CHECKS = 4  # looks from one interruption to the next
IDLE_CHECKS = 4  # looks without a call after which the thread ends
PYTHON_FOLDER = str(Path(os.__file__).parent)
# Interrupts a wait in the main thread: SIGINT is ignored in a process that a script has started in
# the background.
WAKE_SIGNAL = signal.SIGRTMAX
DEBUGGERS = ("bdb", "pydevd", "_pydevd_bundle")  # modules of which one runs at a prompt


class Interruption(BaseException):
    """Raised in a call that takes too long: no Exception, so that fewer users' code catches it."""


class _Call:
    """A call under way: its thread, the looks that it may still take, how it was interrupted."""

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
    """Call a function of a user's code within a time limit; returns its answer.

    Args:
        limit: s of wall time that it may take, at least; up to two PERIODs more.
        scheme: name under which its errors are reported; '': they pass as they are.

    Raises:
        SchemeTimeoutError: it took longer: which function, and where it was.
        MeasurementError: as raised by the call: this image cannot be servoed on.
        SchemeError: with a scheme's name, whatever else it raised, SystemExit included.
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
    except BaseException as error:  # code on the way out may raise something else in its place
        _end_call(here)
        if here.is_interrupted:
            place = _find_place(error.__traceback__)
            owner = getattr(call, "__self__", None)
            name = call.__name__ if owner is None else f"{type(owner).__name__}.{call.__name__}"
            text = f"{name} did not end within {limit:g} s: it was in {place}"
            raise SchemeTimeoutError(
                f"scheme {scheme}: {text}" if scheme else text, traceback.format_exc()
            ) from None
        if not scheme or isinstance(error, (MeasurementError, SchemeError, KeyboardInterrupt)):
            raise
        raise SchemeError(
            f"scheme {scheme} raised {format_error(error)}", traceback.format_exc()
        ) from error


def _end_call(here: _Call) -> None:
    """The call is over: nothing is to be raised for it any more."""
    here.is_done = True
    _calls.discard(here)
    while here.is_interrupting:
        time.sleep(0.0)
    if here.is_interrupted:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(here.thread), None)


def _find_place(trace: TracebackType) -> str:
    """The innermost function of a traceback that is none of Python's own, and its line."""
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
    """Look at the calls until none has been seen at IDLE looks."""
    global _watch_thread
    known: set[_Call] = set()
    idle, pause = 0, threading.Event()  # a user's code, or a test, may replace time.sleep
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
                if not _calls:  # a call that is added now finds no thread, and starts one
                    _watch_thread = None
                    return


def _interrupt(call: _Call) -> None:
    """Raise in a call that is still under way."""
    frame = sys._current_frames().get(call.thread)
    if _is_debugged(frame):
        return
    call.remaining_checks += RETRY_CHECKS
    again = call.is_interrupted
    call.is_interrupting = True  # before the look whether it is done: see _end
    if not call.is_done:
        call.is_interrupted = True
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(call.thread), ctypes.py_object(Interruption)
        )
        main = threading.main_thread().ident == call.thread
        if again and main and signal.getsignal(WAKE_SIGNAL) is _wake:
            with contextlib.suppress(OSError):
                signal.pthread_kill(call.thread, WAKE_SIGNAL)
    call.is_interrupting = False


def _wake(*_: object) -> None:
    """Raise in the main thread, unless the call has ended meanwhile."""
    here = threading.main_thread().ident
    if any(call.is_interrupted and not call.is_done and call.thread == here for call in _calls):
        raise Interruption


def _is_debugged(frame: FrameType | None) -> bool:
    """Whether a debugger's prompt waits for a person."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in DEBUGGERS:
            return True
        frame = frame.f_back
    return False


def _reset_after_fork() -> None:
    """A child process has none of the calls and no thread."""
    global _thread_lock, _watch_thread
    _thread_lock, _watch_thread = threading.Lock(), None
    _calls.clear()


os.register_at_fork(after_in_child=_reset_after_fork)
