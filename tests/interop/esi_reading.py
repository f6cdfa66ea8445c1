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
    kind: str  # "mailbox out", "mailbox in", "outputs", "inputs" or "other window"
    start: int
    size: int
    control: object  # None if the file has no control byte
    window: bool = False  # no SyncManager is switched on; an FMMU alone maps the bytes


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
    windows: dict = field(default_factory=dict)  # SyncManager: (start, bytes) of windows that are mapped
    word: int = 0  # AssignActivate
    clock_only: bool = False
    sync0: object = None  # register 0x09A0, ns
    sync1: object = None  # register 0x09A4, ns
    commands: list = field(default_factory=list)


def object_entries(element, types):
    """{sub-index: (bits, default as hex or None)} of an object; an array is spread out."""
    def bits_of(item):
        return number(text_of(item, "BitSize")) or 0

    def default(info, bits):
        if info is None:
            return None
        length = (bits + 7) // 8
        data, value = text_of(info, "DefaultData"), text_of(info, "DefaultValue")
        if data:
            return "".join(data.split()).lower().ljust(2 * length, "0")
        plain = value and set(value.lower().lstrip("#x")) <= set("0123456789abcdef")
        return number(value).to_bytes(8, "little")[:length].hex() if plain and bits <= 64 else None

    kind = types.get(text_of(element, "Type"))
    infos = element.findall("Info/SubItem")
    if kind is None or not kind.findall("SubItem"):
        bits = bits_of(element)
        return {0: (bits, default(element.find("Info"), bits))}
    found = []
    for item in kind.findall("SubItem"):
        array = types.get(text_of(item, "Type"))
        if item.find("SubIdx") is None and array is not None and array.find("ArrayInfo") is not None:
            first, count = (number(text_of(array, f"ArrayInfo/{key}")) for key in ("LBound", "Elements"))
            bits = bits_of(item) // count
            found += [(max(1, first) + turn, bits, None) for turn in range(count)]
        else:
            found.append((number(text_of(item, "SubIdx")), bits_of(item), text_of(item, "Name")))
    # Only where names leave no doubt is a default compared.
    named = {text_of(info, "Name"): info.find("Info") for info in infos}
    doubtful = len(named) != len(infos) or len({name for _, _, name in found}) != len(found)
    return {sub: (bits, None if doubtful or name is None else default(named.get(name), bits)) for sub, bits, name in found}


