# The segment for pysoem: PROGRAM INTERFACE [CYCLES]. Made of segment.toml by isocat plan.
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
# Not to be named pysoem.py, or it imports itself.
# LIMIT: SOEM does not look whether SYNC0 runs; the program reads 0x0990 twice.
import sys
import time

import pysoem

# Bus cycle, ns: frames with gaps 9.6 us [wire] + one acyclic frame 6.72 us [wire] + send jitter 20
# us [asked for] + jitter of hops 136 ns [chip] + clock error 240 ns [computed from drift loops and
# hops] + 100 ppm of it and a tick 210 ns [assumed] <= cycle 2 ms [asked for], slack 1.963094 ms
CYCLE = 2000000
# Phase of the frame at the reference clock, in the cycle of system time, ns. It may be late by
# 20136 ns.
SEND_PHASE = 0

# By position: vendor, product, bytes of outputs, bytes of inputs.
DEVICES = [
    # SubDevice 0 (axis 1): mode dc-sync0, as it is wished, or the highest that the device has.
    # Note: read-only in PREOP, and different there: 0x1C32:01 (0 (Free Run) instead of 2 (DC
    # SYNC0)), 0x1C33:01 (0 (Free Run) instead of 2 (DC SYNC0)). The types follow from the SYNC unit
    # on the way to SAFEOP, so its registers must be final before SAFEOP is asked for
    (0x0000006A, 0x00ACD200, 7, 7),
    # SubDevice 1 (stage): mode dc-sync1, as it is wished, or the highest that the device has.
    # Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the
    # first one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
    (0x69736F63, 0x0004FFFF, 4, 4),
    # SubDevice 2 (axis 2): mode dc-sync0, as it is wished, or the highest that the device has.
    # Note: its first OpMode switches DC off (AssignActivate 0x0000); a MainDevice that takes the
    # first one leaves it without SYNC. OpMode 1, counted from 0, is the one with SYNC0
    (0x0048504D, 0x00000003, 7, 7),
    # SubDevice 3 (io): mode sm, as it is wished, or the highest that the device has.
    (0x69736F63, 0x00100010, 16, 16),
    # SubDevice 4 (coupler): mode free-run, as it is wished, or the highest that the device has.
    (0x00000002, 0x044C2C52, 0, 0),
]
# SDO downloads in PREOP: position, index, sub-index, bytes, complete access.
OBJECTS = [
    # synchronization: 3 (DC SYNC1)
    (1, 0x1C32, 0x01, bytes.fromhex("0300"), False),
    # synchronization: 2 ms
    (1, 0x1C32, 0x02, bytes.fromhex("80841e00"), False),
    # synchronization: 3 (DC SYNC1)
    (1, 0x1C33, 0x01, bytes.fromhex("0300"), False),
    # synchronization: 2 ms
    (1, 0x1C33, 0x02, bytes.fromhex("80841e00"), False),
    # PDO assignment: count 0
    (2, 0x1C12, 0x00, bytes.fromhex("00"), False),
    # PDO assignment: 0x1600
    (2, 0x1C12, 0x01, bytes.fromhex("0016"), False),
    # PDO assignment: count 1
    (2, 0x1C12, 0x00, bytes.fromhex("01"), False),
    # PDO assignment: count 0
    (2, 0x1C13, 0x00, bytes.fromhex("00"), False),
    # PDO assignment: 0x1A00
    (2, 0x1C13, 0x01, bytes.fromhex("001a"), False),
    # PDO assignment: count 1
    (2, 0x1C13, 0x00, bytes.fromhex("01"), False),
    # synchronization: 2 (DC SYNC0)
    (2, 0x1C32, 0x01, bytes.fromhex("0200"), False),
    # synchronization: 2 (DC SYNC0)
    (2, 0x1C33, 0x01, bytes.fromhex("0200"), False),
]
# SYNC pulses: position, period of SYNC0, its phase in the cycle of system time, SYNC1 after SYNC0
# (None without), in ns.
PULSES = [
    # 2000000: 0x1C32:05: minimum cycle 250 us [0x1C32:05] <= cycle 2 ms [asked for], slack 1.75 ms.
    # 1024000: the frame is at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in
    # all devices with DC, outputs are ready at 89.016 us, inputs are too late from 1.95926 ms on.
    (0, 2000000, 1024000, None),
    # 2000000: 0x1C32:05: minimum cycle 60 us [0x1C32:05] <= cycle 2 ms [asked for], slack 1.94 ms.
    # 1003000: the frame is at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in
    # all devices with DC, outputs are ready at 50.781 us, inputs are too late from 1.988525 ms on.
    # 21000: mode dc-sync1; 0x1C32:06: calc and copy of outputs 20 us [0x1C32:06] + 100 ppm of it
    # and a tick 12 ns [assumed] + share of the clock error in it 3 ns [assumed] <= SYNC0 to SYNC1
    # 21 us [plan], slack 985 ns; 0x1C32:02: SYNC0 to SYNC1 21 us [plan] + share of the clock error
    # in it 238 ns [assumed] + tick of the pulse 10 ns [chip] + less, not equal 1 ns [plan] <= SYNC0
    # cycle 2 ms [asked for], slack 1.978751 ms.
    (1, 2000000, 1003000, 21000),
    # 2000000: 0x1C32:05: minimum cycle 31.2 us [0x1C32:05] <= cycle 2 ms [asked for], slack 1.9688
    # ms.
    # 1024000: the frame is at the reference clock at 0 ns, the pulse that acts lies at 1.024 ms in
    # all devices with DC, outputs are ready at 45.546 us, inputs are too late from 1.99299 ms on.
    (2, 2000000, 1024000, None),
]
# Registers of 16 bits that are written by hand when pulses are set up: position, address, value.
WORDS = [
]


