"""Compilation of kernels, with less work than numba does by default, and their cache on disk.

A kernel that is called by another one becomes a *part* of it. Numba also generates machine code, a Python entry point
and a cache file for each part; here a part gets them only when Python calls it. There is one cache file per kernel and
signature, written atomically. If several processes need the same file, one of them compiles it.
"""

from __future__ import annotations

import contextlib
import glob
import hashlib
import os
import pickle
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config, sigutils
from numba.core.caching import CompileResultCacheImpl, _Cache
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.target_extension import (
    CPU,
    current_target,
    dispatcher_registry,
    jit_registry,
    target_override,
    target_registry,
)

from twc_env.kernels.kernel_context import KernelContext, nothing_twice
from twc_env.kernels.kernel_library import KernelLibrary, PartLibrary
from twc_env.running.file_lock import FileLock

_CONSTANTS = (bool, int, float, str, bytes, tuple, np.generic)
_WAIT_MAX_S = 120.0


class Part:
    """Placeholder for the entry point of a compiled kernel that has none."""


class _KernelFlags(Flags):
    """Compiler flags that compare equal for parts and whole kernels, so that both share numba's own functions."""

    _WRAPPERS = frozenset({"no_cpython_wrapper", "no_cfunc_wrapper", "no_compile"})

    @cached_property
    def _meaning(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.options if name not in self._WRAPPERS}

    def __eq__(self, other):
        return isinstance(other, _KernelFlags) and self._meaning == other._meaning

    def __hash__(self):
        return hash((self.nrt, self.error_model))


class KernelCompiler(Compiler):
    """Numba's compiler; a function without a Python entry point becomes a part."""

    def __init__(self, typingctx, targetctx, library, args, return_type, flags, locals):
        flags = _KernelFlags(flags)
        super().__init__(typingctx, targetctx, library, args, return_type, flags, locals)
        context = self.state.targetctx
        KernelContext.take(context)
        context.target = _KernelTarget

    def compile_extra(self, func):
        """Compile a function."""
        codegen, flags = self.state.targetctx.codegen(), self.state.flags
        if flags.no_cpython_wrapper:
            flags.no_compile = True
            self.state.library = PartLibrary(codegen, func.__qualname__)
        else:
            self.state.library = KernelLibrary(codegen, func.__qualname__)
            self.state.library.enable_object_caching()
        return super().compile_extra(func)


class KernelDispatcher(CPUDispatcher):
    """A kernel with all its signatures, each compiled at its first call."""

    def __init__(self, py_func, locals=None, targetoptions=None, pipeline_class=KernelCompiler):
        super().__init__(py_func, {} if locals is None else locals, targetoptions, pipeline_class)
        self._is_asked_by_kernel = False

    def enable_caching(self) -> None:
        """Keep what is compiled from now on on disk for later processes."""
        self._cache = KernelFiles(self.py_func)

    def get_call_template(self, args, kws):
        """Called by numba while it compiles a caller."""
        self._is_asked_by_kernel = True
        try:
            return super().get_call_template(args, kws)
        finally:
            self._is_asked_by_kernel = False

    def compile(self, sig):
        """The entry point for a signature; a part is enough while a caller is being compiled."""
        with global_compiler_lock:
            is_part, self._is_asked_by_kernel = self._is_asked_by_kernel, False
            args = tuple(sigutils.normalize_signature(sig)[0])
            if not is_part and args in self.overloads and isinstance(self.overloads[args].entry_point, Part):
                del self.overloads[args]
            self.targetoptions["no_cpython_wrapper"] = is_part
            if args in self.overloads:
                return super().compile(sig)
            if is_part or not isinstance(self._cache, KernelFiles):
                with _for_a_kernel():
                    return super().compile(sig)
            with self._cache.reserved(sig, self.targetctx), _for_a_kernel():
                return super().compile(sig)

    def add_overload(self, cres):
        """Register a compiled function, or one loaded from disk."""
        if cres.entry_point is None:
            cres = cres._replace(entry_point=Part())
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
            self.overloads[tuple(cres.signature.args)] = cres
            return
        if (
            cres.referenced_envs is None
        ):  # just compiled: now there is machine code that refers to the environments of its parts
            for environment in cres._find_referenced_environments():
                cres.library.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)


@contextlib.contextmanager
def _for_a_kernel() -> Iterator[None]:
    """Within this context numba compiles for a kernel."""
    if current_target() == _TARGET:
        yield
    else:
        with target_override(_TARGET), nothing_twice():
            yield


_TARGET = "twc_env kernel"


class _KernelTarget(CPU):
    """Target of kernels: those of numba's own functions that typing requests become parts."""


def _part_of_numba(**options: Any):
    return lambda function: KernelDispatcher(function, targetoptions={**options, "no_cfunc_wrapper": True})


target_registry[_TARGET] = _KernelTarget
dispatcher_registry[_KernelTarget] = KernelDispatcher
jit_registry[_KernelTarget] = _part_of_numba


class _OnlyReading:
    """Makes a cache locator of numba accept a folder that is not writable."""

    def ensure_cache_path(self):
        """The folder is not written to."""


_READ_ONLY: tuple[Any, ...] = tuple(
    type(f"ReadOnly{place.__name__}", (_OnlyReading, place), {})
    for place in CompileResultCacheImpl._locator_classes[:2]
)
"""The folder of NUMBA_CACHE_DIR, and the one beside the source."""


