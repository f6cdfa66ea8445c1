"""Sweeps: one segment, many runs, on threads or on other machines."""

from __future__ import annotations

import operator
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol, Union

from . import _store
from ._errors import InputError
from ._isocat import Segment, Sweep, Table

if TYPE_CHECKING:
    from datetime import timedelta

    Value = Union[str, int, float, bool, timedelta]
    Grid = Mapping[str, Union[str, Iterable[Value]]]

MOST_IN_MEMORY = 10_000_000
"""Largest number of rows that a sweep keeps in memory: some 2 GB."""
MOST_POINTS = 1_000_000
"""Largest number of points of a grid that are counted apart."""

Span = tuple[int, int]
Told = Callable[[int, int], object]


class Executor(Protocol):
    """Runs the batches of a sweep."""

    batch: int

    def run(self, sweep: Sweep, spans: Iterable[Span], tell: Told) -> Iterator[tuple[Span, Table]]:
        """Runs each span; yields its rows, in any order."""
        ...


class Threads:
    """Runs on threads of this process, which do not need the interpreter's lock.

    Parameters
    ----------
    workers : int, optional
        Number of threads; one for each processor by default.
    batch : int
        Number of runs whose rows are returned together.
    """

    def __init__(self, workers: int | None = None, batch: int = 1000) -> None:
        self.workers = processors() if workers is None else whole("workers", workers, 1, 1024)
        self.batch = whole("batch", batch, 1, MOST_IN_MEMORY)

    def run(self, sweep: Sweep, spans: Iterable[Span], tell: Told) -> Iterator[tuple[Span, Table]]:
        """Runs spans; consecutive ones are run without a pause in between."""
        for start, stop in _joined(spans):
            yield from self._stretch(sweep, start, stop, tell)

    def _stretch(
        self, sweep: Sweep, start: int, stop: int, tell: Told
    ) -> Iterator[tuple[Span, Table]]:
        # A call only returns after all its batches. Several calls are made, each with enough runs
        # to keep all threads busy, so that rows are written before all runs are made.
        step = self.batch * max(1, -(-self.workers * 64 // self.batch))
        for at in range(start, stop, step):
            done: list[Table] = []
            sweep.run(at, min(at + step, stop), self.workers, self.batch, done.append, tell)
            for table in done:
                yield (at, at + len(table)), table
                at += len(table)


def processors() -> int:
    """The number of processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _joined(spans: Iterable[Span]) -> Iterator[Span]:
    last: Span | None = None
    for span in spans:
        if last and last[1] == span[0]:
            last = (last[0], span[1])
        else:
            if last:
                yield last
            last = span
    if last:
        yield last


def sweep(
    segment: Segment | str | os.PathLike[str] | Mapping[str, Any],
    grid: Grid | None = None,
    *,
    seeds: int | range = 1,
    faults: str | None = None,
    executor: str | Executor = "threads",
    workers: int | None = None,
    to: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool | Callable[[int, int, int], object] | None = None,
) -> SweepResult:
    """Runs a segment many times: over a grid of values, seeds, and faults that are drawn.

    Parameters
    ----------
    segment : Segment, path or dict
    grid : dict, optional
        Keys of the segment file, and their values. Lists make a grid together; from a range in a
        text (``"1m..100m"``) each run draws a value. ``{"cycle": ["500us", "1ms"],
        "subdevice[*].cable": "1m..100m"}``.
    seeds : int or range
        The number of seeds for each point, which begin at 1; or the seeds: a ``range`` with a step
        of 1.
    faults : "swarm", optional
        Each run draws 1 to 4 faults, in addition to those of the segment.
    executor : "threads" or an executor
        ``isocat.ray()`` runs it on a cluster, with the same table, byte for byte.
    workers : int, optional
        Number of threads; one for each processor by default.
    to : path, optional
        A folder, or the URL of a bucket (which needs pyarrow): rows are written there as Parquet
        files as they come, and not kept in memory.
    resume : bool
        Continue the sweep in ``to``, which must be the same one.
    progress : bool or callable, optional
        Whether progress is shown; by default on a terminal and in a notebook. A callable is called
        with the number of finished runs, the number of those not as expected, and the number of
        all runs.

    Returns
    -------
    SweepResult

    Raises
    ------
    InputError
        A key is unknown, a value is invalid, or there are too many runs.
    OSError
        ``to`` can't be written, for example on a full disk; written rows remain, and
        ``resume=True`` continues.
    KeyboardInterrupt
        Ctrl-C was pressed; written rows remain likewise.
    """
    if not isinstance(segment, Segment):
        segment = Segment(segment)
    first, count = _seeds(seeds)
    if faults not in (None, "swarm"):
        raise InputError(
            f'faults: found {faults!r}; expected "swarm", or None',
            place="faults",
            found=repr(faults),
            expected='"swarm", or None',
        )
    spec = Sweep(segment, _grid(grid), first, count, faults is not None)
    runner = _executor(executor, workers)
    if to is None and spec.runs > MOST_IN_MEMORY:
        raise InputError(
            f"{spec.runs} runs; expected {MOST_IN_MEMORY} at most where rows stay in memory, or to=FOLDER, which writes them",
            place="to",
            found=f"{spec.runs} runs",
            expected="to=FOLDER",
        )
    if to is None and resume:
        raise InputError("resume: found without to; expected to=FOLDER beside it", place="resume")
    store = None if to is None else _store.Store.open(to, spec, runner.batch, resume)
    result = SweepResult(spec, store)
    done = store.done() if store else {}
    for counted in done.values():
        result._count(counted)
    spans = [
        (start, min(start + runner.batch, spec.runs))
        for start in range(0, spec.runs, runner.batch)
        if start not in done
    ]
    with _Progress(spec.runs, result, progress) as bar:
        for span, table in runner.run(spec, spans, bar.tell):
            if store:
                store.write(span[0], table)
            result._add(span[0], table)
            bar.settle()
    if store:
        store.finish()
    return result


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Reads a whole number from an argument; those of numpy are such numbers, too."""
    number = None if isinstance(value, bool) or not hasattr(value, "__index__") else value
    if number is None or not least <= operator.index(number) <= most:
        expected = f"a whole number from {least} to {most}"
        raise InputError(
            f"{name}: found {value!r}; expected {expected}",
            place=name,
            found=repr(value),
            expected=expected,
        )
    return operator.index(number)


def _seeds(seeds: int | range) -> tuple[int, int]:
    first, count = 1, 0
    if isinstance(seeds, range):
        first, count = seeds.start, seeds.stop - seeds.start if seeds.step == 1 else 0
    elif hasattr(seeds, "__index__") and not isinstance(seeds, bool):
        count = operator.index(seeds)
    if 0 <= first < first + count <= 2**63:
        return first, count
    expected = "a number from 1 on, or a range with a step of 1, such as range(1000)"
    raise InputError(
        f"seeds: found {seeds!r}; expected {expected}",
        place="seeds",
        found=repr(seeds),
        expected=expected,
    )


def _grid(grid: Grid | None) -> dict[str, Any]:
    if grid is None:
        return {}
    if not isinstance(grid, Mapping):
        raise InputError(
            f"grid: found {type(grid).__name__}; expected a mapping of keys to values, such as {{'cycle': ['500us', '1ms']}}",
            place="grid",
            found=type(grid).__name__,
            expected="a mapping of keys to values",
        )
    return dict(grid)


def _executor(executor: str | Executor, workers: int | None) -> Executor:
    if executor == "threads":
        return Threads(workers)
    if not isinstance(executor, str) and hasattr(executor, "run") and hasattr(executor, "batch"):
        if workers is not None:
            raise InputError(
                "workers: goes with threads; the executor has its own", place="workers"
            )
        return executor
    raise InputError(
        f'executor: found {executor!r}; expected "threads", or isocat.ray()',
        place="executor",
        found=repr(executor),
        expected='"threads", or isocat.ray()',
    )


class SweepResult:
    """The results of many runs: a table with a row for each, in their order.

    It has the Arrow C stream interface, like `Table`.
    """

    def __init__(self, spec: Sweep, store: _store.Store | None) -> None:
        self._spec, self._store = spec, store
        self._tables: dict[int, Table] = {}
        self._table: Table | None = None
        # For each point of the grid: the number of runs, and of those as expected.
        self._points: dict[int, list[int]] = {}
        self.runs = 0
        """Number of finished runs."""
        self.good = 0
        """Number of runs as expected by the segment's ``[[expect]]`` tables, or in sync if there
        are no such tables.
        """

    def _add(self, start: int, table: Table) -> None:
        if self._store is None:
            self._tables[start] = table
        self._count(zip(table["number"].to_list(), table["as_expected"].to_list()))

    def _count(self, rows: Iterable[tuple[int, bool]]) -> None:
        seeds = self._spec.seeds
        tells_apart = self._spec.runs // seeds <= MOST_POINTS
        for number, good in rows:
            self.runs += 1
            self.good += good
            if tells_apart:
                point = self._points.setdefault(number // seeds, [0, 0])
                point[0] += 1
                point[1] += good

    @property
    def as_expected(self) -> bool:
        """Whether every run was as expected."""
        return self.good == self.runs

    @property
    def table(self) -> Table:
        """All rows; rows in ``to`` are read back, which needs pyarrow."""
        if self._table is None:
            if self._store is not None:
                self._table = self._store.read(self._spec)
            elif self._tables:
                self._table = Table.concat([self._tables[start] for start in sorted(self._tables)])
                self._tables = {0: self._table}
            else:
                self._table = self._spec.empty()
        return self._table

    def __len__(self) -> int:
        return self.runs

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.table.__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> Any:
        """The rows as a ``pandas.DataFrame``."""
        return self.table.to_pandas()

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Writes all rows to one Parquet file, completely or not at all."""
        self.table.to_parquet(path)

    @property
    def verdicts(self) -> dict[str, int]:
        """The number of runs by verdict: ``in-sync``, ``not-in-sync``, ``not-up``, ``refused``,
        ``panicked``.
        """
        counts: dict[str, int] = {}
        for verdict in self.table["verdict"]:
            counts[verdict] = counts.get(verdict, 0) + 1
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    @property
    def failed(self) -> list[dict[str, Any]]:
        """The rows of runs that were not as expected."""
        good = self.table["as_expected"].to_list()
        return [self.table.slice(at, 1).rows()[0] for at, one in enumerate(good) if not one]

    def segment(self, number: int) -> Segment:
        """A run as an independent segment, which repeats it exactly."""
        return self._spec.segment(number)

    def shrink(self, number: int) -> Segment:
        """A shrunk run: fewer faults, devices and keys, and less time, with the same verdict and
        the same kind of first finding.
        """
        return Segment.from_toml(self._spec.shrink(number), f"run-{number}.toml")

    def save_failed(
        self, folder: str | os.PathLike[str], *, most: int = 100, shrink: bool = True
    ) -> list[str]:
        """Writes the segment files of runs that were not as expected, for ``isocat run``.

        Parameters
        ----------
        folder : path
            Is created if it does not exist.
        most : int
        shrink : bool
            Shrink them first, which takes a second or two for each.

        Returns
        -------
        list of str
            The paths of the files.
        """
        os.makedirs(folder, exist_ok=True)
        files = []
        for row in self.failed[:most]:
            number = row["number"]
            path = os.path.join(os.fspath(folder), f"run-{number}.toml")
            (self.shrink(number) if shrink else self.segment(number)).save(path)
            files.append(path)
        return files

    @property
    def axes(self) -> dict[str, list[str] | None]:
        """The keys that were varied, with their values; ``None``: the values were drawn."""
        return dict(self._spec.axes)

    def frontier(self, x: str, y: str) -> Frontier:
        """The values of ``y`` with which every run was as expected, for each value of ``x``.

        Parameters
        ----------
        x, y : str
            Keys of the grid that have lists. Runs are counted over all values of other keys.
        """
        axes = self._spec.axes
        lists = {key: values for key, values in axes if values is not None}
        for name, key in (("x", x), ("y", y)):
            if key not in lists:
                expected = (
                    ", ".join(repr(key) for key in lists) or "a sweep with a grid of two keys"
                )
                raise InputError(
                    f"{name}: found {key!r}; expected one of {expected}",
                    place=name,
                    found=repr(key),
                    expected=expected,
                )
        if x == y:
            raise InputError(f"y: found {y!r} twice; expected two keys", place="y", found=repr(y))
        if self.runs and not self._points:
            raise InputError(
                f"a grid of more than {MOST_POINTS} points; expected fewer, or rows counted by hand",
                place="grid",
            )
        counts: dict[tuple[str, str], list[int]] = {}
        for point, (runs, good) in self._points.items():
            place = {}
            for key, values in axes:
                size = 1 if values is None else len(values)
                if values is not None:
                    place[key] = values[point % size]
                point //= size
            count = counts.setdefault((place[x], place[y]), [0, 0])
            count[0] += runs
            count[1] += good
        return Frontier(x, y, self._line(x), self._line(y), counts)

    def _line(self, key: str) -> tuple[list[str], bool]:
        values = list(dict(self._spec.axes)[key] or [])
        sizes = self._spec.sizes(key)
        if sizes is None:
            return list(dict.fromkeys(values)), False
        ordered = [value for _, value in sorted(zip(sizes, values), key=lambda item: item[0])]
        return list(dict.fromkeys(ordered)), True

    def plot(self, x: str | None = None, y: str | None = None, *, ax: Any = None) -> Any:
        """Plots the results with matplotlib, which must be installed.

        With two keys of the grid it plots a frontier; with one key, the share of runs as expected
        with its uncertainty; without keys, histograms of the margins.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from . import _plot

        return _plot.result(self, x, y, ax)

    def __repr__(self) -> str:
        return f"<isocat.SweepResult: {self.good} of {self.runs} runs as expected>"

    def _repr_html_(self) -> str:
        share = 100 * self.good / max(1, self.runs)
        return f"<p><b>{self.good} of {self.runs}</b> runs as expected ({share:.2f} %)</p>" + (
            self.table._repr_html_() if self._store is None else ""
        )


class Frontier:
    """The share of runs as expected at each point of two keys, and the points where all were.

    Attributes
    ----------
    x, y : str
        The keys.
    x_values, y_values : list of str
        Their values, sorted by size if they have one.
    """

    def __init__(
        self,
        x: str,
        y: str,
        x_line: tuple[list[str], bool],
        y_line: tuple[list[str], bool],
        counts: dict[tuple[str, str], list[int]],
    ) -> None:
        self.x, self.y = x, y
        self.x_values, _ = x_line
        self.y_values, self._ordered = y_line
        self._counts = counts

    def runs(self, x: str, y: str) -> int:
        """The number of runs at a point."""
        return self._counts.get((x, y), [0, 0])[0]

    def share(self, x: str, y: str) -> float:
        """The share of runs as expected at a point, 0 to 1; NaN without runs."""
        runs, good = self._counts.get((x, y), [0, 0])
        return good / runs if runs else float("nan")

    @property
    def holds(self) -> dict[str, list[str]]:
        """For each value of ``x``: the values of ``y`` with which every run was as expected."""
        return {x: [y for y in self.y_values if self.share(x, y) == 1] for x in self.x_values}

    @property
    def edges(self) -> dict[str, str]:
        """``holds`` in words: ``"500us and above"``, ``"1ms and below"``, ``"each"``, ``"none"``,
        ``"each but 1ms"``.
        """
        words = {}
        for x, good in self.holds.items():
            tried = [y for y in self.y_values if self.runs(x, y)]
            bad = [y for y in tried if y not in good]
            if not tried:
                words[x] = "not run"
            elif not bad or not good:
                words[x] = "each" if good else "none"
            elif self._ordered and tried == bad + good:
                words[x] = f"{good[0]} and above"
            elif self._ordered and tried == good + bad:
                words[x] = f"{good[-1]} and below"
            else:
                words[x] = "each but " + ", ".join(bad)
        return words

    def to_pandas(self) -> Any:
        """Shares as a ``pandas.DataFrame``: a row for each value of ``y``, a column for each of
        ``x``.
        """
        try:
            import pandas
        except ImportError as error:
            raise ImportError(
                "to_pandas() needs pandas, which is not installed: pip install pandas. "
                "Without it: share(x, y), or holds"
            ) from error
        shares = [[self.share(x, y) for x in self.x_values] for y in self.y_values]
        frame = pandas.DataFrame(shares, index=self.y_values, columns=self.x_values)
        return frame.rename_axis(index=self.y, columns=self.x)

    def plot(self, *, ax: Any = None) -> Any:
        """Plots it with matplotlib: a cell for each point, green if every run was as expected."""
        from . import _plot

        return _plot.frontier(self, ax)

    def __repr__(self) -> str:
        width = max([len(self.x), *(len(x) for x in self.x_values)])
        lines = [f"{self.x:<{width}}  {self.y} at which every run was as expected"]
        lines += [f"{x:<{width}}  {words}" for x, words in self.edges.items()]
        return "\n".join(lines)


class _Progress:
    """Shows the progress of a sweep."""

    def __init__(
        self,
        total: int,
        result: SweepResult,
        wish: bool | Callable[[int, int, int], object] | None,
    ) -> None:
        self._total, self._result = total, result
        self._call = wish if callable(wish) else None
        self._bar: Any = None
        self._line = False
        self._told = 0.0
        if self._call is None and (wish or (wish is None and _is_watched())):
            try:
                from tqdm.auto import tqdm

                self._bar = tqdm(total=total, initial=result.runs, unit="run")
            except ImportError:
                self._line = True

    def __enter__(self) -> _Progress:
        return self

    def tell(self, over: int, bad: int) -> None:
        """Shows the finished runs of the present call, and how many were not as expected."""
        done = self._result
        self._show(done.runs + over, done.runs - done.good + bad)

    def settle(self) -> None:
        """Shows the rows that have been taken."""
        self._show(self._result.runs, self._result.runs - self._result.good)

    def _show(self, over: int, bad: int) -> None:
        # A call counts from its own beginning, so rows taken meanwhile are counted twice.
        over = min(over, self._total)
        if self._call:
            self._call(over, bad, self._total)
        elif self._bar is not None:
            self._bar.update(max(0, over - self._bar.n))
            self._bar.set_postfix_str(f"{bad} not as expected", refresh=False)
        elif self._line and (time.monotonic() - self._told > 1 or over == self._total):
            self._told = time.monotonic()
            print(f"\r{over} of {self._total} runs, {bad} not as expected", end="", file=sys.stderr)

    def __exit__(self, *_exception: object) -> None:
        if self._bar is not None:
            self._bar.close()
        elif self._line:
            print(file=sys.stderr)


def _is_watched() -> bool:
    return sys.stderr.isatty() or "ipykernel" in sys.modules
