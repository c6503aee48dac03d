"""How functions are compiled: equations that compiled code may call, kernels, and where compiled kernels are cached;
and the threads that share work.
"""

import atexit
import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, cached_property, update_wrapper
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

from mgsgraph.atomic_write import lock

Function = TypeVar("Function", bound=Callable[..., Any])
Item = TypeVar("Item")
Result = TypeVar("Result")
_MOMENT = 0.05
"""s between two looks at another process's lock."""


def find_a_place_for_compiled_kernels(package: Path) -> None:
    """Let numba cache beside a checkout's sources, else in the user's cache, else in the temporary folder.

    Not in site-packages: there its files would outlive the package, and a folder `mgsgraph` without a package in it
    hides an editable installation's.

    Parameters
    ----------
    package : Path
        Folder of the package whose kernels are compiled. Called before numba is imported.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    if "site-packages" not in package.parts and os.access(package, os.W_OK):
        return
    caches = _home("XDG_CACHE_HOME", ".cache")
    os.environ["NUMBA_CACHE_DIR"] = str(caches / "mgsgraph" if caches is not None else _temporary_caches())


def find_a_place_for_fonts() -> None:
    """Let matplotlib keep its list of fonts where it may write, so that it need not complain that it can't. Called
    before it is imported.
    """
    homes = ("XDG_CACHE_HOME", ".cache"), ("XDG_CONFIG_HOME", ".config")
    if "MPLCONFIGDIR" in os.environ or all(_home(variable, name) is not None for variable, name in homes):
        return
    os.environ["MPLCONFIGDIR"] = str(_temporary_caches() / "matplotlib")


def _home(variable: str, name: str) -> Path | None:
    """A folder of the user's, by a variable or its name at home; None where nothing can be written there."""
    try:
        folder = Path(os.environ.get(variable) or Path.home() / name)
        folder.mkdir(parents=True, exist_ok=True)
        return folder if os.access(folder, os.W_OK) else None
    except (OSError, RuntimeError):
        return None


@cache
def _temporary_caches() -> Path:
    """A folder of this user alone among temporary ones: what is cached is run, and its name is known to others. Where
    somebody else has made that folder, a new one, which goes with the process.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"mgsgraph-kernels-{user}"
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        if stat.S_ISDIR(about.st_mode) and about.st_uid == user and not about.st_mode & 0o022:
            return folder
    other = tempfile.mkdtemp(prefix="mgsgraph-kernels-")
    atexit.register(shutil.rmtree, other, ignore_errors=True)
    return Path(other)


_equations: list[Callable[..., Any]] = []
"""Those that compiled code doesn't know yet."""


def equation(function: Function) -> Function:
    """A measurement equation, or a part of a kernel that Python may call, too: a pure function of floats and tuples,
    which stays what it is for Python and NumPy arrays. Importing it does not import numba.
    """
    _equations.append(function)
    return function


def make_equations_compilable() -> None:
    """Let compiled code take all equations imported so far in as its own, without a call, so that loops over lanes
    become SIMD. Division by zero gives inf there, as in NumPy; products and sums may be fused.
    """
    from numba.extending import register_jitable

    compilable = register_jitable(forceinline=True, fastmath={"contract", "nsz"}, **options_of_parts())
    while _equations:
        compilable(_equations.pop())


class _Deferred:
    """Stands for a function's numba dispatcher, which is not made before it is called or asked for something, as
    compiled code does, for its type: numba takes long to import.
    """

    def __init__(self, function: Callable[..., Any], make: Callable[[], Any], plain: bool = False) -> None:
        update_wrapper(self, function)
        self.py_func, self._make, self._plain = function, make, plain

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's; the function itself where it compiles nothing (NUMBA_DISABLE_JIT)."""
        _watch_compiler()
        return self._make()

    def __call__(self, *arguments: Any) -> Any:
        if self._plain and "numba" not in sys.modules and _few(len(arguments[0])):
            import numpy as np

            with np.errstate(all="ignore"):
                return self.py_func(*arguments)
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:
        return self.py_func.__qualname__


class _Kernel(_Deferred):
    """The same of what Python calls; compiled code can't."""

    _numba_type_ = None


_FEW = 1000
"""Items of all loops that plain Python does in a process, in 0.05 s or less; numba takes 0.3 s to be loaded."""
_done = 0


def _few(items: int) -> bool:
    """Whether so many items more are few."""
    global _done
    _done += items
    return _done <= _FEW


