"""Replace files atomically; locate the user's cache folder and check who may write to it."""

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
    a reader sees either the complete old file or the complete new one. If a process is killed, the
    next process that writes to the folder from the same host removes its temporary file.
    Permissions of an existing file are preserved. Where `path` is a symbolic link, the file that
    it points to is replaced.

    Parameters
    ----------
    path : path
        Target, new or a regular file.
    mode : int
        Permissions of a new file, reduced by the umask.

    Raises
    ------
    Refused
        If `path` is not a path.
    OSError
        If the file cannot be written, with the name of the target, which is unchanged.

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
    # replacing a link itself would turn it into a file
    target = Path(os.path.realpath(path))
    _remove_left(target.parent)
    temporary = target.with_name(f"{_prefix()}{os.getpid()}-{secrets.token_hex(6)}{target.suffix}")
    try:
        # create it, to see which permissions a new file gets; a writer may replace the file
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
        mode = stat.S_IMODE((target if target.exists() else temporary).stat().st_mode)
        yield temporary
        temporary.chmod(mode)
        # before the renaming, or a crash could leave an empty file under the new name
        _synchronize(temporary)
        os.replace(temporary, target)
        # the renaming has changed the folder
        _synchronize(target.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _prefix() -> str:
    """Return the prefix of temporary file names of this host."""
    return f".meshtrace-{socket.gethostname()}-"


@cache
def _remove_left(folder: Path) -> None:
    """Remove temporary files left in a folder by processes of this host that have ended."""
    import psutil

    with suppress(OSError, OverflowError):
        for file in folder.iterdir():
            in_front, _, rest = file.name.partition(_prefix())
            process = rest.partition("-")[0]
            if not in_front and process.isdecimal() and not psutil.pid_exists(int(process)):
                file.unlink(missing_ok=True)


def _synchronize(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    # Windows can synchronize neither folders nor files that are open only for reading
    if os.name == "nt":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def cache_directory() -> Path:
    """Return the cache folder of compiled kernels and Mie tables.

    It is set by the environment variable MESHTRACE_CACHE_DIR, or else lies in the user's cache
    folder.

    Returns
    -------
    Path
        For a user without a home folder, a path under the null device, where nothing can be
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
    """Create a folder and its missing parents, accessible only to their owner."""
    if not folder.parent.exists():
        make_private(folder.parent)
    # `mkdir` with parents=True would apply the mode to the last folder only
    folder.mkdir(0o700, exist_ok=True)


def foreign_hand(path: Path) -> str:
    """Return why another user may have written a file or folder, "" if none can have done so.

    The superuser, who can write everywhere, is trusted. On Windows all files are, since the cache
    folder of a user is closed to others.
    """
    if os.name != "posix":
        return ""
    status = path.stat()
    if status.st_uid not in (os.geteuid(), 0):
        return f"owned by user {status.st_uid}"
    return "writable by other users" if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) else ""
