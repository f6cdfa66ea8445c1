"""Segments: four ways to make one, and what is refused."""

from __future__ import annotations

import datetime
import pickle
from pathlib import Path
from typing import Any

import isocat
import pytest

TOML = """cycle = "1ms"
for = "100ms"

[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 1"
mode = "dc-sync0"
"""


def test_four_ways_give_the_same_run(tmp_path: Path) -> None:
    path = tmp_path / "machine.toml"
    path.write_text(TOML)
    built = isocat.Segment(cycle="1ms", for_=datetime.timedelta(milliseconds=100))
    assert built.add("kollmorgen_akd2g", name="axis 1", mode="dc-sync0") == 0
    device = {"device": "kollmorgen_akd2g", "name": "axis 1", "mode": "dc-sync0"}
    ways = [
        isocat.Segment(path),
        isocat.Segment.from_toml(TOML),
        isocat.Segment({"cycle": 1_000_000, "for": 100_000_000, "subdevice": [device]}),
        built,
    ]
    reports = [segment.run().to_dict() for segment in ways]
    for report in reports:
        report.pop("segment_file")
    assert all(report == reports[0] for report in reports)
    assert reports[0]["in_sync"]


def test_a_segment_comes_back_from_its_own_forms(pair: isocat.Segment, tmp_path: Path) -> None:
    assert isocat.Segment(pair.to_dict()) == pair
    assert pickle.loads(pickle.dumps(pair)) == pair
    pair.save(tmp_path / "x.toml")
    assert isocat.Segment(tmp_path / "x.toml").to_dict() == pair.to_dict()
    copy = pair.copy()
    copy.set("subdevice[*].cable", "5m")
    assert copy != pair and "5m" not in pair.to_toml()


def test_keys_go_before_the_source(pair: isocat.Segment) -> None:
    assert isocat.Segment(pair, cycle="500us").cycle_ns == 500_000
    assert pair.cycle_ns == 1_000_000


@pytest.mark.parametrize(
    ("time", "nanoseconds"),
    [(7, 7), ("250us", 250_000), ("1.5ms", 1_500_000), (datetime.timedelta(microseconds=3), 3_000)],
)
def test_times(time: Any, nanoseconds: int) -> None:
    assert isocat.nanoseconds(time) == nanoseconds


@pytest.mark.parametrize("time", [1.5, True, None, "", "7", "7 parsec", [], 2**63])
def test_no_times(time: Any) -> None:
    with pytest.raises(isocat.InputError, match="expected"):
        isocat.nanoseconds(time)


def test_unknown_keys_say_what_was_meant(pair: isocat.Segment) -> None:
    before = pair.to_dict()
    with pytest.raises(isocat.InputError, match='did you mean "cycle"'):
        isocat.Segment(cycel="1ms")
    with pytest.raises(isocat.InputError, match='did you mean "cable"') as caught:
        pair.add("kollmorgen_akd2g", cabel="3m")
    assert caught.value.place and caught.value.place.startswith("<segment>:")
    assert 'in: cabel = "3m"' in str(caught.value)
    with pytest.raises(isocat.InputError, match='did you mean "jitter"'):
        pair.set("host.jiter", "5us")
    with pytest.raises(isocat.InputError, match='did you mean "kollmorgen_akd2g"'):
        pair.add("kollmorgen_akd2")
    with pytest.raises(isocat.InputError, match="there are 2 of subdevice"):
        pair.set("subdevice[2].cable", "1m")
    assert pair.to_dict() == before


@pytest.mark.parametrize("seed", [-1, 2**64, "first", 1.5])
def test_no_seeds(pair: isocat.Segment, seed: Any) -> None:
    for call in (pair.run, pair.prove, pair.bus):
        with pytest.raises(
            isocat.InputError, match="seed: found .* expected a whole number from 0"
        ):
            call(seed=seed)  # type: ignore[operator]


@pytest.mark.parametrize("source", [7, 1.5, [], "a\nb", object()])
def test_other_types(source: Any) -> None:
    with pytest.raises(isocat.InputError):
        isocat.Segment(source)


def test_places_in_files(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(TOML.replace("dc-sync0", "dc-sync9"))
    with pytest.raises(isocat.InputError) as caught:
        isocat.Segment(path)
    assert caught.value.place == f"{path}:7:8"
    with pytest.raises(FileNotFoundError) as missing:
        isocat.Segment(tmp_path / "no.toml")
    assert missing.value.filename == str(tmp_path / "no.toml")


def test_errors_cross_processes() -> None:
    with pytest.raises(isocat.InputError) as caught:
        isocat.Segment(cycel="1ms")
    again = pickle.loads(pickle.dumps(caught.value))
    assert (type(again), str(again), again.place) == (
        isocat.InputError,
        str(caught.value),
        caught.value.place,
    )


def test_a_segment_without_devices_is_told_when_it_is_run() -> None:
    with pytest.raises(isocat.InputError, match="at least one device"):
        isocat.Segment(cycle="1ms").run()
    with pytest.raises(isocat.InputError, match="cycle"):
        isocat.Segment().add("kollmorgen_akd2g")
