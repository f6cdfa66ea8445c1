"""kickcat (the Python binding of KickCAT) as it comes from the package index, as the MainDevice of a served segment."""
import time

import kickcat
from kickcat import State

from peer import Failed, Session


def steps(session):
    task, devices = session.task, session.devices
    link = kickcat.create_link(session.interface, "")
    # KickCAT waits for the whole of this time at most of its steps, however soon frames come back.
    link.set_timeout(0.01)
    stalled = 0
    while True:
        bus = kickcat.Bus(link)
        try:
            bus.init(task["watchdog_ms"] / 1e3)
            break
        except RuntimeError as error:
            # A stall of the machine: one late frame ends it.
            if "Timeout" not in str(error) or stalled == 2:
                raise
            stalled += 1
    subdevices = bus.slaves()
    session.expect("SubDevices", len(subdevices), len(devices))
    again = f"; begun {stalled + 1} times, since frames were late" if stalled else ""
    session.ok("preop", f"{len(devices)} SubDevices; the binding shows no identities{again}")

    def state(wanted, cyclic=None):
        bus.request_state(wanted)
        try:
            bus.wait_for_state(wanted, 10.0, *([cyclic] if cyclic else []))
        except Exception as error:
            off = [f"{device['name']} {bus.get_state(subdevice)}" for subdevice, device in zip(subdevices, devices)]
            raise Failed(f"{error}: {', '.join(off)}") from error

    # init() ends in PREOP.
    bus.wait_for_state(State.PREOP, 10.0)
    session.ok("sdo")
    sizes = {(index, sub): size for device in devices for index, sub, size, _ in device["entries"]}

    def read_object(position, index, sub):
        size = sizes[index, sub]
        return bus.read_sdo(subdevices[position], index, sub, kickcat.PARTIAL, size, 2.0)

    session.read_objects(read_object)
    if any(device["startup"] for device in devices):
        write_objects(bus, subdevices, devices)
    bus.create_mapping()
    for subdevice, device in zip(subdevices, devices):
        lengths = (subdevice.output_size, subdevice.input_size)
        session.expect(f"{device['name']}, bytes", lengths, (device["outputs"], device["inputs"]))
    session.ok("dc")
    session.not_there("safeop", "the binding has no clocks")
    state(State.SAFE_OP)
    session.ok("op")
    for subdevice, device in zip(subdevices, devices):
        subdevice.set_output_bytes(bytes(device["outputs"]))

    # A stall of the machine is no fault of the segment.
    link.set_timeout(0.05)

    def cyclic():
        bus.process_data_no_check()
        time.sleep(0.0005)

    cyclic()
    state(State.OPERATIONAL, cyclic)
    session.ok("cycles")

    def exchange():
        try:
            # Raises if a working counter is wrong.
            bus.process_data()
        except Exception:
            return False
        return True

    session.exchange(exchange, lambda position, data: subdevices[position].set_output_bytes(data),
                     lambda position: bytes(subdevices[position].input_data))
    link.set_timeout(0.01)
    state(State.INIT)
    session.ok("")


def write_objects(bus, subdevices, devices):
    from kickcat.mailbox.request import MessageStatus

    for subdevice, device in zip(subdevices, devices):
        for index, sub, size, value in device["startup"]:
            message = subdevice.mailbox.write_sdo(index, sub, False, value.to_bytes(size, "little"), 2.0)
            for _ in range(2000):
                if message.status() != MessageStatus.RUNNING:
                    break
                bus.process_mailboxes()
                time.sleep(0.001)
            if message.status() != MessageStatus.SUCCESS:
                raise Failed(f"{device['name']}: 0x{index:04X}:{sub:02X} is not written: {message.status()}")


Session().run(steps)
