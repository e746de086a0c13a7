"""``@kernel``: the one place where numba compiles, and keeps what it compiled.

numba's own cache stops the program when a file of it is cut (a power cut does that), when its folder can't be
written or when the disk is full. Here each of these means that a kernel is compiled anew.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import os
import pickle
import re
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints, overload

from fleetmap.model import kernel_cache, kernel_compiler
from fleetmap.model.interrupts import interrupts_later

with interrupts_later():  # numba's import calls C code that calls Python
    import numba
    from numba.core import caching, config
    from numba.core.compiler import CompileResult
    from numba.core.registry import cpu_target

JIT = not vars(config)["DISABLE_JIT"]
"""False with ``NUMBA_DISABLE_JIT=1``: then kernels are plain functions."""

F = TypeVar("F", bound=Callable[..., object])

OPTIONS: dict[str, Any] = {"nogil": True}
"""What all kernels have in common; changed options make all that was compiled stale."""

SUM_BYTES = 16
"""Each file ends in a checksum of the rest. What it doesn't fit is never given to pickle or to the linker."""

saving = threading.Lock()
"""Held while a file is written; a process that ends itself at once waits for it, so that no half one is left."""


@overload
def kernel(signature: F) -> F: ...
@overload
def kernel(signature: str | None = None, *, inline: Literal["never", "always"] = "never") -> Callable[[F], F]: ...
def kernel(signature: str | F | None = None, *, inline: Literal["never", "always"] = "never") -> F | Callable[[F], F]:
    """Compile a function when it is defined, or load what was compiled before.

    Parameters
    ----------
    signature : numba's, as ``i8(i8[:,::1], i8)``; without it the annotations of the parameters say the types: ``int``,
        ``float``, ``bool``, an alias of ``model.kernel_types``, or a ``NamedTuple`` of these
    inline : ``always`` for what is too small to be called; numba's own option

    Returns
    -------
    numba's dispatcher, or a decorator that gives it: kernels call each other. With ``NUMBA_DISABLE_JIT=1`` it is the
    function itself.

    Raises
    ------
    Stopped : the thread was told to stop waiting for kernels, see ``compile_ahead``
    TypeError : an annotation that says no type of numba's
    """
    if callable(signature):
        return kernel()(signature)

    def compile_or_load(function: F) -> F:
        if not JIT:
            return function
        kernel_compiler.before_kernel(function.__module__)
        with interrupts_later():
            dispatcher: Any = numba.njit(inline=inline, **OPTIONS)(function)
            dispatcher._cache = KernelCache(function)
            # What numba.njit does with a signature, but with our cache.
            with numba.core.typeinfer.register_dispatcher(dispatcher):
                dispatcher.compile(signature or _parameter_types(function))
            dispatcher.disable_compile()
        return cast(F, dispatcher)

    return compile_or_load


def _parameter_types(function: Callable[..., object]) -> tuple[Any, ...]:
    """Numba's types of a function's parameters, by their annotations."""
    hints = get_type_hints(function, include_extras=True)
    hints.pop("return", None)
    return tuple(_numba_type(hint, f"{name} of {function.__qualname__}") for name, hint in hints.items())


def _numba_type(hint: Any, name: str) -> Any:
    if hint in (int, float, bool):
        return {int: numba.int64, float: numba.float64, bool: numba.boolean}[hint]
    if get_origin(hint) is Annotated:
        return numba.core.sigutils.normalize_signature(f"({get_args(hint)[1]},)")[0][0]
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        fields = get_type_hints(hint, include_extras=True)
        types = [_numba_type(fields[field], f"{field} of {hint.__name__}") for field in hint._fields]
        return numba.types.NamedTuple(types, hint)
    raise TypeError(f"{name}: {hint} says no type of numba's")


