"""Sweeps on a local Ray cluster: the same table, with workers and drivers that die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import isocat
import isocat._sweep
import pytest

ray = pytest.importorskip("ray")
pytest.importorskip("pyarrow")

GRID = {"cycle": ["500us", "1ms"], "host.jitter": ["5us", "100us"]}


@pytest.fixture(scope="module")
def cluster() -> Any:
    # Workers import isocat from where this process has it.
    paths = os.pathsep.join(path for path in sys.path if path)
    ray.init(
        # Not one that happens to run on this machine.
        address="local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        runtime_env={"env_vars": {"PYTHONPATH": paths}},
    )
    yield ray
    ray.shutdown()


@pytest.fixture
def small() -> isocat.Segment:
    segment = isocat.Segment(cycle="1ms", for_="10ms")
    segment.add("simple_io4")
    return segment


def test_the_same_table_to_the_byte(cluster: Any, small: isocat.Segment) -> None:
    there = isocat.sweep(small, GRID, seeds=25, executor=isocat.ray(batch=7))
    here = isocat.sweep(small, GRID, seeds=25)
    assert there.runs == 100 and there.table == here.table
    assert there.table.parquet_bytes() == here.table.parquet_bytes()
    assert (
        there.frontier("host.jitter", "cycle").edges == here.frontier("host.jitter", "cycle").edges
    )


def test_workers_that_are_killed(cluster: Any, small: isocat.Segment) -> None:
    small.set("for", "2s")
    over = threading.Event()
    killed: list[int] = []

    def kill() -> None:
        while not over.wait(0.1) and len(killed) < 3:
            for process in _workers():
                os.kill(process, signal.SIGKILL)
                killed.append(process)
                break

    killer = threading.Thread(target=kill)
    killer.start()
    there = isocat.sweep(small, GRID, seeds=100, executor=isocat.ray(batch=10))
    over.set()
    killer.join()
    assert killed, "it was over before a worker was killed"
    assert there.table == isocat.sweep(small, GRID, seeds=100).table


def _workers() -> list[int]:
    """Workers of this cluster that run a batch: children of children of this process."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            title = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if title.startswith(b"ray::isocat.sweep"):
            found.append(int(entry.name))
    return found


DRIVER = """
import isocat, sys
segment = isocat.Segment(cycle="1ms", for_="500ms")
segment.add("simple_io4")
isocat.sweep(
    segment, {"host.jitter": ["5us", "100us"]}, seeds=50, to=sys.argv[1], resume=len(sys.argv) > 2,
    executor=isocat.ray(address=%r, batch=4, runtime_env={"env_vars": {"PYTHONPATH": %r}}),
)
"""


def test_a_driver_that_is_killed(cluster: Any, tmp_path: Path) -> None:
    address = cluster.get_runtime_context().gcs_address
    paths = os.pathsep.join(path for path in sys.path if path)
    to, script = tmp_path / "rows", tmp_path / "driver.py"
    script.write_text(DRIVER % (address, paths))
    env = {**os.environ, "PYTHONPATH": paths}
    driver = subprocess.Popen([sys.executable, str(script), str(to)], env=env)
    deadline = time.monotonic() + 120
    while not (to.exists() and len(list(to.glob("part-*.parquet"))) >= 3):
        assert time.monotonic() < deadline and driver.poll() is None
        time.sleep(0.05)
    driver.kill()
    driver.wait()
    there = {part.name: part.read_bytes() for part in to.glob("part-*.parquet")}
    assert 3 <= len(there) < 25
    subprocess.run(
        [sys.executable, str(script), str(to), "resume"], env=env, check=True, timeout=240
    )
    parts = {part.name: part.read_bytes() for part in to.glob("part-*.parquet")}
    assert len(parts) == 25 and all(parts[name] == content for name, content in there.items())

    segment = isocat.Segment(cycle="1ms", for_="500ms")
    segment.add("simple_io4")
    batches = isocat._sweep.Threads(batch=4)
    here = isocat.sweep(
        segment, {"host.jitter": ["5us", "100us"]}, seeds=50, to=tmp_path / "here", executor=batches
    )
    assert here.runs == 100
    for name, content in parts.items():
        assert (tmp_path / "here" / name).read_bytes() == content


def test_what_a_worker_raises_comes_out(cluster: Any, small: isocat.Segment) -> None:
    from isocat import _ray

    spec = isocat._sweep.Sweep(small, {}, 1, 3, False)
    with pytest.raises(isocat.InputError, match="which the driver has"):
        _ray._batch(spec, 0, 1, "0.0.0")
    for bad in ({"batch": 0}, {"batch": "many"}, {"retries": -1}, {"num_cpus": 0}):
        with pytest.raises(isocat.InputError, match="expected a"):
            isocat.ray(**bad)  # type: ignore[arg-type]
