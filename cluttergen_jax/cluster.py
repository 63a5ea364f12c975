"""Independent work on a Ray cluster: items go to worker processes, results come back in no fixed order.

Ray is started on this machine, guarded by a token, or a cluster that is there is joined. One worker is one
actor; what it needs is made in it once. A worker that dies is replaced, and what it had begun is given to
another one. It knows nothing of scenes: banks, checks, tables and imports all use it.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import math
import os
import platform
import secrets
import shutil
import socket
import sys
import tempfile
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.progress import stop_asked

_CONNECT = 20.0
"""Seconds in which a machine has to answer."""
_END = 10.0
"""Seconds that Ray's programs have for ending."""
_OBJECT_STORE = 256 * 2**20
"""Bytes of results in flight on a machine of its own; Ray writes to disk what exceeds it."""
_AUTHENTICATION = ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN")
_OLDEST = (2, 52)
"""The first Ray that asks for a token."""
_LONGEST_FOLDER = 30
"""Letters: Ray adds some 70 for its sockets, whose paths have 107 at most."""


@contextmanager
def connect(address: str, num_cores: int) -> Iterator[ModuleType]:
    """Ray, connected; left as it was found.

    Args:
      address: "local" starts it on this machine, with so many cores at least.

    Raises:
      MissingExtraError: it is not installed; ClutterGenError: none answers there, or it is too old.
    """
    # What is never wanted from a library: messages home, and a note about them on the terminal.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("ray", "work on a cluster") from error
    if ray.is_initialized():
        yield ray
        return
    with ExitStack() as stack:
        own: dict[str, Any] = {}
        if address == "local":
            cores = max(os.cpu_count() or 1, num_cores)
            own = {
                "num_cpus": cores,
                "include_dashboard": False,
                "object_store_memory": _OBJECT_STORE,
            }
            own["_temp_dir"] = stack.enter_context(_folder_for_ray())
            stack.enter_context(_token(ray))
        _start(ray, address, own)
        stack.callback(ray.shutdown)
        yield ray


def _start(ray: ModuleType, address: str, own: Mapping[str, Any]) -> None:
    """Starts Ray with settings of our own, or joins a cluster."""
    try:
        _check_answers(address)
        with warnings.catch_warnings():
            # Ray starts programs of its own by a fork, of which JAX warns; no JAX runs in those.
            warnings.simplefilter("ignore", RuntimeWarning)
            ray.init(address, logging_level=logging.ERROR, log_to_driver=False, **own)
    except (RuntimeError, ValueError, OSError, ray.exceptions.RayError) as error:
        raise ClutterGenError(
            f"no Ray cluster answers at {address!r} ({first_line(error)})",
            "local, auto, or the address of a cluster",
            "starting Ray on its machines first (`ray start`), or local",
        ) from error


@contextmanager
def _token(ray: ModuleType) -> Iterator[None]:
    """Inside, Ray, which listens to the whole network, asks for a random token that what it starts has."""
    if tuple(int(part) for part in ray.__version__.split(".")[:2]) < _OLDEST:
        raise ClutterGenError(
            f"Ray {ray.__version__} lets anybody on the network run programs on a cluster",
            f"Ray {'.'.join(map(str, _OLDEST))} or newer",
            "installing a newer one",
        )
    before = {name: os.environ.get(name) for name in _AUTHENTICATION}
    # Whoever has set the mode knows what they want, or has a token of their own.
    if before["RAY_AUTH_MODE"] is None:
        os.environ.update(zip(_AUTHENTICATION, ("token", secrets.token_hex(32)), strict=True))
    _read_authentication()
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        _read_authentication()


def _read_authentication() -> None:
    """Has Ray look at the environment again, which it does once in a process; it says so to nobody else."""
    with suppress(ImportError, AttributeError):
        internals: Any = importlib.import_module("ray._raylet")
        internals.Config.initialize("")
        internals.AuthenticationTokenLoader.instance().reset_cache()


