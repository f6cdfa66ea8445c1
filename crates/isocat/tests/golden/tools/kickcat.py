# The segment for KickCAT's Python binding: PROGRAM INTERFACE [CYCLES]. Made of segment.toml by
# isocat plan.
# Fits with assumptions: least slack 985 ns, SubDevice 1 (stage): calc and copy time <= SYNC1 -
# SYNC0.
# Assumed: SubDevice 0 (axis 1): calc and copy of outputs 60 us: 0x1C32:06: not published; about a
# quarter of the minimum cycle, as other drives of this class state
# Assumed: SubDevice 0 (axis 1): calc and copy of inputs 40 us: 0x1C33:06: not published; from Input
# Latch on, so the 40 us of the application are in it; copying goes on beside them
# Assumed: SubDevice 0 (axis 1): delay of outputs 30 us: 0x1C32:09: not published; one power stage
# update of 30 us, and ETG.1020 asks for less than 1 us between them
# Assumed: SubDevice 1 (stage): share of the clock error in it 3 ns: the device states 0 or nothing;
# its profile knows its CPU
# Assumed: SubDevice 1 (stage): share of the clock error in it 238 ns: the device states 0 or
# nothing; its profile knows its CPU
# Assumed: SubDevice 2 (axis 2): calc and copy of outputs 15 us: 0x1C32:06: build constants of the
# application, not in the ESI; they fit into the minimum cycle time
# Assumed: SubDevice 2 (axis 2): calc and copy of inputs 8 us: 0x1C33:06: build constants of the
# application, not in the ESI; they fit into the minimum cycle time
# Assumed: SubDevice 2 (axis 2): delay of outputs 1 us: 0x1C32:09: build constants of the
# application, not in the ESI; they fit into the minimum cycle time
# Not to be named kickcat.py, or it imports itself.
# LIMIT: the binding has no clocks, so SubDevice 0 (axis 1) runs without SYNC, if it can at all.
# Wanted: AssignActivate 0x0300, SYNC0 every 2000000 ns at phase 1024000 ns (the frame is at the
# reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC, outputs are
# ready at 89.016 us, inputs are too late from 1.95926 ms on). KickCAT's library in C++ has
# Bus::enableDC(cycle, shift, start_delay): SYNC0 alone, one period and shift for all.
# LIMIT: the binding has no clocks, so SubDevice 1 (stage) runs without SYNC, if it can at all.
# Wanted: AssignActivate 0x0700, SYNC0 every 2000000 ns at phase 1003000 ns (the frame is at the
# reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC, outputs are
# ready at 50.781 us, inputs are too late from 1.988525 ms on), SYNC1 21000 ns after it. KickCAT's
# library in C++ has Bus::enableDC(cycle, shift, start_delay): SYNC0 alone, one period and shift for
# all.
# LIMIT: the binding has no clocks, so SubDevice 2 (axis 2) runs without SYNC, if it can at all.
# Wanted: AssignActivate 0x0300, SYNC0 every 2000000 ns at phase 1024000 ns (the frame is at the
# reference clock at 0 ns, the pulse that acts lies at 1.024 ms in all devices with DC, outputs are
# ready at 45.546 us, inputs are too late from 1.99299 ms on). KickCAT's library in C++ has
# Bus::enableDC(cycle, shift, start_delay): SYNC0 alone, one period and shift for all.
import sys
import time

import kickcat
from kickcat import State
from kickcat.mailbox.request import MessageStatus

# Bus cycle, s: frames with gaps 9.6 us [wire] + one acyclic frame 6.72 us [wire] + send jitter 20
# us [asked for] + jitter of hops 136 ns [chip] + clock error 240 ns [computed from drift loops and
# hops] + 100 ppm of it and a tick 210 ns [assumed] <= cycle 2 ms [asked for], slack 1.963094 ms
CYCLE = 0.002
# Watchdog of the process data, s, the same for all: as the chips have it after reset.
WATCHDOG = 0.1

