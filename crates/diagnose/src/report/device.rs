//! One device in the document.

use isocat_sync::explain::assign_activate;
use isocat_sync::object::{self, INPUT_PARAMETER, OUTPUT_PARAMETER, SyncType, sub};
use isocat_wire::Register;
use isocat_wire::al::AlStatus;
use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, Value};
use schemars::JsonSchema;
use serde::Serialize;

use super::{Builder, FrameRef, Shown};
use crate::counters;
use crate::device::Device;
use crate::judge;
use crate::known::Known;
use crate::mailbox::Way;

/// What the capture shows of one device. What is null or empty it does not show.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct DeviceReport {
    /// Its position in the segment, from 0.
    pub position: Option<u16>,
    /// Its station address.
    pub station: Option<Shown<u16>>,
    /// Its name: of the segment file, of a description with this identity, or of its EEPROM.
    pub name: Option<String>,
    /// Out of its EEPROM.
    pub identity: Identity,
    /// Out of registers 0x0000 to 0x0008.
    pub esc: Esc,
    /// DL status (0x0110): links and loops of its ports.
    pub dl_status: Option<Shown<u16>>,
    /// The last status that was read.
    pub state: Option<String>,
    /// Each status that was read and differs from the one before; up to 256.
    pub states: Vec<StateReport>,
    /// SyncManagers that were written or read and are not all zero.
    pub sync_managers: Vec<SyncManagerReport>,
    /// FMMUs that map anything.
    pub fmmus: Vec<FmmuReport>,
    /// The process data watchdog, ns; 0x0400 and 0x0420.
    pub watchdog_ns: Option<u64>,
    /// What went through its mailbox; null: nothing.
    pub mailbox: Option<MailboxReport>,
    /// System time offset (0x0920), ns, modulo 2^64.
    pub offset_ns: Option<Shown<u64>>,
    /// Propagation delay (0x0928), ns.
    pub delay_ns: Option<Shown<u32>>,
    /// Speed counter start (0x0930) of its drift loop.
    pub speed_counter_start: Option<Shown<u16>>,
    /// Filter depths (0x0934, 0x0935) of its drift loop.
    pub filter_depths: Option<Shown<[u8; 2]>>,
    /// Readings of 0x092C.
    pub differences: u64,
    /// The last of them, ns, without its sign: what the sign means depends on the chip.
    pub difference_ns: Option<Shown<u32>>,
    /// The largest of them in operation.
    pub worst_difference_ns: Option<Shown<u32>>,
    /// Each time its SYNC unit was switched; up to 64.
    pub sync: Vec<SyncSwitch>,
    /// How often 0x0984 or 0x0990 was read after SYNC was last switched on.
    pub sync_looked_at: u64,
    /// From cyclic frames to SYNC0; null: not known.
    pub distance: Option<Distance>,
    /// Frames that read error counters.
    pub error_readings: u64,
    /// Error counters that are not zero.
    pub errors: Vec<ErrorCounter>,
    /// The last frame that addressed it alone.
    pub last: FrameRef,
}

/// Which device it is.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Identity {
    /// Vendor id.
    pub vendor: Option<Shown<u32>>,
    /// Product code.
    pub product: Option<Shown<u32>>,
    /// Revision.
    pub revision: Option<Shown<u32>>,
    /// Serial number.
    pub serial: Option<Shown<u32>>,
    /// Words of the EEPROM that the capture shows.
    pub words: usize,
}

/// The chip.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Esc {
    /// 0x0000.
    pub kind: Option<Shown<u8>>,
    /// The chip's name, where its type has one.
    pub name: Option<&'static str>,
    /// 0x0001.
    pub revision: Option<Shown<u8>>,
    /// 0x0004.
    pub fmmus: Option<Shown<u8>>,
    /// 0x0005.
    pub sync_managers: Option<Shown<u8>>,
    /// 0x0006, KiB.
    pub ram: Option<Shown<u8>>,
    /// 0x0008 bit 2: it has a DC unit.
    pub dc: Option<bool>,
    /// 0x0008 bit 3: its system time has 64 bits.
    pub dc_64_bit: Option<bool>,
}

