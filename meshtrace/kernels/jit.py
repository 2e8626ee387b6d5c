"""Compilation of kernels and their cache.

This file and `linker` alone know the inside of numba; all others use the decorators here: `entry`
for functions that Python calls, `inlined` and `outlined` for those that kernels call.

numba counts references: every array in every argument of every call is counted up and down
with atomic instructions. A photon makes some twenty calls with some forty arrays: counting
them took 4.8 microseconds, all of the physics takes 0.2. Kernels make no arrays, and the caller
holds those that it passes, so that the counting is switched off (option `_nrt`) and hot functions
are inlined.
Functions below the entry points are never called from Python and need no wrappers for it,
which saves a third of the compile time.

Compiled kernels are saved in NUMBA_CACHE_DIR, MESHTRACE_CACHE_DIR or the user's cache folder, in a
folder named by the digest of all kernel files: an edit of any of them, which numba's own cache
would miss, starts a new folder. They are pickles, which can run any code: files and folders that
another user owns or can write to are not read. A platform wheel (`.ci/wheel`) holds such a folder,
compiled for every processor of its architecture, which is read where the user's folder has no
kernel.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import inspect
import pickle
import platform
import shutil
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import ccallback, dispatcher
from numba.core.caching import FunctionCache
from numba.core.compiler import CompileResult
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from meshtrace.files import atomic, cache_directory, foreign_hand, make_private
from meshtrace.kernels import linker

# numba's stubs lack fields of its settings, and options of its decorator
config: Any = numba.config
njit: Any = numba.njit

ZERO, ONE = np.int64(0), np.int64(1)
"""Numbers to pass to kernels: a literal has another type, for which numba would compile again."""
NO, YES = np.bool_(False), np.bool_(True)

_SUFFIX = ".kernel"
_ANY_PROCESSOR = "generic", ""
"""Name and features of the processor that shipped kernels are compiled for."""

_KEPT_DIGESTS = 8
"""Number of cache folders kept; an edit of a kernel makes a new one."""

# Waits for another process that compiles a kernel [s]: up to a message, as long as a kernel of
# chains takes to compile; at most, twice the CPU time of the slowest kernel, that of photons.
_SILENT_WAIT = 5.0
_LONGEST_WAIT = 30.0


def kernel_files() -> list[Path]:
    """Return the files that hold kernels: this folder's, and those of the engine that name it."""
    here = Path(__file__).parent
    # Any file that imports this one may hold kernels; a list of them would go out of date.
    engine = sorted(here.parent.glob("engine/**/*.py"))
    return sorted(here.glob("*.py")) + [p for p in engine if b"kernels.jit" in p.read_bytes()]