@contextmanager
def _folder_for_ray() -> Iterator[str]:
    """A folder for logs, sockets and what exceeds the memory, for this user alone; removed afterwards."""
    asked = (os.environ.get("RAY_TMPDIR"), tempfile.gettempdir())
    parents = [each for each in asked if each and len(os.path.abspath(each)) <= _LONGEST_FOLDER]
    folder = tempfile.mkdtemp(prefix="ray-", dir=parents[0] if parents else "/tmp")
    try:
        # Ray lets everybody into its own.
        yield os.path.join(folder, "r")
    finally:
        # Programs of Ray's that are just ending still write there.
        until = time.monotonic() + _END
        while os.path.isdir(folder):
            shutil.rmtree(folder, ignore_errors=time.monotonic() < until)
            if os.path.isdir(folder):
                time.sleep(0.1)


def _check_answers(address: str) -> None:
    """OSError if nobody listens at HOST:PORT, which Ray itself would try for many minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT).close()


def room_for(ray: ModuleType, num_cpus: int, num_gpus: int) -> int:
    """How many workers the cluster has room for now, at least one."""
    nodes = [each["Resources"] for each in ray.nodes() if each["Alive"]]
    room = [int(node.get("CPU", 0) // num_cpus) for node in nodes]
    if num_gpus:
        room = [
            min(most, int(node.get("GPU", 0) // num_gpus))
            for most, node in zip(room, nodes, strict=True)
        ]
    return max(sum(room), 1)


def first_line(error: Exception) -> str:
    """The first line of an error of Ray's, which are long."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".:")


Item = TypeVar("Item")
Result = TypeVar("Result")
Function = Callable[[Item], Result]
MOST_DEATHS = 3
"""So often may workers die over the same item, or each of them before any has started."""
_QUEUED = 2
"""Items that a worker has at a time: the next one waits where it is needed while a result travels."""
_LONGEST_WAIT = 1.0
_PATIENCE = 120.0
"""Seconds after which the user is told that nothing has started."""
_SETTINGS = ("JAX_", "XLA_", "TF_", "OMP_", "MUJOCO_", "CLUTTERGEN_")
"""Environment variables that may change what is computed: a worker has those of the driver, and no others."""
_PROGRAMS = "JAX_COMPILATION_CACHE_DIR"
_PACKAGES = ("cluttergen_jax", "jax", "jaxlib", "mujoco", "numpy", "pyarrow")


@dataclass(frozen=True)
class Cluster:
    """Where work goes.

    Attributes:
      address: "local" starts Ray on this machine for as long as it is needed; "auto" is the cluster that this
        machine belongs to; else a cluster's address.
      num_workers: processes; 0 for as many as the cluster has room for.
    """

    address: str
    num_workers: int = 0


def cluster_of(cluster: str | None, workers: int) -> Cluster | None:
    """What the arguments `cluster` and `workers` of a function ask for; None for this process.

    Raises:
      ConfigError: workers without a cluster, or a number that is out of range.
    """
    if workers < 0:
        raise ConfigError(
            f"workers = {workers}", "0 or more", "workers=0, for as many as there is room for"
        )
    if workers and cluster is None:
        raise ConfigError(
            f"workers = {workers} without `cluster`", "workers on a cluster", "cluster='local'"
        )
    if cluster is None:
        return None
    return Cluster(cluster, workers)


