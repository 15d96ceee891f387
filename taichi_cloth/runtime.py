"""The one caller of ti.init: picks the backend, precision and threads, and says what it got."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import ctypes.util
import gc
import io
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from taichi_cloth import vulkan
from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.front_end import mending
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import ARCHS, PRECISIONS, default_fast_math

BACKENDS = tuple(name for name in ARCHS if name != "gpu")
GPU_ORDER = ("cuda", "metal", "vulkan", "opengl")  # what `gpu` tries, best first

MOST_THREADS = 1024  # Taichi starts as many as it is told, whether the system has them or not

NEEDS = {  # what a backend that is not usable would need
    "cuda": "an NVIDIA GPU with its driver",
    "metal": "macOS on Apple hardware",
    "vulkan": "a Vulkan driver (Mesa's lavapipe serves without a GPU: mesa-vulkan-drivers)",
    "opengl": "an OpenGL 4.3 driver and a display (Xvfb serves)",
}


@dataclass(frozen=True)
class Device:
    """The device of a run. threads: CPU worker threads (1 on other backends).

    precision: f32, f64, or compensated: f32 with compensated sums (`kernels/compensated.py`).
    multiprocessors: of a CUDA GPU, each of which has room for a block of threads; 0 elsewhere.
    """

    arch: str
    precision: str
    threads: int
    fast_math: bool
    multiprocessors: int = 0

    @property
    def real(self) -> str:
        """The type of its numbers: f32 or f64."""
        return _real(self.precision)

    @property
    def compensated(self) -> bool:
        """True if positions and velocities keep what rounding takes from their sums."""
        return self.precision == "compensated"

    def describe(self) -> str:
        threads = f", {self.threads} thread{'s' * (self.threads > 1)}" if self.arch == "cpu" else ""
        return f"{self.arch} {self.precision}{threads}"


class _Start(NamedTuple):
    """The rest of a start. program: Taichi's own, as long as that is there. runtime: has the one
    that runs now. thread: in which it was.
    """

    program: Callable[[], Any]
    runtime: Callable[[], Any]
    thread: Callable[[], threading.Thread | None]


_device: Device | None = None
_start: _Start | None = None  # the last one
# Connections to X servers by name, never closed: a server whose only client leaves starts anew,
# and a window that opens meanwhile would fail.
_displays: dict[str, int] = {}
_passing_caches: list[str] = []  # the folder of `_passing_cache`, once it is needed


def available_cores() -> int:
    """Cores that this process may use: threads that wait for each other need one each."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def current_device() -> Device:
    """The device of the last `start`. Starts the default one where there was none.

    InputError where the program has called `ti.init` since, which ended it.
    """
    if _device and not _is_ours():
        raise InputError(
            "Taichi was started anew by ti.init, with settings of its own; call `start` again, "
            "which ends what that began"
        )
    return _device or start()


def still_runs(device: Device) -> bool:
    """True if `device` is of the last `start`: what an earlier one allocated is gone already, also
    where Taichi was started by another one since.
    """
    return _device is device and _is_ours()


def _is_ours() -> bool:
    """True if Taichi's program is that of the last `start`."""
    program = _start.program() if _start else None
    return _start is not None and program is not None and program is _start.runtime().prog


def in_its_thread() -> bool:
    """True if this is the thread that has started Taichi."""
    return _start is None or threading.current_thread() is _start.thread()


def refuse_other_threads() -> None:
    """InputError in a thread that has not started Taichi: it makes memory only in the one that has,
    and where another one compiles a kernel, it may end the process.
    """
    if not in_its_thread():
        raise InputError(
            "Taichi makes memory and compiles in the thread that started it alone; do in that one "
            "what is done for the first time, or call `start` and make the simulation in this one"
        )


def display_available() -> bool:
    """True if a window can open. Asked before Taichi is, which ends the process if it cannot."""
    if not sys.platform.startswith("linux"):
        return True
    name = os.environ.get("DISPLAY")
    if not name:
        return False
    if name not in _displays:
        try:
            x11 = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        except OSError:
            return False
        x11.XOpenDisplay.restype = ctypes.c_void_p
        # A server may be starting anew at this moment, because its last client just left.
        for pause in (0.0, 0.1, 0.2, 0.4):
            time.sleep(pause)
            display = x11.XOpenDisplay(None)
            if display:
                _displays[name] = display
                break
    return name in _displays


