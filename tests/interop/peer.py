"""What the MainDevices written in Python share: the task, the report of their steps, the other side of the applications.

A MainDevice is started as `PROGRAM INTERFACE TASK.json ROLE`. Roles: `whole` goes through all steps; `hold` comes to OP and
exchanges process data until somebody kills it; `again` comes to OP, exchanges a little, and goes down. Every step prints one
JSON object a line: {"step": NAME, "result": "ok" | "failed" | "n/a", "what": TEXT}. Steps: scan, preop, sdo, map, dc,
safeop, op, cycles, down. The line of the cycles, or of a failure in them, also has what the library told in them: {"noticed":
{"wrong_counters": CYCLES, "fell": SUBDEVICES}}.
"""
import json
import sys
import time

LAG = 100   # cycles from an output to its coming back, at most; stalls of the machine are far longer than cycles
STEP = 10   # a drive's way in a cycle


class Failed(Exception):
    pass


class Session:
    def __init__(self):
        self.interface, task, self.role = sys.argv[1:4]
        with open(task) as file:
            self.task = json.load(file)
        self.devices = self.task["devices"]
        self.step = "scan"
        self.noticed = None
        self.cycle = self.task["cycle_us"] / 1e6
        self.cycles = {"whole": self.task["cycles"], "again": 1000, "hold": 1 << 60}[self.role]

    def run(self, steps):
        try:
            steps(self)
        except Exception as error:  # whatever it is: it is the result of the step
            kind = "" if isinstance(error, Failed) else f"{type(error).__name__}: "
            self.say("failed", f"{kind}{error}")
            sys.exit(1)

    def say(self, result, what=""):
        line = {"step": self.step, "result": result, "what": what}
        if self.step == "cycles" and self.noticed:
            line["noticed"] = self.noticed
        print(json.dumps(line), flush=True)

    def ok(self, next_step, what=""):
        self.say("ok", what)
        self.step = next_step

    def not_there(self, next_step, what):
        self.say("n/a", what)
        self.step = next_step

    def expect(self, what, found, wanted):
        if found != wanted:
            raise Failed(f"{what}: {found}, not {wanted}")

    def read_objects(self, read):
        """`read(position, index, sub_index)` gives bytes."""
        if not any(device["mailbox"] for device in self.devices):
            return self.not_there("map", "no device has a mailbox")
        count = 0
        for position, device in enumerate(self.devices if self.role == "whole" else []):
            for index, sub, size, constant in device["entries"]:
                data = bytes(read(position, index, sub))
                place = f"{device['name']}: 0x{index:04X}:{sub:02X}"
                self.expect(f"length of {place}", len(data), size)
                if constant is not None:
                    self.expect(place, int.from_bytes(data, "little"), constant)
                count += 1
        self.ok("map", f"{count} entries")

    def exchange(self, exchange, write, read, phase=None, recover=None):
        """The cycles. `exchange()` tells whether the working counter was right, `write(position, bytes)` and
        `read(position)` are the process image, `phase()` is how long after its SYNC0 the reference clock saw the last frame, in
        seconds, or None. `recover()` brings back SubDevices that left OP, a step a call, and gives how many it began with: the
        machine may stall for longer than a drive forgives."""
        partners = [Partner(position, device) for position, device in enumerate(self.devices)]
        # `since` counts wrong counters without a right one between: of a SubDevice that fell they belong to its fall.
        bad, since, fell, away, longest = 0, 0, 0, -1, 0.0
        self.noticed = {"wrong_counters": 0, "fell": 0}
        due = last = time.monotonic()
        for number in range(self.cycles):
            for position, partner in enumerate(partners):
                write(position, partner.outputs(number))
            if exchange():
                for position, partner in enumerate(partners):
                    partner.inputs(number, read(position))
                right = True
                since = 0
            else:
                right = False
                since += number > away
                bad += number > away
                self.noticed["wrong_counters"] += 1
            if recover and number % 10 == 0 and (not right or number <= away):
                found = recover()
                fell += found
                self.noticed["fell"] = fell
                if found:
                    away, bad, since = number + 400, bad - since, 0
            now = time.monotonic()
            longest, last = max(longest, now - last), now
            due = self.next(due, phase)
        what = f"{self.cycles} cycles, {bad} with a wrong working counter; longest {longest * 1e3:.0f} ms"
        if fell:
            what += f"; SubDevices that left OP after late frames and were brought back: {fell}"
        complaints = "; ".join(filter(None, (partner.complaints(self.cycles) for partner in partners)))
        if bad * 50 > self.cycles or complaints:
            raise Failed(f"{what}; {complaints}")
        self.ok("down", what)

    def next(self, due, phase=None):
        """Sleeps until the next cycle and gives its time; keeps frames in the middle between two SYNC0 pulses."""
        due += self.cycle
        offset = phase() if phase else None
        if offset is not None:
            due += max(-0.1, min(0.1, 0.5 - offset / self.cycle)) * self.cycle / 4
        wait = due - time.monotonic()
        if wait < -self.cycle / 8:
            # Late: what was missed is missed, the phase is kept.
            missed = int(1 - wait / self.cycle)
            due += missed * self.cycle
            wait += missed * self.cycle
        if wait > 0:
            time.sleep(wait)
        return due


class Partner:
    """The other side of one SubDevice's application."""

    def __init__(self, position, device):
        self.name, self.is_io = device["name"], device["application"] == "io"
        self.length = min(device["outputs"], device["inputs"])
        keys = [position * 37 + place * 11 for place in range(device["outputs"])]
        # Every byte differs by place, device and cycle.
        self.patterns = [bytes((number + key) & 0xFF for key in keys) for number in range(256)]
        self.numbers = {pattern[:self.length]: number for number, pattern in enumerate(self.patterns)}
        self.nothing = bytes(self.length)
        self.torn = self.moved = self.lag = self.status = self.target = self.actual = self.enabled = 0
        self.last = None

    def outputs(self, number):
        if self.is_io:
            return self.patterns[number & 0xFF]
        status = self.status & 0x6F
        if status & 0x08:
            control = 0x80
        elif status == 0x27:
            control = 0x0F
            self.target += STEP
        else:
            control = {0x21: 0x07, 0x23: 0x0F}.get(status, 0x06)
        return control.to_bytes(2, "little") + self.target.to_bytes(4, "little", signed=True) + b"\x08"

    def inputs(self, number, data):
        if self.is_io:
            data = data[:self.length]
            came = self.numbers.get(data)
            if data == self.nothing:
                return
            if came is None:
                self.torn += 1
                return
            self.moved += came != self.last
            self.last = came
            self.lag = max(self.lag, (number - came) & 0xFF)
            return
        self.status = int.from_bytes(data[0:2], "little")
        self.actual = int.from_bytes(data[2:6], "little", signed=True)
        if self.status & 0x6F == 0x27:
            self.enabled += 1
        else:
            self.target = self.actual

    def complaints(self, cycles):
        # A coupler has no outputs that could come back.
        if self.is_io and not self.length:
            return ""
        if self.is_io:
            if not self.torn and self.moved * 10 >= cycles * 9 and self.lag <= LAG:
                return ""
            return f"{self.name}: torn {self.torn}, moved {self.moved}, lag {self.lag}"
        behind = self.target - self.actual
        if self.enabled * 10 >= cycles * 6 and 0 <= behind <= STEP * LAG:
            return ""
        return f"{self.name}: enabled {self.enabled}, behind {behind}, status 0x{self.status:04X}"