class Device:
    """A device of a file."""

    def __init__(self, element, vendor, modules):
        self.element, self.vendor, self.modules = element, vendor, modules
        self.chosen = None  # {place: module}; None for the default
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
        kind, window = called, flag(element.get("Virtual"))
        if window:
            # Windows of outputs lie on the SYNC unit, which isocat writes itself, and a mailbox is no window.
            kind = "inputs" if called == "inputs" else "other window"
        elif control is not None:
            writes, one_buffer = control & 0x0C == 0x04, control & 0x03 == 0x02
            box = one_buffer and called not in ("outputs", "inputs") and (self.has_mailbox or called is not None)
            kind = ("mailbox out" if writes else "mailbox in") if box else ("outputs" if writes else "inputs")
        start, size = number(element.get("StartAddress")) or 0, number(element.get("DefaultSize")) or 0
        return SyncManager(kind, start, size, control, window)

    def places(self):
        """(number, slot) of each place for a module: a slot has as many as it takes modules at most."""
        number_of = lambda slot, key: number(slot.get(key))
        slots = self.element.find("Slots")
        if slots is None:
            return []
        found = []
        for slot in slots.findall("Slot"):
            least, most = number_of(slot, "MinInstances") or 0, number_of(slot, "MaxInstances")
            found += [slot] * (max(1, least) if most is None else most)
        limit = number_of(slots, "MaxSlotCount") or 255
        return list(enumerate(found[:min(limit, 255)]))

    def admissible(self, slot):
        """The modules that a slot takes: in the order of its list of idents, or by class in that of the file."""
        idents = [number(ident.text) for ident in slot.findall("ModuleIdent")]
        classes = [(text_of(c, "Class") or (c.text or "").strip(), number(text_of(c, "VendorId")))
                   for c in slot.findall("ModuleClass")]
        listed = [self.modules[ident] for ident in idents if ident in self.modules]
        return listed + [module for ident, module in self.modules.items() if ident not in idents and any(
            name == module.find("Type").get("ModuleClass") and vendor in (None, module.vendor) for name, vendor in classes)]

    def default_modules(self):
        """{place: module}: the preset of each slot, or the first that fits where one has to be."""
        chosen, places = {}, self.places()
        for slot in self.element.findall("Slots/Slot"):
            least = number(slot.get("MinInstances")) or 0
            preset = [number(i.text) for i in slot.findall("ModuleIdent") if flag(i.get("Default"))]
            fitting = [self.modules[i] for i in preset if i in self.modules] if preset else self.admissible(slot)
            own = [place for place, of in places if of is slot]
            chosen.update({place: fitting[0] for place in own[:max(1, least) if preset else least] if fitting})
        return chosen

    def owners(self):
        """(place, group, increments, owner) of the device, then of each of its modules."""
        chosen = self.default_modules() if self.chosen is None else self.chosen
        slots, result = self.element.find("Slots"), [(0, 0, dict.fromkeys(INCREMENTS, 0), self.element)]
        for place, slot in self.places():
            if place in chosen:
                # What a slot says goes before what all slots have.
                increments = {key: number(slot.get(key, slots.get(key))) or 0 for key in INCREMENTS}
                result.append((place, number(slot.get("SlotGroup")) or 0, increments, chosen[place]))
        return result

    @staticmethod
    def moved(index, owner, kind):
        """The index of an element (`Index`) of an owner; `kind`: "Pdo" or "Index"."""
        place, group, increments, _ = owner
        result = number("".join(index.itertext()))
        result += place * increments[f"Slot{kind}Increment"] if flag(index.get("DependOnSlot")) else 0
        result += group * increments[f"SlotGroup{kind}Increment"] if flag(index.get("DependOnSlotGroup")) else 0
        return result & 0xFFFF

    def pdos(self):
        found = []
        for owner in self.owners():
            group = number(owner[3].find("Type").get("ModulePdoGroup")) or 0
            for element in owner[3]:
                if element.tag not in ("RxPdo", "TxPdo") or element.find("Index") is None:
                    continue
                entries = []
                for entry in element.findall("Entry"):
                    index = number(text_of(entry, "Index"))
                    index = index and self.moved(entry.find("Index"), owner, "Index")
                    entries.append((index, number(text_of(entry, "SubIndex")) or 0, number(text_of(entry, "BitLen"))))
                # Old files define the PDO of a channel once; the channels follow each other.
                channel = number(element.get("Chn")) or 0 if element.get("Ref") else 0
                index = (self.moved(element.find("Index"), owner, "Pdo") + channel) & 0xFFFF
                if owner[3] is not self.element and any(pdo.index == index for _, pdo in found):
                    continue
                factor, step = number(element.get("OSFac")) or 0, number(element.get("OSIndexInc")) or 0
                outputs = element.tag == "RxPdo"
                found.append((group, Pdo(index, outputs, number(element.get("Sm")), factor, step, entries)))
        found.sort(key=lambda row: row[0])
        return self.aligned(found)

    def aligned(self, found):
        """PDOs by group; before a group that must begin at whole bytes stands the PDO that its ModulePdoGroup names."""
        groups, result = self.element.findall("Slots/ModulePdoGroup"), []
        for group in sorted({group for group, _ in found}):
            own = [pdo for of, pdo in found if of == group]
            head = groups[group] if group < len(groups) else None
            step = 8 * max(1, number(head.get("Alignment")) or 0) if head is not None else 8
            for outputs, at in dict.fromkeys((pdo.outputs, pdo.sync_manager) for pdo in own if pdo.sync_manager is not None):
                bits = sum(entry[2] for pdo in result for entry in pdo.entries
                           if (pdo.outputs, pdo.sync_manager) == (outputs, at))
                index = head is not None and number(head.get("RxPdo" if outputs else "TxPdo"))
                taken = {pdo.index for _, pdo in found} | {pdo.index for pdo in result}
                if bits % step and index and index not in taken:
                    result.append(Pdo(index, outputs, at, 0, 0, [(0, 0, step - bits % step)]))
            result += own
        return result

    def module_objects(self):
        """{index: {sub-index: (bits, default as hex or None)}} of the objects that modules bring; the first counts."""
        result = {}
        for owner in self.owners()[1:]:
            dictionary = owner[3].find("Profile/Dictionary")
            if dictionary is None:
                continue
            types = {}
            for kind in dictionary.findall("DataTypes/DataType"):
                types.setdefault(text_of(kind, "Name"), kind)
            for element in dictionary.findall("Objects/Object"):
                index = self.moved(element.find("Index"), owner, "Index")
                entries = object_entries(element, types)
                if entries:
                    result.setdefault(index, entries)
        return result

    def module_idents(self):
        """Idents by place, 0 for an empty one, up to the last module."""
        idents = []
        for place, _, _, owner in self.owners()[1:]:
            idents += [0] * (place - len(idents)) + [number(owner.find("Type").get("ModuleIdent"))]
        return idents

    def takes_list(self):
        """Whether the list of modules is written to 0xF030: the slots say so, or the dictionary has it to write."""
        slots = self.element.find("Slots")
        if slots is None or self.element.find("Mailbox/CoE") is None:
            return False
        for kind in self.element.findall("Profile/Dictionary/Objects/Object"):
            if number(text_of(kind, "Index")) == 0xF030:
                name = text_of(kind, "Type")
                definition = next(t for t in self.element.findall("Profile/Dictionary/DataTypes/DataType")
                                  if text_of(t, "Name") == name)
                access = [text_of(item, "Flags/Access") for item in definition.findall("SubItem")][1:]
                return flag(slots.get("DownloadModuleIdentList")) or any("w" in text for text in access)
        return flag(slots.get("DownloadModuleIdentList"))

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

    def assigned_to_other_windows(self, mode_number):
        """Numbers of the windows that are not mapped, and have PDOs by default or in the OpMode."""
        mode = self.modes[mode_number] if mode_number is not None else None
        named = {pdo.sync_manager for pdo in self.pdos()}
        named |= {number(sm.get("No")) for sm in (mode.findall("Sm") if mode is not None else []) if sm.findall("Pdo")}
        return {at for at, sm in enumerate(self.sync_managers) if sm.kind == "other window" and at in named}

    def commands(self):
        all_commands = []
        if self.element.find("Mailbox/CoE") is None:
            return all_commands
        for owner in self.owners():
            for one in owner[3].findall("Mailbox/CoE/InitCmd"):
                index = self.moved(one.find("Index"), owner, "Index")
                transitions = [(t.text or "").strip() for t in one.findall("Transition")]
                data = "".join(text_of(one, "Data").split()).lower()
                all_commands.append(
                    Command(transitions, index, number(text_of(one, "SubIndex")), data, flag(one.get("CompleteAccess"))))
        idents = self.module_idents()
        if idents and self.takes_list() and all(command.index != 0xF030 for command in all_commands):
            at = self.element.find("Slots").get("DownloadModuleListTransition") or "PS"
            all_commands += [Command(["PS" if at == "SP" else at], 0xF030, place + 1, ident.to_bytes(4, "little").hex(), False)
                             for place, ident in enumerate(idents)]
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
        # A window has its FMMU and no SyncManager.
        for at in [at for at in result.lengths if self.sync_managers[at].window]:
            length = result.lengths.pop(at)
            if length:
                result.windows[at] = (self.sync_managers[at].start, length)
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


