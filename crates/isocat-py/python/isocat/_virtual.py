"""Unmodified MainDevice programs on a virtual segment, in virtual time: the command ``isocat
virtual``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Union

from ._errors import InputError
from ._isocat import Segment, Sweep, nanoseconds
from ._sweep import _grid, _seeds, processors

if TYPE_CHECKING:
    from datetime import timedelta

    from ._sweep import Grid

    Time = Union[int, str, timedelta]


class VirtualRun:
    """One run of a program.

    Attributes
    ----------
    seed : int
    values : dict
        The value of each key that was varied.
    code : int
        0: in sync, and the program ended with 0; 1: not in sync or not as expected; 3: not known,
        because no device was in OP; 4: no finding against synchronization, but the program failed.
    output : str
        Standard output and error output of the program and the supervisor.
    summary : dict
        The judges' document (docs/serve-summary.schema.json).
    segment : Segment
        The segment that repeats the run.
    """

    def __init__(
        self,
        seed: int,
        values: dict[str, str],
        code: int,
        output: str,
        summary: dict[str, Any],
        segment: Segment,
    ) -> None:
        self.seed, self.values, self.code = seed, values, code
        self.output, self.summary, self.segment = output, summary, segment

    @property
    def in_sync(self) -> bool:
        """Whether nothing was found against devices in operation, and the program ended with 0."""
        return self.code == 0

    @property
    def verdict(self) -> str:
        """``"in-sync"``, ``"not-in-sync"``, ``"not-known"`` or ``"program-failed"``."""
        words = {0: "in-sync", 1: "not-in-sync", 3: "not-known", 4: "program-failed"}
        return words.get(self.code, f"code {self.code}")

    @property
    def findings(self) -> list[str]:
        """The findings against devices in the last session, as sentences."""
        sessions = self.summary.get("sessions") or [{}]
        judged = sessions[-1].get("judged") or {}
        return [
            f"{device['name']}: {what}"
            for device in judged.get("devices", [])
            for what in device.get("findings", [])
        ]

    def __repr__(self) -> str:
        return f"<isocat.VirtualRun seed {self.seed}: {self.verdict}>"


class VirtualRuns(Sequence["VirtualRun"]):
    """Runs of a program, in the order of their numbers."""

    def __init__(self, runs: list[VirtualRun]) -> None:
        self._runs = runs

    def __getitem__(self, place: Any) -> Any:
        return self._runs[place]

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[VirtualRun]:
        return iter(self._runs)

    @property
    def in_sync(self) -> bool:
        """Whether every run was in sync."""
        return all(run.in_sync for run in self._runs)

    @property
    def failed(self) -> list[VirtualRun]:
        """The runs that were not in sync."""
        return [run for run in self._runs if not run.in_sync]

    def rows(self) -> list[dict[str, Any]]:
        """A ``dict`` for each run, for ``pandas.DataFrame(runs.rows())``."""
        return [
            {
                "seed": run.seed,
                **run.values,
                "verdict": run.verdict,
                "frames": run.summary.get("frames"),
                "lost": run.summary.get("lost"),
                "finding": next(iter(run.findings), None),
            }
            for run in self._runs
        ]

    def __repr__(self) -> str:
        good = len(self._runs) - len(self.failed)
        return f"<isocat.VirtualRuns: {good} of {len(self._runs)} in sync>"


def virtual(
    program: Sequence[str | os.PathLike[str]],
    segment: Segment | str | os.PathLike[str] | Mapping[str, Any] | None = None,
    *,
    seeds: int | range = 1,
    grid: Grid | None = None,
    faults: str | None = None,
    lateness: Time | None = None,
    preemption: str | None = None,
    for_: Time | None = None,
    interface: str = "vt0",
    secondary: str | None = None,
    workers: int | None = None,
    env: Mapping[str, str] | None = None,
) -> VirtualRuns:
    """Runs an unmodified MainDevice program on the segment, in deterministic virtual time, once for
    each seed.

    Needs Linux on x86-64, but no root. docs/virtual.md tells which programs can be run.

    Parameters
    ----------
    program : list of str
        The program and its arguments: ``["python3", "pysoem_dc.py", "vt0"]``.
    segment : Segment, path or dict, optional
        The built-in one by default.
    seeds : int or range
        As in `sweep`. A seed is that of the segment, of the host's delays and of the program's
        random numbers.
    grid : dict, optional
        As in `sweep`.
    faults : "swarm", optional
        Each run draws its own faults.
    lateness : int, str or timedelta, optional
        How late wake-ups of the program are at most; replaces what the segment says of its host.
    preemption : str, optional
        ``"1000:300us"``: one in 1000 system calls takes up to this much longer.
    for_ : int, str or timedelta, optional
        The program is ended after this virtual time; an hour by default.
    interface, secondary : str
        The interface names of the segment and of the other end of a ring, for the program.
    workers : int, optional
        Number of concurrent runs; one for each processor by default.
    env : mapping, optional
        The environment of the program; that of this process by default.

    Returns
    -------
    VirtualRuns

    Raises
    ------
    InputError
        The program is not found, or a key or a value is invalid.
    OSError
        Programs can't be supervised on this system.
    """
    if not sys.platform.startswith("linux"):
        raise OSError(
            f"isocat.virtual: programs can't be supervised on {sys.platform}; expected Linux on x86-64"
        )
    if isinstance(program, (str, bytes)) or not program:
        raise InputError(
            f"program: found {program!r}; expected a list of the program and its arguments, such as ['python3', 'main.py', 'vt0']",
            place="program",
            found=repr(program),
            expected="a list of the program and its arguments",
        )
    if segment is None:
        segment = Segment.built_in()
    elif not isinstance(segment, Segment):
        segment = Segment(segment)
    if faults not in (None, "swarm"):
        raise InputError(f'faults: found {faults!r}; expected "swarm", or None', place="faults")
    first, count = _seeds(seeds)
    spec = Sweep(segment, _grid(grid), first, count, faults is not None)
    words = ["--interface", interface]
    for flag, text in (("--secondary", secondary), ("--preemption", preemption)):
        words += [flag, text] if text is not None else []
    for flag, time in (("--lateness", lateness), ("--for", for_)):
        words += [flag, f"{nanoseconds(time)}ns"] if time is not None else []
    words += ["--", *(os.fspath(word) for word in program)]
    pool = ThreadPoolExecutor(workers or processors())
    try:
        runs = [pool.submit(_one, spec, number, words, env) for number in range(spec.runs)]
        return VirtualRuns([run.result() for run in runs])
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _one(spec: Sweep, number: int, words: list[str], env: Mapping[str, str] | None) -> VirtualRun:
    """Makes one run, in its own process."""
    segment, values, seed = spec.segment(number), spec.values(number), spec.seed(number)
    with tempfile.TemporaryDirectory(prefix="isocat-") as folder:
        text, report = os.path.join(folder, "segment.toml"), os.path.join(folder, "report.json")
        with open(text, "w", encoding="utf-8") as file:
            file.write(segment.to_toml())
        command = [sys.executable, "-m", "isocat", "virtual", segment.path, "--text", text]
        command += ["--seed", str(seed), "--report", report, *words]
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=None if env is None else dict(env),
            check=False,
        )
        output = done.stdout.decode(errors="replace")
        if done.returncode == 2 or not os.path.exists(report):
            raise InputError(f"run {number}, seed {seed}: {output.strip()}", place=f"seed {seed}")
        with open(report, encoding="utf-8") as file:
            summary: dict[str, Any] = json.load(file)
    return VirtualRun(seed, values, done.returncode, output, summary, segment)