def compiled(function: Function) -> Function:
    """Compile a part of a kernel, which compiled code alone calls; division by zero gives inf, as in NumPy."""

    def make() -> Any:
        from numba import njit

        return njit(**options_of_parts())(function)

    return cast(Function, _Deferred(function, make))


def options_of_parts() -> dict[str, Any]:
    """Options of numba for what compiled code alone calls, without entries for Python and C; division by zero gives
    inf, as in NumPy. None makes an array: those that come and go need not be counted (NumPy's runtime in Numba, nrt).
    """
    entries = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return {"error_model": "numpy", "pipeline_class": compiler_of_parts(), "_nrt": False, **entries}


@cache
def compiler_of_parts() -> type:
    """Numba's compiler for functions that compiled code alone calls: they are optimized and made into machine code
    where they are taken in, not by themselves before, which halves the time. Python gets a TypeError from them.
    """
    from ctypes import c_void_p, cast, pythonapi

    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler

    refusal = cast(pythonapi.PyErr_BadArgument, c_void_p).value

    class Part(JITCodeLibrary):
        def _optimize_final_module(self) -> None:
            pass

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int | None:
            self._ensure_finalized()
            return refusal

        @property
        def codegen(self) -> Any:
            return self

        def set_env(self, name: str, environment: Any) -> None:
            pass

    class CompilerOfParts(Compiler):
        def __init__(self, typing: Any, target: Any, library: Any, *more: Any) -> None:
            super().__init__(typing, target, library or Part(target.codegen(), "part"), *more)

    return CompilerOfParts


def cached_kernel(function: Function, plain: bool = False, **options: Any) -> Function:
    """Compile a function that Python calls, as `compiled` does, and cache it on disk; `options` of `numba.njit`.
    A `plain` one, a loop over its first argument, runs as Python where the process has needed no compiled code so far
    and little is to be done (`_few`); results differ by rounding.

    Numba looks for changes in the function's file alone; this cache looks at all files of its folder and of `factors`
    (`sources_of`). Of processes that need a kernel at once one compiles it, and the others wait for what it stores.
    """
    return cast(Function, _Kernel(function, lambda: _with_cache(function, options), plain))


def _with_cache(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Numba's dispatcher of a function that Python calls."""
    from numba import njit
    from numba.core.caching import CompileResultCacheImpl, FunctionCache
    from numba.core.codegen import ll  # type: ignore[attr-defined]
    from numba.core.runtime.nrt import rtsys

    class Code(CompileResultCacheImpl):
        def reduce(self, data: Any) -> Any:
            """Machine code without the bitcode that it is made from, which would take longer to load: only compiled
            code that takes a kernel in would need it, and none does. What remains says that there are functions.
            """
            (name, kind, (code, _)), *more = super().reduce(data)
            names = data.fndesc.llvm_cpython_wrapper_name, data.fndesc.llvm_func_name
            stub = "\n".join(f'define void @"{name}"() {{ ret void }}' for name in names)
            return (name, kind, (code, ll.parse_assembly(stub).as_bitcode())), *more

    class Cache(FunctionCache):
        _impl_class = Code

        def __init__(self, function: Callable[..., Any]) -> None:
            super().__init__(function)
            self._cache_file._version += digest  # compared before anything is unpickled: classes may be gone or renamed
            self._turn = -1  # descriptor of the lock, as long as this process compiles

        def load_overload(self, signature: Any, target: Any) -> Any:
            found = self._from_disk(signature, target)
            if found is None and self._turn < 0:
                self._turn = _take_turn(Path(self.cache_path) / f"{function.__name__}.lock")
                found = self._from_disk(signature, target)
            if found is not None:
                self.end_turn()
            else:
                make_equations_compilable()
            return found

        def _from_disk(self, signature: Any, target: Any) -> Any:
            """None if it is not there; numba's tables of all that it compiles, which import SciPy, stay out."""
            rtsys.initialize(target)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, target)

        def save_overload(self, signature: Any, data: Any) -> None:
            try:
                super().save_overload(signature, data)
            finally:
                self.end_turn()

        def end_turn(self) -> None:
            if self._turn >= 0:
                os.close(self._turn)
            self._turn = -1

    digest = sources_of(function)
    kernel = njit(nogil=True, error_model="numpy", **options)(function)
    if hasattr(kernel, "enable_caching"):  # else it is plain Python (NUMBA_DISABLE_JIT)
        kernel._cache = Cache(function)
    return kernel


