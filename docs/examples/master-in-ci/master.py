"""pysoem on the segment of docs/recipes.md: clocks, SYNC0 by the plan's figures, a look whether it runs, OP, and bringing back
who fell. pysoem_dc.py INTERFACE [CYCLES]"""
import sys
import time

import pysoem

CYCLE, SHIFT = 4_000_000, 2_024_000     # ns; SHIFT is the acting pulse of `isocat plan`
WITH_SYNC0 = [0, 1]                     # whose mode in the plan is dc-sync0

pysoem.settings.timeouts.ret = 20_000   # us, of what is not cyclic; a busy machine needs more than 2 ms
main_device = pysoem.Master()
main_device.manual_state_change = True  # else config_map() asks for SAFEOP before SYNC is set up
main_device.open(sys.argv[1])
if main_device.config_init() <= 0:
    sys.exit("no SubDevice")
devices = main_device.slaves
due = 0


def ask(state):
    main_device.state = state
    main_device.write_state()


def exchange(paced=True):
    """A frame now, or at its time; it carries the drift datagram, too. Whether the working counter was right."""
    global due
    if paced:
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
    main_device.send_processdata()
    right = main_device.receive_processdata(2_000) == main_device.expected_wkc
    # When it was at the reference clock: 0 of the cycle is wanted.
    off = (main_device.dc_time + CYCLE // 2) % CYCLE - CYCLE // 2
    if paced:
        due += CYCLE - off // 16
    return right


def bring_back(number):
    if main_device.read_state() == pysoem.OP_STATE:
        return
    for at, device in enumerate(devices):
        if device.state == pysoem.SAFEOP_STATE + pysoem.STATE_ERROR:
            print(f"cycle {number}: {at} fell, {pysoem.al_status_code_to_string(device.al_status)}")
            device.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
            device.write_state()
        elif device.state == pysoem.SAFEOP_STATE:
            device.state = pysoem.OP_STATE
            device.write_state()
        elif device.state == 0:
            device.recover()
        elif device.state != pysoem.OP_STATE and device.reconfig():
            print(f"cycle {number}: {at} set up anew")


ask(pysoem.PREOP_STATE)
main_device.state_check(pysoem.PREOP_STATE, 1_000_000)
main_device.config_map()
main_device.config_dc()
for at in WITH_SYNC0:                   # the drift loops' filters: with those of reset, 0 and 12, a loop learns its speed too slowly
    devices[at]._fpwr(0x0934, bytes([4, 6]))
for _ in range(15_000):                 # the clocks converge
    exchange(paced=False)
due = time.monotonic_ns()
for _ in range(250):                    # frames come to their phase
    exchange()
for at in WITH_SYNC0:
    devices[at].dc_sync(True, CYCLE, SHIFT)
for _ in range(50):                     # the first pulse comes after 100 ms
    exchange()
for at in WITH_SYNC0:
    difference, pulse = (int.from_bytes(devices[at]._fprd(register, 4), "little") for register in (0x092C, 0x0990))
    time.sleep(0.01)
    runs = int.from_bytes(devices[at]._fprd(0x0990, 4), "little") != pulse
    print(f"{at}: 0x092C {difference & 0x7FFFFFFF} ns, SYNC0 {'runs' if runs else 'stands'}")
due = time.monotonic_ns()
for number in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3000):
    if number == 250:                   # in phase again; without a pause in the cycle
        ask(pysoem.SAFEOP_STATE)
    if number == 500:
        ask(pysoem.OP_STATE)
    exchange()
    if number > 750 and number % 25 == 0:
        bring_back(number)
main_device.read_state()
for at, device in enumerate(devices):
    print(f"{at}: state {device.state}, {pysoem.al_status_code_to_string(device.al_status)}")
ask(pysoem.INIT_STATE)