class _Places(CompileResultCacheImpl):
    """Numba's cache locators, followed by read-only folders that another user may have filled."""

    _locator_classes = (*CompileResultCacheImpl._locator_classes, *_READ_ONLY)


class KernelFiles(_Cache):
    """Cache files of the compiled signatures of one kernel: beside its source, or in NUMBA_CACHE_DIR.

    A user who may not write there, as in a shared installation, reads that folder and keeps other files elsewhere.
    """

    def __init__(self, function: Any):
        self._function = function
        self._paths: dict[Any, Path | None] = {}
        self._is_enabled = True

    @cached_property
    def _impl(self) -> CompileResultCacheImpl | None:
        try:
            return _Places(self._function)
        except RuntimeError:  # its source is in no file
            return None

    @property
    def cache_path(self) -> str | None:
        """The folder that files are written to, or None."""
        impl = self._impl
        return None if impl is None or isinstance(impl.locator, _READ_ONLY) else impl.locator.get_cache_path()

    @cached_property
    def _shared(self) -> Path | None:
        """The read-only folder of files of another user; None if this process can write there."""
        file = self._function.__code__.co_filename
        for place in _READ_ONLY:
            locator = place.from_function(self._function, file)
            if locator is not None:
                return None if locator.get_cache_path() == self.cache_path else Path(locator.get_cache_path())
        return None

    def load_overload(self, sig, target_context):
        """The compiled code of a signature on disk, or None.

        Unlike numba's method this does not load all registries of numba: compiled code needs its runtime only.
        """
        path, impl = self._path(sig, target_context.codegen()), self._impl
        if path is None or impl is None:
            return None
        try:
            content = pickle.loads(path.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        rtsys.initialize(target_context)
        return impl.rebuild(target_context, content)

    def save_overload(self, sig, data):
        """Write compiled code to disk; files of earlier versions of the sources are deleted."""
        if data.entry_point is None:  # a part
            return
        path, impl = self._path(sig, data.codegen), self._impl
        if path is None or impl is None or self.cache_path is None or not impl.check_cachable(data):
            return
        path = Path(self.cache_path, path.name)
        temporary = path.with_suffix(f".{os.getpid()}.tmp")
        with contextlib.suppress(OSError):
            try:
                temporary.write_bytes(dumps(impl.reduce(data)))
                os.replace(temporary, path)
            except OSError:  # no room
                temporary.unlink(missing_ok=True)
            for other in self._all_files():
                if other.name.split(".")[-3] != path.name.split(".")[-3]:
                    other.unlink()

    @contextlib.contextmanager
    def reserved(self, sig, target_context) -> Iterator[None]:
        """Within this context other processes do not compile this; they wait and then find it on disk."""
        path = self._path(sig, target_context.codegen())
        if path is None or self.cache_path is None or path.exists():
            yield
        else:
            with FileLock(path.with_suffix(".lock")).held(_WAIT_MAX_S):
                yield

    def _path(self, sig, codegen) -> Path | None:
        if self._impl is None or not self._is_enabled:
            return None
        if sig not in self._paths:
            state, _ = _foundation(self._function, self._impl)
            code, cells = self._function.__code__.co_code, self._function.__closure__ or ()
            meant = sig, codegen.magic_tuple(), numba.__version__, config.BOUNDSCHECK
            key = hashlib.sha256(repr(meant).encode() + code)
            key.update(dumps(tuple(cell.cell_contents for cell in cells)))
            name = f"{self._impl.filename_base}.{state[:12]}.{key.hexdigest()[:24]}.nbc"
            is_shared = self._shared is not None and (self._shared / name).exists()
            folder = self._shared if is_shared else self.cache_path
            self._paths[sig] = None if folder is None else Path(folder, name)
        return self._paths[sig]

    def _all_files(self) -> list[Path]:
        if self._impl is None or self.cache_path is None:
            return []
        return list(Path(self.cache_path).glob(f"{glob.escape(self._impl.filename_base)}.*.*.nbc"))

    def enable(self) -> None:
        """Use the disk cache from now on."""
        self._is_enabled = True

    def disable(self) -> None:
        """Do not use the disk cache from now on."""
        self._is_enabled = False

    def flush(self) -> None:
        """Delete the files on disk."""
        for path in self._all_files():
            path.unlink(missing_ok=True)


_FOUNDATIONS: dict[int, tuple[str, dict[str, Any]]] = {}
"""Digests by identity of the global namespace of a file, which is kept alive with it."""


def _foundation(function: Any, impl: CompileResultCacheImpl | None = None) -> tuple[str, dict[str, Any]]:
    """Digest of all that the kernels of a file depend on: the file, and the kernels and constants it imports."""
    names = function.__globals__
    if id(names) not in _FOUNDATIONS:
        digest = hashlib.sha256(repr((impl or CompileResultCacheImpl(function)).locator.get_source_stamp()).encode())
        for name, value in sorted(names.items()):
            if name.startswith("__"):
                continue
            if isinstance(value, Dispatcher):
                if value.py_func.__globals__ is not names:
                    digest.update(_foundation(value.py_func)[0].encode())
            elif isinstance(value, np.ndarray):
                digest.update(f"{name} {value.dtype.str} {value.shape}".encode() + value.tobytes())
            elif isinstance(value, _CONSTANTS):
                digest.update(f"{name} {value!r}".encode())
        _FOUNDATIONS[id(names)] = digest.hexdigest(), names
    return _FOUNDATIONS[id(names)]