/// A status.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct StateReport {
    /// AL status, as `SAFEOP+ERR`. A device without a CPU copies the acknowledge bit of the request to the place of the error bit:
    /// that is no error.
    pub status: String,
    /// AL status as it was read.
    pub raw: u16,
    /// AL status code, if it was read while this status held.
    pub code: Option<u16>,
    /// The state that was asked for last; null: none in this capture.
    pub asked: Option<String>,
    /// The first frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// A SyncManager.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncManagerReport {
    /// From 0.
    pub number: usize,
    /// First address.
    pub start: u16,
    /// Bytes.
    pub length: u16,
    /// Control byte.
    pub control: u8,
    /// Whether it is on.
    pub enabled: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// A FMMU.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct FmmuReport {
    /// From 0.
    pub number: usize,
    /// First logical address.
    pub logical: u32,
    /// Bits.
    pub bits: u32,
    /// First address of the device's memory.
    pub physical: u16,
    /// The MainDevice reads through it.
    pub reads: bool,
    /// The MainDevice writes through it.
    pub writes: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// What went through a mailbox.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct MailboxReport {
    /// Messages to the device and from it.
    pub messages: [u64; 2],
    /// SDO transfers that the device answered without an abort.
    pub transfers: u64,
    /// SDO transfers that it aborted.
    pub aborts: Vec<Aborts>,
    /// Entries of 0x1C32 and 0x1C33, as they were last written or read.
    pub sync_objects: Vec<ObjectValue>,
    /// No frame shows where the mailboxes are: messages are known by their content.
    pub by_content: bool,
}

/// SDO transfers of one object that the device aborted with one code.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Aborts {
    /// The object, as `0x1C32:01`.
    pub object: String,
    /// Abort code.
    pub code: u32,
    /// How often.
    pub count: usize,
    /// The first of them.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// An entry of 0x1C32 or 0x1C33.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ObjectValue {
    /// As `0x1C32:01`.
    pub object: String,
    /// Its index.
    pub index: u16,
    /// Its sub-index.
    pub sub: u8,
    /// Its name.
    pub name: Option<&'static str>,
    /// Its value; times are in ns.
    pub value: u64,
    /// The MainDevice wrote it; if not, the device told it.
    pub written: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// A SYNC unit was switched.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncSwitch {
    /// 0x0980 and 0x0981 as a word (AssignActivate).
    pub assign_activate: u16,
    /// What its bits mean.
    pub words: Vec<&'static str>,
    /// SYNC0 cycle (0x09A0), ns.
    pub sync0_cycle_ns: Option<Shown<u32>>,
    /// SYNC1 cycle (0x09A4), ns.
    pub sync1_cycle_ns: Option<Shown<u32>>,
    /// Start time (0x0990), ns of system time; of a 32-bit one as many bits as were written.
    pub start_ns: Option<Shown<u64>>,
    /// Bytes of the start time that were written, 4 or 8.
    pub start_bytes: Option<u8>,
    /// The start time less the reference's time, as that was last seen before, ns; below 0 it had passed.
    pub ahead_ns: Option<i64>,
    /// The frame that switched it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// From the end of cyclic frames at a device to its SYNC0, in the time of the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Distance {
    /// Frames that were measured.
    pub frames: u64,
    /// From one SYNC0 to the next, ns.
    pub cycle_ns: u64,
    /// The shortest distance, ns; below 0: behind the SYNC0 that usually follows.
    pub shortest_ns: Shown<i64>,
    /// The mean, ns.
    pub mean_ns: i64,
    /// The longest, ns.
    pub longest_ns: Shown<i64>,
    /// How much later a frame comes here than at the reference (0x0928), ns.
    pub delay_ns: i64,
    /// Frames slide through the cycle: the MainDevice does not follow the reference clock.
    pub slides: bool,
}

/// An error counter.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ErrorCounter {
    /// Its register.
    pub address: u16,
    /// What it counts.
    pub name: Option<&'static str>,
    /// Its port; null: it is the device's.
    pub port: Option<u16>,
    /// As it was last read or cleared.
    pub value: u8,
    /// That frame.
    #[serde(flatten)]
    pub frame: FrameRef,
}

impl DeviceReport {
    /// `SubDevice 2 (EL2828)`, `SubDevice 0x1001`.
    pub fn title(&self) -> String {
        let number = match (self.position, &self.station) {
            (Some(position), _) => position.to_string(),
            (None, Some(station)) => format!("{:#06x}", station.value),
            (None, None) => "of unknown address".to_owned(),
        };
        match &self.name {
            Some(name) => format!("SubDevice {number} ({name})"),
            None => format!("SubDevice {number}"),
        }
    }
}

