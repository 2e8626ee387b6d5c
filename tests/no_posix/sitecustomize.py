"""A Python without what Windows lacks: fcntl, resource, symbolic links, forks and signal handlers.

`pytest --no-posix` runs it, and so does each Python that the tests start, by PYTHONPATH. Libraries
keep what they have for this system: on Windows they have something else.
"""

import builtins
import os
import signal
import sysconfig

ABSENT = {
    builtins: ("fcntl", "resource"),
    os: ("fork", "forkpty", "killpg", "mkfifo", "pread", "pwrite", "sched_getaffinity"),
    signal: ("SIGALRM", "pthread_kill", "setitimer"),
}
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
_import = builtins.__import__


def _import_here(name, globals=None, *rest, **named):
    of_library = str((globals or {}).get("__file__")).startswith(_LIBRARIES)
    if name in ABSENT[builtins] and not of_library:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return _import(name, globals, *rest, **named)


def _no_link(*_args, **_options):
    raise OSError("A required privilege is not held by the client")


builtins.__import__ = _import_here
for _module in (os, signal):
    for _name in ABSENT[_module]:
        if hasattr(_module, _name):
            delattr(_module, _name)
os.symlink = _no_link
