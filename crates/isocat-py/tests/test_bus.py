"""The bus: frames, instants, faults, process data, behaviours in Python."""

from __future__ import annotations

import hashlib
import threading
from types import ModuleType
from typing import Any

import isocat
import pytest


def count(command: int = 7, register: int = 0x0130, data: bytes = b"\0\0") -> bytes:
    """A broadcast frame; BRD of the AL status counts all devices."""
    body = bytes([command, 0, 0, 0]) + register.to_bytes(2, "little")
    body += len(data).to_bytes(2, "little") + b"\0\0" + data + b"\0\0"
    head = b"\xff" * 6 + b"\x02\0\0\0\0\x01\x88\xa4" + (0x1000 | len(body)).to_bytes(2, "little")
    return (head + body).ljust(60, b"\0")


def counter(answer: bytes, size: int = 2) -> int:
    return int.from_bytes(answer[26 + size : 28 + size], "little")


def test_frames_come_back_at_their_instants() -> None:
    with isocat.Segment.built_in().bus(now="1s") as bus:
        assert bus.now == 10**9 and len(bus.devices) == 5
        back, answer = bus.exchange(count(), at=10**9 + 5) or (0, b"")
        assert counter(answer) == 5
        # 60 bytes at 100 Mbit/s with preamble and check sequence are 5.76 us each way, and each
        # device takes its time.
        assert 6_000 < back - 10**9 < 20_000 and bus.now == back
        again = bus.send(count())
        assert again is not None and bus.next_arrival == again and bus.receive() is None
        bus.advance_to(again)
        came = bus.receive()
        assert came is not None and came[0] == again and came[2] == 0 and counter(came[1]) == 5


def test_the_same_calls_give_the_same_answers() -> None:
    def wire() -> str:
        with isocat.Segment.built_in().bus(seed=3) as bus:
            answers = [
                bus.exchange(count(register=0x0910, data=bytes(8)), at=at * 10**6)
                for at in range(1, 50)
            ]
        return hashlib.sha256(repr(answers).encode()).hexdigest()

    assert wire() == wire()


def test_faults() -> None:
    with isocat.Segment.built_in().bus() as bus:
        bus.fault("drop 1")
        assert bus.exchange(count()) is None
        bus.fault("pull 1 for 5ms", at="10ms")
        seen = [
            counter((bus.exchange(count(), at=at) or (0, bytes(60)))[1])
            for at in ("9ms", "12ms", "3s")
        ]
        assert seen == [5, 1, 5]
        assert bus.verdict().lost == 1
        with pytest.raises(isocat.BusError, match='fault "pul 1"'):
            bus.fault("pul 1")
        with pytest.raises(isocat.BusError, match="has passed"):
            bus.fault("heal", at=1)


def test_refused() -> None:
    bus = isocat.Segment.built_in().bus()
    with pytest.raises(isocat.BusError, match="14 to 1514"):
        bus.send(b"\0")
    with pytest.raises(isocat.BusError, match="other end of a ring"):
        bus.send(count(), port=1)
    with pytest.raises(isocat.InputError, match="0, or 1"):
        bus.send(count(), port=2)
    bus.advance("1ms")
    with pytest.raises(isocat.BusError, match="has passed"):
        bus.send(count(), at=7)
    with pytest.raises(isocat.BusError, match="too far ahead"):
        bus.advance_to(31 * 86_400 * 10**9)
    assert bus.now == 1_000_000, "what is refused has not happened"
    for wrong in ("axis 9", 5, -1, 1.5, None):
        with pytest.raises(isocat.InputError, match="expected"):
            bus.device(wrong)  # type: ignore[arg-type]
    with pytest.raises(isocat.InputError, match="64 at most"):
        bus.device(0).inputs = bytes(2_000)
    bus.close()
    with pytest.raises(isocat.BusError, match="closed"):
        bus.send(count())


