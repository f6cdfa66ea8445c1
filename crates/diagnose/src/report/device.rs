//! Makes the part of one device.

use isocat_sync::explain::assign_activate;
use isocat_sync::object::{self, INPUT_PARAMETER, OUTPUT_PARAMETER, SyncType, sub};
use isocat_wire::Register;
use isocat_wire::al::AlStatus;
use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, Value};

use super::{Builder, Shown};
use crate::Names;
use crate::counters;
use crate::device::Device;
use crate::judge;
use crate::judge::sync::OfDevice;
use crate::known::Known;
use crate::mailbox::Way;

mod document;

pub use document::*;

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

/// Makes the part of one device. `place`: its place in the observer's list.
pub(super) fn report(builder: &Builder<'_>, place: usize, names: &Names) -> DeviceReport {
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
    let named = names.name(device.position, vendor, product);
    let differences = &device.differences;
    let depths = (register::TIME_FILTER_DEPTH, register::SPEED_FILTER_DEPTH);
    let depths = device.image.latest(depths.0).zip(device.image.latest(depths.1));
    let magnitude = |known: Option<Known<SystemTimeDifference>>| {
        builder.shown(known.map(|known| known.map(SystemTimeDifference::magnitude)))
    };
    let states = states(builder, device);
    let silences = device.silences.kept.iter().map(|silence| SilenceReport {
        frame: builder.files.place(silence.frame),
        at_ns: builder.at_ns(silence.at),
        until_ns: silence.until.map(|until| builder.at_ns(until.value)),
    });
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
        silences: silences.collect(),
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
        distance: distance(builder, place),
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
            error: seen.error(),
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
        slowest: mailbox.slowest.map(|slowest| SlowestAnswer {
            object: slowest.object.to_string(),
            took_ns: u64::try_from(slowest.took.as_nanos()).unwrap_or(u64::MAX),
            frame: builder.files.place(slowest.frame),
        }),
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

fn distance(builder: &Builder<'_>, place: usize) -> Option<Distance> {
    let known = judge::sync::distance(builder.observer, place)?;
    let OfDevice { distance, delay, within, .. } = Some(known).filter(|known| !known.ended)?;
    let shown = |known: Known<i64>| Shown {
        value: known.value - delay,
        frame: builder.files.place(known.frame),
    };
    Some(Distance {
        frames: distance.count,
        cycle_ns: distance.grid.cycle,
        grid: distance.grid,
        shortest_ns: shown(distance.shortest),
        mean_ns: distance.mean() - delay,
        longest_ns: shown(distance.longest),
        delay_ns: delay,
        within_ns: within,
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
