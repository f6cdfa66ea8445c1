#!/usr/bin/env python3
"""Every device of device descriptions (ESI) in every OpMode, compared with a foreign reading of the same file.

    esi_compare.py [--isocat PATH] [--run] [--rows] [FOLDER...]

`esi_reading.py` reads the files with Python's ElementTree. What it expects is compared with what `isocat plan --start-up --json`
writes and what `isocat scan --json` finds: identity, ports, mailbox, SyncManagers, PDOs, FMMUs, AssignActivate, SYNC0 and SYNC1,
the OpModes of the SII, and InitCmds with their transitions. A modular device is tried with its default modules, and with three
choices of modules: each place with the first that its slot takes, one after the other, and with empty places; of these the objects
are compared, too, which the example `dictionary` of isocat-segment prints. Modules of files whose root is EtherCATModule belong to
devices of the same vendor. --modules tries modular devices alone. A table tells how often each field was equal; each difference is
listed with file, device, OpMode, expected and found. With --run each one is run for 60 ms as well: `plan` and `run` have to
agree. --rows prints a line for each device and OpMode.

The bus cycle is 1 ms, or the first of CYCLES that `plan` takes. The folders are ../shared/esi and ../shared/esi-more beside the
project unless others are given. Exit codes: 0 all equal, 1 something differs, 77 there are no descriptions.
"""
import argparse
import copy
import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import esi_reading

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", PROJECT / "target")).resolve()
CYCLES = ["1ms", "2ms", "4ms", "10ms", "20ms", "100ms", "1s", "3ms", "500us", "250us", "125us"]
NS = {"s": 10**9, "ms": 10**6, "us": 10**3}
TOO_LONG = 60
MOST_PROCESS_DATA = 256
AL_EVENT = 0x20
# Objects that follow from SyncManagers, PDOs and identity.
FOLLOWS = {0x1018, 0x1C00, 0x1C12, 0x1C13}


@dataclass
class Trial:
    path: Path
    device: esi_reading.Device
    mode: object  # the number of the OpMode, None for a device without
    further: tuple = ()  # files with modules
    chosen: object = None  # {place: module}, None for the default
    filled: str = ""  # in words
    cycle: str = CYCLES[0]
    plan_code: object = None
    run_code: object = None
    reason: str = ""
    run_reason: str = ""
    equal: list = field(default_factory=list)
    differs: list = field(default_factory=list)  # (field, expected, found)

    def name(self):
        mode = "-" if self.mode is None else f"{self.mode} {self.device.mode_names()[self.mode]}"
        device = self.device
        mode += f" | {self.filled}" if self.filled else ""
        return f"{self.path.name} | {device.type} {device.product or 0:#x} {device.revision:#010x} | {mode}"

    def segment(self):
        ports = self.device.physics() or "Y"
        host = '[host]\nport = "ebus"\n' if ports[0] in "KB" else ""
        mode = "" if self.mode is None else f"opmode = {self.mode}\n"
        paths = [str(path) for path in (self.path, *self.further)]
        quoted = [json.dumps(text, ensure_ascii=False) for text in (paths if self.further else paths[0], self.device.type)]
        product = "" if self.device.product is None else f"product = {self.device.product}\n"
        return (f'cycle = "{self.cycle}"\n{host}[[subdevice]]\nesi = {quoted[0]}\ntype = {quoted[1]}\n'
                f"{product}revision = {self.device.revision}\n{mode}{self.modules()}")

    def modules(self):
        """The key `modules`, by ident with the number of the place: types are not unique in all files."""
        if self.chosen is None:
            return ""
        rows = [f"{{ slot = {place}, module = {module.find('Type').get('ModuleIdent').lower().replace('#x', '0x')} }}"
                for place, module in sorted(self.chosen.items())]
        return f"modules = [{', '.join(rows)}]\n"

    def compare(self, what, expected, found):
        if expected == found:
            self.equal.append(what)
        else:
            self.differs.append((what, expected, found))


def call(isocat, *arguments):
    done = subprocess.run([isocat, *arguments], capture_output=True, text=True, timeout=TOO_LONG)
    return done.returncode, done.stdout, done.stderr


