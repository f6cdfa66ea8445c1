"""pysoem (SOEM) as it comes from the package index, as the MainDevice of a served segment."""
import time

import pysoem

from peer import Failed, Session

STATES = {pysoem.PREOP_STATE: "PREOP", pysoem.SAFEOP_STATE: "SAFEOP", pysoem.OP_STATE: "OP", pysoem.INIT_STATE: "INIT"}


def steps(session):
    task, devices = session.task, session.devices
    # A stall of the machine is no fault of the segment.
    pysoem.settings.timeouts.ret = 100_000
    main_device = pysoem.Master()
    main_device.open(session.interface)
    # Else config_map() asks for SAFEOP itself, before the clocks are set up.
    main_device.manual_state_change = True
    session.expect("SubDevices", main_device.config_init(), len(devices))
    for subdevice, device in zip(main_device.slaves, devices):
        identity = (subdevice.man, subdevice.id, subdevice.rev)
        session.expect(device["name"], identity, (device["vendor"], device["product"], device["revision"]))
    session.ok("preop", f"{len(devices)} SubDevices")

    def state(wanted, cyclic=None):
        main_device.state = wanted
        main_device.write_state()
        for _ in range(100):
            if cyclic:
                for _ in range(20):
                    cyclic()
            if main_device.state_check(wanted, 2_000 if cyclic else 100_000) == wanted:
                return
        main_device.read_state()
        off = [f"{device['name']} {subdevice.state:#x}/{subdevice.al_status:#06x}"
               for subdevice, device in zip(main_device.slaves, devices) if subdevice.state != wanted]
        raise Failed(f"not in {STATES[wanted]}: {', '.join(off)}")

    state(pysoem.PREOP_STATE)
    session.ok("sdo")
    session.read_objects(lambda position, index, sub: main_device.slaves[position].sdo_read(index, sub))

    for subdevice, device in zip(main_device.slaves, devices):
        for index, sub, size, value in device["startup"]:
            subdevice.sdo_write(index, sub, value.to_bytes(size, "little"))
        subdevice.set_watchdog("processdata", task["watchdog_ms"])
    main_device.config_map()
    for subdevice, device in zip(main_device.slaves, devices):
        lengths = (len(subdevice.output), len(subdevice.input))
        session.expect(f"{device['name']}, bytes", lengths, (device["outputs"], device["inputs"]))
    session.ok("dc", f"working counter {main_device.expected_wkc}")

    if not main_device.config_dc():
        raise Failed("no SubDevice with a clock")
    sync0 = [subdevice for subdevice, device in zip(main_device.slaves, devices) if device["sync0"]]
    if task["drift_frames"]:
        # The drift loops' filters: with those of reset, 0 and 12, a loop learns its speed too
        # slowly.
        for subdevice in sync0:
            subdevice._fpwr(0x0934, bytes([4, 6]))
        for _ in range(task["drift_frames"]):
            time.sleep(0.001)
            main_device.send_processdata()
            main_device.receive_processdata(100_000)
    for subdevice in sync0:
        subdevice.dc_sync(True, task["cycle_us"] * 1000)
    session.ok("safeop", f"SYNC0 in {len(sync0)}" if sync0 else "delays and offsets; nobody wants SYNC0")
    state(pysoem.SAFEOP_STATE)
    session.ok("op")

    def exchange():
        main_device.send_processdata()
        return main_device.receive_processdata(100_000) == main_device.expected_wkc

    def phase():
        cycle_ns = task["cycle_us"] * 1000
        return main_device.dc_time % cycle_ns / 1e9

    phase_of = phase if sync0 else None
    due = None

    def cyclic():
        nonlocal due
        exchange()
        due = session.next(due or time.monotonic(), phase_of)

    # Frames first come to their place between two SYNC0 pulses.
    for _ in range(200):
        cyclic()
    state(pysoem.OP_STATE, cyclic)
    session.ok("cycles")
    slaves = main_device.slaves

    def write(position, data):
        slaves[position].output = data

    asked = set()

    def recover():
        """As pysoem's own example does it, but it asks only once."""
        main_device.read_state()
        began = 0
        for position, subdevice in enumerate(slaves):
            if subdevice.state == pysoem.SAFEOP_STATE + pysoem.STATE_ERROR:
                asked.discard(position)
                subdevice.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
                subdevice.write_state()
                began += 1
            elif subdevice.state == pysoem.SAFEOP_STATE and position not in asked:
                asked.add(position)
                subdevice.state = pysoem.OP_STATE
                subdevice.write_state()
        return began

    session.exchange(exchange, write, lambda position: slaves[position].input, phase_of, recover if sync0 else None)
    state(pysoem.INIT_STATE)
    session.ok("")
    main_device.close()


Session().run(steps)
