"""A plain pysoem program over a segment of drives and an I/O, with one mistake by name, or none.

    isocat virtual SEGMENT -- python3 tests/interop/mistakes_pysoem.py MISTAKE [INTERFACE [CYCLES [CONVERGENCE]]]

The segment's file asks for a cycle of 4 ms and a shift of 2 ms, with SYNC0 at each drive. The program ends with 0 whatever
came of it: the verdict is isocat's. CYCLES are those in operation, and CONVERGENCE the frames before SYNC0, 100 us apart.
"""
import socket
import struct
import sys
import time

import pysoem

MISTAKE, INTERFACE, *NUMBERS = [*sys.argv[1:], "vt0"][:2] + sys.argv[3:]
NAME, _, AT = MISTAKE.partition("@")
CYCLE, SHIFT = 4_000_000, 2_000_000
CYCLES, CONVERGENCE = [int(number) for number in NUMBERS] + [1_000, 15_000][len(NUMBERS):]
# Makers of the I/O in these segments.
NO_DRIVES = (0x02, 0x69736F63)


def has(*names):
    return NAME in names


class Program:
    def __init__(self):
        self.main = pysoem.Master()
        self.main.open(INTERFACE)
        # Else config_map() asks for SAFEOP itself, before the clocks are set up.
        self.main.manual_state_change = True
        pysoem.settings.timeouts.ret = 2_000
        self.main.config_init()
        self.devices = list(self.main.slaves)
        self.drives = [device for device in self.devices if device.man not in NO_DRIVES]
        self.target = self.devices[int(AT)] if AT else [*self.devices[-1:], *self.drives[:2]][-1]
        self.due, self.integral = None, 0.0

    # Steps, in their order.
    def run(self):
        if has("sdo-before-preop"):
            self.write_before_preop()
        self.state(pysoem.PREOP_STATE)
        self.write_types()
        if has("config-dc-first"):
            self.main.config_dc()
        self.main.config_map()
        self.after_mapping()
        if has("sync-before-dc"):
            self.start_sync()
        if not has("no-config-dc"):
            self.main.config_dc()
        if has("config-dc-twice"):
            self.main.config_dc()
        self.change_clocks()
        self.set_filters()
        if not has("no-converge"):
            for _ in range(200 if has("converge-200") else CONVERGENCE):
                self.exchange()
                time.sleep(0.0001)
        if not has("sync0-never", "sync-after-safeop", "sync-after-op", "sync-before-dc"):
            self.start_sync()
        if has("sync-twice"):
            self.start_sync()
        if not has("no-wait-after-sync"):
            # A clock behind others follows them, so that a long line settles later.
            for _ in range(200 * len(self.devices)):
                self.cycle()
        self.to_safeop()
        if has("sync-after-safeop"):
            self.start_sync()
        if has("type-late"):
            self.try_write(self.target, 0x1C32, 1, struct.pack("<H", 1))
        if has("op-never"):
            for _ in range(CYCLES):
                self.cycle()
            return self.down()
        self.to_op()
        if has("sync-after-op"):
            self.start_sync()
        for number in range(CYCLES):
            self.in_operation(number)
            self.cycle(number)
        if not has("init-forgotten"):
            self.down()

    def down(self):
        self.main.state = pysoem.INIT_STATE
        self.main.write_state()

    def write_before_preop(self):
        """PREOP is asked for, and the mailbox is used at once."""
        for drive in self.drives:
            drive.state = pysoem.INIT_STATE
            drive.write_state()
            drive.state_check(pysoem.INIT_STATE, 500_000)
            drive.state = pysoem.PREOP_STATE
            drive.write_state()
            self.try_write(drive, 0x1C32, 3, bytes(4))

    def try_write(self, device, index, sub, data):
        try:
            device.sdo_write(index, sub, data)
        except (pysoem.SdoError, pysoem.WkcError, pysoem.MailboxError):
            pass

    def interpolate(self, drive, units, power):
        """Not all drives have the object."""
        self.try_write(drive, 0x60C2, 1, struct.pack("<B", units))
        self.try_write(drive, 0x60C2, 2, struct.pack("<b", power))

    def write_types(self):
        types = {"type-sm": 1, "type-free": 0, "type-and-cycle": 2}
        for drive in self.drives:
            if NAME in types:
                self.try_write(drive, 0x1C32, 1, struct.pack("<H", types[NAME]))
            if has("type-and-cycle"):
                self.try_write(drive, 0x1C32, 2, struct.pack("<I", CYCLE))
        # Units and power of 0x60C2; 1 ms is what a drive has after power-on.
        interpolation = {"interpolation": (4, -3), "interpolation-10ms": (10, -3), "interpolation-left": (1, -3)}
        if NAME in interpolation:
            for drive in self.drives:
                self.interpolate(drive, *interpolation[NAME])
        if has("interpolation-one"):
            self.interpolate(self.target, 40, -3)
        one = {"type-free-one": 0, "type-sync1": 3}
        if NAME in one:
            self.try_write(self.target, 0x1C32, 1, struct.pack("<H", one[NAME]))

    def after_mapping(self):
        # Where the FMMUs of the target are.
        write, read = 0x0600, 0x0610
        outputs = [device._fprd(0x0600, 4) for device in self.devices]
        if has("fmmu-overlap"):
            self.target._fpwr(write, outputs[self.devices.index(self.drives[0])])
        if has("fmmu-short"):
            (length,) = struct.unpack("<H", self.target._fprd(write + 4, 2))
            self.target._fpwr(write + 4, struct.pack("<H", length - 2))
        if has("fmmu-outputs-off"):
            self.target._fpwr(write + 12, b"\x00")
        if has("fmmu-inputs-off"):
            self.target._fpwr(read + 12, b"\x00")
        if has("sm-size"):
            (length,) = struct.unpack("<H", self.target._fprd(0x0812, 2))
            self.target._fpwr(0x0812, struct.pack("<H", length - 2))
        for device in self.devices:
            if has("watchdog-off"):
                device._fpwr(0x0420, b"\x00\x00")
            if has("watchdog-1ms"):
                device._fpwr(0x0420, struct.pack("<H", 10))

    def change_clocks(self):
        def add(device, by):
            (offset,) = struct.unpack("<q", device._fprd(0x0920, 8))
            device._fpwr(0x0920, struct.pack("<q", offset + by))

        if has("offset-zero"):
            self.target._fpwr(0x0920, bytes(8))
        if has("offset-100us"):
            add(self.target, 100_000)
        if has("delay-5us"):
            (delay,) = struct.unpack("<I", self.target._fprd(0x0928, 4))
            self.target._fpwr(0x0928, struct.pack("<I", delay + 5_000))
        if has("delay-zero"):
            self.target._fpwr(0x0928, bytes(4))
        self.add = add

    def set_filters(self):
        if has("filters-untouched"):
            return
        filters = bytes([3, 7]) if has("filters-other") else bytes([4, 6])
        for device in self.devices:
            device._fpwr(0x0934, filters)

    def start_sync(self):
        wanted = self.drives
        if has("sync0-first-only"):
            wanted = self.drives[:1]
        if has("sync0-not-target"):
            wanted = [drive for drive in self.drives if drive is not self.target]
        if has("sync0-wrong-device"):
            wanted = [self.drives[0], self.devices[-1]]
        for drive in wanted:
            cycle, shift = CYCLE, SHIFT
            if has("cycle-half"):
                cycle = CYCLE // 2
            if has("cycle-double") or has("cycle-double-one") and drive is self.target:
                cycle = 2 * CYCLE
            if has("cycle-3ms"):
                cycle = 3_000_000
            if has("cycle-1ns-more"):
                cycle = CYCLE + 1
            if has("shift-0"):
                shift = 0
            if has("shift-in-us"):
                shift = SHIFT // 1000
            if has("shift-60us"):
                shift = 60_000
            if has("shift-one-300us") and drive is self.target:
                shift += 300_000
            if has("shift-one-5us") and drive is self.target:
                shift += 5_000
            if has("activate-0x0700"):
                drive.dc_sync(True, cycle, shift, sync1_cycle_time=1_000_000)
                continue
            drive.dc_sync(True, cycle, shift)
            if has("cycle-zero"):
                drive._fpwr(0x0981, b"\x00")
                drive._fpwr(0x09A0, bytes(4))
                drive._fpwr(0x0981, b"\x03")
            if has("start-past"):
                self.restart(drive, -40_000_000)
            if has("start-off-grid-one") and drive is self.target:
                self.restart(drive, 100_300_000)
            if has("activate-no-cyclic"):
                drive._fpwr(0x0981, b"\x02")

    @staticmethod
    def restart(drive, ahead):
        drive._fpwr(0x0981, b"\x00")
        (now,) = struct.unpack("<Q", drive._fprd(0x0910, 8))
        drive._fpwr(0x0990, struct.pack("<Q", now + ahead))
        drive._fpwr(0x0981, b"\x03")

    def to_safeop(self):
        if has("states-one-by-one"):
            for device in self.devices:
                device.state = pysoem.SAFEOP_STATE
                device.write_state()
                for _ in range(20):
                    self.cycle()
            return
        self.state(pysoem.SAFEOP_STATE)

    def to_op(self):
        wanted = self.devices
        if has("op-not-target"):
            wanted = [device for device in self.devices if device is not self.target]
        if has("op-blocking"):
            # Something else first; and no process data while it waits for OP.
            time.sleep(0.3)
        for attempt in range(3):
            if has("op-blocking"):
                self.main.state = pysoem.OP_STATE
                self.main.write_state()
                self.main.state_check(pysoem.OP_STATE, 15_000_000)
                self.main.read_state()
                self.due = None
            elif has("op-not-target", "states-one-by-one"):
                for device in wanted:
                    device.state = pysoem.OP_STATE
                    device.write_state()
                    for _ in range(5):
                        self.cycle()
            else:
                self.main.state = pysoem.OP_STATE
                self.main.write_state()
            for _ in range(100):
                self.cycle()
                self.main.read_state()
                if all(device.state == pysoem.OP_STATE for device in wanted):
                    return
            # As programs do it: acknowledge, and try again.
            for device in wanted:
                if device.state & pysoem.STATE_ERROR:
                    device.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
                    device.write_state()

    def in_operation(self, number):
        target, half = self.target, CYCLES // 2
        if number == half:
            if has("watchdog-off-in-op"):
                target._fpwr(0x0420, b"\x00\x00")
            if has("sync-off-in-op"):
                target._fpwr(0x0981, b"\x00")
            if has("sync-again-in-op"):
                target.dc_sync(True, CYCLE, SHIFT)
            if has("sync-shift-in-op"):
                target.dc_sync(True, CYCLE, SHIFT + 500_000)
            if has("offset-in-op"):
                self.add(target, 50_000)
            if has("reference-in-op"):
                self.add(self.devices[0], 50_000)
            if has("delay-in-op"):
                target._fpwr(0x0928, bytes(4))
            if has("clock-step-host"):
                self.due += 2_500_000
            if has("late-once"):
                time.sleep(0.003)
            if has("late-30ms"):
                time.sleep(0.03)
            if has("sdo-in-op"):
                # In the thread of the cycle, as long as it takes.
                for _ in range(500):
                    target.sdo_read(0x1018, 1)
                self.main.read_state()
                self.due = None
            if has("restart-sync-left"):
                # As a program that is started anew, and leaves SYNC0 as it was.
                self.state(pysoem.INIT_STATE)
                self.state(pysoem.PREOP_STATE)
                self.main.config_map()
                self.main.config_dc()
                self.add(target, 700_000)
                self.to_safeop()
                self.to_op()
            if has("rescan-in-op"):
                self.main.config_init()
                self.due = None
        if has("read-state-each"):
            self.main.read_state()

    def state(self, wanted):
        self.main.state = wanted
        self.main.write_state()
        for _ in range(200):
            self.cycle()
            if self.main.state_check(wanted, 2_000) == wanted:
                return

    def exchange(self):
        self.main.send_processdata()
        # A loop that forgives: an answer that is late counts as the one of the next cycle.
        self.main.receive_processdata(100 if has("receive-100us") else 2_000)

    def cycle(self, number=None):
        now = time.monotonic_ns()
        self.due = max(self.due, now - 10 * CYCLE) if self.due else now
        period = CYCLE
        if has("period-1-percent"):
            period = CYCLE * 101 // 100
        if has("period-half"):
            period = CYCLE // 2
        if has("period-double"):
            period = CYCLE * 2
        self.due += period + self.correction()
        time.sleep(max(0, self.due - time.monotonic_ns()) / 1e9)
        operates = number is not None
        if has("work-3ms") and operates and number % 100 == 99:
            # Between waking and sending.
            time.sleep(0.003)
        if has("every-second-cycle") and operates and number % 2:
            return
        self.exchange()
        if has("frame-twice") and operates:
            self.main.send_processdata()
            self.main.receive_processdata(2_000)
        if has("second-program") and operates and number % 10 == 0:
            self.stranger()

    def correction(self):
        """As SOEM's example does it: the phase of frames is controlled to the beginning of the cycle."""
        if has("no-phase-control") or not self.main.dc_time:
            return 0
        target = SHIFT if has("phase-on-sync0") else 0
        delta = (self.main.dc_time - target) % CYCLE
        if delta > CYCLE // 2:
            delta -= CYCLE
        gain = {"phase-gain-3": 3.0, "half-gain": 0.005}.get(NAME, 0.01)
        self.integral += (delta > 0) - (delta < 0)
        return int(-delta * gain - self.integral * 20)

    def stranger(self):
        wire = getattr(self, "wire", None)
        if wire is None:
            self.wire = wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88A4))
            wire.bind((INTERFACE, 0))
        datagram = struct.pack("<BBHHHH", 7, 0xEE, 0, 0x0130, 2, 0) + bytes(4)
        frame = b"\xff" * 6 + b"\x02\x22\x33\x44\x55\x66" + b"\x88\xa4" + struct.pack("<H", len(datagram) | 0x1000) + datagram
        wire.send(frame.ljust(60, b"\0"))


Program().run()
