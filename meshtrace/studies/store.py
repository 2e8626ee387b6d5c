"""The store of a study: finished steps as lines of one file, each with its checksum.

A line is the SHA-256 digest of a JSON object and that object: the identity of a loop, or the
numbers of one of its items. Lines are appended as items finish. A line that was cut by a power
failure or is damaged is dropped, and its item computed again.
"""

from __future__ import annotations

import hashlib
import json
import math
import operator
import os
import socket
import time
from base64 import b64decode, b64encode
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused, one_line, show, warn
from meshtrace.files import atomic
from meshtrace.kernels.jit import sources
from meshtrace.models import Floats
from meshtrace.parallel import duration

_SYNCHRONIZED = 1.0  # [s] of finished items that a power failure may lose


Item = tuple[Floats, str]
"""Numbers of a finished step, and a text such as an error."""


class Kept:
    """Finished items of one loop by key, kept in a file if there is one."""

    def __init__(
        self,
        items: dict[str, Item],
        digest: str = "",
        file: IO[bytes] | None = None,
        turn: Lock | None = None,
        path: Path | None = None,
    ) -> None:
        self._items, self._digest, self._path = items, digest, path
        self._file, self._turn = file, turn or Lock()
        self._synchronized = time.monotonic()

    def __contains__(self, key: object) -> bool:
        return str(key) in self._items

    def __getitem__(self, key: object) -> Item:
        return self._items[str(key)]

    def of_shape(self, key: object, shape: tuple[int | None, ...]) -> Item:
        """Return an item; refuse numbers of another shape than a study writes (None: any size)."""
        item = numbers, _ = self[key]
        sizes = zip(numbers.shape, shape, strict=False)
        if numbers.ndim != len(shape) or not all(n is None or n == m for m, n in sizes):
            wanted = " x ".join("n" if n is None else str(n) for n in shape)
            reason = Described(f"{str(self._path)!r}: an item of shape {numbers.shape}")
            raise Refused("store", reason, f"items of {wanted} numbers, or a new path")
        return item

    def keep(self, key: object, numbers: ArrayLike, text: str = "") -> Item:
        """Append an item, and return it."""
        numbers = np.asarray(numbers, np.float64)
        if self._file is None:
            return numbers, text
        # all bits of the numbers, which decimal digits may lose
        bits = b64encode(numbers.tobytes()).decode()
        content = {"of": self._digest, "item": str(key), "shape": numbers.shape}
        line = _line(content | {"numbers": bits, "text": text})
        with self._turn:
            # one write of a whole line: a kill leaves it whole, or cut and without its checksum
            self._file.write(line)
            self._file.flush()
        if time.monotonic() - self._synchronized > _SYNCHRONIZED:
            # not after each item: a flush to the disk takes as long as a fast step
            os.fsync(self._file.fileno())
            self._synchronized = time.monotonic()
        self._items[str(key)] = numbers, text
        return numbers, text


