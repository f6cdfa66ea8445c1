//! Builds the report of a scan.

use isocat_maindevice::error::AccessError;
use isocat_maindevice::segment::{self, Segment, SubDevice};
use isocat_maindevice::{Cause, Error, Stage};
use isocat_sync::delay::{self, Delay as Measured};
use isocat_sync::explain::assign_activate;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::datagram::Address;
use isocat_wire::dc::AssignActivate;
use isocat_wire::sii::SmRecord;
use isocat_wire::time::Picos;
use isocat_wire::{PortNumber, StationAddress};

use super::doubts::{self, Known, alias};
use super::esc::PortKind;
use super::objects::sync_object;
use super::{
    Clock, Delay, Device, FORMAT, Guarded, Mailbox, Note, OpMode, Pdo, PdoEntry, Port, ProcessData,
    ScanReport, State, SyncManager, esc,
};
use crate::report::NoteKind;
use crate::scan::{Failure, Scan};

/// The place of a scan.
#[derive(Clone, Copy, Debug)]
pub enum Place<'a> {
    /// A virtual segment, and the file with its description.
    Virtual(&'a str),
    /// An interface, and its network namespace.
    Interface(&'a str, Option<&'a str>),
}

impl ScanReport {
    /// Reports on a scan.
    pub fn new(place: Place<'_>, scan: &Scan) -> Self {
        let segment = &scan.segment;
        let (mut findings, mut open) = (Vec::new(), Vec::new());
        for problem in &segment.problems {
            findings.push(note(
                segment,
                position(segment, problem),
                NoteKind::NotRead,
                problem.to_string(),
            ));
        }
        match &scan.failure {
            Some(Failure::Gave(error)) => {
                findings.push(note(
                    segment,
                    position(segment, error),
                    NoteKind::GivenUp,
                    error.to_string(),
                ));
            }
            Some(Failure::TooLong(stage)) => {
                let what = format!("the scan did not end, its last stage was {stage}");
                findings.push(note(segment, None, NoteKind::GivenUp, what));
            }
            Some(Failure::Ended(why)) => {
                findings.push(note(segment, None, NoteKind::GivenUp, why.clone()))
            }
            None => {}
        }
        if let Some(why) = &scan.way_down {
            let what = format!("SubDevices may not be back in INIT: {why}");
            findings.push(note(segment, None, NoteKind::WayDown, what));
        }
        for device in &segment.devices {
            let at = Some(device.position);
            let failed = |stage| {
                let here = |problem: &&Error| position(segment, problem) == at;
                segment.problems.iter().filter(here).any(|problem| problem.stage <= stage)
            };
            let sii = scan.failure.is_none() && !failed(Stage::Sii);
            let objects = scan.objects && sii && !failed(Stage::PreOp);
            let known = Known { sii, objects, all_objects: !failed(Stage::Objects) };
            let found = doubts::of(device, known);
            findings.extend(
                found.contradictions.into_iter().map(|(kind, what)| note(segment, at, kind, what)),
            );
            open.extend(found.open.into_iter().map(|(kind, what)| note(segment, at, kind, what)));
        }
        let tree_known =
            segment.devices.iter().filter(|device| device.parent.is_none()).count() <= 1;
        let (segment_file, interface, namespace) = match place {
            Place::Virtual(file) => (Some(file.to_owned()), None, None),
            Place::Interface(name, namespace) => {
                (None, Some(name.to_owned()), namespace.map(str::to_owned))
            }
        };
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            segment_file,
            interface,
            namespace,
            consistent: findings.is_empty(),
            verdict: verdict(segment, &findings, &open),
            findings,
            doubts: open,
            objects_read: scan.objects,
            reference: segment.reference,
            tree_known,
            frames_sent: scan.statistics.frames_sent,
            frames_lost: scan.statistics.frames_lost,
            devices: segment
                .devices
                .iter()
                .map(|found| device(segment, found, scan.objects))
                .collect(),
        }
    }
}

