"""A Python without what Windows lacks: fcntl, resource, symbolic links, forks and signal handlers.

`pytest --no-posix` imports it, and so does each Python that the tests start, by PYTHONPATH.
"""

import contextlib
import os
import signal
import sys
from asyncio import SelectorEventLoop

with contextlib.suppress(ImportError):
    import filelock  # noqa: F401 - on Windows its locks are those of msvcrt


def _no_link(*_args, **_options):
    raise OSError("A required privilege is not held by the client")


def _no_handler(*_args):
    raise NotImplementedError


for _name in ("fcntl", "resource"):
    sys.modules[_name] = None  # as if it were not there
for _module, _names in {
    os: "fork forkpty killpg mkfifo pread pwrite sched_getaffinity sched_setaffinity",
    signal: "SIGALRM pthread_kill setitimer",
}.items():
    for _name in _names.split():
        if hasattr(_module, _name):
            delattr(_module, _name)
os.symlink = _no_link
SelectorEventLoop.add_signal_handler = _no_handler
