"""A plain KickCAT program that brings I/O to OP and exchanges process data for some cycles of 1 ms; the binding has no clocks.

    isocat virtual SEGMENT -- python3 tests/interop/mutants_kickcat.py INTERFACE CYCLES
"""
import sys
import time

import kickcat
from kickcat import State

INTERFACE, CYCLES = sys.argv[1], int(sys.argv[2])
CYCLE = 0.001


def main():
    link = kickcat.create_link(INTERFACE, "")
    link.set_timeout(0.002)
    bus = kickcat.Bus(link)
    bus.init(0.1)
    subdevices = bus.slaves()
    bus.create_mapping()
    due = time.monotonic()

    def cycle():
        nonlocal due
        due += CYCLE
        time.sleep(max(0.0, due - time.monotonic()))
        bus.process_data_no_check()

    def state(wanted, *cyclic):
        bus.request_state(wanted)
        bus.wait_for_state(wanted, 2.0, *cyclic)

    state(State.SAFE_OP)
    for subdevice in subdevices:
        subdevice.set_output_bytes(bytes(subdevice.output_size))
    cycle()
    state(State.OPERATIONAL, cycle)
    for number in range(CYCLES):
        for subdevice in subdevices:
            subdevice.set_output_bytes(bytes([number % 256] * subdevice.output_size))
        cycle()
    state(State.INIT)


main()
