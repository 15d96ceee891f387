"""A Dask cluster as a place for tasks: `distributed` is imported here, when it is asked for."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import re
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from taichi_cloth.errors import InputError, clipped, one_line
from taichi_cloth.sweeps.tasks import Elsewhere, TaskLost, place, refusal

PATIENCE = 2.0  # seconds in which a scheduler has to answer, and then to have a worker
ENTRY = 10.0  # seconds in which a scheduler that answered lets a client in, however busy it is
ABSENCE = 30.0  # seconds without a worker after which none is waited for
ADDRESS = re.compile(r"(?:tcp|tls|ws|wss|ucx)://[^\s/]+:(\d+)")
LAST_PORT = 65535


@contextlib.contextmanager
def connected(address: str | None, times_on: str | None = None) -> Iterator[Elsewhere | None]:
    """The workers of the scheduler at this address, as long as the context lasts; None without one.

    times_on: the machine on whose workers times are measured, and nowhere else; None: this one.
    Raises InputError where there is no scheduler or no worker, or where one has other versions.
    """
    if address is None:
        if times_on is not None:
            raise InputError("--times-on names a worker's machine: give --on, too")
        yield None
        return
    parts = ADDRESS.fullmatch(address)
    if parts is None or int(parts[1][:9]) > LAST_PORT:
        says = "--on must be a Dask scheduler's address, such as tcp://10.0.0.1:8786"
        raise InputError(f"{says}; is '{clipped(address)}'")
    with warnings.catch_warnings():
        # Of versions of its own and of large tasks, of which a sweep says itself what matters.
        warnings.filterwarnings("ignore", module=r"distributed\b")
        client = _client(address)
        try:
            there = sorted(set(_checked(client, address).values()))
            if times_on is not None and times_on not in there:
                says = f"--times-on {clipped(times_on)}: no worker is there; on: "
                raise InputError(says + ", ".join(there))
            everywhere = _Workers(client)
            if times_on is None:
                yield Elsewhere(everywhere, gone=_gone)
            else:
                yield Elsewhere(everywhere, _Workers(client, times_on), times_on, _gone)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                client.close(timeout=PATIENCE)


def _client(address: str) -> Any:
    """A client of the scheduler."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise InputError(
            "--on needs the package distributed, which is not there "
            "(pip install 'taichi-cloth[cluster]')"
        ) from None
    for name in ("distributed", "distributed.client", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        asyncio.run(asyncio.wait_for(_greet(distributed, address), PATIENCE))
        return distributed.Client(address, timeout=ENTRY, set_as_default=False)
    except Exception as error:
        silent = isinstance(error, (OSError, TimeoutError)) or "Timeout" in type(error).__name__
        says = f"no scheduler answers within {PATIENCE:g} s"
        if not silent:  # another program's words are taken for a length of gigabytes, say
            says = f"what answers is no scheduler ({type(error).__name__})"
        raise InputError(
            f"--on {address}: {says}; start one there (dask scheduler), and workers "
            "(dask worker ADDRESS)"
        ) from None


async def _greet(distributed: Any, address: str) -> None:
    """See that a scheduler answers: a client would wait for the answer without end."""
    how = distributed.Security().get_connection_args("client")
    comm = await importlib.import_module("distributed.comm").connect(address, PATIENCE, **how)
    await comm.close()


def _checked(client: Any, address: str) -> dict[str, str]:
    """The machine of each worker, by its address; raises InputError for one of other versions."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
        found = client.run(place, on_error="return")
    except Exception as error:
        says = "the scheduler has no worker; start one (dask worker ADDRESS)"
        says = says if "Timeout" in type(error).__name__ else one_line(error)
        raise InputError(f"--on {address}: {says}") from None
    hosts, here = {}, place()[1]
    for worker, said in found.items():
        if isinstance(said, BaseException):
            says = f"--on: the worker at {worker} cannot run taichi-cloth"
            raise InputError(f"{says}: {one_line(said)}")
        host, there = said
        if there != here:
            raise InputError(refusal(f"{host} ({worker})", there, here))
        hosts[worker] = host
    return hosts


def _gone(executor: Executor) -> str:
    """Why nobody will do what waits for one of these executors; nothing while somebody may."""
    return executor.gone() if isinstance(executor, _Workers) else ""


class _Workers(Executor):
    """The workers of a client's cluster, all of them or those on the machine of this name."""

    def __init__(self, client: Any, host: str | None = None):
        self._client, self._host = client, host
        self._at: set[str] | None = None  # where what was last submitted may run; None: anywhere
        self._looked = self._seen = time.monotonic()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a function run there, which takes `wanted` besides (`tasks.run`).

        Raises TaskLost where nobody is there any more.
        """
        try:
            where = self._where()
            there = self._client.get_executor(pure=False, **where)
            made: Future[Any] = there.submit(_while_wanted, fn, *args, **kwargs)
        except TaskLost:
            raise
        except Exception:  # many kinds, by what a client without a scheduler was about to do
            raise TaskLost("the scheduler does not answer any more") from None
        self._seen = time.monotonic()
        return made

    def _where(self) -> dict[str, Any]:
        """Which workers may do it, as a client's executor takes it; nothing: all."""
        if self._host is None:
            return {}
        # Asked each time: a worker that was started again has another address.
        said = self._client.run(place, on_error="ignore")
        self._at = {worker for worker, (host, _) in said.items() if host == self._host}
        if not self._at:
            raise TaskLost(self._nobody())
        return {"workers": sorted(self._at), "allow_other_workers": False}

    def gone(self) -> str:
        """Why nobody will do what was submitted; nothing while somebody may."""
        now = time.monotonic()
        if now - self._looked > 1.0:
            self._looked = now
            with contextlib.suppress(Exception):  # what has no scheduler is cancelled anyway
                there = set(self._client.nthreads())
                if there and (self._at is None or there & self._at):
                    self._seen = now
        return self._nobody() if now - self._seen > ABSENCE else ""

    def _nobody(self) -> str:
        return f"the scheduler has no worker{f' on {self._host}' if self._host else ''} any more"


def _while_wanted(run: Callable[..., bytes], payload: bytes) -> bytes:
    """`tasks.run` on a worker, which ends a task once it is cancelled, or its client is gone."""
    worker = importlib.import_module("distributed").get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return run(payload, wanted)
