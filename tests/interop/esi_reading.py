"""What device descriptions (ESI) say, read with xml.etree.ElementTree alone: the foreign witness of `esi_compare.py`.

Nothing here is taken from the importer of isocat. `devices(path)` gives the devices of a file, `Device.expected(mode, bus)`
gives what a MainDevice has to write for a device in one OpMode at a bus cycle in ns. A field that the file leaves open is None
and is not compared.
"""
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field


def number(text):
    """The number that a description writes as #x1F, 0x1F or decimal; None for an absent or empty text."""
    text = (text or "").strip()
    if not text:
        return None
    sign = -1 if text.startswith("-") else 1
    digits = text.lstrip("+-").lower()
    base = 10
    # Some tools write the prefix twice: #x0x6041.
    while digits[:2] in ("#x", "0x"):
        digits, base = digits[2:], 16
    return sign * int(digits, base)


def flag(text):
    return (text or "").strip() in ("1", "true")


def text_of(element, path):
    found = element.find(path)
    return "" if found is None else "".join(found.itertext()).strip()


@dataclass
class SyncManager:
    kind: str  # "mailbox out", "mailbox in", "outputs", "inputs" or "window"
    start: int
    size: int
    control: object  # None if the file has no control byte


@dataclass
class Pdo:
    index: int
    outputs: bool
    sync_manager: object
    factor: int
    step: int
    entries: list  # (index or None, sub, bits)

    def mapped(self, factor):
        """(index, sub, bits) of each entry as often as the factor says; padding has index 0."""
        return [
            ((index + turn * self.step) & 0xFFFF if index else 0, sub if index else 0, bits)
            for turn in range(max(1, factor))
            for index, sub, bits in self.entries
        ]


@dataclass
class Command:
    transitions: list
    index: int
    sub: int
    data: str
    complete: bool


@dataclass
class Expected:
    """One device in one OpMode. SyncManagers are told by number, PDOs by SyncManager."""
    identity: tuple
    physics: object
    mailbox: object  # (out start, out length, in start, in length) or None
    protocols: set
    lengths: dict = field(default_factory=dict)  # SyncManager: bytes
    pdos: dict = field(default_factory=dict)  # SyncManager: [(index, mapped entries)]
    fmmus: list = field(default_factory=list)  # (type, start, bytes)
    word: int = 0  # AssignActivate
    clock_only: bool = False
    sync0: object = None  # register 0x09A0, ns
    sync1: object = None  # register 0x09A4, ns
    commands: list = field(default_factory=list)