class Store:
    """File that keeps the finished items of a study, for a stopped run to resume.

    Parameters
    ----------
    path : path, optional
        The file, a new one or that of the same study; None keeps nothing.
    study : str
        Name of the study.
    """

    def __init__(self, path: str | Path | None = None, study: str = "") -> None:
        self.path, self._study = None if path is None else Path(path), study
        self._end = 0  # of the lines that were read
        self.identities: dict[str, Any] = {}  # of each loop
        self._items: dict[str, dict[str, Item]] = {}  # of each digest of an identity
        self._turn, self._loops, self._lock = Lock(), 0, ExitStack()

    def __reduce__(self) -> Any:
        """Pickle the store without its contents, as workers store nothing."""
        return Store, (self.path, self._study)

    @contextmanager
    def loop(self, name: str, identity: dict[str, Any]) -> Iterator[Kept]:
        """Hold the lock of the store, and yield the finished items of a loop.

        Loops of several threads share the lock.

        Parameters
        ----------
        name : str
            Name of the loop in its study.
        identity : dict
            All that its numbers depend on, as plain data; versions are added.

        Raises
        ------
        Refused
            If another process uses the store, it is none, cannot be written or holds other items.
        """
        if self.path is None:
            with _brief_interruption("no store= was given, with which the same call would resume"):
                yield Kept({})
            return
        # other code may give other digits
        code = {"meshtrace": version("meshtrace"), "kernels": sources().hex()}
        # as it will be read back: tuples become lists
        here = json.loads(json.dumps(identity | code | {"study": self._study}))
        digest = digest_of(here, name)
        with self._held():
            with self._turn:
                file = self._opened(name, here)
            with (
                file,
                _brief_interruption(f"finished steps are in {self.path}: the same call resumes"),
            ):
                yield Kept(self._items.setdefault(digest, {}), digest, file, self._turn, self.path)
                with self._turn:
                    os.fsync(file.fileno())
                    self._end = max(self._end, file.tell())

    @contextmanager
    def _held(self) -> Iterator[None]:
        """Hold the lock of the file, which loops of several threads share."""
        assert self.path is not None
        with self._turn:
            if self._loops == 0:
                # a lock of the file is one of the process: threads share it by counting their loops
                self._lock.enter_context(locked(self.path))
            self._loops += 1
        try:
            yield
        finally:
            with self._turn:
                self._loops -= 1
                if self._loops == 0:
                    self._lock.close()

    def _opened(self, name: str, here: dict[str, Any]) -> IO[bytes]:
        """Open the file for appending, and write the identity of a new loop."""
        assert self.path is not None
        first = _line({"loop": name, "identity": here})
        if not self.path.exists():
            # appears with a line: a file without any is no store
            with atomic(self.path) as temporary:
                temporary.write_bytes(first)
        self.read()
        self._require_same(name, here)
        # appended, never rewritten: what was finished cannot be lost by a later line
        file = self.path.open("ab")
        if name not in self.identities:
            file.write(first)
            file.flush()
            self.identities[name] = here
        return file

    def _require_same(self, name: str, here: dict[str, Any]) -> None:
        """Refuse a store of another study, or of one with another identity of a loop."""
        there = self.identities.get(name, here)
        others = [
            identity for identity in self.identities.values() if identity["study"] != self._study
        ]
        if others:
            # another study altogether: the first differing key would only confuse
            there, here = ({"study": identity["study"]} for identity in (others[0], here))
        elif digest_of(there) == digest_of(here):
            return
        held = Described(f"{str(self.path)!r} holds another study ({_difference(there, here)})")
        raise Refused("store", held, "the same arguments, or another path")

    def items(self, name: str) -> Kept:
        """Return the items of a loop that have been read."""
        return Kept(self._items.get(digest_of(self.identities[name], name), {}), path=self.path)

    def read(self) -> None:
        """Read the lines that are new; drop damaged ones from the file, with a warning.

        Raises
        ------
        Refused
            If the file cannot be read, or has no line of a store.
        """
        assert self.path is not None
        try:
            with self.path.open("rb") as file:
                file.seek(self._end)
                lines = file.readlines()
        except OSError as error:
            raise _unusable(self.path, f"{str(self.path)!r}: {error.strerror}") from error
        # a damaged line costs its item alone: each line has a checksum of its own
        sound = [line for line in lines if self._take(line)]
        if not self.identities and not self._items:
            raise _unusable(self.path, f"{str(self.path)!r} is not that of a study")
        # a last line without its end was cut by a kill: it is dropped without a warning
        damaged = sum(line.endswith(b"\n") for line in lines) - len(sound)
        if damaged:
            what = f"{damaged} damaged line{'s' * (damaged > 1)}"
            warn(f"{self.path}: {what}, the items are computed again")
        if len(sound) < len(lines):
            # lines that were read before are sound
            before = self.path.read_bytes()[: self._end]
            with atomic(self.path) as temporary:
                temporary.write_bytes(before + b"".join(sound))
        self._end += sum(map(len, sound))

    def _take(self, line: bytes) -> bool:
        """Add the identity or the item of a line; return whether the line is undamaged."""
        digest, _, content = line.removesuffix(b"\n").partition(b" ")
        if not line.endswith(b"\n") or digest.decode("latin-1") != _digest(content):
            return False
        try:
            self._take_content(json.loads(content))
        except (LookupError, ValueError, TypeError, AttributeError, RecursionError) as error:
            # sound, but written by another program: no damage that a new computation mends
            reason = f"{str(self.path)!r}: a line that no study wrote ({one_line(error)})"
            raise _unusable(Path(self.path or ""), reason) from error
        return True

    def _take_content(self, content: dict[str, Any]) -> None:
        """Add the identity of a loop, or the numbers of an item."""
        if "loop" in content:
            name, identity = content["loop"], content["identity"]
            if not isinstance(name, str) or not isinstance(identity["study"], str):
                raise TypeError("no name of a loop and of its study")
            self.identities[name] = identity
            return
        names = content["of"], content["item"], content["text"]
        if not all(isinstance(name, str) for name in names):
            raise TypeError("names and texts that are none")
        digest, item, text = names
        # validated, since a checksum proves no good intent
        numbers = np.frombuffer(b64decode(content["numbers"], validate=True))
        shape = [operator.index(n) for n in content["shape"]]
        # reshape would take -1 for any size
        if min(shape, default=0) < 0 or math.prod(shape) != numbers.size:
            raise ValueError(f"{numbers.size} numbers of shape {shape}")
        self._items.setdefault(digest, {})[item] = numbers.reshape(shape), text