class KernelFiles(caching.IndexDataCacheFile):
    """numba's index and data files of one kernel, each with a checksum behind it."""

    def has(self, machine: tuple[str, ...]) -> bool:
        """Whether what was compiled for this machine is there and whole."""
        for (_, built_for, _), name in self._load_index().items():
            if built_for == machine and _read_whole(self._data_path(name)) is not None:
                return True
        return False

    def _load_index(self) -> dict[tuple[object, tuple[str, ...], object], str]:
        whole = _read_whole(self._index_path)
        if whole is None:
            return {}
        stream = io.BytesIO(whole)
        if pickle.load(stream) != self._version:
            return {}  # what follows may not even be readable by this version of numba
        stamp, overloads = pickle.load(stream)
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> object:
        whole = _read_whole(self._data_path(name))
        if whole is None:
            raise OSError(f"{name} is missing or not whole")  # which numba takes for a miss
        return pickle.loads(whole)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        """Replace a file at once: readers see the old or the new one."""
        content = io.BytesIO()
        yield content
        whole = content.getvalue()
        temporary = f"{filepath}.tmp.{uuid.uuid4().hex[:16]}"
        with saving:
            try:
                Path(temporary).write_bytes(whole + _sum(whole))
                os.replace(temporary, filepath)
            except BaseException:
                Path(temporary).unlink(missing_ok=True)
                raise


class KernelCache(caching.FunctionCache):
    """numba's cache of one kernel, for which no file and no folder is a reason to fail."""

    def __init__(self, function: Callable[..., object]) -> None:
        self._name, self._py_func = repr(function), function
        self._source = Path(inspect.getfile(function)).resolve()
        self._base = _file_base(self._source, function.__qualname__)
        self._cache_path = ""
        self.enable()

    def load_overload(self, sig: object, target_context: object) -> CompileResult | None:
        """What was compiled before, from the first folder that has it whole."""
        target_context.refresh()  # type: ignore[attr-defined]
        key = self._index_key(sig, target_context.codegen())  # type: ignore[attr-defined]
        for folder in kernel_cache.reading_folders(self._source):
            try:
                payload = self._files(folder).load(key)
                if payload is not None:
                    self._cache_path = str(folder)
                    return cast(CompileResult, CompileResult._rebuild(target_context, *payload))
            # Whatever a whole file of another installation makes pickle and numba raise: compile anew.
            except Exception:
                continue
        kernel_compiler.compiles_here()
        return None

    def save_overload(self, sig: object, data: CompileResult) -> None:
        """Keep what was compiled, if there is a folder for it and room on the disk."""
        folder = kernel_cache.writing_folder(self._source)
        if folder is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._files(folder).save(self._index_key(sig, data.codegen), data._reduce())
        except OSError as error:
            kernel_compiler.could_not_save(folder, error)

    def _index_key(self, sig: object, codegen: object) -> tuple[object, ...]:
        """Numba's own, with the signature in words: an index is read before the types that it names are defined."""
        _, *others = super()._index_key(sig, codegen)
        return (str(sig), *others)

    def _files(self, folder: Path) -> KernelFiles:
        return _files(folder, self._source, self._base)


def cached_in(module: str) -> Path | None:
    """The folder of compiled kernels of a module of this package; None if one is missing. Imports nothing."""
    source = kernel_cache.source_of(module)
    folders = kernel_cache.reading_folders(source)
    found = None
    for name in re.findall(r"^@kernel\b.*?^def (\w+)", source.read_text("utf-8"), re.M | re.S):
        base = _file_base(source, name)
        found = next((f for f in folders if _files(f, source, base).has(_machine())), None)
        if found is None:
            return None
    return found


def _files(folder: Path, source: Path, base: str) -> KernelFiles:
    return KernelFiles(str(folder), base, (kernel_cache.stamp(source), OPTIONS))


@cache
def _machine() -> tuple[str, ...]:
    """The processor, as numba's index names it."""
    with interrupts_later():
        return tuple(cpu_target.target_context.codegen().magic_tuple())


def _file_base(source: Path, name: str) -> str:
    """The name of a kernel's files: numba's own but for the line, so that new code replaces the files of old."""
    version = f"py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
    return f"{source.stem}.{name.replace('<', '').replace('>', '')}.{version}"


def _sum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=SUM_BYTES).digest()


def _read_whole(path: str) -> bytes | None:
    """A file without its checksum; None if the file is missing, can't be read, or doesn't fit its checksum."""
    try:
        content = Path(path).read_bytes()
    except OSError:
        return None
    whole, found = content[:-SUM_BYTES], content[-SUM_BYTES:]
    return whole if len(content) > SUM_BYTES and found == _sum(whole) else None