_one_at_a_time = Lock()


def address_of(kernel: Any, arguments: dict[str, Any]) -> Any:
    """Where a kernel's machine code lies, compiled or loaded for arguments like those of its parameters' names, and for
    no others from then on, so that other kernels may call it without taking it in; the function itself where nothing
    is compiled (NUMBA_DISABLE_JIT).
    """
    from numba import typeof

    if not hasattr(kernel, "overloads"):
        return kernel
    kinds = tuple(typeof(arguments[name]) for name in signature(kernel.py_func).parameters)
    with _one_at_a_time:  # of threads that need it at once
        if kinds not in kernel.overloads:
            kernel.compile(kinds)
            kernel.disable_compile()
    found = kernel.overloads[kinds]
    return found.library.get_pointer_to_function(found.fndesc.llvm_func_name)


def _take_turn(path: Path) -> int:
    """Wait for a lock, which goes when the file's descriptor, that is returned, is closed, or with the process."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
    except OSError:  # then each process compiles by itself
        return -1
    _under_way.append(path)
    try:
        while not lock(descriptor):
            time.sleep(_MOMENT)
    except BaseException:
        os.close(descriptor)
        raise
    finally:
        _under_way.pop()
    return descriptor


def compile_beside(kernel: Any, statement: str) -> None:
    """Where a kernel is not cached, let another process compile it by a statement, while this one reads files; that
    process goes with this one.
    """
    if threads() < 2 or not hasattr(kernel, "signatures") or kernel._cache._cache_file._load_index():
        return
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    here = str(Path(__file__).parents[1])  # not the working folder, where there may be another copy of this program
    paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    more = quiet | {"env": os.environ | {"PYTHONPATH": paths}}
    try:  # what numba makes lives as long as the process: there is nothing to collect
        command = [sys.executable, "-P", "-c", f"import gc; gc.disable(); {statement}"]
        process = subprocess.Popen(command, **more)  # type: ignore[call-overload]
    except OSError:  # no file or process more is allowed: then this one compiles it
        return

    def end() -> None:
        process.kill()
        process.wait()

    atexit.register(end)


def sources_of(function: Callable[..., Any], *packages: str) -> str:
    """Digest of the files of a function's folder, of `factors` and of other packages."""
    found = (find_spec(name).origin for name in packages)  # type: ignore[union-attr]
    folders = (Path(str(file)).parent for file in (function.__code__.co_filename, *found))
    return _digest_of(Path(__file__).with_name("factors"), *folders)


_under_way: list[Any] = []
"""What numba is compiling at this moment, one within another."""


def is_compiling() -> bool:
    """Whether a kernel is being compiled, as it is once after an installation; not while one comes from the cache."""
    return bool(_under_way)


@cache
def _watch_compiler() -> None:
    """Let numba say when it begins to compile a function and when it has."""
    from numba.core import event

    class Counting(event.Listener):
        def on_start(self, event: Any) -> None:
            _under_way.append(event.data)

        def on_end(self, event: Any) -> None:
            _under_way.pop()

    event.register("numba:compile", Counting())


def threads() -> int:
    """Threads that compiled code may take: NUMBA_NUM_THREADS, by default one per processor."""
    from numba import config  # get_num_threads would start numba's own threads, whose lock a killed fork keeps for ever

    return int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def in_threads(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    done: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """Results of work on each of some items, in `threads` where there are several: compiled code and NumPy let go of
    the interpreter. `done` is called, by the caller's thread, with how many are.
    """
    many, found = list(items), list[Result]()
    with ThreadPoolExecutor(max(1, min(len(many), threads()))) as pool:
        for result in (pool.map if len(many) > 1 and threads() > 1 else map)(work, many):
            found.append(result)
            done(len(found))
    return found


def shares(size: int, least: int = 1) -> list[slice]:
    """Even parts of 0 .. size - 1, one for each of `threads`; fewer where they would be smaller than `least`."""
    parts = max(1, min(threads(), size // least))
    return [slice(size * k // parts, size * (k + 1) // parts) for k in range(parts)]


@cache
def _digest_of(*folders: Path) -> str:
    """Digest of the sources in folders."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


find_a_place_for_compiled_kernels(Path(__file__).parent)  # before whoever compiles imports numba
find_a_place_for_fonts()