def read_modules(root, modules):
    """Adds the modules of a file by ident, each with the vendor that the file names; the first of an ident counts."""
    vendor = number(text_of(root, "Vendor/Id"))
    for module in root.findall("Descriptions/Modules/Module") + root.findall("Modules/Module"):
        module = Module(module, vendor)
        modules.setdefault(number(module.find("Type").get("ModuleIdent")), module)


class Module:
    """A module: its element, and its vendor."""

    def __init__(self, element, vendor):
        self.element, self.vendor = element, vendor

    def __iter__(self):
        return iter(self.element)

    def __getattr__(self, name):
        return getattr(self.element, name)


def devices(path, further=()):
    """The devices of a file; raises ET.ParseError where it is not well-formed, ValueError where it is no description.
    `further`: files whose modules the slots take, too."""
    root = ET.parse(path).getroot()
    if root.tag != "EtherCATInfo" or root.find("Descriptions") is None:
        raise ValueError(f"the root is {root.tag}")
    definitions = {pdo.get("RefName"): pdo for pdo in root.findall("Descriptions/Pdos/Pdo")}
    for pdo in root.iter():
        # Old files define a PDO once and refer to it by name.
        if pdo.tag in ("RxPdo", "TxPdo") and pdo.get("Ref") in definitions:
            pdo.extend(definitions[pdo.get("Ref")])
    modules = {}
    read_modules(root, modules)
    for other in further:
        read_modules(ET.parse(other).getroot(), modules)
    vendor = number(text_of(root, "Vendor/Id"))
    for element in root.findall("Descriptions/Devices/Device"):
        yield Device(element, vendor, modules)


PROTOCOLS = {"AoE", "EoE", "CoE", "FoE", "SoE", "VoE"}
FMMU_READ, FMMU_WRITE = 1, 2
INCREMENTS = ("SlotPdoIncrement", "SlotIndexIncrement", "SlotGroupPdoIncrement", "SlotGroupIndexIncrement")