@cache
def sources() -> bytes:
    """Return a digest of all kernels."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in kernel_files())).digest()


def folder() -> Path:
    """Return the cache folder of these kernels, compiler and Python."""
    # Code of another compiler may not fit, and pickles of another Python may not load.
    versions = (numba.__version__, llvmlite.__version__, platform.python_version())
    digest = hashlib.sha256(sources() + repr(versions).encode()).hexdigest()
    root = Path(config.CACHE_DIR).absolute() if config.CACHE_DIR else cache_directory()
    return root / "kernels" / digest[:16]


def shipped() -> Path:
    """Return the folder of the kernels that a platform wheel holds."""
    return Path(__file__).parent / "compiled" / folder().name


class KernelCache(FunctionCache):
    """Compiled overloads of a function, one file each: a checksum and the pickled object code.

    numba's cache refuses to import where no folder can be written, and executes files as it
    finds them: its index, too, is a pickle, which processes read, extend and write back without a
    lock. Here a folder that cannot be written costs one warning, and a damaged file is
    removed, so that its kernel is compiled and saved again. Files are replaced atomically, and of
    processes that share the folder one compiles a kernel while the others wait for its file, for
    a time: the process may be stopped.
    """

    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._py_func = py_func
        file = Path(inspect.getfile(py_func))
        # Lambdas and functions of tests share names: the source of their file tells them apart.
        self._source = file.read_bytes() if file.is_file() else b""
        name = f"{py_func.__module__}.{py_func.__qualname__}"
        self._prefix = name.replace("<", "").replace(">", "") + "-"
        self._thread_turn = threading.Lock()
        self.enable()

    @property
    def cache_path(self) -> str:
        """Folder of the files."""
        return str(folder())

    def files(self) -> list[Path]:
        """Return the trusted files of the saved and shipped overloads."""
        paths: list[Path] = []
        for place in (folder(), shipped()):
            with contextlib.suppress(OSError):
                paths += place.glob(f"{self._prefix}*{_SUFFIX}")
        return [path for path in paths if _is_trusted(path)]

    @contextlib.contextmanager
    def turn(self, sig: Any, target_context: Any) -> Iterator[None]:
        """Hold the right to compile an overload; wait while another process compiles it.

        A process that ends in any way frees its lock. One that is stopped holds it: after
        `_LONGEST_WAIT` both compile, and the file of the last one stays.
        """
        with contextlib.ExitStack() as stack:
            # threads wait without a limit: the work of their own process ends
            stack.enter_context(self._thread_turn)
            if self._enabled and not self._place(sig, target_context)[1].is_file():
                path = self._path(self._index_key(sig, target_context.codegen()))
                # without a lock in read-only folders and network file systems that have none
                with contextlib.suppress(OSError, NotImplementedError):
                    _make_folder(path.parent)
                    if not foreign_hand(path.parent):
                        lock = _locked(path.with_suffix(".lock"), self._prefix[:-1])
                        stack.enter_context(lock)
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the saved overload of a signature; None if it is missing or damaged."""
        # numba calls `refresh` here, which also loads registries that compilation alone needs
        rtsys.initialize(target_context)
        if not self._enabled:
            return None
        key, path = self._place(sig, target_context)
        try:
            content = path.read_bytes()
        except OSError:
            return None
        # Compared before the pickle is read: a flipped bit of machine code may crash or give wrong
        # numbers.
        checksum, payload = content[:32], content[32:]
        if checksum == hashlib.sha256(payload).digest():
            # An intact file may name a class that its module no longer has.
            with contextlib.suppress(Exception):
                saved_key, overload, kind = pickle.loads(payload)
                if saved_key == key:
                    rebuilt = CompileResult._rebuild(target_context, *overload)
                    # numba restores a library of its own class, which lets kernels call its stubs;
                    # `Whole` refuses
                    rebuilt.library.__class__ = kind
                    return rebuilt
        warnings.warn(f"{path}: damaged, compiled again", stacklevel=2)
        with contextlib.suppress(OSError):
            path.unlink()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the overload of a signature; warn once if that fails."""
        # Dynamic globals are addresses in this process, as of ctypes functions.
        if not self._enabled or data.library.has_dynamic_globals:
            return
        key = self._index_key(sig, data.codegen)
        payload = dumps((key, data._reduce(), type(data.library)))
        path = self._path(key)
        try:
            _make_folder(path.parent)
            if foreign_hand(path.parent):
                return
            if path.is_file() and foreign_hand(path):
                path.unlink()  # else the new file takes its permissions
            with atomic(path, 0o600) as temporary:
                temporary.write_bytes(hashlib.sha256(payload).digest() + payload)
        except OSError as error:
            reason = error.strerror or str(error)
            _warn_once(path.parent, f"{reason}, compiled kernels are not kept")

    def flush(self) -> None:
        """Remove the saved overloads."""
        for path in folder().glob(f"{self._prefix}*{_SUFFIX}"):
            path.unlink(missing_ok=True)

    def _place(self, sig: Any, target_context: Any) -> tuple[Any, Path]:
        """Return key and file of the saved overload, or of the shipped one."""
        key = self._index_key(sig, target_context.codegen())
        path = self._path(key)
        if path.is_file() and _is_trusted(path):
            return key, path
        # key[1] names architecture, processor and features: shipped code is for any processor.
        key = key[0], (key[1][0], *_ANY_PROCESSOR), key[2]
        return key, shipped() / self._path(key).name

    def _path(self, key: Any) -> Path:
        """Return the file of a key, which names signature, processor and code."""
        digest = hashlib.sha256(self._source + repr(key).encode()).hexdigest()
        return folder() / f"{self._prefix}{digest[:16]}{_SUFFIX}"


@contextlib.contextmanager
def _locked(path: Path, kernel: str) -> Iterator[None]:
    """Hold a lock file if it is free within `_LONGEST_WAIT`, else go on without it."""
    from filelock import FileLock, Timeout  # imported here, as saved kernels need no lock

    lock = FileLock(path, thread_local=False)
    try:
        try:
            lock.acquire(timeout=_SILENT_WAIT)
        except Timeout:
            # not a warning, which filters may turn into an error
            longest = f"for {_LONGEST_WAIT:.0f} s at most"
            told = f"waiting {longest} for another process that compiles {kernel} and holds {path}"
            print(told, file=sys.stderr, flush=True)
            lock.acquire(timeout=_LONGEST_WAIT - _SILENT_WAIT)
    except Timeout:
        yield
        return
    try:
        yield
    finally:
        # removed while locked: a process that waits for this file makes a new one
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()


def _is_trusted(path: Path) -> bool:
    """Return whether nobody but this user can have written a saved kernel, else warn once.

    The folder inside the package is as trusted as the package.
    """
    if path.parent == shipped():
        return True
    # Whoever can write to the folder can replace a file in it.
    for place in (path.parent, path):
        try:
            reason = foreign_hand(place)
        except OSError:  # removed meanwhile
            return False
        if reason:
            _warn_once(place, f"{reason}, its compiled kernels are not read")
            return False
    return True


@cache
def _warn_once(place: Path, problem: str) -> None:
    """Warn, once per process, of a folder or file of kernels that is not used."""
    warnings.warn(f"{place}: {problem}; MESHTRACE_CACHE_DIR sets another folder", stacklevel=2)


def _make_folder(path: Path) -> None:
    """Create a cache folder, and remove the oldest sibling folders."""
    if path.is_dir():
        return
    make_private(path)
    with contextlib.suppress(OSError):  # another process may be at it
        by_age = sorted(path.parent.iterdir(), key=lambda p: p.stat().st_mtime, reverse=True)
        for old in by_age[_KEPT_DIGESTS:]:
            shutil.rmtree(old, ignore_errors=True)


class _Entry(CPUDispatcher):
    """Dispatcher of an entry point, which one process at a time compiles."""

    _cache: KernelCache

    def compile(self, sig: Any) -> Any:
        """Load or compile the overload of a signature."""
        with self._cache.turn(sig, self.targetctx), _without_collection():
            return super().compile(sig)


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Pause the collection of cycles, which takes a quarter of the time of a compilation."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _compiled(function: Callable[..., Any], counts: bool) -> Any:
    """Return an entry point that compiles on its first call, and saves its code.

    `counts` is whether references to arrays are counted, see the docstring of the module.
    """
    compiled = njit(
        nogil=True,
        error_model="numpy",
        _nrt=counts,
        no_cfunc_wrapper=True,  # only Python calls it
        pipeline_class=linker.WholeCompiler if linker.LINKED else None,
    )(function)
    if compiled is not function:  # NUMBA_DISABLE_JIT, for debuggers, leaves plain Python
        compiled._cache = KernelCache(function)
        compiled.__class__ = _Entry
    return compiled


def entry(function: Callable[..., Any]) -> Any:
    """Decorate an entry point called from Python: cached on disk, without the GIL."""
    return _compiled(function, counts=False)


def allocating_entry(function: Callable[..., Any]) -> Any:
    """Decorate an entry point called from Python that allocates arrays."""
    return _compiled(function, counts=True)


class _Below(CPUDispatcher):
    """Dispatcher of a function below the entry points, which has no wrapper for Python."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Refuse a call from Python, which would end the process."""
        raise TypeError(
            f"{self.py_func.__name__} is called by kernels only; py_func is its Python code"
        )


