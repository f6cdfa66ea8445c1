//! Contradictions and open questions of a SubDevice.

mod sync_objects;

use std::ops::Range;

use isocat_maindevice::segment::{self, DcCapability, SubDevice};
use isocat_sync::delay::Delay;
use isocat_wire::dc::AssignActivate;
use isocat_wire::register::{PROCESS_RAM, features};
use isocat_wire::sii::sm_type;
use isocat_wire::{AlState, PortNumber};

use crate::report::NoteKind;

use super::esc::{PortKind, sync_manager_use};

/// The parts of a SubDevice that were read.
#[derive(Clone, Copy)]
pub(super) struct Known {
    /// Whether its SII was read.
    pub sii: bool,
    /// Whether some of its objects were read.
    pub objects: bool,
    /// Whether all requested objects were read.
    pub all_objects: bool,
}

/// The notes on one SubDevice.
#[derive(Default)]
pub(super) struct Doubts {
    /// Contradictions: kind and words.
    pub contradictions: Vec<(NoteKind, String)>,
    /// Allowed settings that leave a question open: kind and words.
    pub open: Vec<(NoteKind, String)>,
}

/// All doubts about a SubDevice, as far as it is known.
pub(super) fn of(device: &SubDevice, known: Known) -> Doubts {
    let mut doubts = Doubts::default();
    doubts.state(device);
    doubts.ports(device);
    doubts.clock(device);
    if known.sii {
        doubts.sii(device);
        doubts.sync_managers(device);
        doubts.op_modes(device);
    }
    if known.objects && device.has_coe() {
        doubts.sync_objects(device, known.all_objects);
    }
    doubts
}

impl Doubts {
    fn contradicts(&mut self, kind: NoteKind, what: String) {
        self.contradictions.push((kind, what));
    }

    fn asks(&mut self, kind: NoteKind, what: String) {
        self.open.push((kind, what));
    }

    /// Notes its state before the scan.
    fn state(&mut self, device: &SubDevice) {
        let Some((status, code)) = device.observed.state_before else { return };
        if status.error() {
            self.asks(
                NoteKind::ErrorBefore,
                format!("it stood in an error before the scan: {status}, AL status code {code}"),
            );
        } else if status.state() != Ok(AlState::Init) {
            self.asks(
                NoteKind::InUse,
                format!(
                    "it was in {status}: whoever brought it there may run on; the \
                    scan took it to INIT"
                ),
            );
        }
    }

    fn ports(&mut self, device: &SubDevice) {
        let (status, kinds) = (device.dl_status, device.esc.ports);
        if device.entry != PortNumber::P0 {
            let entry = device.entry;
            let port_0 = match status.link(PortNumber::P0) {
                true => "port 0 (IN) leads on",
                false => "port 0 (IN) has no link",
            };
            self.contradicts(
                NoteKind::PortsSwapped,
                format!(
                    "frames come in at port {entry}, and {port_0}: the cable from the MainDevice is in \
                    the wrong port. It works; swap the plugs, since other MainDevices compute its \
                    delay for IN at port 0"
                ),
            );
        }
        for port in PortNumber::ALL {
            let kind = PortKind::of(kinds, port);
            if status.open(port) && !kind.is_there() {
                self.contradicts(
                    NoteKind::PortNotThere,
                    format!(
                        "frames leave through port {port} (0x0110), whose kind is \
                        \"{kind}\" (0x0007)"
                    ),
                );
            } else if status.link(port) && !status.communication(port) {
                self.asks(
                    NoteKind::LinkWithoutSignal,
                    format!(
                        "port {port} has a link and no signal (0x0110): what is \
                        behind it does not answer"
                    ),
                );
            }
        }
    }

    fn clock(&mut self, device: &SubDevice) {
        let promised = device.esc.has(features::DC);
        match (promised, device.dc) {
            (true, DcCapability::None) => self.contradicts(
                NoteKind::NoReceiveTimes,
                "0x0008 bit 2 promises distributed clocks, but 0x0900 does not answer".to_owned(),
            ),
            (true, DcCapability::ReceiveTimes) => self.asks(
                NoteKind::ReceiveTimesOnly,
                "it has receive times and no system time (0x0910 does not answer)".to_owned(),
            ),
            _ => {}
        }
        if let Some(Delay::Indeterminate { why, between }) = device.measured_delay {
            let range = between.map_or(String::new(), |(least, most)| {
                format!("; {} to {} ns are possible", least.0 / 1_000, most.0 / 1_000)
            });
            self.asks(NoteKind::DelayUnknown, format!("its delay can't be known: {why}{range}"));
        }
    }

    fn sii(&mut self, device: &SubDevice) {
        let alias = alias(device);
        if let Some(found) = device.observed.alias.filter(|found| *found != alias) {
            self.contradicts(
                NoteKind::Alias,
                format!("its alias is {found} in register 0x0012 and {alias} in the SII"),
            );
        }
        if device.identity.vendor == 0 || device.identity.product == 0 {
            self.asks(NoteKind::NoIdentity, "its SII names no vendor or no product".to_owned());
        }
        for lack in crate::diagnosis::eeprom::of(&device.sii) {
            let what = format!("its EEPROM can't bring a device to OP: {lack}");
            self.contradicts(NoteKind::EepromIncomplete, what);
        }
    }

