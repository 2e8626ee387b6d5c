"""Atomic replacement of files, and the cache folder of a user."""

from __future__ import annotations

import os
import secrets
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from meshtrace.errors import Refused


@contextmanager
def atomic(path: str | Path, mode: int = 0o666) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` when the block ends without an error.

    The temporary file lies in the folder of the target and has its suffix, so that writers which
    choose a format by the name work as usual. It is synchronized to the disk before it is renamed:
    a reader finds the old file or the new one, whole. That of a killed process is removed by the
    next process that writes to the folder from the same host. Permissions of an existing file are
    kept, and a symbolic link still points to its target, which is replaced.

    Parameters
    ----------
    path : path
        Target, new or a regular file.
    mode : int
        Permissions of a new file, less those of the umask.

    Raises
    ------
    Refused
        If `path` is none.
    OSError
        If the file cannot be written; it names the target. The target is unchanged.

    Examples
    --------
    >>> import tempfile
    >>> target = Path(tempfile.mkdtemp()) / "note.txt"
    >>> with atomic(target) as temporary:
    ...     _ = temporary.write_text("all or nothing")
    >>> target.read_text()
    'all or nothing'
    """
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise Refused("path", path, "the path of a file")
    # a link stays one: the file behind it is replaced
    target = Path(os.path.realpath(path))
    _remove_left(target.parent)
    temporary = target.with_name(f"{_prefix()}{os.getpid()}-{secrets.token_hex(6)}{target.suffix}")
    try:
        # created here, with the permissions that a new file gets; a writer may replace it
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
        mode = stat.S_IMODE((target if target.exists() else temporary).stat().st_mode)
        yield temporary
        temporary.chmod(mode)
        # contents before the name, or a crash could leave the new name with an empty file
        _synchronize(temporary)
        os.replace(temporary, target)
        # the new name is an entry of the folder
        _synchronize(target.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _prefix() -> str:
    """Return the start of the names of temporary files of this host."""
    return f".meshtrace-{socket.gethostname()}-"


@cache
def _remove_left(folder: Path) -> None:
    """Remove the temporary files of processes of this host that have ended."""
    import psutil

    with suppress(OSError, OverflowError):
        for left in folder.iterdir():
            before, _, rest = left.name.partition(_prefix())
            owner = rest.partition("-")[0]
            if not before and owner.isdecimal() and not psutil.pid_exists(int(owner)):
                left.unlink(missing_ok=True)


def _synchronize(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    if os.name == "nt":  # folders cannot be opened there, files only for writing
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def cache_directory() -> Path:
    """Return the cache folder of compiled kernels and Mie tables.

    MESHTRACE_CACHE_DIR, or the user's cache folder.

    Returns
    -------
    Path
        For a user without a home folder a path under the null device, where nothing can be
        written: callers warn as for any other folder that is not writable.
    """
    chosen = os.environ.get("MESHTRACE_CACHE_DIR")
    if chosen:
        return Path(chosen).absolute()
    import platformdirs

    try:
        folder = Path(platformdirs.user_cache_dir("meshtrace", appauthor=False))
    except RuntimeError:  # platformdirs 4.4 and later
        folder = Path()
    return folder if folder.is_absolute() else Path(os.devnull, "meshtrace")


def make_private(folder: Path) -> None:
    """Create a folder and its missing parents, which their owner alone can enter."""
    if not folder.parent.exists():
        make_private(folder.parent)
    # the mode of `mkdir` does not hold for parents: each is made here in turn
    folder.mkdir(0o700, exist_ok=True)


def foreign_hand(path: Path) -> str:
    """Return how another user may have written a file or folder, "" if none can have done so.

    That of the superuser is trusted, who can write everywhere. On Windows, whose folders of a user
    are closed to others, all are.
    """
    if os.name != "posix":
        return ""
    status = path.stat()
    if status.st_uid not in (os.geteuid(), 0):
        return f"owned by user {status.st_uid}"
    return "writable by other users" if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""