fn verdict(segment: &Segment, findings: &[Note], doubts: &[Note]) -> String {
    let count = |n: usize, one: &str| format!("{n} {one}{}", if n == 1 { "" } else { "s" });
    let devices = count(segment.devices.len(), "SubDevice");
    let clocks = segment.devices.iter().filter(|device| device.dc.has_clock()).count();
    let found = format!("{devices}, {clocks} with a clock");
    let open = match doubts.len() {
        0 => String::new(),
        n => format!(", {}", count(n, "open question")),
    };
    match findings {
        [] => format!("Found and read: {found}{open}."),
        [one] => format!("Found with a fault: {found}{open}. {}.", one.sentence()),
        all => format!("Found with {}: {found}{open}.", count(all.len(), "fault")),
    }
}

impl Note {
    /// The note with the device it concerns.
    pub fn sentence(&self) -> String {
        match (self.position, self.device.as_deref()) {
            // What the MainDevice says names the SubDevice itself.
            _ if self.kind.names_its_device() => self.what.clone(),
            (Some(position), Some("")) | (Some(position), None) => {
                format!("SubDevice {position}: {}", self.what)
            }
            (Some(position), Some(name)) => format!("SubDevice {position} ({name}): {}", self.what),
            (None, _) => self.what.clone(),
        }
    }
}

fn note(segment: &Segment, position: Option<usize>, kind: NoteKind, what: String) -> Note {
    let device = position.and_then(|at| segment.devices.get(at)).map(|device| device.name.clone());
    Note { position, device, kind, what }
}

/// The SubDevice at which something failed.
fn position(segment: &Segment, error: &Error) -> Option<usize> {
    let at = |station: StationAddress| {
        segment.devices.iter().position(|device| device.station == station)
    };
    match &error.cause {
        Cause::Access(AccessError { address: Address::Station(station, _), .. }) => at(*station),
        cause => cause.place().map(|place| place.position),
    }
}

fn device(segment: &Segment, found: &SubDevice, objects: bool) -> Device {
    let header = &found.sii.header;
    Device {
        position: found.position,
        station_address: found.station.0,
        name: found.name.clone(),
        order: found.sii.order.clone(),
        vendor_id: found.identity.vendor,
        product_code: found.identity.product,
        revision: found.identity.revision,
        serial: found.identity.serial,
        alias: found.observed.alias,
        sii_alias: alias(found),
        esc: esc::esc(found),
        ports: PortNumber::ALL.into_iter().map(|port| self::port(segment, found, port)).collect(),
        parent: found.parent.map(|(parent, _)| parent),
        parent_port: found.parent.map(|(_, port)| port.index()),
        delay: self::delay(segment, found),
        clock: clock(found),
        sync_managers: sync_managers(found),
        mailbox: found.has_mailbox().then(|| Mailbox {
            receive_start: header.receive.start,
            receive_length: header.receive.length,
            send_start: header.send.start,
            send_length: header.send.length,
            protocols: esc::protocols(header),
            coe_details: if found.has_coe() {
                esc::coe_details(found.sii.coe_details)
            } else {
                Vec::new()
            },
        }),
        outputs: process_data(&found.outputs, objects && found.has_coe()),
        inputs: process_data(&found.inputs, objects && found.has_coe()),
        output_sync: sync_object(found, OUTPUT_PARAMETER, found.output_sync.as_ref()),
        input_sync: sync_object(found, INPUT_PARAMETER, found.input_sync.as_ref()),
        op_modes: found.sii.operation_modes.iter().map(op_mode).collect(),
        state_before: found.observed.state_before.map(|(status, code)| state(status, code)),
        state: state(found.al_status, found.al_code),
    }
}

fn port(segment: &Segment, found: &SubDevice, port: PortNumber) -> Port {
    let status = found.dl_status;
    let hangs = |other: &SubDevice| other.parent == Some((found.position, port));
    Port {
        port: port.index(),
        kind: PortKind::of(found.esc.ports, port),
        link: status.link(port),
        loop_closed: status.loop_closed(port),
        signal: status.communication(port),
        entry: found.entry == port,
        leads_to: segment.devices.iter().position(hangs),
    }
}

