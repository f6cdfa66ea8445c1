"""pysoem (SOEM) as it comes from the package index, in its redundant mode: `PROGRAM PRIMARY SECONDARY DEVICES CYCLE_US`.

Brings so many devices, each of which copies its outputs to its inputs, to OP and exchanges process data until its input
ends. Prints one JSON object a line: {"op": WKC} when all are in OP, then one for each cycle that is over:
{"at": SECONDS, "wkc": WKC, "echo": BOOL}, with the monotonic clock, and whether all inputs are outputs of a cycle shortly
before.
"""
import json
import select
import sys
import time

import pysoem

LAG = 16


def say(**what):
    print(json.dumps(what), flush=True)


def main():
    primary, secondary, devices, cycle_us = sys.argv[1:5]
    main_device = pysoem.Master()
    main_device.open(primary, secondary)
    # Else config_map() asks for SAFEOP itself.
    main_device.manual_state_change = True
    found = main_device.config_init()
    if found != int(devices):
        sys.exit(f"{found} devices, not {devices}")
    slaves = main_device.slaves

    def state(wanted, cyclic=None):
        main_device.state = wanted
        main_device.write_state()
        for _ in range(200):
            for _ in range(20 if cyclic else 0):
                cyclic()
            if main_device.state_check(wanted, 2_000 if cyclic else 100_000) == wanted:
                return
        sys.exit(f"not in state {wanted}: {[(hex(slave.state), hex(slave.al_status)) for slave in slaves]}")

    state(pysoem.PREOP_STATE)
    for slave in slaves:
        slave.set_watchdog("processdata", 1000)
    main_device.config_map()
    state(pysoem.SAFEOP_STATE)
    due, number, written = time.monotonic(), 0, []

    def exchange():
        nonlocal due, number
        due = max(due + int(cycle_us) / 1e6, time.monotonic() - int(cycle_us) / 1e6)
        time.sleep(max(due - time.monotonic(), 0))
        number += 1
        outputs = [bytes((number + position + at) % 256 for at in range(len(slave.output))) for position, slave in enumerate(slaves)]
        for slave, data in zip(slaves, outputs):
            slave.output = data
        written.append(outputs)
        del written[:-LAG]
        main_device.send_processdata()
        wkc = main_device.receive_processdata(20_000)
        fresh = all(any(bytes(slave.input) == outputs[position] for outputs in written) for position, slave in enumerate(slaves))
        return wkc, fresh

    for _ in range(50):
        exchange()
    state(pysoem.OP_STATE, exchange)
    say(op=main_device.expected_wkc)
    while not select.select([sys.stdin], [], [], 0)[0]:
        wkc, echo = exchange()
        say(at=time.monotonic(), wkc=wkc, echo=echo)
    main_device.state = pysoem.INIT_STATE
    main_device.write_state()
    main_device.state_check(pysoem.INIT_STATE, 500_000)
    main_device.close()


main()
