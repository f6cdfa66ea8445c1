"""Sweeps on threads: rows, where they go, what is refused."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import isocat
import isocat._sweep
import pytest

GRID = {"cycle": ["500us", "1ms"], "host.jitter": ["5us", "100us"]}


@pytest.fixture
def short() -> isocat.Segment:
    """A segment that is judged for 30 ms."""
    segment = isocat.Segment(cycle="1ms", for_="30ms")
    segment.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0")
    return segment


def test_rows_are_those_of_runs(short: isocat.Segment) -> None:
    result = isocat.sweep(short, GRID, seeds=range(5, 7))
    assert len(result) == 8 and result.as_expected and result.verdicts == {"in-sync": 8}
    rows = result.table.rows()
    assert [row["number"] for row in rows] == list(range(8))
    assert [row["seed"] for row in rows] == [5, 6] * 4
    assert [row["cycle"] for row in rows] == ["500us"] * 2 + ["1ms"] * 2 + ["500us"] * 2 + [
        "1ms"
    ] * 2
    for row in (rows[0], rows[7]):
        report = result.segment(row["number"]).run()
        assert report.seed == row["seed"]
        worst = max(report.devices["sync0_worst_ns"])
        assert row["worst_sync0_ps"] == round(worst * 1000)


def test_threads_change_nothing(short: isocat.Segment) -> None:
    one = isocat.sweep(short, GRID, seeds=3, workers=1)
    four = isocat.sweep(short, GRID, seeds=3, workers=4)
    assert one.table == four.table
    assert one.table.parquet_bytes() == four.table.parquet_bytes()


def test_values_of_python(short: isocat.Segment) -> None:
    from datetime import timedelta

    result = isocat.sweep(
        short, {"cycle": [500_000, timedelta(milliseconds=1)], "hop_jitter": [True, False]}
    )
    assert result.table["cycle"].to_list() == ["500000ns", "1000000ns"] * 2
    assert result.table["hop_jitter"].to_list() == ["true", "true", "false", "false"]
    filters = isocat.sweep(short, {"host.difference_filter": range(3, 5)})
    assert filters.table["host.difference_filter"].to_list() == [3, 4]


def test_ranges_are_drawn(short: isocat.Segment) -> None:
    result = isocat.sweep(short, {"subdevice[*].cable": "1m..100m"}, seeds=20)
    assert len(set(result.table["subdevice[*].cable"])) > 10


def test_frontier(short: isocat.Segment) -> None:
    # A copy that takes longer than the cycle can't hold.
    grid = {"cycle": ["2ms", "500us", "1ms"], "subdevice[0].copy_time": ["10us", "600us"]}
    result = isocat.sweep(short, grid, seeds=2)
    frontier = result.frontier(x="subdevice[0].copy_time", y="cycle")
    assert frontier.y_values == ["500us", "1ms", "2ms"]
    assert frontier.edges["10us"] == "each"
    assert frontier.share("600us", "500us") == 0 and frontier.share("600us", "2ms") == 1
    assert frontier.edges["600us"] == "2ms and above" and "2ms and above" in repr(frontier)
    for key in ("x", "host.jitter"):
        with pytest.raises(isocat.InputError, match="expected one of"):
            result.frontier(x=key, y="cycle")
    assert not result.as_expected and {row["finding"] for row in result.failed} == {"state-refused"}


def test_frontier_goes_to_pandas_and_matplotlib(short: isocat.Segment, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    result = isocat.sweep(short, GRID, seeds=2)
    frame = result.frontier("host.jitter", "cycle").to_pandas()
    assert frame.shape == (2, 2) and frame.loc["1ms", "5us"] == 1
    for number, keys in enumerate([(), ("cycle",), ("cycle", "host.jitter")]):
        axes = result.plot(*keys)
        axes.figure.savefig(tmp_path / f"{number}.png")
        assert (tmp_path / f"{number}.png").stat().st_size > 5_000


def test_swarm_and_shrinking(tmp_path: Path) -> None:
    segment = isocat.Segment(cycle="1ms", for_="50ms", expect=[{"in_sync": True}])
    for _ in range(3):
        segment.add("simple_io4")
    result = isocat.sweep(segment, seeds=30, faults="swarm")
    assert 0 < result.good < 30
    number = result.failed[0]["number"]
    small = result.shrink(number)
    assert len(small.to_toml()) < len(result.segment(number).to_toml())
    assert small.run().findings[0].kind == result.failed[0]["finding"]
    files = result.save_failed(tmp_path / "failed", most=2, shrink=False)
    assert not isocat.Segment(files[0]).run().as_expected and len(files) == 2


BAD: list[tuple[str, dict[str, Any], str]] = [
    ("an unknown key", {"grid": {"cycel": ["1ms"]}}, 'did you mean "cycle"'),
    (
        "a device that is not there",
        {"grid": {"subdevice[7].cable": ["1m"]}},
        "there are 1 of subdevice",
    ),
    ("a device by its name", {"grid": {"axis 1.cable": ["1m"]}}, r"expected subdevice\[0\].cable"),
    ("a value that is none", {"grid": {"cycle": ["1ms", "3 parsec"]}}, "unknown unit"),
    ("no values", {"grid": {"cycle": []}}, "no values"),
    ("a value of another kind", {"grid": {"cycle": [None]}}, "cycle"),
    ("a grid that is none", {"grid": [("cycle", "1ms")]}, "a mapping"),
    ("no seeds", {"seeds": 0}, "from 1 on"),
    ("seeds with gaps", {"seeds": range(0, 9, 2)}, "step of 1"),
    ("a list of seeds", {"seeds": [1, 2]}, "step of 1"),
    ("faults", {"faults": "storm"}, "swarm"),
    ("another executor", {"executor": "ray"}, "isocat.ray"),
    ("no workers", {"workers": 0}, "1 to 1024"),
    ("workers that are no number", {"workers": "two"}, "1 to 1024"),
    ("seeds before 0", {"seeds": range(-1, 9)}, "step of 1"),
    ("seeds that no number holds", {"seeds": 10**30}, "step of 1"),
    ("a billion values", {"grid": {"cycle": range(10**9)}}, "more than 100000 values"),
    ("values without end", {"grid": {"cycle": itertools.count(1)}}, "more than 100000 values"),
    ("to go on with nothing", {"resume": True}, "to=FOLDER"),
    ("too many for the memory", {"seeds": 10_000_001}, "to=FOLDER"),
    ("a billion", {"seeds": 10**9, "to": "never"}, "999999999 at most"),
    (
        "a billion points",
        {"grid": {"cycle": range(10**6, 10**6 + 31623), "watchdog": range(10**8, 10**8 + 31623)}},
        "999999999 at most",
    ),
]


@pytest.mark.parametrize(
    ("keys", "words"), [case[1:] for case in BAD], ids=[case[0] for case in BAD]
)
def test_refused(short: isocat.Segment, keys: dict[str, Any], words: str) -> None:
    with pytest.raises(isocat.InputError, match=words):
        isocat.sweep(short, **keys)
    assert not os.path.exists("never")


def test_a_run_whose_plan_is_refused_is_a_row(short: isocat.Segment) -> None:
    result = isocat.sweep(short, {"shift": ["1us"]})
    (row,) = result.failed
    assert row["verdict"] == "refused" and row["why"]


def test_rows_go_to_a_folder_and_are_gone_on_with(short: isocat.Segment, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    whole = isocat.sweep(short, GRID, seeds=3)

    class Some(isocat._sweep.Threads):  # type: ignore[name-defined,misc]
        """Ends in the middle."""

        def __init__(self, most: int) -> None:
            super().__init__(batch=5)
            self.most = most

        def run(self, *arguments: Any) -> Any:
            for number, item in enumerate(super().run(*arguments)):
                if number == self.most:
                    raise KeyboardInterrupt
                yield item

    to = tmp_path / "rows"
    with pytest.raises(KeyboardInterrupt):
        isocat.sweep(short, GRID, seeds=3, to=to, executor=Some(1))
    assert sorted(os.listdir(to)) == ["_isocat-sweep.json", "part-000000000000.parquet"]
    # What a process that died left behind.
    (to / "_part-000000000005.parquet.99.part").write_bytes(b"half")
    with pytest.raises(isocat.InputError, match="resume=True"):
        isocat.sweep(short, GRID, seeds=3, to=to, executor=Some(9))
    with pytest.raises(isocat.InputError, match="another sweep"):
        isocat.sweep(short, GRID, seeds=4, to=to, resume=True, executor=Some(9))
    done = isocat.sweep(short, GRID, seeds=3, to=to, resume=True, executor=Some(9))
    assert done.runs == 12 and done.good == 12
    assert done.table == whole.table
    assert (
        done.frontier("host.jitter", "cycle").edges == whole.frontier("host.jitter", "cycle").edges
    )
    assert json.loads((to / "_isocat-sweep.json").read_text())["batch"] == 5
    pandas = pytest.importorskip("pandas")
    assert list(pandas.read_parquet(to)["number"]) == list(range(12)), "it is one table to others"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    with pytest.raises(isocat.InputError, match="an empty folder"):
        isocat.sweep(short, to=tmp_path / "other")


def test_progress_is_told(short: isocat.Segment) -> None:
    told: list[tuple[int, int, int]] = []
    isocat.sweep(short, seeds=20, progress=lambda *numbers: told.append(numbers))
    assert told[-1] == (20, 0, 20) and [over for over, *_ in told] == sorted(
        over for over, *_ in told
    )

    def stop(*_: int) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        isocat.sweep(short, seeds=20, progress=stop)


def test_a_disk_that_is_full_ends_it_and_keeps_what_stands(tmp_path: Path) -> None:
    tiny = tmp_path / "tiny"
    tiny.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=24k", "tmpfs", str(tiny)],
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip("a tiny disk needs root")
    code = f"""
import isocat
import isocat._sweep
segment = isocat.Segment(cycle="1ms", for_="5ms")
segment.add("simple_io4")
isocat.sweep(segment, seeds=4000, to={str(tiny / "rows")!r},
executor=isocat._sweep.Threads(batch=100)) 
"""
    try:
        done = subprocess.run(
            [sys.executable, "-c", "import isocat._sweep\n" + code],
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        names = os.listdir(tiny / "rows")
        assert done.returncode == 1 and "No space left on device: " in done.stderr
        assert f"{tiny}/rows/part-" in done.stderr
        assert names and not any(name.endswith(".part") for name in names)
    finally:
        subprocess.run(["umount", str(tiny)], check=True)