class Device:
    """A device of a file."""

    def __init__(self, element, vendor, modules):
        self.element, self.vendor, self.modules = element, vendor, modules
        kind = element.find("Type")
        self.type = "".join(kind.itertext()).strip()
        self.product = number(kind.get("ProductCode"))
        self.revision = number(kind.get("RevisionNo")) or 0
        self.serial = number(kind.get("SerialNo")) or 0
        self.has_mailbox = element.find("Mailbox") is not None
        self.sync_managers = [self.sync_manager(sm) for sm in element.findall("Sm")]
        self.modes = element.findall("Dc/OpMode")

    def mode_names(self):
        return [text_of(mode, "Name") for mode in self.modes]

    def sync_manager(self, element):
        """The control byte decides what a SyncManager is for; the text decides where there is none."""
        name, control = "".join(element.itertext()).strip(), number(element.get("ControlByte"))
        called = {"MBoxOut": "mailbox out", "MBoxIn": "mailbox in", "Outputs": "outputs", "Inputs": "inputs",
                  "DynamicOutputs": "outputs", "DynamicInputs": "inputs"}.get(name)
        kind = called
        if flag(element.get("Virtual")):
            kind = "window"
        elif control is not None:
            writes, one_buffer = control & 0x0C == 0x04, control & 0x03 == 0x02
            box = one_buffer and called not in ("outputs", "inputs") and (self.has_mailbox or called is not None)
            kind = ("mailbox out" if writes else "mailbox in") if box else ("outputs" if writes else "inputs")
        return SyncManager(kind, number(element.get("StartAddress")) or 0, number(element.get("DefaultSize")) or 0, control)

    def slot_modules(self):
        """(place, module) of each slot that has a module by default: the preset, or the first where one has to be."""
        place = 0
        for slot in self.element.findall("Slots/Slot"):
            least = number(slot.get("MinInstances")) or 0
            most = number(slot.get("MaxInstances"))
            most = max(1, least) if most is None else most
            idents = slot.findall("ModuleIdent")
            preset = [number(ident.text) for ident in idents if flag(ident.get("Default"))]
            count = max(1, least) if preset else least
            classes = [text_of(c, "Class") or (c.text or "").strip() for c in slot.findall("ModuleClass")]
            wanted = preset or [number(ident.text) for ident in idents]
            module = next((self.modules[ident] for ident in wanted if ident in self.modules), None)
            if module is None and not preset:
                module = next((m for m in self.modules.values() if m.find("Type").get("ModuleClass") in classes), None)
            for turn in range(count):
                if module is not None:
                    yield place + turn, module
            place += max(count, most)

    def pdos(self):
        slots = self.element.find("Slots")
        increment = {key: number(slots.get(key)) or 0 if slots is not None else 0
                     for key in ("SlotPdoIncrement", "SlotIndexIncrement")}
        found = []
        for place, owner in [(0, self.element), *self.slot_modules()]:
            for element in owner:
                if element.tag not in ("RxPdo", "TxPdo") or element.find("Index") is None:
                    continue
                shift = increment["SlotPdoIncrement"] * place if flag(element.find("Index").get("DependOnSlot")) else 0
                entries = []
                for entry in element.findall("Entry"):
                    index = number(text_of(entry, "Index"))
                    if index and flag(entry.find("Index").get("DependOnSlot")):
                        index += increment["SlotIndexIncrement"] * place
                    entries.append((index, number(text_of(entry, "SubIndex")) or 0, number(text_of(entry, "BitLen"))))
                # Old files define the PDO of a channel once; the channels follow each other.
                channel = number(element.get("Chn")) or 0 if element.get("Ref") else 0
                index = (number(text_of(element, "Index")) + shift + channel) & 0xFFFF
                if owner is not self.element and any(pdo.index == index for pdo in found):
                    continue
                factor, step = number(element.get("OSFac")) or 0, number(element.get("OSIndexInc")) or 0
                outputs = element.tag == "RxPdo"
                found.append(Pdo(index, outputs, number(element.get("Sm")), factor, step, entries))
        return found

    def assigned(self, mode):
        """{SyncManager: [(PDO, factor)]}: the default, or what the OpMode puts in its place."""
        def fits(pdo, at):
            return at < len(self.sync_managers) and self.sync_managers[at].kind == ("outputs" if pdo.outputs else "inputs")
        pdos, result = self.pdos(), {}
        for pdo in pdos:
            if pdo.sync_manager is not None and fits(pdo, pdo.sync_manager):
                result.setdefault(pdo.sync_manager, []).append((pdo, pdo.factor))
        for element in mode.findall("Sm") if mode is not None else []:
            at = number(element.get("No"))
            # An Sm without a PDO still gives times that are obsolete, and no assignment.
            named = element.findall("Pdo")
            if not named or at is None:
                continue
            result[at] = []
            for one in named:
                index, factor = number("".join(one.itertext())), number(one.get("OSFac"))
                pdo = next((pdo for pdo in pdos if pdo.index == index and fits(pdo, at)), None)
                if pdo is not None:
                    result[at].append((pdo, pdo.factor if factor is None else factor))
        return result

    def commands(self):
        slots = self.element.find("Slots")
        increment = number(slots.get("SlotIndexIncrement")) or 0 if slots is not None else 0
        all_commands = []
        for place, owner in [(0, self.element), *self.slot_modules()]:
            for one in owner.findall("Mailbox/CoE/InitCmd"):
                index = number(text_of(one, "Index"))
                if flag(one.find("Index").get("DependOnSlot")):
                    index = (index + increment * place) & 0xFFFF
                transitions = [(t.text or "").strip() for t in one.findall("Transition")]
                data = "".join(text_of(one, "Data").split()).lower()
                all_commands.append(
                    Command(transitions, index, number(text_of(one, "SubIndex")), data, flag(one.get("CompleteAccess"))))
        return all_commands

    def soe_commands(self):
        """Transition, drive, IDN in words and data of each."""
        rows = []
        for one in self.element.findall("Mailbox/SoE/InitCmd"):
            idn, drive = number(text_of(one, "IDN")), number(one.get("Chn") or "0")
            name = f"{'P' if idn & 0x8000 else 'S'}-{idn >> 12 & 7}-{idn & 0xFFF:04}"
            data = "".join(text_of(one, "Data").split()).lower()
            rows += [((t.text or "").strip(), drive, name, data) for t in one.findall("Transition")]
        return rows

    def expected(self, mode_number, bus):
        mode = self.modes[mode_number] if mode_number is not None else None
        dc = self.element.find("Dc")
        result = Expected(
            identity=(self.vendor, self.product, self.revision, self.serial),
            physics=self.physics(),
            mailbox=self.mailbox(),
            protocols={child.tag for child in self.element.findall("Mailbox/*")} & PROTOCOLS,
            clock_only=dc is not None and flag(dc.get("TimeLoopControlOnly")),
            commands=self.commands(),
        )
        for at, pdos in self.assigned(mode).items():
            mapped = [(pdo.index, pdo.mapped(factor)) for pdo, factor in pdos]
            bits = sum(entry[2] for _, entries in mapped for entry in entries)
            result.pdos[at], result.lengths[at] = mapped, (bits + 7) // 8
        for kind, purpose in ((FMMU_WRITE, "outputs"), (FMMU_READ, "inputs")):
            of_kind = [at for at in sorted(result.pdos) if result.lengths[at] and self.sync_managers[at].kind == purpose]
            result.fmmus += self.mapped_by_fmmus(kind, purpose, [(self.sync_managers[at].start, result.lengths[at])
                                                                 for at in of_kind])
        if result.mailbox:
            result.lengths[0], result.lengths[1] = result.mailbox[1], result.mailbox[3]
        if mode is not None:
            result.word = number(text_of(mode, "AssignActivate")) or 0
            if result.word & 0x0100 and result.word & 0x0600:
                result.sync0, result.sync1 = pulses(mode, result.word, bus)
        return result

    def mapped_by_fmmus(self, kind, purpose, places):
        """One FMMU for each SyncManager, unless the file lists fewer: then one maps all bytes that lie behind each other."""
        listed = [(fmmu.text or "").strip().lower() for fmmu in self.element.findall("Fmmu")]
        if listed.count(purpose) < len(places):
            merged = []
            for start, length in places:
                if merged and sum(merged[-1]) == start:
                    merged[-1] = (merged[-1][0], merged[-1][1] + length)
                else:
                    merged.append((start, length))
            places = merged
        return [(kind, start, length) for start, length in places]

    def physics(self):
        letters = self.element.get("Physics")
        return None if letters is None or not letters.strip() else letters.rstrip()

    def mailbox(self):
        kinds = [sm.kind for sm in self.sync_managers[:2]]
        if not self.has_mailbox or kinds != ["mailbox out", "mailbox in"]:
            return None
        out, back = self.sync_managers[:2]
        return (out.start, out.size, back.start, back.size)

    def stored_modes(self):
        """Each OpMode as category 60 of the SII has it: AssignActivate, SYNC0 cycle, factor, shift, SYNC1 factor, shift."""
        rows = []
        for mode in self.modes:
            def time(name):
                found = mode.find(name)
                return (0, 0) if found is None else (number(found.text) or 0, number(found.get("Factor")) or 0)
            rows.append((number(text_of(mode, "AssignActivate")) or 0, *time("CycleTimeSync0"), time("ShiftTimeSync0")[0],
                         time("CycleTimeSync1")[1], time("ShiftTimeSync1")[0]))
        return rows