def _below(inline: bool) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator of functions below the entry points."""
    # never set to False: what is not set numba inherits from the function that calls
    inlining = {"forceinline": True} if inline else {}

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = njit(
            # Division by 0 gives inf or nan: Python's test costs a branch, and forbids vector code.
            error_model="numpy",
            _nrt=False,
            no_cpython_wrapper=True,
            no_cfunc_wrapper=True,
            pipeline_class=linker.PartCompiler if linker.LINKED else None,
            **inlining,
        )(function)
        if compiled is not function:
            compiled.__class__ = _Below
        return compiled

    return decorate


inlined = _below(inline=True)
"""Decorator of hot functions; they must not make arrays."""

outlined = _below(inline=False)
"""Decorator of functions that few photons reach: kept out of the hot code."""


def record_type(fields: list[tuple[Any, ...]]) -> np.dtype[np.void]:
    """Return the type of a record whose fields kernels read as attributes.

    Plain Python, under NUMBA_DISABLE_JIT, has these attributes for `numpy.record` alone. numba
    needs no such records, and takes twice as long to recognise an array of them in a call.
    """
    return np.dtype((np.record, fields) if config.DISABLE_JIT else fields)


def is_compiled(compiled: Any) -> bool:
    """Return whether an entry point is compiled, in this process or on disk."""
    if not hasattr(compiled, "signatures"):  # a plain function under NUMBA_DISABLE_JIT
        return True
    return bool(compiled.signatures or compiled._cache.files())


@contextlib.contextmanager
def foreign_kernels() -> Iterator[None]:
    """Use this cache for the kernels of an imported package."""
    # numba looks this name up when a function is decorated with cache=True.
    modules: tuple[Any, ...] = dispatcher, ccallback
    for module in modules:
        module.FunctionCache = KernelCache
    try:
        yield
    finally:
        for module in modules:
            module.FunctionCache = FunctionCache
