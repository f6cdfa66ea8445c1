"""Sweeps on a Ray cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from ._errors import Error, InputError
from ._isocat import __version__
from ._sweep import MOST_IN_MEMORY, whole

if TYPE_CHECKING:
    from ._isocat import Sweep, Table
    from ._sweep import Span, Told


class ray:
    """Runs batches of a sweep as tasks of a Ray cluster: ``isocat.sweep(...,
    executor=isocat.ray())``.

    The segment and what is varied in it are sent once; a task is two numbers. It returns its rows,
    some 100 kB. A task whose worker fails is run again elsewhere: runs are independent of each
    other, so its rows are the same.

    Parameters
    ----------
    address : str, optional
        The cluster, as for ``ray.init``; if Ray runs already, it is used as it is.
    batch : int
        Number of runs of a task. 500 to 1000 runs take some ten seconds.
    retries : int
        How often a task is run again after its worker failed.
    num_cpus : float
        Number of processors of a task.
    runtime_env : dict, optional
        The environment of workers, as for Ray: ``{"pip": ["isocat==..."]}``, or
        ``{"working_dir": "."}`` for descriptions that the segment names.
    """

    def __init__(
        self,
        address: str | None = None,
        *,
        batch: int = 1000,
        retries: int = 5,
        num_cpus: float = 1,
        runtime_env: dict[str, Any] | None = None,
    ) -> None:
        self.batch = whole("batch", batch, 1, MOST_IN_MEMORY)
        self._address, self._retries = address, whole("retries", retries, 0, 1_000_000)
        if isinstance(num_cpus, bool) or not isinstance(num_cpus, (int, float)) or num_cpus <= 0:
            expected = "a number above 0"
            raise InputError(
                f"num_cpus: found {num_cpus!r}; expected {expected}",
                place="num_cpus",
                found=repr(num_cpus),
                expected=expected,
            )
        self._num_cpus, self._runtime_env = num_cpus, runtime_env

    def run(self, sweep: Sweep, spans: Iterable[Span], tell: Told) -> Iterator[tuple[Span, Table]]:
        """Runs each span as a task; yields its rows as they come, in any order."""
        cluster = _import()
        if not cluster.is_initialized():
            cluster.init(address=self._address, log_to_driver=False, runtime_env=self._runtime_env)
        task = cluster.remote(_batch).options(
            num_cpus=self._num_cpus, max_retries=self._retries, name="isocat.sweep"
        )
        base = cluster.put(sweep)
        waiting: deque[Span] = deque(spans)
        under_way: dict[Any, Span] = {}
        again: dict[Span, int] = {}
        try:
            while waiting or under_way:
                # Submits twice as many tasks as can run, so a worker that is done has a next task.
                room = 2 * max(1, int(cluster.cluster_resources().get("CPU", 1) / self._num_cpus))
                while waiting and len(under_way) < room:
                    span = waiting.popleft()
                    under_way[task.remote(base, *span, __version__)] = span
                ready, _ = cluster.wait(list(under_way), num_returns=1, timeout=1.0)
                for one in ready:
                    span = under_way.pop(one)
                    try:
                        table = cluster.get(one)
                    except cluster.exceptions.RayTaskError as error:
                        # The task itself raised this, and would raise it again.
                        raise (error.cause if isinstance(error.cause, Error) else error) from None
                    except cluster.exceptions.RayError as error:
                        again[span] = again.get(span, 0) + 1
                        if again[span] > self._retries:
                            raise RuntimeError(
                                f"runs {span[0]} to {span[1] - 1} were lost {again[span]} times with their workers; "
                                "expected workers that live for a batch: smaller ones (batch=), or more memory"
                            ) from error
                        waiting.appendleft(span)
                        continue
                    yield span, table
        finally:
            for one in under_way:
                cluster.cancel(one, force=True)


def _batch(sweep: Sweep, start: int, stop: int, version: str) -> Table:
    """Runs a batch on a worker."""
    if version != __version__:
        raise InputError(
            f"this worker has isocat {__version__}; expected {version}, which the driver has",
            found=__version__,
            expected=version,
        )
    return sweep.table(start, stop, 1)


def _import() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ImportError(
            "executor=isocat.ray() needs Ray, which is not installed: pip install 'isocat[ray]'. "
            'Without it: executor="threads"'
        ) from error
    return ray