# By position: bytes of outputs, bytes of inputs. The binding shows no identities.
DEVICES = [
    # SubDevice 0 (axis 1): mode dc-sync0, as it is wished, or the highest that the device has.
    # Note: read-only in PREOP, and different there: 0x1C32:01 (0 (Free Run) instead of 2 (DC
    # SYNC0)), 0x1C33:01 (0 (Free Run) instead of 2 (DC SYNC0)). The types follow from the SYNC unit
    # on the way to SAFEOP, so its registers must be final before SAFEOP is asked for
    # vendor 0x0000006A, product 0x00ACD200
    (7, 7),
    # SubDevice 1 (stage): mode dc-sync1, as it is wished, or the highest that the device has.
    # Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the
    # first one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
    # vendor 0x69736F63, product 0x0004FFFF
    (4, 4),
    # SubDevice 2 (axis 2): mode dc-sync0, as it is wished, or the highest that the device has.
    # Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the
    # first one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
    # vendor 0x0048504D, product 0x00000003
    (7, 7),
    # SubDevice 3 (io): mode sm, as it is wished, or the highest that the device has.
    # vendor 0x69736F63, product 0x00100010
    (16, 16),
    # SubDevice 4 (coupler): mode free-run, as it is wished, or the highest that the device has.
    # vendor 0x00000002, product 0x044C2C52
    (0, 0),
]
# SDO downloads in PREOP: position, index, sub-index, complete access, bytes. Types of DC modes are
# left out.
OBJECTS = [
    # PDO assignment: count 0
    (2, 0x1C12, 0x00, False, bytes.fromhex("00")),
    # PDO assignment: 0x1600
    (2, 0x1C12, 0x01, False, bytes.fromhex("0016")),
    # PDO assignment: count 1
    (2, 0x1C12, 0x00, False, bytes.fromhex("01")),
    # PDO assignment: count 0
    (2, 0x1C13, 0x00, False, bytes.fromhex("00")),
    # PDO assignment: 0x1A00
    (2, 0x1C13, 0x01, False, bytes.fromhex("001a")),
    # PDO assignment: count 1
    (2, 0x1C13, 0x00, False, bytes.fromhex("01")),
]


link = kickcat.create_link(sys.argv[1], "")
# KickCAT waits for the whole of this time at most of its steps, however soon frames come back.
link.set_timeout(0.01)
bus = kickcat.Bus(link)
bus.init(WATCHDOG)
subdevices = bus.slaves()
if len(subdevices) != len(DEVICES):
    sys.exit(f"expected {len(DEVICES)} SubDevices, found {len(subdevices)}")
bus.wait_for_state(State.PREOP, 10.0)
for at, index, sub, complete, data in OBJECTS:
    message = subdevices[at].mailbox.write_sdo(index, sub, complete, data, 2.0)
    while message.status() == MessageStatus.RUNNING:
        bus.process_mailboxes()
        time.sleep(0.001)
    if message.status() != MessageStatus.SUCCESS:
        sys.exit(f"{at}: 0x{index:04X}:{sub:02X} is not written: {message.status()}")
bus.create_mapping()
for at, (device, expected) in enumerate(zip(subdevices, DEVICES)):
    if (device.output_size, device.input_size) != expected:
        sys.exit(f"{at}: expected {expected} bytes, found {device.output_size} and {device.input_size}")
    device.set_output_bytes(bytes(device.output_size))
bus.request_state(State.SAFE_OP)
bus.wait_for_state(State.SAFE_OP, 10.0)


def cyclic():
    bus.process_data_no_check()
    time.sleep(0.0005)


cyclic()
bus.request_state(State.OPERATIONAL)
bus.wait_for_state(State.OPERATIONAL, 10.0, cyclic)
due = time.monotonic()
for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3000):
    # Read subdevices[at].input_data and call subdevices[at].set_output_bytes() here.
    bus.process_data()
    due += CYCLE
    time.sleep(max(0, due - time.monotonic()))
for at, device in enumerate(subdevices):
    print(f"{at}: {bus.get_state(device)}")
bus.request_state(State.INIT)