def is_store(path: Path) -> bool:
    """Return whether a file exists and begins like a store."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        # 64 digits of SHA-256, a blank and the brace of an object
        head = file.read(66)
    return len(head) == 66 and head.endswith(b" {") and head[:64].isalnum()


def _line(content: dict[str, Any]) -> bytes:
    """Return an object as a line of a store: its digest and its JSON."""
    text = json.dumps(content).encode()
    return f"{_digest(text)} ".encode() + text + b"\n"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def digest_of(values: Any, name: str = "") -> str:
    """Return a short digest of long plain data, or of the identity of a loop with its name."""
    # 64 bits: one collision among 2^32 loops
    return _digest(json.dumps([name, values], sort_keys=True).encode())[:16]


def _unusable(path: Path, text: str) -> Refused:
    return Refused("store", Described(text), "one, or a new path")


def _difference(there: Any, here: Any, path: str = "") -> str:
    """Return the first difference of two trees of plain data as text, empty if none."""
    if isinstance(there, dict) and isinstance(here, dict):
        # the same text on every run, whatever the order of the keys
        for key in sorted({*there, *here}):
            inner = f"{path}.{key}" if path else key
            text = _difference(there.get(key), here.get(key), inner)
            if text:
                return text
        return ""
    return "" if there == here else f"{path}: {show(there)} there, {show(here)} here"


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Hold the lock file of a store, which records the owning process.

    The operating system frees the lock of a process that ended in any way; the file of one that
    died on this host is taken over. Nothing waits for a lock.

    Raises
    ------
    Refused
        If another process holds the lock; the message names it and the age of the lock.
    """
    path = Path(f"{store}.lock")
    try:
        file = _held(path)
    except OSError as error:
        problem = Described(f"{str(path)!r}: {error.strerror}")
        raise Refused("store", problem, "a path to write to") from error
    with file:
        try:
            owner = {"host": socket.gethostname(), "pid": os.getpid(), "since": time.time()}
            file.truncate(0)
            file.seek(0)
            file.write(f" {json.dumps(owner)}".encode())  # Windows locks the first byte to readers
            yield
        finally:
            with suppress(OSError):
                file.truncate(0)  # Windows removes no open file
                path.unlink()


def _held(path: Path) -> IO[bytes]:
    """Open and lock a lock file; refuse one that another process holds."""
    from filelock import lock_descriptor

    while True:
        with ExitStack() as stack:
            # not truncated: the file names its owner
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            file = stack.enter_context(open(handle, "r+b", buffering=0))
            free = lock_descriptor(handle, blocking=False)
            owner = _owner(file)
            if free and not _lives_elsewhere(owner):
                with suppress(FileNotFoundError):
                    # the file may have been removed between opening and locking: such a lock binds
                    # nobody
                    if os.path.samestat(os.fstat(handle), path.stat()):
                        stack.pop_all()
                        return file
                continue  # its last owner has just removed it
            who = f"{owner.get('host', 'unknown')}:{owner.get('pid', '?')}"
            age = max(time.time() - float(owner.get("since", time.time())), 0.0)
            used = f"{str(path.with_suffix(''))!r} is in use by {who} for {duration(age)}"
            allowed = f"another path, or none of that process and no {path.name}"
            raise Refused("store", Described(used), allowed)


def _owner(file: IO[bytes]) -> dict[str, Any]:
    """Return the owner that a lock file names; empty for a new or damaged one."""
    for start in (0, 1):  # Windows locks the first byte, a blank
        with suppress(PermissionError, ValueError, TypeError):
            file.seek(start)
            return dict(json.loads(file.read(4096)))
    return {}


def _lives_elsewhere(owner: dict[str, Any]) -> bool:
    """Return whether the owner in a free lock may still run, elsewhere or without its lock."""
    import psutil

    # the lock is free, and its file names nobody, or this process
    if not owner or owner.get("pid") == os.getpid():
        return False
    # file systems over a network may not pass on locks: the file alone has to do
    if owner.get("host") != socket.gethostname():
        return True
    try:
        # numbers of processes are used again
        began = psutil.Process(int(owner["pid"])).create_time()
    except (psutil.Error, KeyError, ValueError, TypeError):
        return False
    return began <= float(owner.get("since", 0.0))  # else another process has its number


@contextmanager
def _brief_interruption(text: str) -> Iterator[None]:
    """Re-raise an interruption of the block with a text, without its traceback.

    A step that is interrupted is some forty lines of frames deep, which tell a user nothing.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(text) from None
