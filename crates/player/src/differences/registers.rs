//! Compares registers by their values after the last write on the way up.

use std::collections::BTreeMap;

use isocat_descriptions::start_up::{Address, DeviceStartUp, RegisterStep, StartUp, Transition};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, Value};
use isocat_wire::{AutoIncrementAddress, Command, Nanos};

use super::{Difference, Kind, value};

/// Written bytes, each with the transition of its last write.
#[derive(Default)]
struct Memory(BTreeMap<u16, (u8, Transition)>);

/// A register, or several that belong together.
struct Group {
    kind: Kind,
    first: u16,
    length: u16,
    name: String,
    consequence: &'static str,
}

pub(super) fn compare(
    position: usize,
    (eni, device): (&StartUp, &DeviceStartUp),
    (ours, planned): (&StartUp, &DeviceStartUp),
) -> Vec<Difference> {
    let one = Memory::of(position, eni, device);
    let other = Memory::of(position, ours, planned);
    let mut all: Vec<Difference> =
        groups().iter().filter_map(|group| differ(position, group, &one, &other)).collect();
    all.extend(fmmus(position, &one, &other));
    all
}

/// Compares a group. A group that is switched off counts as never written.
fn differ(position: usize, group: &Group, one: &Memory, other: &Memory) -> Option<Difference> {
    let (eni, plan) = (one.read(group), other.read(group));
    let values = [&eni, &plan].map(|found| found.as_ref().map(|(bytes, _)| bytes.clone()));
    let transitions = [&eni, &plan].map(|found| found.as_ref().map(|(_, transition)| *transition));
    let [eni, plan] = values;
    let transition = transitions[0].or(transitions[1]).map(|one| one.to_string());
    let difference = |kind, eni, plan, consequence: &str| Difference {
        position: Some(position),
        kind,
        transition: transition.clone(),
        place: format!("0x{:04X} {}", group.first, group.name),
        eni,
        plan,
        consequence: consequence.into(),
    };
    if eni != plan {
        return Some(difference(
            group.kind,
            eni.map(|bytes| group.text(&bytes)),
            plan.map(|bytes| group.text(&bytes)),
            group.consequence,
        ));
    }
    let [Some(first), Some(second)] = transitions else { return None };
    (first != second).then(|| {
        let words = "the value is the same; until then the device has another one";
        difference(Kind::Transition, Some(first.to_string()), Some(second.to_string()), words)
    })
}

/// Compares FMMUs by what they map; their numbers do not matter.
fn fmmus(position: usize, one: &Memory, other: &Memory) -> Vec<Difference> {
    let (one, other) = (one.fmmus(), other.fmmus());
    let mut all = Vec::new();
    let difference =
        |kind, eni: Option<&Fmmu>, plan: Option<&Fmmu>, consequence: &str| Difference {
            position: Some(position),
            kind,
            transition: Some(Transition::PS.to_string()),
            place: "FMMU".into(),
            eni: eni.map(words),
            plan: plan.map(words),
            consequence: consequence.into(),
        };
    let mut left: Vec<&Fmmu> = other.iter().collect();
    for fmmu in &one {
        let same = |planned: &&Fmmu| {
            (planned.physical_start, planned.kind) == (fmmu.physical_start, fmmu.kind)
        };
        let planned = left.iter().position(same).map(|at| left.remove(at));
        let status = register::sm_status(0).address..register::PROCESS_RAM;
        match planned {
            Some(planned) if planned.length != fmmu.length => all.push(difference(
                Kind::Fmmu,
                Some(fmmu),
                Some(planned),
                "another number of bytes is exchanged with this area",
            )),
            Some(planned) if planned.logical_start != fmmu.logical_start => all.push(difference(
                Kind::ImagePlace,
                Some(fmmu),
                Some(planned),
                "the same bytes lie elsewhere in the process image; the device sees no difference",
            )),
            Some(_) => {}
            None if status.contains(&fmmu.physical_start) => all.push(difference(
                Kind::MailboxState,
                Some(fmmu),
                None,
                "the ENI looks whether the mailbox is full in each cycle; our plan asks when it waits for an answer",
            )),
            None => all.push(difference(
                Kind::Fmmu,
                Some(fmmu),
                None,
                "the ENI exchanges an area that our plan does not",
            )),
        }
    }
    for planned in left {
        let words = "our plan exchanges an area that the ENI does not";
        all.push(difference(Kind::Fmmu, None, Some(planned), words));
    }
    all
}

fn words(fmmu: &Fmmu) -> String {
    let way = match (fmmu.kind & Fmmu::READ != 0, fmmu.kind & Fmmu::WRITE != 0) {
        (true, true) => "read and written",
        (true, false) => "read",
        (false, true) => "written",
        (false, false) => "unused",
    };
    format!(
        "0x{:08X}, {} bytes at 0x{:04X}, {way}",
        fmmu.logical_start, fmmu.length, fmmu.physical_start
    )
}

impl Group {
    /// The meaning of the bytes, in words.
    fn text(&self, bytes: &[u8]) -> String {
        match (self.kind, bytes) {
            (Kind::SyncManager, [a, b, c, d]) => {
                let (start, length) = (u16::from_le_bytes([*a, *b]), u16::from_le_bytes([*c, *d]));
                format!("0x{start:04X}, {length} bytes")
            }
            (Kind::Sync0Cycle | Kind::Sync1Cycle, [a, b, c, d]) => {
                Nanos(u32::from_le_bytes([*a, *b, *c, *d]).into()).to_string()
            }
            _ => value(bytes),
        }
    }
}

