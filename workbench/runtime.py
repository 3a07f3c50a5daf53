"""How JAX and NumPy run here: double precision for the solves, compiled programs kept, threads that do not fight."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

COMPUTING = threading.RLock()
"""Held while a large compiled program runs. XLA splits such a program over a pool of one thread a core; two programs
at once, called from two threads, can fill the pool with parts that wait for each other, and then wait for ever."""
SMALL_ARRAYS = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}
"""Compiler options for programs of small arrays, where most of the time of a first fit is compiling. XLA's newer way on
a CPU builds every kernel as a module of its own and takes half as long again to compile such a program, and LLVM's
higher levels another quarter; the programs run no faster for it. Renderer and networks keep both: without the newer way
they run a quarter slower."""
ONE_THREAD = SMALL_ARRAYS | {
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_experimental_ynn_fusion_type": "LIBRARY_FUSION_TYPE_INDIVIDUAL_DOT",
}
"""The same without sharing products and sums out over threads, which would change their last bits with the number of
cores: Eigen does so with products, YNNPACK with sums, and is left the products alone."""
SHORT_TURN_S = 0.001
"""Python's own turn is 5 ms."""


class ShortTurns:
    """While on, a Python thread that computes lets the others have their turn each millisecond instead of every five.

    A cell that runs holds Python's lock for a whole turn, and a frame of the live panel needs hundreds of them: beside
    such a cell it is fitted more than twice as often with short turns.
    """

    _usual_s, _wanted = 0.0, 0
    _lock = threading.Lock()

    def __init__(self) -> None:
        self._on = False

    def turn(self, on: bool) -> None:
        """Want short turns or not; they end when nobody wants them any more."""
        with ShortTurns._lock:
            if on == self._on:
                return
            self._on = on
            if on and ShortTurns._wanted == 0:
                ShortTurns._usual_s = sys.getswitchinterval()
                sys.setswitchinterval(min(SHORT_TURN_S, ShortTurns._usual_s))
            ShortTurns._wanted += 1 if on else -1
            if ShortTurns._wanted == 0:
                sys.setswitchinterval(ShortTurns._usual_s)


def cache_folder() -> Path:
    """Folder of compiled programs and other things that can be made again."""
    base = os.environ.get("WORKBENCH_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "face-energy-workbench"


def prepare_blas() -> None:
    """Let NumPy and SciPy multiply in one thread, where they are not loaded yet and the user has not set a number.

    OpenBLAS' threads wait for one another without sleeping. The matrices here are small: on two cores a head's vertices
    take 0.15 ms with one thread and 0.1 with two, but 6 ms with two beside other busy processes, as browsers are.
    """
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


ONE_CORE = {"OPENBLAS_NUM_THREADS": "1", "NPROC": "1"}
"""Environment of one of several processes that compute: one thread for BLAS, and one for XLA, which reads `NPROC`."""


@contextmanager
def starting_on_one_core() -> Iterator[None]:
    """While on, processes that are started compute in one thread, unless the user has set a number.

    Threads of BLAS wait for one another without sleeping: beside another worker, calibrating an identity took forty
    times as long. XLA's look for work and slow the one that has some. BLAS reads the number where it is loaded, and a
    process that is spawned from a script runs the script's imports before anything of ours: only what it is born with
    comes early enough.
    """
    unset = {name: value for name, value in ONE_CORE.items() if name not in os.environ}
    os.environ.update(unset)
    try:
        yield
    finally:
        for name in unset:
            os.environ.pop(name, None)


def prepare_jax() -> None:
    """Configure JAX before anybody makes an array: at once where it is loaded, else as soon as anything imports it.

    Precision cannot be changed for arrays that exist, and JAX alone takes a second and 160 MB to import.
    """
    if "jax" in sys.modules:
        configure_jax(sys.modules["jax"])
    elif not any(isinstance(finder, JaxFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, JaxFinder())


def configure_jax(jax: ModuleType) -> None:
    """Switch on float64 and the persistent compilation cache, leaving what the user has set.

    A float32 Levenberg–Marquardt diverges on E_β, whose slope at the bounds is about 40,000. The cache keeps even
    small programs (JAX skips those under a second by default), so a second start of a notebook compiles nothing.
    """
    jax.config.update("jax_enable_x64", True)
    # A call returns when its result is there, so that `COMPUTING` covers the whole run.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    programs = cache_folder() / "jax"
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(programs))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    from workbench.program_cache import watch_cache  # here, because `import workbench` does not need it

    watch_cache(jax, programs)


class JaxFinder(MetaPathFinder):
    """Finds JAX where Python does, and configures it at the end of its import; everything else it leaves alone."""

    def find_spec(self, fullname: str, path=None, target=None) -> ModuleSpec | None:
        if fullname != "jax":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, (finder.find_spec(fullname, path, target) for finder in others)), None)
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = _then_configured(spec.loader.exec_module)
        return spec


def _then_configured(load: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def exec_module(module: ModuleType) -> None:
        load(module)
        configure_jax(module)

    return exec_module