def each_on(
    cluster: Cluster,
    make: Callable[[], Function[Item, Result]],
    items: Sequence[Item],
    what: str,
    num_cpus: int = 1,
    num_gpus: int = 0,
    settings: Mapping[str, str] | None = None,
    if_lost: Result | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """Yields (place, result) of every item as they come.

    Closed early, as by Ctrl-C, it ends its workers. Equal items must give equal results wherever they are
    worked on: one that a worker died over is worked on again.

    Args:
      items: each is looked up when a worker is free for it.
      make: called once in each worker for the function that items are given to; it is pickled, as items and
        results are.
      what: an item is called in messages, such as "block".
      num_cpus, num_gpus: cores and devices of a worker.
      settings: environment variables of workers that this process has not.
      if_lost: the result of an item over which `MOST_DEATHS` workers died; an error if it is None.

    Raises:
      ClutterGenError: a worker has other versions than this process, `MOST_DEATHS` workers died over an item,
        or what the function itself raises.
      MissingExtraError: the extra `ray` is not installed.
    """
    if not items:
        return
    with connect(cluster.address, cluster.num_workers * num_cpus) as ray:
        number = min(cluster.num_workers or room_for(ray, num_cpus, num_gpus), len(items))
        actor = ray.remote(max_restarts=0, num_cpus=num_cpus, num_gpus=num_gpus)(_Actor)
        own = {name: value for name, value in os.environ.items() if name.startswith(_SETTINGS)}
        own |= {} if num_gpus else {"JAX_PLATFORMS": "cpu"}
        begin = (
            ray.cloudpickle.dumps(make),
            own | dict(settings or {}),
            versions_here(),
            os.getcwd(),
            platform.node(),
        )
        crew = _Crew(ray, actor, begin, items, what, if_lost)
        try:
            yield from crew.results(number)
        finally:
            crew.end()


class _Actor:
    """A worker process. Nothing heavy is imported before its settings are those of the driver."""

    def begin(
        self,
        make: bytes,
        settings: Mapping[str, str],
        versions: Mapping[str, str],
        folder: str,
        host: str,
    ) -> None:
        """Makes the function that items are given to; paths begin where those of the driver do."""
        if other := {name: own for name, own in versions_here().items() if versions[name] != own}:
            found = ", ".join(
                f"{name} {own} (here {versions[name]})" for name, own in other.items()
            )
            raise ClutterGenError(
                f"a worker on {platform.node()} has {found}",
                "the same versions everywhere, which make the same scenes",
                "installing the same package on every machine of the cluster",
            )
        for name in [each for each in os.environ if each.startswith(_SETTINGS)]:
            del os.environ[name]
        os.environ.update(settings)
        if platform.node() != host:
            # Compiled programs that are kept there are of the driver's kind of processor.
            os.environ.pop(_PROGRAMS, None)
        if os.path.isdir(folder):
            os.chdir(folder)
        # What the driver sends comes through Ray, which unpickles all that it carries: no file is read.
        from ray.cloudpickle import loads

        try:
            function = loads(make)
        except ModuleNotFoundError as error:
            raise ClutterGenError(
                f"a worker on {platform.node()} has no module {error.name!r}",
                "code that every machine of the cluster can import",
                "method='FILE.py:name', where a method of your own is in that module",
            ) from error
        self._function = function()

    def run(self, item: Any) -> Any:
        """The result of one item."""
        return self._function(item)


def versions_here() -> dict[str, str]:
    """What decides results, of this process."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    # Copies of one version may have been worked on.
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return found | {"files of cluttergen_jax": digest.hexdigest()[:12]}


@dataclass(eq=False)
class _Worker:
    """An actor, and what it was given, oldest first, as (place, reference); its start has no place."""

    actor: Any
    given: deque[tuple[int | None, Any]]
    is_ready: bool = False


@dataclass(eq=False)
class _Crew:
    """The workers of one call of `each_on`.

    Attributes:
      deaths: of workers that had this item alone, or (None) had not started.
      suspects: items of workers that died with several: of one that was over just before, the news may be
        lost with the worker. From then on a worker has such an item alone, so that the right one is blamed.
    """

    ray: ModuleType
    actor: Any
    begin: tuple[Any, ...]
    items: Sequence[Any]
    what: str
    if_lost: Any
    workers: list[_Worker] = field(default_factory=list)
    deaths: Counter[int | None] = field(default_factory=Counter)
    suspects: set[int] = field(default_factory=set)

    def results(self, num_workers: int) -> Iterator[tuple[int, Any]]:
        """See `each_on`."""
        waiting = deque(range(len(self.items)))
        self.workers = [self._start_worker() for _ in range(num_workers)]
        num_left = len(self.items)
        until = time.monotonic() + _PATIENCE
        while num_left:
            if stop_asked.is_set():
                raise KeyboardInterrupt
            if time.monotonic() > until and not any(worker.is_ready for worker in self.workers):
                print(
                    "note: no worker has started: the cluster may have no room now", file=sys.stderr
                )
                until = math.inf
            self._hand_out(waiting)
            oldest = {each.given[0][1]: each for each in self.workers if each.given}
            ready, _ = self.ray.wait(list(oldest), num_returns=1, timeout=_LONGEST_WAIT)
            for reference in ready:
                worker = oldest[reference]
                is_known, result = self._result(worker, reference, waiting)
                if is_known:
                    place, _ = worker.given.popleft()
                    worker.is_ready = True
                    if place is not None:
                        num_left -= 1
                        self.suspects.discard(place)
                        yield place, result
                    else:
                        self.deaths.pop(None, None)

    def end(self) -> None:
        """Ends the workers; those that are at work do not finish it."""
        for worker in self.workers:
            self.ray.kill(worker.actor)

    def _start_worker(self) -> _Worker:
        actor = self.actor.remote()
        return _Worker(actor, deque([(None, actor.begin.remote(*self.begin))]))

    def _hand_out(self, waiting: deque[int]) -> None:
        """Gives everybody who is at work something for now, and then something for later."""
        for most in range(1, _QUEUED + 1):
            for worker in self.workers:
                # A worker that waits for room on the cluster would keep what it is given.
                if waiting and worker.is_ready and len(worker.given) < most:
                    places = [waiting[0], *(place for place, _ in worker.given)]
                    if len(places) == 1 or self.suspects.isdisjoint(places):
                        place = waiting.popleft()
                        worker.given.append((place, worker.actor.run.remote(self.items[place])))

    def _result(self, worker: _Worker, reference: Any, waiting: deque[int]) -> tuple[bool, Any]:
        """Whether the oldest of a worker is done, and its result; the worker is replaced where it is not."""
        errors = self.ray.exceptions
        try:
            return True, self.ray.get(reference)
        except (errors.ActorUnschedulableError, errors.ObjectStoreFullError):
            raise
        except (errors.RayActorError, errors.ObjectLostError, errors.WorkerCrashedError) as error:
            return self._replace(worker, waiting, error), self.if_lost
        except errors.RayTaskError as error:
            cause = getattr(error, "cause", None)
            if isinstance(cause, ClutterGenError):
                raise cause from None
            raise

    def _replace(self, worker: _Worker, waiting: deque[int], error: Exception) -> bool:
        """Another worker in the place of one that died; whether the item that it died over is given up."""
        places = [place for place, _ in worker.given if place is not None]
        blamed = worker.given[0][0]
        if len(places) > 1:
            self.suspects.update(places)
        else:
            self.deaths[blamed] += 1
        # A machine that is lost takes many workers along, some of which may have been about to start.
        is_lost = self.deaths[blamed] >= MOST_DEATHS * (len(self.workers) if blamed is None else 1)
        if is_lost and (blamed is None or self.if_lost is None):
            one = (
                "their start"
                if blamed is None
                else f"{self.what} {blamed + 1} of {len(self.items)}"
            )
            raise ClutterGenError(
                f"{self.deaths[blamed]} worker processes died over {one} ({first_line(error)})",
                hint="more memory or fewer workers on a machine, and the same package on all of them",
            ) from error
        waiting.extendleft(reversed([] if is_lost else places))
        self.ray.kill(worker.actor)
        self.workers[self.workers.index(worker)] = self._start_worker()
        return is_lost
