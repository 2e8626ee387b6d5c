"""Output files: check before the run, and atomic replacement."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from meshtrace.errors import Refused

_ALLOWED = "a file in an existing folder, both writable"


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` when the block ends without an error.

    The temporary file lies in the folder of the target and has its suffix, so that writers which
    choose a format by the name work as usual. It is synchronized to the disk before it is renamed:
    a reader finds the old file or the new one, whole. Permissions of an existing file are kept,
    and a symbolic link still points to its target, which is replaced.

    Parameters
    ----------
    path : path
        Target, new or a regular file.

    Raises
    ------
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
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{secrets.token_hex(6)}{target.suffix}")
    try:
        # created here, with the permissions that a new file gets; a writer may replace it
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        mode = stat.S_IMODE((target if target.exists() else temporary).stat().st_mode)
        yield temporary
        temporary.chmod(mode)
        _synchronize(temporary)
        os.replace(temporary, target)
        _synchronize(target.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _synchronize(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    if os.name == "nt":  # folders cannot be opened there, files only for writing
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_writable(
    path: str | Path, inputs: Iterable[str | Path | None] = (), field: str = "--output"
) -> None:
    """Check before the work that an output file can be written.

    Parameters
    ----------
    path : path
        Output file.
    inputs : iterable of path or None
        Files that the work reads, or writes too; None is ignored.
    field : str
        Name of the argument, for the message.

    Raises
    ------
    Refused
        If the path is one of these, a folder, a device, a FIFO or a read-only file, if its name is
        too long, or if its folder does not exist or is read-only.
    """
    try:
        found = _status(path)
        folder = Path(os.path.realpath(path)).parent
        read_only = not (folder.is_dir() and os.access(folder, os.W_OK))
        if found is not None:
            # no write bit at all: read-only even for a user whom the kernel lets write
            read_only |= not (os.access(path, os.W_OK) and found.st_mode & 0o222)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise Refused(field, str(path), f"{_ALLOWED} ({reason})") from error
    if read_only or (found is not None and not stat.S_ISREG(found.st_mode)):
        raise Refused(field, str(path), _ALLOWED)
    for name in inputs:
        if name is not None and _same(name, path, found is not None):
            raise Refused(field, str(path), "a file other than the input and other outputs")


def _same(name: str | Path, path: str | Path, exists: bool) -> bool:
    """Return whether two names are those of one file, which may not exist yet."""
    if exists and os.path.exists(name):
        return os.path.samefile(name, path)
    return os.path.realpath(name) == os.path.realpath(path)


def _status(path: str | Path) -> os.stat_result | None:
    """Return the status of a file, None if there is none."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None
