"""A small MainDevice in Python over `Segment.bus`: it brings two drives into OP with SYNC0, runs
some cycles, and tells what the judges say of it. No socket, no hardware, no waiting.

    python main_device.py [CYCLES]

What it writes into the drives is what `isocat plan --start-up` lists for them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import isocat

APWR, FPRD, FPWR, BRD, BWR, LRW, FRMW = 2, 4, 5, 7, 8, 12, 14
INIT, PREOP, SAFEOP, OP, ACKNOWLEDGE = 1, 2, 4, 8, 0x10
DRIVES, STATION, BYTES = 2, 0x1001, 14
CYCLE = 1_000_000


class MainDevice:
    """Sends frames at instants of its own; `due` is that of the next cycle."""

    def __init__(self, bus: isocat.Bus, shift: int) -> None:
        self.bus, self.shift, self.due = bus, shift, bus.now
        self.image = bytearray(BYTES)
        self._index = 0

    def exchange(self, *datagrams: tuple[int, int, int, bytes]) -> list[tuple[bytes, int]]:
        """One frame of datagrams (command, adp, ado, data); gives data and working counter of
        each.
        """
        body = b""
        for number, (command, adp, ado, data) in enumerate(datagrams):
            more = 0x8000 if number + 1 < len(datagrams) else 0
            self._index = (self._index + 1) % 256
            head = bytes([command, self._index]) + (adp & 0xFFFF).to_bytes(2, "little")
            head += ado.to_bytes(2, "little") + (len(data) | more).to_bytes(2, "little") + bytes(2)
            body += head + data + bytes(2)
        ethernet = b"\xff" * 6 + b"\x02\0\0\0\0\x01\x88\xa4"
        frame = ethernet + (0x1000 | len(body)).to_bytes(2, "little") + body
        back = self.bus.exchange(frame.ljust(60, b"\0"))
        if back is None:
            return [(data, 0) for *_, data in datagrams]
        answers, at = [], 16
        for *_, data in datagrams:
            end = at + 10 + len(data)
            answers.append(
                (back[1][at + 10 : end], int.from_bytes(back[1][end : end + 2], "little"))
            )
            at = end + 2
        return answers

    def access(self, command: int, adp: int, ado: int, data: bytes) -> tuple[int, int]:
        """One datagram by itself; gives its value and its working counter."""
        ((answer, counter),) = self.exchange((command, adp, ado, data))
        return int.from_bytes(answer, "little"), counter

    def write(self, drive: int, address: int, value: int, size: int) -> None:
        _, counter = self.access(FPWR, STATION + drive, address, value.to_bytes(size, "little"))
        assert counter == 1, f"drive {drive} did not take 0x{address:04X}"

    def read(self, drive: int, address: int, size: int) -> int:
        value, counter = self.access(FPRD, STATION + drive, address, bytes(size))
        assert counter == 1, f"drive {drive} was not read at 0x{address:04X}"
        return value

    def cycle(self) -> int:
        """Waits for the next cycle: the reference time for all, and process data; gives the working
        counter of these.

        The instant of the cycle behind it follows the reference clock, which is to be at 0 of its
        cycle.
        """
        self.bus.advance_to(max(self.due, self.bus.now))
        (time, _), (data, counter) = self.exchange(
            (FRMW, STATION, 0x0910, bytes(8)), (LRW, 0, 0, bytes(self.image))
        )
        self.image[:] = data
        off = int.from_bytes(time, "little") % CYCLE
        self.due += CYCLE - int((off - CYCLE if off > CYCLE // 2 else off) / 16)
        return counter

    def reach(self, state: int) -> None:
        for drive in range(DRIVES):
            self.write(drive, 0x0120, state, 2)
        for _ in range(3000):
            if all(self.read(drive, 0x0130, 2) & 0x1F == state for drive in range(DRIVES)):
                return
            self.cycle()
        raise TimeoutError(f"no drive comes to state {state}")

    def bring_up(self) -> None:
        _, found = self.access(BRD, 0, 0x0130, bytes(2))
        self.access(BWR, 0, 0x0120, bytes([INIT | ACKNOWLEDGE, 0]))
        self.access(BWR, 0, 0x0981, b"\0")
        for at in range(found):
            self.access(APWR, -at, 0x0010, (STATION + at).to_bytes(2, "little"))
        for drive in range(DRIVES):
            # Mailbox: 256 bytes at 0x1000 and at 0x1100.
            self.write(drive, 0x0800, 0x0001002601001000, 8)
            self.write(drive, 0x0808, 0x0001002201001100, 8)
        self.due = self.bus.now
        self.reach(PREOP)
        for drive in range(DRIVES):
            logical = BYTES // DRIVES * drive
            self.write(drive, 0x0810, 0x0001006400071200, 8)  # outputs: 7 bytes at 0x1200
            self.write(drive, 0x0818, 0x0001002000071400, 8)  # inputs: 7 bytes at 0x1400
            for fmmu, place in ((0x0600, 0x0000000102001200), (0x0610, 0x0000000101001400)):
                self.write(drive, fmmu, 0x0700000700000000 | logical, 8)
                self.write(drive, fmmu + 8, place, 8)
        self.set_up_clocks()
        self.due = self.bus.now
        for _ in range(250):  # frames come to their phase
            self.cycle()
        start = self.read(0, 0x0910, 8) // CYCLE * CYCLE + 100 * CYCLE + self.shift
        for drive in range(DRIVES):
            self.write(drive, 0x09A0, CYCLE, 8)
            self.write(drive, 0x0990, start, 8)
            self.write(drive, 0x0981, 3, 1)
        for _ in range(150):
            self.cycle()
        self.reach(SAFEOP)
        self.reach(OP)

    def set_up_clocks(self) -> None:
        """Delay and offset of each drive against the first one, whose clock leads. They stand in a
        line.
        """
        self.access(BWR, 0, 0x0900, bytes(4))
        reference = loop = 0
        for drive in range(DRIVES):
            out, back = self.read(drive, 0x0900, 4), self.read(drive, 0x0904, 4)
            goes_on = self.read(drive, 0x0110, 2) & 0x20  # there is a link at port 1
            received, behind = self.read(drive, 0x0918, 8), (back - out) % 2**32 if goes_on else 0
            if drive == 0:
                reference, loop = received, behind
            delay = (loop - behind) // 2
            self.write(drive, 0x0920, (reference + delay - received) % 2**64, 8)
            self.write(drive, 0x0928, delay, 4)
            # It forgets what was filtered before the clock was set.
            self.write(drive, 0x0930, 0x1000, 2)
        # The clocks converge. With the 15 000 frames that are usual, SYNC0 would be off by some 900
        # ns at first.
        for _ in range(60_000):
            self.exchange((FRMW, STATION, 0x0910, bytes(8)))


def run(
    segment: isocat.Segment,
    cycles: int,
    each: Callable[[MainDevice, int], object] = lambda _main, _number: None,
    behaviours: dict[str | int, object] | None = None,
) -> tuple[isocat.Verdict, int]:
    """Brings the drives up and runs so many cycles; gives the verdict, and how many cycles were
    incomplete.
    """
    shift = segment.plan().devices["sync0_phase_ns"][0]
    with segment.bus(behaviours=behaviours) as bus:
        main = MainDevice(bus, shift)
        main.bring_up()
        missed = 0
        for number in range(cycles):
            each(main, number)
            missed += main.cycle() != 3 * DRIVES
        main.access(BWR, 0, 0x0120, bytes([INIT, 0]))
        bus.advance("10ms")
        bus.finish()
        return bus.verdict(), missed


def drives() -> isocat.Segment:
    """What it operates. A segment with more in it would have devices that are not in OP."""
    segment = isocat.Segment(cycle="1ms")
    for name in ("axis 1", "axis 2"):
        segment.add("kollmorgen_akd2g", name=name, mode="dc-sync0")
    return segment


if __name__ == "__main__":
    verdict, missed = run(drives(), int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
    print(verdict)
    print(f"{missed} cycles incomplete: {verdict.answer}")
    sys.exit(0 if verdict.in_sync else 1)
