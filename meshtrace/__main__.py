"""Command line, as `meshtrace` and `python -m meshtrace`, with Ctrl-C from its first moment."""

from __future__ import annotations

import _thread
import gc
import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

_LATER = 0.05  # [s]
_LLVM = f"{os.sep}llvmlite{os.sep}"
_interrupted = threading.Event()


def main() -> None:
    """Run the command line and exit."""
    # a shell's background jobs ignore Ctrl-C
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    sys.excepthook, sys.unraisablehook = _report, _unraisable
    # imports make some 10^6 objects that stay: at Python's threshold of 700 the search for cycles
    # among them takes an eighth of a warm command
    gc.set_threshold(50_000, 20, 20)
    try:
        from meshtrace.cli import app

        app(prog_name="meshtrace")
    except KeyboardInterrupt:  # while the commands were set up
        print("interrupted", file=sys.stderr)
        sys.exit(130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, once the current import or call of llvmlite is complete.

    Compiled modules turn an interrupted import into other errors, and Python ends by the signal
    if the exception passes through `exec` of a text, as in dataclasses. Objects of LLVM whose
    making was interrupted are freed twice.
    """
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith("<frozen importlib") or _LLVM in file:
            _interrupt_later()
            return
        frame = frame.f_back
    _interrupted.set()
    raise KeyboardInterrupt


def _report(kind: type[BaseException], error: BaseException, traceback: Any) -> None:
    """Print an unraisable error, except Ctrl-C in a callback of a compiled module."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, traceback)


def _unraisable(unraisable: Any) -> None:
    """Raise KeyboardInterrupt again if a callback could not pass it on.

    After it, errors of destructors are those of objects that were not complete.
    """
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _interrupt_later()
    elif not _interrupted.is_set():
        sys.__unraisablehook__(unraisable)


def _interrupt_later() -> None:
    """Send the signal again to the main thread to interrupt a system call."""
    to_main: Any = getattr(signal, "pthread_kill", lambda *_: _thread.interrupt_main())
    signal_of = (threading.main_thread().ident, signal.SIGINT)
    timer = threading.Timer(_LATER, to_main, signal_of)
    timer.daemon = True
    timer.start()


if __name__ == "__main__":
    main()
