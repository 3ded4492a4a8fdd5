"""How numerical functions become machine code: the one decorator, and what Python shares with compiled code.

Nothing is imported from Numba, and nothing is compiled, before the first call. Compiled code is kept on disk in a
folder named after a digest of slamkit's own sources, so that no change of slamkit ever meets stale machine code.
"""

from __future__ import annotations

import hashlib
import importlib
import platform
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

#: Entries of ``State.size``: D of what is active; rows of the last update and D of what was active then (-1 once that
#: has rested); the failing sighting and the status of the last step; columns C of Φ, D of the whole map, first row of
#: the store that a flush has yet to correct; D of the whole map at the last update; sightings since the step began that
#: gave no finite numbers; entries from one row of the store to the next, 0 where it is a packed triangle.
ACTIVE, ROWS, ACTIVE_THEN, FAILING, STATUS, COLUMNS, WHOLE, CORRECTED, WHOLE_THEN, ODD, LEAD = range(11)

#: Entries of ``State.work``, see `slamkit.cycle.steps.upkeep`.
DEBT, PER_SQUARE, START, MOST, LIMIT, SPENT, SPENT_PLAIN, STAYS = range(8)

#: Doubles of a cache line, rows and columns of a tile; terms of a sum that are written out, which divides every rank.
TILE, UNROLLED = 8, 4

__all__ = [
    "Compiled",
    "MachineCode",
    "Models",
    "Policy",
    "Shared",
    "State",
    "aligned",
    "call",
    "compiled",
    "intrinsics",
    "models_of",
    "needed",
    "part",
]