/// Makes the part of one device; `place`: its place in the observer's list.
pub(super) fn report(
    builder: &Builder<'_>,
    place: usize,
    names: &dyn Fn(Option<u16>, u32, u32) -> Option<String>,
) -> DeviceReport {
    let device = &builder.observer.devices.list[place];
    let identity = Identity {
        vendor: builder.shown(device.sii.vendor()),
        product: builder.shown(device.sii.product()),
        revision: builder.shown(device.sii.revision()),
        serial: builder.shown(device.sii.serial()),
        words: device.sii.len(),
    };
    let known = identity.vendor.as_ref().zip(identity.product.as_ref());
    let (vendor, product) = known.map_or((0, 0), |(vendor, product)| (vendor.value, product.value));
    let named = names(device.position, vendor, product);
    let differences = &device.differences;
    let depths = (register::TIME_FILTER_DEPTH, register::SPEED_FILTER_DEPTH);
    let depths = device.image.latest(depths.0).zip(device.image.latest(depths.1));
    let magnitude = |known: Option<Known<SystemTimeDifference>>| {
        builder.shown(known.map(|known| known.map(SystemTimeDifference::magnitude)))
    };
    let states = states(builder, device);
    DeviceReport {
        position: device.position,
        station: builder.shown(device.station),
        name: named.or_else(|| device.sii.name()),
        identity,
        esc: esc(builder, device),
        dl_status: builder
            .shown(device.image.read(register::DL_STATUS).map(|known| known.map(|s| s.0))),
        state: states.last().map(|seen| seen.status.clone()),
        states,
        sync_managers: sync_managers(builder, device),
        fmmus: fmmus(builder, device),
        watchdog_ns: judge::sync::watchdog_ns(device).map(|(ns, _)| ns),
        mailbox: mailbox(builder, device),
        offset_ns: builder.register(device, register::SYSTEM_TIME_OFFSET),
        delay_ns: builder.register(device, register::SYSTEM_TIME_DELAY),
        speed_counter_start: builder.register(device, register::SPEED_COUNTER_START),
        filter_depths: builder.shown(depths.map(|(time, speed)| Known {
            value: [time.value, speed.value],
            frame: time.frame.max(speed.frame),
        })),
        differences: differences.count,
        difference_ns: magnitude(differences.last),
        worst_difference_ns: magnitude(differences.worst),
        sync: device.sync.switched.kept.iter().map(|one| switched(builder, one)).collect(),
        sync_looked_at: device.sync.looked.map_or(0, |looked| looked.value),
        distance: distance(builder, device),
        error_readings: device.errors.readings,
        errors: errors(builder, device),
        last: builder.files.place(device.last),
    }
}

impl Builder<'_> {
    fn shown<T>(&self, known: Option<Known<T>>) -> Option<Shown<T>> {
        known.map(|Known { value, frame }| Shown { value, frame: self.files.place(frame) })
    }

    /// A register that keeps what is written to it.
    fn register<T: Value>(&self, device: &Device, register: Register<T>) -> Option<Shown<T>> {
        self.shown(device.image.latest(register))
    }
}

fn esc(builder: &Builder<'_>, device: &Device) -> Esc {
    let kind = builder.register(device, register::TYPE);
    let features = device.image.read(register::FEATURES).map(|known| known.value);
    Esc {
        name: kind.as_ref().and_then(|kind| chip(kind.value)),
        kind,
        revision: builder.register(device, register::REVISION),
        fmmus: builder.register(device, register::FMMU_COUNT),
        sync_managers: builder.register(device, register::SM_COUNT),
        ram: builder.register(device, register::RAM_SIZE),
        dc: features.map(|features| features & register::features::DC != 0),
        dc_64_bit: features.map(|features| features & register::features::DC_64_BIT != 0),
    }
}

/// The name of a chip by its type (0x0000).
fn chip(kind: u8) -> Option<&'static str> {
    Some(match kind {
        0x04 => "IP core",
        0x11 => "ET1100",
        0x12 => "ET1200",
        0x98 => "XMC4x00",
        0xC0 => "LAN925x",
        _ => return None,
    })
}

fn states(builder: &Builder<'_>, device: &Device) -> Vec<StateReport> {
    let asked = |seen: &crate::state::StateSeen| {
        let control = seen.asked?.value;
        Some(control.state().map_or_else(|unknown| unknown.to_string(), |s| s.to_string()))
    };
    let changes = device.states.changes.kept.iter();
    changes
        .map(|seen| StateReport {
            status: match seen.copied() {
                true => AlStatus(seen.status.0 & 0x0F).to_string(),
                false => seen.status.to_string(),
            },
            raw: seen.status.0,
            code: seen.code.map(|code| code.0),
            asked: asked(seen),
            frame: builder.files.place(seen.frame),
            at_ns: builder.at_ns(seen.at),
        })
        .collect()
}