def reason_of(errors, report):
    """A name for why something was refused: the one in brackets, the kind of a finding, or the words without numbers."""
    words = " ".join(errors.split())
    named = re.search(r"can't be (?:simulated|run) \(([a-z0-9-]+)\)", words)
    if named:
        return named[1]
    kinds = [finding.get("kind", "?") for finding in (report or {}).get("findings", [])]
    if kinds:
        return ", ".join(sorted(set(kinds)))
    return re.sub(r"\d+", "#", re.sub(r"^error: [^ ]*?:\d+(:\d+)?: ", "", words))[:110] or "no reason"


def try_one(trial, isocat, folder, also_run, place, dictionary=None):
    """Fills in a trial; gives it back."""
    # All OpModes of a device share it, and each trial has modules of its own.
    trial.device = copy.copy(trial.device)
    trial.device.chosen = trial.chosen
    file = Path(folder) / f"{place}.toml"
    for trial.cycle in CYCLES:
        file.write_text(trial.segment())
        trial.plan_code, written, errors = call(isocat, "plan", file, "--start-up", "--json")
        if trial.reason == "" and trial.plan_code != 0:
            report = json.loads(call(isocat, "plan", file, "--json")[1] or "null") if trial.plan_code == 1 else None
            trial.reason = reason_of(errors, report)
        if trial.plan_code == 0 or "can't be simulated" in " ".join(errors.split()):
            break
    if trial.plan_code != 0:
        trial.cycle = CYCLES[0]
        file.write_text(trial.segment())
    else:
        trial.reason = ""
        # A scan exits 1 where the description contradicts itself, and has found everything all the same.
        scan_code, scanned, scan_errors = call(isocat, "scan", file, "--json")
        found = json.loads(scanned or "{}").get("devices")
        if found and found[0].get("op_modes") is not None:
            compare(trial, json.loads(written)["devices"][0], found[0])
            if trial.chosen is not None and dictionary is not None:
                compare_objects(trial, json.loads(call(dictionary, file)[1])[0])
        else:
            trial.differs.append(("scan", "what was found", f"exit {scan_code}: {reason_of(scan_errors, None)}"))
    if also_run:
        trial.run_code, report, errors = call(isocat, "run", file, "--for", "60ms", "--json")
        if trial.run_code != 0:
            trial.run_reason = reason_of(errors, json.loads(report or "null"))
    return trial


class Written:
    """The start-up list of one device: the memory of its ESC after the way up."""

    def __init__(self, listed):
        self.memory, self.steps = {}, listed["registers"]
        for step in self.steps:
            at = step["address"].get("physical")
            if step["command"] in ("FPWR", "APWR") and at is not None:
                data = bytes.fromhex(step["data"])
                self.memory.update({int(at["register"], 16) + i: byte for i, byte in enumerate(data)})

    def value(self, address, length):
        """Little-endian; None where nothing was written."""
        known = [self.memory.get(address + i) for i in range(length)]
        return None if None in known else int.from_bytes(bytes(known), "little")

    def fmmus(self):
        found = []
        for address in range(0x600, 0x700, 16):
            if self.value(address + 12, 1):
                found.append((self.value(address + 11, 1), self.value(address + 8, 2), self.value(address + 4, 2)))
        return found