def vulkan_available() -> bool:
    """True if Taichi finds a Vulkan driver."""
    mending.imported()
    from taichi._lib import core

    with _silence():
        return bool(core.GGUI_AVAILABLE and core.with_vulkan())


def usable_backends() -> dict[str, str | None]:
    """For every backend: None where it works here, else what it would need.

    Each is tried in a process of its own, because a driver at fault may end the process.
    """
    probes = {name: _start_probe(name) for name in BACKENDS}
    return {name: _finish_probe(name, probe) for name, probe in probes.items()}


def start(
    arch: str = "cpu",
    precision: str = "f32",
    threads: int | None = None,
    fast_math: bool | None = None,
    cache: bool = True,
) -> Device:
    """Start Taichi on the backend `arch` ("gpu": the best there is) and say what it got.

    threads: CPU worker threads, all cores when absent. fast_math: by default on in f32 and off
    in f64, the reference precision, and in compensated sums, which it would undo. cache: whether
    kernels compiled by earlier processes are used. Fields of an earlier start, or of a `ti.init`,
    are gone, and so are the simulations that were made on it: their methods raise InputError.
    What makes or compiles anything, as a new simulation and the first call of nearly all that it
    can do, is for the thread that called `start`: others, which may call the rest, get InputError.

    Raises InputError where the backend or precision is unknown or not usable here (it is never
    replaced by another one), and for compensated sums with fast_math. RunFailure where the system
    refuses the memory, or the threads.
    """
    accepted.word("--arch", arch, ARCHS)
    accepted.word("--precision", precision, PRECISIONS)
    if threads is not None:
        threads = accepted.whole_number("--threads", threads, 1, MOST_THREADS)
    if fast_math is not None:
        fast_math = accepted.flag("--fast-math", fast_math)
    cache = accepted.flag("cache", cache)
    threads = threads or available_cores()
    if fast_math is None:
        fast_math = default_fast_math(precision)
    if fast_math and precision == "compensated":
        raise InputError(
            "--fast-math: --precision compensated excludes it, which may drop what the sums keep; "
            "give one of them"
        )
    if arch == "gpu":
        lacks = usable_backends()
        best = next((name for name in GPU_ORDER if lacks[name] is None), None)
        if best is None:
            raise InputError("--arch gpu: no GPU backend is usable here; usable: cpu")
        arch = best
    if arch == "metal" and precision == "f64":
        raise InputError("--precision f64: Metal has no f64; use --precision f32 or --arch cpu")
    global _device, _start
    # From here on what was made before is gone: to give it back would be to take what comes.
    _device = None
    try:
        started = _initialize(arch, precision, threads, fast_math, cache)
    except RuntimeError as error:  # Taichi's, with where in its source
        why = " ".join(str(error).rpartition("] ")[2].split()).rstrip(".")
        raise RunFailure(
            f"--arch {arch}: Taichi cannot start: {why}; see that this process may have more "
            f"memory (ulimit -v), and {threads} more threads (ulimit -u)"
        ) from None
    if not started:
        usable = [name for name, lack in usable_backends().items() if lack is None]
        raise InputError(
            f"--arch {arch}: not usable here (it needs {_need(arch)}); usable: {', '.join(usable)}"
        )
    from taichi.lang import impl

    program = weakref.ref(impl.get_runtime().prog)
    _start = _Start(program, impl.get_runtime, weakref.ref(threading.current_thread()))
    multiprocessors = _multiprocessors() if arch == "cuda" else 0
    threads = threads if arch == "cpu" else 1
    _device = Device(arch, precision, threads, fast_math, multiprocessors)
    return _device


def stop() -> None:
    """End what `start` began: only then does Taichi write what it compiled to its cache."""
    global _device
    _device = None
    mending.imported().reset()


def _real(precision: str) -> str:
    """The type of numbers that a precision computes in."""
    return "f64" if precision == "f64" else "f32"