impl Memory {
    /// The bytes that a list writes to a device on the way up.
    fn of(position: usize, list: &StartUp, device: &DeviceStartUp) -> Self {
        let mut memory = Self::default();
        let place = AutoIncrementAddress::of_position(position as u16).0;
        for transition in Transition::UP {
            for step in list.before.iter().chain(&device.registers).chain(&list.after) {
                let Address::Physical { device: at, register } = step.address else { continue };
                let is_meant = match step.command {
                    Command::Bwr => true,
                    Command::Fpwr => at == device.station,
                    Command::Apwr => at == place,
                    _ => false,
                };
                if is_meant && step.transitions.contains(&transition) {
                    memory.write(register, step, transition);
                }
            }
        }
        memory
    }

    fn write(&mut self, register: u16, step: &RegisterStep, transition: Transition) {
        for (at, byte) in step.data.iter().enumerate() {
            let at = (at as u16).wrapping_add(register);
            self.0.insert(at, (*byte, transition));
        }
    }

    /// The bytes of a group, and the transition of the last write to any of them; `None`: all are 0
    /// or not written.
    fn read(&self, group: &Group) -> Option<(Vec<u8>, Transition)> {
        let at = |address| self.0.get(&address).copied();
        let all: Vec<_> = (group.first..group.first + group.length).map(at).collect();
        let last = all.iter().flatten().rfind(|(byte, _)| *byte != 0)?;
        Some((all.iter().map(|one| one.map_or(0, |(byte, _)| byte)).collect(), last.1))
    }

    /// The active FMMUs.
    fn fmmus(&self) -> Vec<Fmmu> {
        let byte = |address| self.0.get(&address).map_or(0, |(byte, _)| *byte);
        let one = |number: usize| {
            let first = register::fmmu(number).address;
            let mut bytes = [0; 16];
            for (at, place) in bytes.iter_mut().enumerate() {
                *place = byte(first + at as u16);
            }
            Fmmu::from_bytes(bytes)
        };
        (0..16).map(one).filter(Fmmu::is_active).collect()
    }
}

/// The registers that are compared: not states, the EEPROM interface, error counters and clocks.
fn groups() -> Vec<Group> {
    let group = |kind, first, length, name: &str, consequence| Group {
        kind,
        first,
        length,
        name: name.to_owned(),
        consequence,
    };
    let mut all = vec![
        group(
            Kind::StationAddress,
            register::STATION_ADDRESS.address,
            2,
            "station address",
            "a name on the wire and no more",
        ),
        group(
            Kind::Register,
            register::ECAT_EVENT_MASK.address,
            2,
            "ECAT event mask",
            "frames bring events of the devices back; a MainDevice may look at them or not",
        ),
        group(
            Kind::Watchdog,
            register::WATCHDOG_DIVIDER.address,
            2,
            "watchdog divider",
            "watchdog times count in other units",
        ),
        group(
            Kind::Watchdog,
            register::WATCHDOG_TIME_PDI.address,
            2,
            "watchdog of the PDI",
            "the ESC waits for its CPU for another time",
        ),
        group(
            Kind::Watchdog,
            register::WATCHDOG_TIME_PROCESS_DATA.address,
            2,
            "watchdog of the process data",
            "outputs go safe after another time without frames",
        ),
        group(
            Kind::DriftFilter,
            register::TIME_FILTER_DEPTH.address,
            2,
            "filter depths of the drift loop",
            "clocks follow faster and show more jitter, or slower and lag a changing crystal; where the list writes none, \
             depths that suit the cycle are set",
        ),
        group(
            Kind::AssignActivate,
            register::CYCLIC_UNIT_CONTROL.address,
            2,
            "AssignActivate",
            "the device is synchronized by other pulses, or by none; bits of the first byte say whether EtherCAT or the device has the latch units",
        ),
        group(
            Kind::Sync0Cycle,
            register::SYNC0_CYCLE.address,
            4,
            "cycle of SYNC0",
            "pulses come more or less often",
        ),
        group(
            Kind::Sync1Cycle,
            register::SYNC1_CYCLE.address,
            4,
            "from SYNC0 to SYNC1",
            "the second step of the device comes at another instant",
        ),
        group(
            Kind::Register,
            register::LATCH0_CONTROL.address,
            2,
            "latch control",
            "edges at the latch inputs are stamped once or always",
        ),
    ];
    for number in 0..16 {
        let first = register::sync_manager(number).address;
        let what = [
            (
                0,
                4,
                "start and length",
                "the device refuses areas that are not its own, by AL status 0x001D or 0x001E",
            ),
            (
                4,
                1,
                "control",
                "bit 6 is the watchdog, bits 4 and 5 the interrupts: a device without its interrupt does not see the frame",
            ),
            (6, 1, "activation", "an area that is off is not exchanged"),
        ];
        for (at, length, name, consequence) in what {
            let name = format!("SyncManager {number}, {name}");
            all.push(group(Kind::SyncManager, first + at, length, &name, consequence));
        }
    }
    all
}