class Compiled:
    """A function that compiles itself at its first call.

    ``f(...)`` runs the machine code; ``f.plain(...)`` runs the same source in Python over compiled primitives.

    Parameters
    ----------
    function : callable
        Written in the part of Python that Numba compiles; it may call other `Compiled` functions by name.
    signature : str
        Its type, in the words of `slamkit.compiled.structures`: ``void``, ``real``, ``index``, ``flag``,
        ``vector``, ``matrix``, ``cube``, ``integers``, ``flags``, ``state``, ``models``, ``policy``.
    generic : bool
        True: it calls functions of models or filters, so its Python form calls the Python forms of what it uses.
    allocates : bool
        True: it makes arrays, as any function outside of slamkit may. In code that makes none nobody counts the
        references to any.
    """

    def __init__(
        self, function: FunctionType, signature: str, *, generic: bool = False, allocates: bool = False
    ) -> None:
        self.function, self.signature, self.generic = function, signature, generic
        self.allocates = allocates or not function.__module__.startswith("slamkit.")
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__

    @property
    def uses(self) -> dict[str, Compiled]:
        """What it calls, by name."""
        f = self.function
        return {n: v for n in f.__code__.co_names if isinstance(v := f.__globals__.get(n), Compiled)}

    def _over(self, choose: Callable[[Compiled], Any]) -> FunctionType:
        """The function over the same globals, with every `Compiled` among them replaced."""
        f, chosen = self.function, {name: choose(used) for name, used in self.uses.items()}
        copy = FunctionType(f.__code__, {**f.__globals__, **chosen}, f.__name__, f.__defaults__, f.__closure__)
        copy.__module__, copy.__qualname__ = f.__module__, f.__qualname__
        return copy

    @cached_property
    def jitted(self) -> Any:
        """For other compiled functions to call: Numba's dispatcher of a fragment, see `slamkit.compiled.fragments`.

        A function that is read from the cache holds the code of all that it calls, so fragments are not kept there.
        """
        fragments = importlib.import_module(f"{__name__}.fragments")
        jitted = self._dispatcher(pipeline_class=fragments.FragmentCompiler, no_cpython_wrapper=True)
        resolve = jitted.get_call_template

        def compiled_first(args: Any, kws: Any) -> Any:
            """With its one signature compiled, a call casts its arguments to it instead of compiling for others."""
            if not jitted.overloads:
                self._compile(jitted)
            return resolve(args, kws)

        jitted.get_call_template = compiled_first
        return jitted

    @cached_property
    def dispatcher(self) -> Any:
        """For Python: machine code, compiled now or read from the cache."""
        return self._compile(self._dispatcher(cache=True))

    @cached_property
    def entry(self) -> Any:
        """The same for tables, whose functions take arrays as less than Numba makes of them."""
        return self._compile(self._dispatcher(cache=True), "PASSED")

    def _dispatcher(self, **options: Any) -> Any:
        load_structures()
        import numba

        # contract lets a·b + c be one instruction; no other rule of floating-point arithmetic is relaxed.
        with cache_folder():
            options |= {"fastmath": {"contract"}, "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
            options["_nrt"] = self.allocates
            return numba.njit(**options)(self._over(lambda c: c.jitted))

    def _compile(self, dispatcher: Any, words: str = "WORDS") -> Any:
        with cache_folder():
            dispatcher.compile(eval(self.signature, dict(getattr(load_structures(), words))))
        dispatcher.disable_compile()
        return dispatcher

    @cached_property
    def plain(self) -> Callable[..., Any]:
        """The same source in Python."""
        return self._over(lambda c: c.plain if c.generic else c)

    def __call__(self, *args: Any) -> Any:
        return self.dispatcher(*args)

    def __reduce__(self) -> tuple[Any, ...]:
        return _find, (self.function.__module__, self.function.__qualname__)


#: A function, and the attribute that is its machine code: for Python ("dispatcher") or for tables ("entry").
MachineCode = tuple[Compiled, str]


class Intrinsic(Compiled):
    """A function of a module that imports Numba, by name, for compiled functions to call.

    Python calls `plain` instead, where there is one.
    """

    def __init__(self, module: str, name: str, plain: Callable[..., Any] | None = None) -> None:
        self.__module__, self.__name__, self.generic = module, name, False
        if plain is not None:
            self.plain = plain

    @cached_property
    def jitted(self) -> Any:
        """What Numba puts in the place of a call."""
        load_structures()
        return getattr(importlib.import_module(self.__module__), self.__name__)

    def __call__(self, *args: Any) -> Any:
        return self.plain(*args)

    def __reduce__(self) -> tuple[Any, ...]:
        return Intrinsic, (self.__module__, self.__name__, vars(self).get("plain"))


def intrinsics(module: str, *names: str) -> list[Intrinsic]:
    """Functions of a module of this package that is not to be imported before the first call."""
    return [Intrinsic(f"{__name__}.{module}", name) for name in names]


def _slice(array: Any, first: int, count: int) -> Any:
    return array[first : first + count]


#: ``part(array, first, count)`` is ``array[first : first + count]`` without Numba's care for where an array ends.
part = Intrinsic(f"{__name__}.structures", "part", _slice)


def _find(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def compiled(
    signature: str, *, generic: bool = False, allocates: bool = False
) -> Callable[[Callable[..., Any]], Compiled]:
    """Decorate a function so that it compiles at its first call; see :class:`Compiled`."""

    def decorate(function: Callable[..., Any]) -> Compiled:
        assert isinstance(function, FunctionType)
        return Compiled(function, signature, generic=generic, allocates=allocates)

    return decorate


def needed(functions: Sequence[Compiled]) -> list[Compiled]:
    """These, and what they call as machine code where they run as Python: every function that Python may call."""
    found, generic = dict.fromkeys(functions), [f for f in functions if f.generic]
    for f in generic:
        for used in f.uses.values():
            if used.generic and used not in generic:
                generic.append(used)
            elif not used.generic and not isinstance(used, Intrinsic):
                found[used] = None
    return list(found)


class Shared:
    """A Python object with a twin in compiled code, which is made when it is first asked for."""

    kind: str

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, **fields: Any) -> None:
        self.fields = fields
        self.__dict__.update(fields)

    def __getstate__(self) -> dict[str, Any]:
        derived = ("handle", "plain", "address", "_numba_type_")
        return {n: v for n, v in self.__dict__.items() if n not in derived}

    def replace(self, **fields: Any) -> None:
        """Let fields be these from now on."""
        self.fields.update(fields)
        self.__dict__.update(fields)
        if "handle" in self.__dict__:
            self.handle.put(**fields)

    @cached_property
    def _numba_type_(self) -> Any:
        return self.handle.table

    @cached_property
    def address(self) -> int:
        """Where the table is that compiled functions take."""
        return int(self.handle.address)

    @cached_property
    def handle(self) -> Any:
        """The table, which holds on to what it points to."""
        return load_structures().Handle(self.kind, **{n: getattr(v, "entry", v) for n, v in self.fields.items()})


def aligned(shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """An array of zeros that starts a cache line: a vector of numbers across two takes twice the time to read."""
    line, kind = 8 * TILE, np.dtype(dtype)
    size = kind.itemsize * int(np.prod(shape))
    memory = np.zeros(size + line, dtype=np.uint8)
    first = -memory.ctypes.data % line
    return memory[first : first + size].view(kind).reshape(shape)


class State(Shared):
    """Belief and workspace. The arrays are shared with compiled code: each side sees what the other writes."""

    kind = "state"

    def __deepcopy__(self, memo: dict[int, Any]) -> State:
        copies = {name: aligned(array.shape, array.dtype) for name, array in self.fields.items()}
        for name, array in self.fields.items():
            copies[name][...] = array
        return State(**copies)


class Models(Shared):
    """A motion and a sensor model as functions that write into their last arguments.

    Parameters
    ----------
    compiled : bool
        Whether every function can be compiled; if not, steps run as Python.
    **fields
        The functions, parameters and R named in `slamkit.compiled.structures.MODELS_FIELDS`.
    """

    kind = "models"

    def __init__(self, *, compiled: bool, **fields: Any) -> None:
        super().__init__(**fields)
        self.compiled = compiled


@compiled("void(vector, vector, vector, vector, vector, vector, matrix, matrix)")
def no_sight(pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any) -> None:
    """Stands where a sensor model offers no function for this; it is never called."""


@compiled("void(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix)")
def no_drive(pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any) -> None:
    """The same for a motion model."""


def models_of(motion: Any, sensor: Any, motion_params: Any, sensor_params: Any, R: Any, *, compiled: bool) -> Models:
    """The models whose functions are these MotionFunctions and SensorFunctions of `slamkit.protocols`."""
    drive, sight = getattr(motion, "drive", None), getattr(sensor, "sight", None)
    return Models(
        compiled=compiled,
        move=motion.move,
        motion_jacobians=motion.jacobians,
        control_noise=motion.control_noise,
        pose_noise=motion.pose_noise,
        drive=drive or no_drive,
        drives=drive is not None,
        predict=sensor.predict,
        sensor_jacobians=sensor.jacobians,
        residual=sensor.residual,
        invert=sensor.invert,
        inverse_jacobians=sensor.inverse_jacobians,
        sight=sight or no_sight,
        sights=sight is not None,
        motion_params=motion_params,
        sensor_params=sensor_params,
        R=R,
    )


class Policy(Shared):
    """What distinguishes one estimator, and the step that all have in common, see `slamkit.cycle.steps`."""

    kind = "policy"

    @cached_property
    def plain(self) -> SimpleNamespace:
        """The same policy with the Python forms of its functions."""
        generic = {n: v.plain for n, v in self.fields.items() if isinstance(v, Compiled) and v.generic}
        return SimpleNamespace(**{**self.fields, **generic})


def call(step: Compiled, policy: Policy, models: Models, *args: Any) -> Any:
    """Run a step: as machine code where the models allow it, else the same source as Python."""
    if models.compiled:
        return step(policy, models, *args)
    return step.plain(policy.plain, models, *args)


@cache
def load_structures() -> ModuleType:
    """`slamkit.compiled.structures`, imported at the first need of it."""
    with cache_folder():
        return importlib.import_module("slamkit.compiled.structures")


@contextmanager
def cache_folder() -> Iterator[None]:
    """Within the block Numba caches in slamkit's folder; the caller's own setting is put back afterwards."""
    from numba import config
    from numba.core.errors import NumbaExperimentalFeatureWarning

    before = config.CACHE_DIR
    config.CACHE_DIR = str(_cache_path(before))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
            yield
    finally:
        config.CACHE_DIR = before


@cache
def _cache_path(configured: str) -> Path:
    if configured:
        root = Path(configured)
    else:
        import platformdirs

        root = Path(platformdirs.user_cache_dir("slamkit", appauthor=False))
    return root / f"compiled-{_digest()}"


def _digest() -> str:
    """Digest of every source that takes part in compilation, and of the versions that decide what it becomes."""
    import numba

    package = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256(f"{numba.__version__} {sys.version} {platform.machine()}".encode())
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"@compiled(" in source or path.parent.name == "compiled":
            digest.update(path.relative_to(package).as_posix().encode() + source)
    return digest.hexdigest()[:16]