def compare_objects(trial, dictionary):
    """The objects of chosen modules, against what the virtual device answers."""
    device, idents = trial.device, trial.device.module_idents()
    # Mapping objects follow from the PDOs; how the device communicates it says itself.
    own = {esi_reading.number(text) for text in (one.findtext("Index") for one in device.element.iter("Object"))}
    mapping = {pdo.index for pdo in device.pdos()} | {index for index in own if index < 0x2000} | FOLLOWS
    known = {one["index"]: {sub: (bits, value) for sub, bits, value in one["entries"]} for one in dictionary["objects"]}
    written = {(command.index, command.sub) for command in device.commands()}
    for index, entries in device.module_objects().items():
        if index in mapping:
            continue
        if index not in known:
            told = any("left out" in one and f"0x{index:04X}" in one for one in dictionary["assumptions"])
            trial.compare("module objects left out, said so", (hex(index), True), (hex(index), told))
            continue
        # Sub-index 0 of a structure is a count of 8 bits, whatever a file says; entries of no bits are none.
        expected = {sub: 8 if sub == 0 and len(entries) > 1 else bits for sub, (bits, _) in entries.items() if bits}
        found = {sub: bits for sub, (bits, _) in known[index].items() if sub in expected or (index, sub) not in written}
        trial.compare("module objects: bits by sub-index", (hex(index), expected), (hex(index), found))
        values = {sub: value[:2] if expected.get(sub) == 8 else value for sub, (_, value) in entries.items()
                  if value and sub in found and (sub or len(entries) == 1)}
        trial.compare("module objects: defaults", (hex(index), values),
                      (hex(index), {sub: known[index][sub][1] for sub in values}))
    if 0xF050 in known:
        detected = [int.from_bytes(bytes.fromhex(known[0xF050][place + 1][1]), "little") for place in range(len(idents))]
        trial.compare("0xF050 as the modules stand", idents, detected)


def compare(trial, listed, scanned):
    bus = next(int(trial.cycle[: -len(unit)]) * ns for unit, ns in NS.items() if trial.cycle[: -len(unit)].isdigit())
    device, written = trial.device, Written(listed)
    expected = device.expected(trial.mode, bus)
    found = (*(int(listed[key], 16) for key in ("vendor", "product", "revision")), listed["serial"])
    trial.compare("identity", expected.identity, found)
    trial.compare("identity on the wire", expected.identity,
                  tuple(scanned[key] for key in ("vendor_id", "product_code", "revision", "serial")))
    if expected.physics is not None:
        trial.compare("ports", expected.physics, listed["physics"])
    box = listed["mailbox"]
    trial.compare("mailbox areas", expected.mailbox, box and (
        *(int(box["out"]["start"], 16), box["out"]["length"]), *(int(box["back"]["start"], 16), box["back"]["length"])))
    if expected.mailbox:
        trial.compare("mailbox protocols", sorted(expected.protocols), sorted(scanned["mailbox"]["protocols"]))
    compare_sync_managers(trial, expected, written, listed["notes"])
    compare_pdos(trial, expected, scanned)
    trial.compare("FMMUs", sorted(expected.fmmus), sorted(written.fmmus()))
    compare_windows(trial, expected, listed, scanned)
    compare_dc(trial, expected, written)
    keys = ("assign_activate", "sync0_cycle_ns", "sync0_factor", "sync0_shift_ns", "sync1_factor", "sync1_shift_ns")
    trial.compare("OpModes of the SII", device.stored_modes(), [tuple(mode[key] for key in keys) for mode in scanned["op_modes"]])
    compare_commands(trial, expected, listed)


def compare_sync_managers(trial, expected, written, notes):
    for at, manager in enumerate(trial.device.sync_managers):
        address, length = 0x800 + 8 * at, expected.lengths.get(at, 0)
        on = bool(written.value(address + 6, 1))
        # A window is no SyncManager, and a mailbox without protocol is none either.
        trial.compare("SyncManager enabled", (at, length > 0), (at, on))
        if not on or length == 0:
            continue
        trial.compare("SyncManager start", (at, manager.start), (at, written.value(address, 2)))
        trial.compare("SyncManager length", (at, length), (at, written.value(address + 2, 2)))
        if manager.control is not None:
            control = written.value(address + 4, 1)
            told = any(f"SyncManager {at}:" in note for note in notes)
            said = told and control == manager.control | AL_EVENT != manager.control
            what = "control byte, AL event added, said so" if said else "control byte"
            trial.compare(what, (at, f"{manager.control | AL_EVENT * said:#04x}"), (at, f"{control:#04x}"))