def test_one_thread_at_a_time_and_none_of_its_own() -> None:
    buses = [isocat.Segment.built_in().bus() for _ in range(4)]
    threads = [threading.Thread(target=lambda bus=bus: bus.advance("2s")) for bus in buses]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [bus.now for bus in buses] == [2 * 10**9] * 4


class Axis:
    """Counts what it is asked for; its position is twice the number that it is sent."""

    def __init__(self) -> None:
        self.cycles = 0
        self.outputs = b""
        self.safe = 0

    def map_outputs(self, outputs: bytes) -> None:
        self.outputs = outputs

    def work(self, cycle_ns: int) -> None:
        assert cycle_ns == 1_000_000
        self.cycles += 1

    def map_inputs(self, inputs: bytes) -> bytes:
        return (2 * int.from_bytes(self.outputs[:2], "little") % 65_536).to_bytes(2, "little")

    def safe_outputs(self) -> None:
        self.safe += 1


def test_a_main_device_and_a_device_in_python(main_device: ModuleType) -> None:
    axis, seen = Axis(), []

    def each(main: Any, number: int) -> None:
        seen.append(int.from_bytes(main.image[:2], "little"))
        main.image[:2] = number.to_bytes(2, "little")
        if number == 30:
            main.bus.device(1).inputs = b"\x11\x22\x33"
        if number == 39:
            device = main.bus.device("axis 1" if "axis 1" in main.bus.names else 0)
            assert device.state == "OP" and device.al_status_code == 0
            assert device.outputs == axis.outputs
            assert main.image[7:10] == b"\x11\x22\x33"

    verdict, missed = main_device.run(main_device.drives(), 40, each, {0: axis})
    assert missed == 0 and verdict.answer == "in-sync", str(verdict)
    assert axis.cycles > 40 and axis.safe == 1
    # An answer of cycle n has what was sent some cycles before.
    assert seen[-1] in {2 * number for number in range(34, 40)}
    assert verdict.devices.rows()[0]["state"]
    assert not verdict.findings and verdict.as_expected


def test_a_behaviour_that_raises(main_device: ModuleType) -> None:
    class Broken:
        def map_outputs(self, outputs: bytes) -> None:
            raise ArithmeticError("of the machine")

    with pytest.raises(ArithmeticError, match="of the machine"):
        main_device.run(isocat.Segment.built_in(), 5, behaviours={0: Broken()})

    class Long:
        def map_inputs(self, inputs: bytes) -> bytes:
            return inputs + b"\0"

    with pytest.raises(
        isocat.InputError, match="map_inputs: found 8 bytes; expected 7 bytes at most"
    ):
        main_device.run(isocat.Segment.built_in(), 5, behaviours={0: Long()})

    class Text:
        def map_inputs(self, inputs: bytes) -> str:
            return "position"

    with pytest.raises(isocat.InputError, match="map_inputs: found str; expected bytes, or None"):
        main_device.run(isocat.Segment.built_in(), 5, behaviours={0: Text()})


def test_a_behaviour_without_a_method() -> None:
    class Wrong:
        def map_output(self, outputs: bytes) -> None: ...

    segment = isocat.Segment.built_in()
    with pytest.raises(isocat.InputError, match='did you mean "map_outputs" by "map_output"'):
        segment.bus(behaviours={0: Wrong()})
    with pytest.raises(isocat.InputError, match="expected"):
        segment.bus(behaviours={9: Axis()})


def test_a_behaviour_can_not_call_its_bus(main_device: ModuleType) -> None:
    refused = []

    class Reaching:
        bus: Any = None

        def work(self, cycle_ns: int) -> None:
            try:
                self.bus.verdict()
            except isocat.BusError as error:
                refused.append(str(error))

    reaching = Reaching()

    def each(main: Any, _: int) -> None:
        reaching.bus = main.bus

    # Until it has its bus, it does not get far.
    reaching.bus = isocat.Segment.built_in().bus()
    main_device.run(isocat.Segment.built_in(), 3, each, {0: reaching})
    assert refused and all("one call" in words for words in refused)