fn delay(segment: &Segment, found: &SubDevice) -> Delay {
    let known = |device: &SubDevice| match device.measured_delay {
        Some(Measured::Known { delay, .. }) => Some(delay),
        _ => None,
    };
    let above = found.parent.and_then(|(above, _)| known(segment.devices.get(above)?));
    let mut delay = Delay {
        ns: None,
        error_ns: found.measured_delay.and_then(|delay| delay.bar()).map(ns),
        standard_error_ns: None,
        systematic_ns: None,
        unknown: None,
        least_ns: None,
        most_ns: None,
        written_ns: found.delay.map(|delay| delay.0).filter(|_| found.dc.has_clock()),
        from_parent_ns: known(found).zip(above).map(|(own, above)| ns(own - above)),
        spread_ns: found.delay_spread.map(|spread| spread.0),
        latches_left_out: found.delay_latches_left_out,
    };
    match found.measured_delay {
        Some(Measured::Known { delay: own, standard_error, systematic }) => {
            delay.ns = Some(ns(own));
            delay.standard_error_ns = Some(ns(standard_error));
            delay.systematic_ns = Some(ns(systematic));
        }
        Some(Measured::Indeterminate { why, between }) => {
            delay.unknown = Some(delay::Why::to_string(&why));
            delay.least_ns = between.map(|(least, _)| ns(least));
            delay.most_ns = between.map(|(_, most)| ns(most));
        }
        None => {}
    }
    delay
}

fn clock(found: &SubDevice) -> Clock {
    let speed = found.observed.speed;
    let ppm = |ppb: i64| ppb as f64 / 1_000.0;
    Clock {
        speed_ppm: speed.map(|speed| ppm(speed.ppb)),
        speed_error_ppm: speed.map(|speed| ppm(speed.error_ppb)),
        speed_window_ns: speed.map(|speed| speed.window.0),
        correction: found.observed.correction.map(|(_, difference)| difference),
        correction_start: found.observed.correction.map(|(start, _)| start),
        system_time_difference_ns: found.difference.map(|difference| difference.0),
    }
}

fn sync_managers(found: &SubDevice) -> Vec<SyncManager> {
    let kinds = &found.sm_types;
    let records = found.sii.sync_managers.iter().enumerate();
    records
        .map(|(number, record)| SyncManager {
            number,
            start: record.start,
            length: record.length,
            control: record.control,
            control_in_words: esc::control(record.control),
            enabled: record.enable & SmRecord::ENABLED != 0,
            window: record.is_window(),
            use_in_sii: esc::sync_manager_use(record.kind),
            use_in_object: kinds.get(number).map(|kind| esc::sync_manager_use(*kind)),
        })
        .collect()
}

fn process_data(data: &segment::ProcessData, by_objects: bool) -> ProcessData {
    let entry = |entry: &segment::PdoEntry| PdoEntry {
        index: entry.index,
        sub: entry.sub,
        bits: entry.bits,
    };
    let pdo = |pdo: &segment::Pdo| Pdo {
        index: pdo.index,
        bits: pdo.bits(),
        entries: pdo.entries.iter().map(entry).collect(),
    };
    let guarded = |guarded: &segment::Guarded| Guarded {
        sync_manager: guarded.sync_manager,
        start: guarded.start,
        length: guarded.length,
        window: guarded.window,
    };
    ProcessData {
        source: if by_objects { "objects" } else { "SII" }.to_owned(),
        sync_manager: data.sync_manager,
        window: data.window,
        start: data.start,
        length: data.length,
        further: data.further.iter().map(guarded).collect(),
        pdos: data.pdos.iter().map(pdo).collect(),
    }
}

fn op_mode(mode: &segment::OperationMode) -> OpMode {
    let word = AssignActivate(mode.assign_activate);
    OpMode {
        assign_activate: mode.assign_activate,
        in_words: assign_activate::explain(word).means.to_owned(),
        sync0_cycle_ns: mode.cycle_time_0,
        sync0_factor: mode.sync0_factor,
        sync0_shift_ns: mode.shift_time_0,
        sync1_factor: mode.sync1_factor,
        sync1_shift_ns: mode.shift_time_1,
    }
}

fn state(status: AlStatus, code: AlStatusCode) -> State {
    State {
        al_status: status.to_string(),
        al_status_code: code.0,
        al_status_code_name: code.meaning().unwrap_or("a code of the vendor").to_owned(),
    }
}

/// A time in ns, exact to the picosecond.
fn ns(time: Picos) -> f64 {
    time.0 as f64 / 1_000.0
}
