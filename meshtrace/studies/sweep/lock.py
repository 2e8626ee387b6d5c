"""The lock that keeps two sweeps from one store."""

from __future__ import annotations

import json
import os
import platform
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from meshtrace.errors import Described, Refused
from meshtrace.parallel import duration


@contextmanager
def locked(store: str | Path | None) -> Iterator[None]:
    """Hold the lock of a store, a file beside it that names its owner.

    The operating system frees the lock of a process that ended in any way; the file of one that
    died on this host is taken over.

    Raises
    ------
    Refused
        If another process holds the lock; the message names it and the age of the lock. On
        Windows, which has no such locks.
    """
    if store is None:
        yield
        return
    path = Path(f"{Path(store)}.lock")
    try:
        handle = _held(path)
    except OSError as error:
        problem = Described(f"{str(path)!r}: {error.strerror}")
        raise Refused("store", problem, "a path to write to") from error
    try:
        owner = {"host": socket.gethostname(), "pid": os.getpid(), "since": time.time()}
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps(owner).encode(), 0)
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def _held(path: Path) -> int:
    """Return the locked file of an open lock."""
    try:
        import fcntl
    except ImportError as error:
        system = Described(f"{str(path.with_suffix(''))!r} on {platform.system()}")
        allowed = "none, or Linux, macOS or the Windows Subsystem for Linux"
        raise Refused("store", system, allowed) from error
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = True
        except BlockingIOError:
            free = False
        owner = _owner(handle)
        if not free or _lives_elsewhere(owner):
            os.close(handle)
            raise _in_use(path, owner)
        try:
            if os.fstat(handle).st_ino == path.stat().st_ino:
                return handle
        except FileNotFoundError:
            pass
        os.close(handle)  # its last owner has just removed it


def _owner(handle: int) -> dict[str, Any]:
    try:
        return dict(json.loads(os.pread(handle, 4096, 0)))
    except (ValueError, TypeError):  # just made, or damaged
        return {}


def _lives_elsewhere(owner: dict[str, Any]) -> bool:
    """Return whether the owner in a free lock may still run, elsewhere or without its lock."""
    import psutil

    if not owner or owner.get("pid") == os.getpid():
        return False
    if owner.get("host") != socket.gethostname():
        return True
    try:
        began = psutil.Process(int(owner["pid"])).create_time()
    except (psutil.Error, KeyError, ValueError, TypeError):
        return False
    return began <= float(owner.get("since", 0.0))  # else another process has its number


def _in_use(path: Path, owner: dict[str, Any]) -> Refused:
    who = f"{owner.get('host', 'unknown')}:{owner.get('pid', '?')}"
    age = max(time.time() - float(owner.get("since", time.time())), 0.0)
    used = Described(f"{str(path.with_suffix(''))!r} is in use by {who} for {duration(age)}")
    return Refused("store", used, f"another path, or none of that process and no {path.name}")