    fn sync_managers(&mut self, device: &SubDevice) {
        let (records, esc) = (&device.sii.sync_managers, &device.esc);
        if records.len() > usize::from(esc.sync_managers) {
            self.contradicts(
                NoteKind::TooFewSyncManagers,
                format!(
                    "its SII has {} SyncManagers, its ESC {} (0x0005)",
                    records.len(),
                    esc.sync_managers
                ),
            );
        }
        let used = device.fmmus_needed();
        if used > usize::from(esc.fmmus) {
            self.contradicts(
                NoteKind::TooFewFmmus,
                format!(
                    "{used} FMMUs are needed for its process data, its ESC has {} (0x0004)",
                    esc.fmmus
                ),
            );
        }
        for (number, record) in records.iter().enumerate().filter(|(_, sm)| sm.is_window()) {
            let mut outputs = device.sii.rx_pdos.iter();
            if !device.has_coe() && outputs.any(|pdo| usize::from(pdo.record.sm) == number) {
                self.asks(
                    NoteKind::WindowNotMapped,
                    format!(
                        "its SII assigns outputs to SyncManager {number}, a window on {:#06x}: they are not mapped, as \
                        registers are the plan's to write",
                        record.start
                    ),
                );
            }
        }
        for (number, (record, kind)) in records.iter().zip(&device.sm_types).enumerate() {
            if record.kind != *kind && *kind != sm_type::UNUSED {
                let (sii, object) = (sync_manager_use(record.kind), sync_manager_use(*kind));
                self.contradicts(
                    NoteKind::SyncManagerUse,
                    format!(
                        "SyncManager {number} is for {sii} in its SII, for {object} \
                        in 0x1C00"
                    ),
                );
            }
        }
        let areas = areas(device);
        let end = u32::from(PROCESS_RAM) + 1024 * u32::from(esc.ram);
        for (at, (name, from, to)) in areas.iter().enumerate() {
            let digital = DIGITAL_OUTPUTS.contains(from) && *to <= DIGITAL_OUTPUTS.end;
            if (*from < u32::from(PROCESS_RAM) || *to > end) && !digital {
                self.contradicts(
                    NoteKind::BeyondTheMemory,
                    format!(
                        "{name} is at {from:#06x}..{to:#06x}, its process RAM at \
                        0x1000..{end:#06x} (0x0006)"
                    ),
                );
            }
            for (other, begin, until) in &areas[at + 1..] {
                if from < until && begin < to {
                    self.contradicts(
                        NoteKind::Overlap,
                        format!(
                            "{name} at {from:#06x}..{to:#06x} and {other} at \
                            {begin:#06x}..{until:#06x} overlap"
                        ),
                    );
                }
            }
        }
        if device.has_mailbox() {
            let header = &device.sii.header;
            let named =
                [(sm_type::MAILBOX_OUT, header.receive), (sm_type::MAILBOX_IN, header.send)];
            for (kind, area) in named {
                let Some(record) = records.iter().find(|record| record.kind == kind) else {
                    continue;
                };
                if (record.start, record.length) != (area.start, area.length) {
                    self.contradicts(
                        NoteKind::MailboxArea,
                        format!(
                            "{} is {} bytes at {:#06x} in the head of its SII, {} bytes \
                                at {:#06x} among its SyncManagers",
                            sync_manager_use(kind),
                            area.length,
                            area.start,
                            record.length,
                            record.start
                        ),
                    );
                }
            }
        }
    }

    fn op_modes(&mut self, device: &SubDevice) {
        let wanting =
            device.sii.operation_modes.iter().map(|mode| AssignActivate(mode.assign_activate));
        let synced = wanting.filter(|word| word.activates()).count();
        if synced > 0 && !device.dc.has_clock() {
            self.contradicts(
                NoteKind::OpModeWithoutClock,
                format!("{synced} OpModes of its SII switch SYNC on, but it has no system time"),
            );
        }
    }
}

/// The areas of the process RAM: name, first byte, end. Three buffers lie one behind the other.
fn areas(device: &SubDevice) -> Vec<(String, u32, u32)> {
    let header = &device.sii.header;
    let mut areas = Vec::new();
    if device.has_mailbox() {
        for (name, area) in [("mailbox out", header.receive), ("mailbox in", header.send)] {
            areas.push((name.to_owned(), area.start.into(), u32::from(area.length)));
        }
    }
    for (name, data) in [("outputs", &device.outputs), ("inputs", &device.inputs)] {
        let guarded = data.guarded().filter(|guarded| !guarded.window);
        for segment::Guarded { sync_manager, start, length, .. } in guarded {
            let record = device.sii.sync_managers.get(usize::from(sync_manager));
            // A single byte has one buffer, and registers are there once.
            let one = length == 1 || start < PROCESS_RAM;
            let three = !one && record.is_some_and(|record| record.control & 3 == 0);
            let buffers = if three { 3 } else { 1 };
            areas.push((name.to_owned(), start.into(), buffers * u32::from(length)));
        }
    }
    areas.retain(|(_, _, length)| *length > 0);
    areas.into_iter().map(|(name, start, length)| (name, start, start + length)).collect()
}

/// Registers that drive the digital outputs of an ESC without a CPU.
const DIGITAL_OUTPUTS: Range<u32> = 0x0F00..0x0F04;

/// Word 4 of the SII.
pub(super) fn alias(device: &SubDevice) -> u16 {
    let words = &device.sii.header.configuration;
    u16::from_le_bytes([words[8], words[9]])
}