def _initialize(
    arch: str, precision: str, threads: int, fast_math: bool, cache: bool = True
) -> bool:
    """Start Taichi; False where it starts something else, or would crash."""
    if arch == "opengl" and not display_available():
        return False
    ti = mending.imported()
    ti.set_logging_level(ti.CRITICAL)  # it warns of the fallback that we refuse ourselves
    with _silence(), mending.told_nothing():
        _end()
        before = _own_threads()
        ti.init(
            arch=getattr(ti, arch),
            default_fp=getattr(ti, _real(precision)),
            cpu_max_num_threads=threads,
            fast_math=fast_math,
            **({} if cache else {"offline_cache": False}),
            **_cache_that_works(),
            # LLVM does the same again: without it kernels are as fast, and compile in a third of
            # the time.
            cfg_optimization=False,
            # Else each of very many threads ends a loop by an atomic minimum for the watchdog:
            # 70 us of a step on an H100.
            make_thread_local=arch == "cpu",
            # Else CUDA reads by way of a cache that no store reaches what it takes for never
            # written: also what is, but by a real function or component by component.
            detect_read_only=False,
            **_block_size(arch),
            # One task of a kernel is nearly all of it, and each thread reads what Taichi links.
            **({"num_compile_threads": 0} if arch == "cpu" else {}),
            unrolling_limit=0,  # it warns of loops over fields that must be unrolled
            log_level=ti.ERROR,
            verbose=False,
        )
    if arch == "cpu":
        _pin(sorted(_own_threads() - before)[-threads:], threads)
    return ti.cfg.arch in ((ti.x64, ti.arm64) if arch == "cpu" else (getattr(ti, arch),))


def _cache_that_works() -> dict[str, str]:
    """A folder for compiled kernels, where Taichi's own one cannot be made, or not be read.

    It makes and reads that also where it is to keep none, and ends the process where it cannot
    (1.7.4), as in a home of somebody else.
    """
    from taichi.lang import impl

    named = os.environ.get("TI_OFFLINE_CACHE_FILE_PATH")
    folder = named or impl.default_cfg().offline_cache_file_path
    with contextlib.suppress(OSError):
        os.makedirs(folder, exist_ok=True)
    if os.path.isdir(folder) and os.access(folder, os.R_OK | os.X_OK):
        return {}
    return {"offline_cache_file_path": _passing_cache()}


def _passing_cache() -> str:
    """A folder for compiled kernels that is there as long as this process."""
    if not _passing_caches:
        _passing_caches.append(tempfile.mkdtemp(prefix="taichi-cloth-kernels-"))
        atexit.register(_remove_caches)
    return _passing_caches[0]


def _remove_caches() -> None:
    stop()  # Taichi writes to it at its end
    for folder in _passing_caches:
        shutil.rmtree(folder, ignore_errors=True)


def _block_size(arch: str) -> dict[str, int]:
    """Threads in a block of a GPU's outer loops, where it is not Taichi's 128."""
    if arch == "cuda":  # with 128 2048 x 2048 take 1.02 to 1.10 times as long on an H100
        return {"default_gpu_block_dim": 256}
    # Mesa's driver on the processor (22.3) runs 8 threads at once, and where all 8 have nothing to
    # do, the others of their block leave an inner loop with an atomic after its first turn.
    names = vulkan.devices() if arch == "vulkan" else []
    if names and all(vulkan.is_software(name) for name in names):
        return {"default_gpu_block_dim": 8}
    return {}


def _end() -> None:
    """End what was started before, and have Taichi give its memory back now.

    It does once nobody holds its program, by address. Trees of fields hold it, and wait in cycles
    for Python to look: by then what was started next has its arrays at these addresses.
    """
    import taichi
    from taichi._snode.snode_tree import SNodeTree
    from taichi.lang import impl

    program = impl.get_runtime().prog
    if program is None:
        return
    # Not by what refers to it: that is, of all on Python 3.10, a dictionary that nobody tracks.
    for tree in gc.get_objects():
        if type(tree) is SNodeTree and tree.prog is program:
            tree.prog = None  # as of any earlier program: `destroy` does nothing
    del program
    taichi.reset()


def _multiprocessors() -> int:
    """Count the multiprocessors of the first CUDA GPU, by its driver."""
    count, device = ctypes.c_int(), ctypes.c_int()
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    attribute = 16  # CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT
    asked = (
        driver.cuInit(0),
        driver.cuDeviceGet(ctypes.byref(device), 0),
        driver.cuDeviceGetAttribute(ctypes.byref(count), attribute, device),
    )
    return 0 if any(asked) else count.value


def kernel_cache() -> Path:
    """The folder in which Taichi keeps compiled kernels from process to process."""
    from taichi.lang import impl

    return Path(impl.default_cfg().offline_cache_file_path)