def compare_windows(trial, expected, listed, scanned):
    """Windows of inputs are mapped, each with its PDOs and no SyncManager; windows of other kinds with PDOs are told."""
    managers = trial.device.sync_managers
    inputs = scanned["inputs"] or {"sync_manager": None, "further": []}
    parts = [inputs] * (inputs["sync_manager"] is not None) + inputs["further"]
    at = {part["sync_manager"]: part["start"] for part in parts if part["window"]}
    # The first part has the length of all.
    lengths = {part["sync_manager"]: part["length"] for part in inputs["further"] if part["window"]}
    for number, (start, length) in expected.windows.items():
        trial.compare("windows mapped", (number, start), (number, at.get(number)))
        if number in lengths:
            trial.compare("windows: bytes", (number, length), (number, lengths[number]))
        stored = scanned["sync_managers"][number]
        trial.compare("windows in the SII", (start, length, True, False),
                      tuple(stored[key] for key in ("start", "length", "window", "enabled")))
    trial.compare("no other windows", [], sorted(set(at) - set(expected.windows)))
    for number in sorted(trial.device.assigned_to_other_windows(trial.mode)):
        told = [note for note in listed["notes"] if f"SyncManager {number}, a window" in note]
        trial.compare("windows left out, said so", (number, managers[number].start, True),
                      (number, managers[number].start, len(told) == 1 and f"0x{managers[number].start:04X}" in told[0]))


def compare_pdos(trial, expected, scanned):
    for direction in ("outputs", "inputs"):
        wanted = [pdo for at in sorted(expected.pdos) if trial.device.sync_managers[at].kind == direction
                  for pdo in expected.pdos[at]]
        found = scanned[direction]["pdos"] if scanned[direction] else []
        # Without CoE no object says that a PDO without entries is assigned.
        if "CoE" not in expected.protocols:
            wanted, found = [pdo for pdo in wanted if pdo[1]], [pdo for pdo in found if pdo["bits"]]
        trial.compare("PDO assignment", [f"{index:#06x}" for index, _ in wanted], [f"{pdo['index']:#06x}" for pdo in found])
        sizes = [(f"{index:#06x}", sum(bits for _, _, bits in entries)) for index, entries in wanted]
        trial.compare("PDO sizes", sizes, [(f"{pdo['index']:#06x}", pdo["bits"]) for pdo in found])
        mapped = [(index, sub, bits) for _, entries in wanted for index, sub, bits in entries if 0 < bits <= 255]
        listed = [(e["index"], e["sub"], e["bits"]) for pdo in found for e in pdo["entries"]]
        if all(bits <= 255 for _, entries in wanted for _, _, bits in entries):
            trial.compare("PDO entries", mapped, listed)


def compare_dc(trial, expected, written):
    latch, activation = written.value(0x980, 1) or 0, written.value(0x981, 1) or 0
    word = 0 if expected.clock_only else expected.word
    trial.compare("DC: AssignActivate (0x0980, 0x0981)", f"{word:#06x}", f"{activation << 8 | latch:#06x}")
    if expected.clock_only:
        touched = sorted(address for address in written.memory if 0x940 <= address < 0xA00)
        trial.compare("DC: SYNC unit untouched", [], touched)
    elif expected.sync0 is not None:
        trial.compare("DC: SYNC0 cycle", expected.sync0, written.value(0x9A0, 4))
        # Where SYNC1 comes with SYNC0, whether it is made at all belongs to AssignActivate.
        trial.compare("DC: SYNC1 after SYNC0", expected.sync1, written.value(0x9A4, 4))