# us, of what is not cyclic; a busy machine needs more than 2 ms
pysoem.settings.timeouts.ret = 20_000
main_device = pysoem.Master()
# Else config_map() asks for SAFEOP before SYNC is set up.
main_device.manual_state_change = True
main_device.open(sys.argv[1])
if main_device.config_init() != len(DEVICES):
    sys.exit(f"expected {len(DEVICES)} SubDevices, found {len(main_device.slaves)}")
slaves = main_device.slaves
due = 0


def ask(state):
    main_device.state = state
    main_device.write_state()


def exchange(paced=True):
    """A frame now, or at its time; it carries the drift datagram, too."""
    global due
    if paced:
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
    main_device.send_processdata()
    main_device.receive_processdata(2_000)
    # When it was at the reference clock: 0 is wanted.
    off = (main_device.dc_time - SEND_PHASE + CYCLE // 2) % CYCLE - CYCLE // 2
    if paced:
        due += CYCLE - off // 16


def next_pulse(at):
    return int.from_bytes(slaves[at]._fprd(0x0990, 4), "little")


for at, (vendor, product, _, _) in enumerate(DEVICES):
    if (slaves[at].man, slaves[at].id) != (vendor, product):
        sys.exit(f"{at}: expected vendor 0x{vendor:08X} and product 0x{product:08X}, found "
                 f"0x{slaves[at].man:08X} and 0x{slaves[at].id:08X}")
ask(pysoem.PREOP_STATE)
main_device.state_check(pysoem.PREOP_STATE, 1_000_000)
for at, index, sub, data, complete in OBJECTS:
    slaves[at].sdo_write(index, sub, data, complete)
main_device.config_map()
for at, (_, _, outputs, inputs) in enumerate(DEVICES):
    found = len(slaves[at].output), len(slaves[at].input)
    if found != (outputs, inputs):
        sys.exit(f"{at}: expected {outputs} and {inputs} bytes of outputs and inputs, found {found}")
main_device.config_dc()
# Filters of the drift loops: with those of reset, 0 and 12, a loop learns its speed too slowly.
for at, *_ in PULSES:
    slaves[at]._fpwr(0x0934, bytes([4, 6]))
# The clocks converge, then frames come to their phase.
for _ in range(15_000):
    exchange(paced=False)
due = time.monotonic_ns()
for _ in range(250):
    exchange()
for at, sync0, phase, sync1 in PULSES:
    slaves[at].dc_sync(True, sync0, phase, sync1)
for at, address, value in WORDS:
    slaves[at]._fpwr(address, value.to_bytes(2, "little"))
# The first pulse comes after 100 ms.
for _ in range(200_000_000 // CYCLE + 1):
    exchange()
for at, *_ in PULSES:
    pulse = next_pulse(at)
    # Ten cycles are longer than any period of SYNC0 that is used with them.
    time.sleep(10 * CYCLE / 1e9)
    print(f"{at}: SYNC0 {'runs' if next_pulse(at) != pulse else 'stands'}")
due = time.monotonic_ns()
for number in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3000):
    # In phase again; then up, without a pause in the cycle.
    if number == 250:
        ask(pysoem.SAFEOP_STATE)
    if number == 500:
        ask(pysoem.OP_STATE)
    # Read slaves[at].input and set slaves[at].output here.
    exchange()
main_device.read_state()
for at, device in enumerate(slaves):
    print(f"{at}: state {device.state}, {pysoem.al_status_code_to_string(device.al_status)}")
in_op = all(device.state == pysoem.OP_STATE for device in slaves)
ask(pysoem.INIT_STATE)
sys.exit(0 if in_op else 1)