def pulses(mode, word, bus):
    """Registers 0x09A0 and 0x09A4 in ns. A text other than 0 is a time; factor n is n or 1/n of the bus cycle (SYNC0), and
    n SYNC0 cycles or 1/n of the bus cycle (SYNC1). Without both, SYNC0 follows the bus cycle."""
    def period(name, whole):
        found = mode.find(name)
        if found is None:
            return None
        fixed, factor = number(found.text) or 0, number(found.get("Factor")) or 0
        return fixed or (factor * whole if factor > 0 else bus / -factor if factor < 0 else None)
    sync0 = period("CycleTimeSync0", bus) or bus
    if not word & 0x0400:
        return sync0, 0
    shift = number(text_of(mode, "ShiftTimeSync1")) or 0
    return sync0, (period("CycleTimeSync1", sync0) or sync0) - sync0 + shift


def devices(path):
    """The devices of a file; raises ET.ParseError where it is not well-formed, ValueError where it is no description."""
    root = ET.parse(path).getroot()
    if root.tag != "EtherCATInfo" or root.find("Descriptions") is None:
        raise ValueError(f"the root is {root.tag}")
    definitions = {pdo.get("RefName"): pdo for pdo in root.findall("Descriptions/Pdos/Pdo")}
    for pdo in root.iter():
        # Old files define a PDO once and refer to it by name.
        if pdo.tag in ("RxPdo", "TxPdo") and pdo.get("Ref") in definitions:
            pdo.extend(definitions[pdo.get("Ref")])
    modules = {}
    for module in root.findall("Descriptions/Modules/Module"):
        modules.setdefault(number(module.find("Type").get("ModuleIdent")), module)
    vendor = number(text_of(root, "Vendor/Id"))
    for element in root.findall("Descriptions/Devices/Device"):
        yield Device(element, vendor, modules)


PROTOCOLS = {"AoE", "EoE", "CoE", "FoE", "SoE", "VoE"}
FMMU_READ, FMMU_WRITE = 1, 2