def compare_commands(trial, expected, listed):
    """Each InitCmd is in the list with its transitions, or a note of the list names it."""
    left = [(step["transitions"], step["object"].upper(), step["data"], step["complete"]) for step in listed["objects"]]
    for command in expected.commands:
        entry = f"0x{command.index:04X}:{command.sub:02X}".upper()
        missing = []
        for transition in command.transitions:
            step = ([transition], entry, command.data, command.complete)
            wanted = next((row for row in left if row == step), None)
            if wanted is None:
                missing.append(transition)
            else:
                left.remove(wanted)
        told = any(entry in note.upper() for note in listed["notes"])
        what = "InitCmds listed" if not (missing and told) else "InitCmds left out, said so"
        trial.compare(what, (entry, []), (entry, [] if told else missing))
    wanted = trial.device.soe_commands()
    if wanted:
        # Configuration tools put the bus cycle, in us, into these two.
        unit = trial.cycle.lstrip("0123456789")
        micros = int(trial.cycle.removesuffix(unit)) * NS[unit] // 1000
        cycle = (micros & 0xFFFF).to_bytes(2, "little").hex()
        adapts = lambda row: row[2] in ("S-0-0001", "S-0-0002") and len(row[3]) == 4 and micros <= 0xFFFF
        wanted = [(*row[:3], cycle if adapts(row) else row[3]) for row in wanted]
        found = [(*step["transitions"], step["drive"], step["idn"], step["data"]) for step in listed["parameters"]]
        # As with CoE: each is listed, or a note names it as left out.
        told = [row for row in wanted if row not in found and any(row[2] in note and "left out" in note for note in listed["notes"])]
        trial.compare("SoE InitCmds listed", sorted(row for row in wanted if row not in told), sorted(found))
        for row in told:
            trial.compare("SoE InitCmds left out, said so", row, row)
    for protocol in ("AoE", "EoE", "FoE", "VoE"):
        count = len(trial.device.element.findall(f"Mailbox/{protocol}/InitCmd"))
        told = sum(f"{protocol} InitCmd" in note for note in listed["notes"])
        if count:
            trial.compare(f"{protocol} InitCmds left out, said so", count, told)


def filled(path, device, further):
    """Configurations of a modular device, in its last OpMode: each place with the first module that its slot takes, and with
    one after the other; as many as the process data of isocat take, which is told where it is the limit."""
    places = [(place, device.admissible(slot)) for place, slot in device.places()]
    places = [(place, modules) for place, modules in places if modules]
    mode = len(device.modes) - 1 if device.modes else None
    for words, turn in (("each place with its first module", lambda place, all_: all_[0]),
                        ("one module after the other", lambda place, all_: all_[place % len(all_)]),
                        ("every third place empty", lambda place, all_: all_[-1 - place % len(all_)])):
        chosen = {}
        for place, modules in places:
            if words.startswith("every third") and place % 3 == 1 and place not in needed(device):
                continue
            chosen[place] = turn(place, modules)
            device.chosen = chosen
            if too_long(device):
                del chosen[place]
                break
        device.chosen = None
        yield Trial(path.resolve(), device, mode, tuple(further), chosen, f"{words}: {len(chosen)}")


def needed(device):
    """Places that must have a module."""
    result, seen = set(), Counter()
    for place, slot in device.places():
        seen[id(slot)] += 1
        if seen[id(slot)] <= (esi_reading.number(slot.get("MinInstances")) or 0):
            result.add(place)
    return result