fn sync_managers(builder: &Builder<'_>, device: &Device) -> Vec<SyncManagerReport> {
    let all = (0..16).filter_map(|number| {
        let known = device.image.latest(register::sync_manager(number))?;
        let manager = known.value;
        let set = manager.start != 0 || manager.length != 0 || manager.is_enabled();
        set.then(|| SyncManagerReport {
            number,
            start: manager.start,
            length: manager.length,
            control: manager.control,
            enabled: manager.is_enabled(),
            frame: builder.files.place(known.frame),
        })
    });
    all.collect()
}

fn fmmus(builder: &Builder<'_>, device: &Device) -> Vec<FmmuReport> {
    let all = (0..16).filter_map(|number| {
        let known = device.image.latest(register::fmmu(number))?;
        let fmmu = known.value;
        fmmu.is_active().then(|| FmmuReport {
            number,
            logical: fmmu.logical_start,
            bits: fmmu.bits(),
            physical: fmmu.physical_start,
            reads: fmmu.kind & Fmmu::READ != 0,
            writes: fmmu.kind & Fmmu::WRITE != 0,
            frame: builder.files.place(known.frame),
        })
    });
    all.collect()
}

fn mailbox(builder: &Builder<'_>, device: &Device) -> Option<MailboxReport> {
    let mailbox = &device.mailbox;
    if mailbox.messages.is_empty() {
        return None;
    }
    let mut aborts: Vec<Aborts> = Vec::new();
    for abort in &mailbox.aborts.kept {
        let (object, code) = (abort.object.to_string(), abort.code.0);
        match aborts.iter_mut().find(|known| known.object == object && known.code == code) {
            Some(known) => known.count += 1,
            None => {
                let frame = builder.files.place(abort.frame);
                aborts.push(Aborts { object, code, count: 1, frame });
            }
        }
    }
    let of_sync = mailbox.values.iter().filter(|(object, _)| {
        matches!(object.index, OUTPUT_PARAMETER | INPUT_PARAMETER) && object.sub > 0
    });
    let sync_objects = of_sync.filter_map(|(object, known)| {
        Some(ObjectValue {
            object: object.to_string(),
            index: object.index,
            sub: object.sub,
            name: object::name(object.sub),
            value: known.value.number()?,
            written: known.value.way == Way::Written,
            frame: builder.files.place(known.frame),
        })
    });
    Some(MailboxReport {
        messages: mailbox
            .messages
            .values()
            .fold([0, 0], |[to, from], [more_to, more_from]| [to + more_to, from + more_from]),
        transfers: mailbox.transfers,
        aborts,
        sync_objects: sync_objects.collect(),
        by_content: mailbox.by_content,
    })
}

fn switched(builder: &Builder<'_>, one: &crate::sync_unit::Switched) -> SyncSwitch {
    let now = one.now.map(|now| now.value);
    SyncSwitch {
        assign_activate: one.word.0,
        words: assign_activate::bits(one.word).map(|(_, words)| words).collect(),
        sync0_cycle_ns: builder.shown(one.sync0_cycle),
        sync1_cycle_ns: builder.shown(one.sync1_cycle),
        start_ns: builder.shown(one.start.map(|start| start.map(|start| start.ns))),
        start_bytes: one.start.map(|start| start.value.bytes),
        ahead_ns: one
            .full_start()
            .zip(now)
            .map(|(start, now)| start.wrapping_sub(now).cast_signed()),
        frame: builder.files.place(one.frame),
        at_ns: builder.at_ns(one.at),
    }
}

fn distance(builder: &Builder<'_>, device: &Device) -> Option<Distance> {
    let (delay, distance) = judge::sync::distance(builder.observer, device)?;
    let shown = |known: Known<i64>| Shown {
        value: known.value - delay,
        frame: builder.files.place(known.frame),
    };
    Some(Distance {
        frames: distance.count,
        cycle_ns: distance.grid.cycle,
        shortest_ns: shown(distance.shortest),
        mean_ns: distance.mean() - delay,
        longest_ns: shown(distance.longest),
        delay_ns: delay,
        slides: distance.slides(),
    })
}

fn errors(builder: &Builder<'_>, device: &Device) -> Vec<ErrorCounter> {
    let all = device.errors.now().map(|(address, known)| ErrorCounter {
        address,
        name: counters::name(address),
        port: counters::port(address),
        value: known.value,
        frame: builder.files.place(known.frame),
    });
    all.collect()
}

/// The synchronization type in words, if it is known.
pub(super) fn mode(device: &DeviceReport) -> Option<SyncType> {
    let objects = &device.mailbox.as_ref()?.sync_objects;
    let is_type =
        |object: &&ObjectValue| (object.index, object.sub) == (OUTPUT_PARAMETER, sub::SYNC_TYPE);
    Some(SyncType(objects.iter().find(is_type)?.value as u16))
}
