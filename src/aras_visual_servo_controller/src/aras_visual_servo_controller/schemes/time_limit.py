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

from aras_visual_servo_base.names import words

from ..errors import MeasurementError, SchemeError, SchemeTimeoutError

T = TypeVar("T")

PERIOD = 0.25  # s between two looks
INSISTENCE = 4  # looks from one interruption to the next
IDLE = 4  # looks without a call after which the thread ends
PYTHON = str(Path(os.__file__).parent)
# Interrupts a wait in the main thread: SIGINT is ignored in a process that a script has started in
# the background.
WAKE = signal.SIGRTMAX
DEBUGGERS = ("bdb", "pydevd", "_pydevd_bundle")  # modules of which one runs at a prompt


class Interruption(BaseException):
    """Raised in a call that takes too long: no Exception, so that fewer users' code catches it."""


class _Call:
    """A call under way: its thread, the looks that it may still take, how it was interrupted."""

    __slots__ = ("done", "interrupted", "interrupting", "looks", "thread")

    def __init__(self, limit: float) -> None:
        self.thread, self.looks = threading.get_ident(), limit / PERIOD
        self.interrupting = self.interrupted = self.done = False


_calls: set[_Call] = set()
_watch: threading.Thread | None = None
_starting = threading.Lock()


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
            if _watch is None:
                _look_on()
            return call(*arguments)
        finally:
            _end(here)
    except BaseException as error:  # code on the way out may raise something else in its place
        _end(here)
        if here.interrupted:
            place = _place(error.__traceback__)
            owner = getattr(call, "__self__", None)
            name = call.__name__ if owner is None else f"{type(owner).__name__}.{call.__name__}"
            text = f"{name} did not end within {limit:g} s: it was in {place}"
            raise SchemeTimeoutError(
                f"scheme {scheme}: {text}" if scheme else text, traceback.format_exc()
            ) from None
        if not scheme or isinstance(error, (MeasurementError, SchemeError, KeyboardInterrupt)):
            raise
        raise SchemeError(
            f"scheme {scheme} raised {words(error)}", traceback.format_exc()
        ) from error


def _end(here: _Call) -> None:
    """The call is over: nothing is to be raised for it any more."""
    here.done = True
    _calls.discard(here)
    while here.interrupting:
        time.sleep(0.0)
    if here.interrupted:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(here.thread), None)


def _place(trace: TracebackType) -> str:
    """The innermost function of a traceback that is none of Python's own, and its line."""
    place = ""
    while trace is not None:
        code = trace.tb_frame.f_code
        if not code.co_filename.startswith(PYTHON):
            place = f"{code.co_qualname} ({Path(code.co_filename).name}, line {trace.tb_lineno})"
        trace = trace.tb_next
    return place


def _look_on() -> None:
    global _watch
    if threading.current_thread() is threading.main_thread():
        signal.signal(WAKE, _wake)
    with _starting:
        if _watch is None:
            _watch = threading.Thread(target=_look, name="time limits", daemon=True)
            _watch.start()


def _look() -> None:
    """Look at the calls until none has been seen at IDLE looks."""
    global _watch
    known: set[_Call] = set()
    idle, pause = 0, threading.Event()  # a user's code, or a test, may replace time.sleep
    while True:
        pause.wait(PERIOD)
        now = set(_calls)
        for call in now & known:
            call.looks -= 1
            if call.looks <= 0:
                _interrupt(call)
        known, idle = now, 0 if now else idle + 1
        if idle >= IDLE:
            with _starting:
                if not _calls:  # a call that is added now finds no thread, and starts one
                    _watch = None
                    return


def _interrupt(call: _Call) -> None:
    """Raise in a call that is still under way."""
    frame = sys._current_frames().get(call.thread)
    if _is_debugged(frame):
        return
    call.looks += INSISTENCE
    again = call.interrupted
    call.interrupting = True  # before the look whether it is done: see _end
    if not call.done:
        call.interrupted = True
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(call.thread), ctypes.py_object(Interruption)
        )
        main = threading.main_thread().ident == call.thread
        if again and main and signal.getsignal(WAKE) is _wake:
            with contextlib.suppress(OSError):
                signal.pthread_kill(call.thread, WAKE)
    call.interrupting = False


def _wake(*_: object) -> None:
    """Raise in the main thread, unless the call has ended meanwhile."""
    here = threading.main_thread().ident
    if any(call.interrupted and not call.done and call.thread == here for call in _calls):
        raise Interruption


def _is_debugged(frame: FrameType | None) -> bool:
    """Whether a debugger's prompt waits for a person."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in DEBUGGERS:
            return True
        frame = frame.f_back
    return False


def _forget() -> None:
    """A child process has none of the calls and no thread."""
    global _starting, _watch
    _starting, _watch = threading.Lock(), None
    _calls.clear()


os.register_at_fork(after_in_child=_forget)