def too_long(device):
    """More process data than a virtual SubDevice of isocat has room for."""
    bits = Counter()
    for pdo in device.pdos():
        if pdo.sync_manager is not None:
            bits[pdo.outputs] += sum(entry[2] for entry in pdo.entries)
    return any((count + 7) // 8 > MOST_PROCESS_DATA for count in bits.values())


def module_files(paths):
    """Files of modules alone, by vendor."""
    found = defaultdict(list)
    for path in paths:
        try:
            root = ET.parse(path).getroot()
        except ET.ParseError:
            continue
        if root.tag == "EtherCATModule":
            found[esi_reading.number(root.findtext("Vendor/Id"))].append(path.resolve())
    return found


def folders(given):
    found = [Path(folder) for folder in given] or [PROJECT.parent / "shared" / name for name in ("esi", "esi-more")]
    return [folder for folder in found if folder.is_dir()]


def read(paths):
    """The trials of all files, and (file, reason) of those that can't be read."""
    trials, unread, twice = [], [], []
    of_vendor = module_files(paths)
    for path in paths:
        try:
            devices = list(esi_reading.devices(path))
        except (ET.ParseError, ValueError) as error:
            unread.append((path.name, str(error)))
            continue
        known = set()
        for device in devices:
            key = (device.type, device.product, device.revision)
            if key in known:
                twice.append(f"{path.name}: {device.type} {device.revision:#010x}")
                continue
            known.add(key)
            modes = range(len(device.modes)) if device.modes else [None]
            trials += [Trial(path.resolve(), device, mode) for mode in modes]
            if device.element.find("Slots") is not None:
                further = of_vendor[device.vendor]
                same = next(one for one in esi_reading.devices(path, further)
                            if (one.type, one.product, one.revision) == key)
                trials += filled(path, same, further)
    return trials, unread, twice


def print_comparison(trials):
    equal, differs = Counter(), defaultdict(list)
    for trial in trials:
        equal.update(trial.equal)
        for what, expected, found in trial.differs:
            differs[what].append(f"{trial.name()} | expected {short(expected)} | found {short(found)}")
    print(f"\n{'field':<40}{'equal':>8}{'differs':>9}")
    for what in sorted(set(equal) | set(differs)):
        print(f"{what:<40}{equal[what]:>8}{len(differs[what]):>9}")
    for what, rows in sorted(differs.items()):
        print(f"\n{what}: {len(rows)}")
        for row in rows:
            print(f"  {row}")
    return sum(map(len, differs.values()))


def short(value):
    text = str(value)
    return text if len(text) <= 240 else text[:237] + "..."


def print_results(trials, also_run):
    """Planned, refused by reason, and where plan and run contradict each other; gives how many do."""
    reasons = Counter("planned" if trial.plan_code == 0 else f"refused: {trial.reason}" for trial in trials)
    print(f"\n{'plan':<100}{'OpModes':>8}")
    for reason, count in reasons.most_common():
        print(f"{reason:<100}{count:>8}")
    if not also_run:
        return 0
    contradict = [trial for trial in trials if (trial.plan_code == 0) != (trial.run_code == 0)]
    in_sync = sum(trial.run_code == 0 for trial in trials)
    print(f"\nin sync for 60 ms: {in_sync} of {len(trials)}; plan and run contradict each other: {len(contradict)}")
    for trial in contradict:
        print(f"  {trial.name()} | plan {trial.plan_code} {trial.reason} | run {trial.run_code} {trial.run_reason}")
    return len(contradict)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--isocat", default=TARGET / "release" / "isocat")
    parser.add_argument("--dictionary", default=TARGET / "debug" / "examples" / "dictionary",
                        help="the example of isocat-segment that prints a device's objects")
    parser.add_argument("--modules", action="store_true", help="only devices with slots")
    parser.add_argument("--run", action="store_true", help="run each for 60 ms, too")
    parser.add_argument("--rows", action="store_true", help="a line for each device and OpMode")
    parser.add_argument("folders", nargs="*")
    arguments = parser.parse_args()
    paths = sorted(path for folder in folders(arguments.folders) for path in folder.glob("*.xml"))
    if not paths:
        print("skipped: there are no device descriptions beside the project")
        return 77
    trials, unread, twice = read(paths)
    if arguments.modules:
        trials = [trial for trial in trials if trial.device.element.find("Slots") is not None]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        dictionary = arguments.dictionary if Path(arguments.dictionary).exists() else None
        if dictionary is None:
            print("objects of modules are not compared: cargo build --example dictionary")
        one = lambda numbered: try_one(numbered[1], arguments.isocat, folder, arguments.run, numbered[0], dictionary)
        trials = list(pool.map(one, enumerate(trials)))
    print(f"{len(paths)} files, {len({id(trial.device) for trial in trials})} devices, {len(trials)} device x OpMode")
    for name, error in unread:
        print(f"  not well-formed: {name}: {error}")
    for row in twice:
        print(f"  stands twice with one product code: {row}")
    if arguments.rows:
        for trial in trials:
            print(f"{trial.name()} | plan {trial.plan_code} {trial.reason} | run {trial.run_code} {trial.run_reason}")
    contradictions = print_results(trials, arguments.run)
    differences = print_comparison(trials)
    print(f"\n{differences} differences, {contradictions} contradictions")
    return 1 if differences or contradictions else 0


if __name__ == "__main__":
    sys.exit(main())