def keeps_kernels() -> bool:
    """True if later processes find what this one compiles, since `start`."""
    folder = str(kernel_cache())
    return folder not in _passing_caches and os.access(folder, os.W_OK)


def compilation_time() -> float:
    """Seconds for which Taichi has compiled kernels, or read them from its cache, since `start`."""
    from taichi.lang import impl

    return float(impl.get_runtime().prog.get_total_compilation_time())


def whole_vectors() -> contextlib.AbstractContextManager[None]:
    """While it lasts, kernels are compiled with each vector or matrix as one vector of LLVM's.

    Taichi takes them apart into numbers otherwise, and LLVM (15), told nothing of the processor's
    width, packs those into vectors of 16 bytes again. Kept whole, they become the widest
    instructions that the processor has. `kernels/packs.py` says what such kernels must not do.
    """
    return _compiled_with(real_matrix_scalarize=False)


def sums_in_order() -> contextlib.AbstractContextManager[None]:
    """While it lasts, kernels are compiled without `fast_math`.

    It lets the compiler add in another order, and another one for each number of threads: sums over
    all particles, which decide when a solver stops, would then not have the same bits, nor what
    contacts leave of a step and what air does to a triangle.
    """
    return _compiled_with(fast_math=False)


def compiled_soon() -> contextlib.AbstractContextManager[None]:
    """While it lasts, kernels are compiled without most of Taichi's own optimizations.

    They go over a kernel again and again, above all the search for common subexpressions; LLVM has
    its own. Kernels compile in about half the time, but run longer: on the graph 1.0 to 1.2 times,
    in lanes up to 2.3 times. In all runs that were compared they had the same bits. For what loops
    do not change Taichi keeps a copy for each expression that reads it, which is wrong where two of
    them read one place: that goes, too. So does its search for what many threads add to, which
    kernels of frames sum by themselves (`loops.py`).
    """
    return _compiled_with(
        advanced_optimization=False, cache_loop_invariant_global_vars=False, make_thread_local=False
    )


def usual_blocks() -> contextlib.AbstractContextManager[None]:
    """While it lasts, kernels are compiled with Taichi's own size of blocks on GPUs.

    Those of `_block_size` for Mesa's driver on the processor are so small that a loop over a
    window's pixels has more blocks than that driver takes.
    """
    return _compiled_with(default_gpu_block_dim=128)


def nothing_kept_over_calls() -> contextlib.AbstractContextManager[None]:
    """While it lasts, kernels are compiled to read anew what their loops do not change.

    Taichi keeps it otherwise, and stores what is new only after the loop, without a look at what
    real functions that are called there read and store (`kernels/parts.py`).
    """
    return _compiled_with(cache_loop_invariant_global_vars=False)


@contextlib.contextmanager
def _compiled_with(**settings: Any) -> Iterator[None]:
    """While it lasts, kernels are compiled with these settings of Taichi's."""
    from taichi.lang import impl

    config = impl.get_runtime().prog.config()
    before = {name: getattr(config, name) for name in settings}
    for name, value in settings.items():
        setattr(config, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(config, name, value)


def _own_threads() -> set[int]:
    """The threads of this process, where the system tells (Linux)."""
    try:
        return {int(name) for name in os.listdir("/proc/self/task")}
    except OSError:
        return set()


def _pin(workers: list[int], threads: int) -> None:
    """Give each worker thread a core of its own, where there is one for each.

    Taichi wakes its workers for every loop; left alone, two of them often share a core for the
    first milliseconds, which is as long as a loop lasts. The workers are the threads that
    Taichi made last; were one not, a pinned thread would be all that comes of it.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if threads == len(cores) == len(workers) > 1:
        for worker, core in zip(workers, cores, strict=True):
            with contextlib.suppress(OSError):
                os.sched_setaffinity(worker, {core})


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Neither what Taichi announces nor what its C++ parts complain of: callers check and say."""
    sys.stderr.flush()
    kept = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


def _start_probe(arch: str) -> subprocess.Popen:
    start = f"runtime._initialize('{arch}', 'f32', 1, True)"
    code = f"import sys; from taichi_cloth import runtime; sys.exit(not {start})"
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )


def _finish_probe(arch: str, probe: subprocess.Popen) -> str | None:
    if probe.wait() == 0:
        return None
    return _need(arch)


def _need(arch: str) -> str:
    return NEEDS.get(arch, "a supported processor")
