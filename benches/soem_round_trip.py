"""Round trips of SOEM (by pysoem): brings what is behind the interface to OP and exchanges process data at 1 kHz.

Prints the least and the median round trip of a cycle in microseconds. Used by benches/wire.sh.
"""

import sys
import time

import pysoem

interface, count = sys.argv[1], int(sys.argv[2])
main = pysoem.Master()
main.open(interface)
if main.config_init() <= 0:
    sys.exit("no SubDevice answers")
main.config_map()
main.config_dc()
main.state_check(pysoem.SAFEOP_STATE, 5_000_000)
main.state = pysoem.OP_STATE
main.send_processdata()
main.receive_processdata(20_000)
main.write_state()
trips = []
due = time.monotonic_ns()
operating = False
while len(trips) < count:
    begin = time.perf_counter_ns()
    main.send_processdata()
    counter = main.receive_processdata(20_000)
    end = time.perf_counter_ns()
    if counter == main.expected_wkc:
        trips.append((end - begin) / 1000)
    if not operating and len(trips) % 50 == 49:
        operating = main.state_check(pysoem.OP_STATE, 1000) == pysoem.OP_STATE
        trips = []
    due = max(due + 1_000_000, time.monotonic_ns())
    time.sleep(max(0, due - time.monotonic_ns()) / 1e9)
trips.sort()
print(f"{trips[0]:.1f} {trips[len(trips) // 2]:.1f}")
main.state = pysoem.INIT_STATE
main.write_state()
main.close()
