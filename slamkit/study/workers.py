"""Worker processes: on this machine or on a Dask cluster. They share the compiling and survive each other's deaths."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from slamkit.errors import InputError
from slamkit.study.tasks import Part, Task, alone, failed, perform
from slamkit.study.trial import text_of

if TYPE_CHECKING:
    from slamkit.study.settings import Settings

#: How long a Dask scheduler may take to answer [s].
CONNECT_SECONDS = 4.0
#: With more threads, linear algebra would sum in another order, and the result would depend on the number of jobs.
_ONE_THREAD = {
    f"{library}_THREADS": "1"
    for library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "NUMEXPR_NUM")
}
_IDLE_SECONDS = 300

_Result = tuple[Task, Part]
#: Gives None once the workers are connected and can load everything, then the results.
_Results = Generator[_Result | None, None, None]


@contextmanager
def connect(settings: Settings, tasks: Sequence[Task], jobs: int, backend: str) -> Iterator[Iterable[_Result]]:
    """Start workers for these tasks; gives an iterator over the results, in the order in which they are finished.

    A task whose worker dies is tried again with each filter in a process of its own, and recorded as failed if it
    dies again.

    Raises
    ------
    InputError
        Dask is missing, its scheduler does not answer, or the workers cannot load a filter or model.
    """
    if not tasks:
        yield ()
        return
    content = _pack(settings)
    if backend == "processes":
        results = _on_processes(settings, content, tasks, jobs)
    else:
        results = _on_dask(settings, content, tasks, jobs, backend)
    next(results)  # connects and checks
    try:
        yield (result for result in results if result is not None)
    finally:
        results.close()


def compile_shared(studies: Iterable[Settings], jobs: int) -> None:
    """Compile what the filters of these studies need, shared among the processes of this machine."""
    pool = _pool(jobs)
    _compile(pool, studies)


def _run(content: bytes, path: Sequence[str], task: Task) -> Part:
    """In a worker: do a task."""
    return perform(_unpack(content, tuple(path)), task)


# -- sending settings to other processes ------------------------------------------------------------------------------


def _pack(settings: Settings) -> bytes:
    """The settings as bytes. Classes and functions of a script, notebook or function are pickled by value."""
    import cloudpickle

    try:
        return bytes(cloudpickle.dumps(settings))
    except Exception as error:
        whole = error
    for what, item in _items(settings):
        try:
            cloudpickle.dumps(item)
        except Exception as error:
            raise _cannot_be_sent(what, text_of(error)) from None
    raise _cannot_be_sent("the study", text_of(whole))


@lru_cache(maxsize=2)
def _unpack(content: bytes, path: tuple[str, ...]) -> Any:
    """Load what :func:`_pack` made; modules are also looked for where the sender looks for them."""
    import cloudpickle

    sys.path += [folder for folder in path if folder not in sys.path]
    return cloudpickle.loads(content)


def _items(settings: Settings) -> list[tuple[str, Any]]:
    """What may come from a user, and what to call it in a message."""
    named: list[tuple[str, Any]] = [(f"filter {name!r}", kind) for name, kind in settings.filters.items()]
    own = [("the motion model", settings.motion), ("the sensor model", settings.sensor)]
    return [*named, *own, ("options", settings.options), ("the world", settings.world)]


def _load_error(content: bytes, path: Sequence[str]) -> str | None:
    """In a worker: why this cannot be loaded; None if it can."""
    try:
        _unpack(content, tuple(path))
    except Exception as error:
        return text_of(error)
    return None


def _refuse_unloadable(settings: Settings, content: bytes, path: Sequence[str], call: Callable[..., Any]) -> None:
    """Let a worker load the settings; if it cannot, find out which part of them is the cause.

    ``call(function, *arguments)`` gives what a worker returns.
    """
    import cloudpickle

    whole = call(_load_error, content, path)
    if whole is None:
        return
    for what, item in _items(settings):
        why = call(_load_error, bytes(cloudpickle.dumps(item)), path)
        if why is not None:
            raise _cannot_be_sent(what, why)
    raise _cannot_be_sent("the study", whole)


def _cannot_be_sent(what: str, why: str) -> InputError:
    return InputError(
        f"{what} cannot be loaded in a worker process ({why}); define it at the top level of a module that can be "
        "imported"
    )


def _sender_path() -> tuple[str, ...]:
    """The folders in which this process finds modules; the empty one is the working folder."""
    return tuple(os.path.abspath(folder) for folder in sys.path)


# -- processes of this machine ----------------------------------------------------------------------------------------


def _pool(jobs: int) -> Any:
    """Worker processes that last from one call to the next."""
    from joblib import cpu_count
    from joblib.externals.loky import get_reusable_executor

    return get_reusable_executor(
        max_workers=cpu_count() if jobs == -1 else jobs, timeout=_IDLE_SECONDS, env=_ONE_THREAD
    )


def _on_processes(settings: Settings, content: bytes, tasks: Sequence[Task], jobs: int) -> _Results:
    path, pool = _sender_path(), _pool(jobs)
    finished = False
    try:
        try:
            _refuse_unloadable(settings, content, path, lambda *call: pool.submit(*call).result())
        except BrokenProcessPool as error:
            raise _cannot_be_sent("the study", text_of(error)) from None
        yield None
        _compile(pool, [settings])
        left = dict.fromkeys(tasks)
        while left:
            pool = _pool(jobs)
            futures = {pool.submit(_run, content, path, task): task for task in left}
            for future in as_completed(futures):
                if isinstance(future.exception(), BrokenProcessPool):
                    continue
                task = futures[future]
                del left[task]
                yield task, _result(settings, task, future)
            # Tasks start in order: when a worker died, it was at one of the first that are left.
            for task in list(left)[: _size(pool)]:
                del left[task]
                yield task, _in_isolation(settings, content, path, task)
        finished = True
    finally:
        if not finished:
            pool.shutdown(wait=False, kill_workers=True)


def _size(pool: Any) -> int:
    return int(pool._max_workers)


def _in_isolation(settings: Settings, content: bytes, path: Sequence[str], task: Task) -> Part:
    """Do a task with one filter at a time, so that a filter that ends its process takes no other with it."""
    whole: list[Any] = []
    for piece in alone(settings, task):
        future = _pool(1).submit(_run, content, path, piece)
        part = _result(settings, piece, future)
        if not isinstance(part, list):
            return part
        whole += part
    return whole


def _result(settings: Settings, task: Task, future: Future[Part]) -> Part:
    """The result of a future, or a failed part with the reason."""
    error = future.exception()
    if error is None:
        return future.result()
    # loky's message goes on with advice of several lines.
    why = text_of(error).split("\n")[0] if isinstance(error, BrokenProcessPool) else text_of(error)
    return failed(settings, task, f"the worker process failed: {why}")


def _compile(pool: Any, studies: Iterable[Settings]) -> None:
    """Let each process compile a share. Otherwise all of them would begin with the same functions."""
    import cloudpickle

    functions: dict[Any, None] = {}
    for settings in studies:
        for name in settings.filters:
            # If a user's filter cannot be made, its trials record that.
            with suppress(Exception):
                functions.update(dict.fromkeys(settings.make(name)._compiles()))
    waiting = []
    for function in functions:
        with suppress(Exception):
            waiting.append(pool.submit(_compile_one, bytes(cloudpickle.dumps(function)), _sender_path()))
    for future in waiting:
        future.exception()


def _compile_one(packed: bytes, path: Sequence[str]) -> None:
    # If a function does not compile, the trials record that.
    with suppress(Exception):
        function, attribute = _unpack(packed, tuple(path))
        getattr(function, attribute)


# -- Dask -------------------------------------------------------------------------------------------------------------


def _on_dask(settings: Settings, content: bytes, tasks: Sequence[Task], jobs: int, backend: str) -> _Results:
    path = _sender_path()
    with _client(jobs, backend) as (dask, client):
        try:
            _refuse_unloadable(settings, content, path, lambda *call: client.submit(*call, pure=False).result())
        except InputError:
            raise
        except Exception as error:
            raise _cannot_be_sent("the study", text_of(error)) from None
        yield None
        [common] = client.scatter([content], broadcast=True, hash=False)
        futures = {client.submit(_run, common, path, task, pure=False): task for task in tasks}
        try:
            for future in dask.as_completed(list(futures)):
                yield futures[future], _result(settings, futures[future], future)
        finally:
            client.cancel(list(futures))


@contextmanager
def _client(jobs: int, backend: str) -> Iterator[tuple[Any, Any]]:
    """Dask's module and a client. A client that is made here is closed at the end."""
    try:
        dask: Any = import_module("distributed")
    except ImportError:
        raise InputError(f"backend {backend!r} needs Dask: install slamkit[dask]") from None
    if backend != "dask":
        try:
            client = dask.Client(backend, timeout=CONNECT_SECONDS)
        except (OSError, ValueError) as error:
            raise InputError(f"the Dask scheduler at {backend} does not answer: {error}") from None
        with client:
            yield dask, client
        return
    try:
        client = dask.get_client()
    except ValueError:
        workers = None if jobs == -1 else jobs
        local = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
        with dask.LocalCluster(n_workers=workers, **local) as cluster, dask.Client(cluster) as client:
            yield dask, client
        return
    yield dask, client
