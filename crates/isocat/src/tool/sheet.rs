//! The data of a plan for any other tool: numbers, each with its reason.

use isocat_descriptions::start_up::{
    Address, DeviceStartUp, ObjectStep, ParameterStep, Transition,
};
use isocat_engine::plan::report::{self, Line, Term};
use isocat_engine::plan::{Plan, PlanReport};
use isocat_maindevice::segment::{Guarded, Pdo, ProcessData};
use isocat_segment::Scenario;
use isocat_sync::SyncMode;
use isocat_sync::budget::Check;
use isocat_sync::object::{INPUT_ASSIGNMENT, OUTPUT_ASSIGNMENT, SyncType};
use isocat_wire::dc::AssignActivate;
use isocat_wire::{Nanos, register};

/// A segment. All times are nanoseconds.
#[derive(Clone, PartialEq, Debug)]
pub struct Sheet {
    /// File with the description of the segment.
    pub source: String,
    /// The verdict on the plan, in one sentence.
    pub verdict: String,
    /// Figures in use that no source states.
    pub assumptions: Vec<String>,
    /// Known pitfalls of such a segment in practice.
    pub notes: Vec<String>,
    /// Bus cycle.
    pub cycle_ns: i64,
    /// Why this cycle is long enough.
    pub why_cycle: String,
    /// Phase of the frame in the cycle of system time.
    pub send_phase_ns: i64,
    /// Largest lateness of a frame.
    pub send_jitter_ns: i64,
    /// Position of the SubDevice whose clock leads; `None` without clocks.
    pub reference: Option<usize>,
    /// Bytes of the process image.
    pub image_bytes: u32,
    /// The SubDevices, by position.
    pub devices: Vec<Device>,
}

/// A SubDevice.
#[derive(Clone, PartialEq, Debug)]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// Vendor id.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision.
    pub revision: u32,
    /// Synchronization mode.
    pub mode: SyncMode,
    /// The mode, and why no higher one is used.
    pub why_mode: String,
    /// Whether its ESC has a DC clock.
    pub clock: bool,
    /// The SYNC unit; `None` if the plan leaves it off.
    pub unit: Option<Unit>,
    /// Process data, outputs first; without those of length 0.
    pub channels: Vec<Channel>,
    /// SDO downloads in the order of the plan, including PDO assignments.
    pub objects: Vec<Object>,
    /// Parameters of its drives that SoE writes, in order.
    pub drives: Vec<ParameterStep>,
    /// Registers of the watchdogs; `None` if they stay as after power-on.
    pub watchdog: Option<Watchdog>,
    /// Its process data are exchanged in every n-th bus cycle.
    pub every: u32,
    /// Doubts about its description, and warnings of the plan about it.
    pub notes: Vec<String>,
}

/// The SYNC unit of a SubDevice.
#[derive(Clone, PartialEq, Debug)]
pub struct Unit {
    /// AssignActivate: registers 0x0980 and 0x0981.
    pub word: AssignActivate,
    /// Why this word.
    pub why_word: String,
    /// Register 0x09A0; 0 if the unit makes no pulse.
    pub sync0_ns: u32,
    /// Why this cycle.
    pub why_sync0: String,
    /// Register 0x09A4: time from SYNC0 to SYNC1; 0 without SYNC1.
    pub sync1_ns: u32,
    /// Why this distance; empty without SYNC1.
    pub why_sync1: String,
    /// Phase of SYNC0 in the cycle of system time.
    pub phase_ns: i64,
    /// Why this phase.
    pub why_phase: String,
}

/// Process data of one direction.
#[derive(Clone, PartialEq, Debug)]
pub struct Channel {
    /// Whether the MainDevice writes it.
    pub outputs: bool,
    /// Number of its SyncManager.
    pub sync_manager: u8,
    /// Whether the SyncManager triggers the watchdog.
    pub watchdog: bool,
    /// Bytes.
    pub bytes: u16,
    /// The assigned PDOs with their entries, in order.
    pub pdos: Vec<Pdo>,
}

/// An SDO download.
#[derive(Clone, PartialEq, Debug)]
pub struct Object {
    /// The download.
    pub step: ObjectStep,
    /// Its purpose, with the value in words.
    pub why: String,
}

impl Sheet {
    /// Collects the data of a plan.
    pub fn of(plan: &Plan, scenario: &Scenario) -> Self {
        let (report, list) = (plan.report(scenario), plan.start_up(scenario));
        let device = |(of_report, of_list)| device(plan, &report, of_report, of_list);
        Self {
            source: report.segment_file.clone(),
            verdict: report.verdict.clone(),
            assumptions: report.assumptions.clone(),
            notes: warnings(&report, None),
            cycle_ns: report.segment.cycle_ns,
            why_cycle: why(&report.frames_line),
            send_phase_ns: report.segment.send_phase_ns,
            send_jitter_ns: report.segment.send_jitter_ns,
            reference: report.segment.reference,
            image_bytes: list.output_bytes.max(list.input_bytes),
            devices: report.devices.iter().zip(&list.devices).map(device).collect(),
        }
    }

    /// The SubDevices that get pulses, with their units.
    pub fn with_pulses(&self) -> impl Iterator<Item = (&Device, &Unit)> {
        let units = self.devices.iter().filter_map(|device| Some((device, device.unit.as_ref()?)));
        units.filter(|(_, unit)| unit.sync0_ns > 0)
    }

    /// The SubDevices whose unit is on without a pulse.
    pub fn without_pulses(&self) -> impl Iterator<Item = (&Device, &Unit)> {
        let units = self.devices.iter().filter_map(|device| Some((device, device.unit.as_ref()?)));
        units.filter(|(_, unit)| unit.sync0_ns == 0)
    }

    /// The limit for a tool whose reference clock is always the first one; `None` if that agrees
    /// with the plan.
    pub(super) fn reference_not_first(&self) -> Option<String> {
        let first = self.devices.iter().position(|device| device.clock);
        let wanted = self.reference.filter(|wanted| Some(*wanted) != first)?;
        let name = &self.devices.get(wanted)?.name;
        Some(format!(
            "the reference clock can't be chosen: the first device with a clock leads. The plan \
                counts with \
             SubDevice {wanted} ({name}); plan again without that wish."
        ))
    }

    /// The limits of IgH's master about the watchdogs.
    pub(super) fn watchdogs_at_igh(&self) -> Vec<String> {
        let of = |device: &Device| {
            let watchdog = device.watchdog?;
            let pdi = watchdog.pdi.map(|steps| {
                format!("the watchdog of the PDI (0x0410, {steps} steps) can't be set: the chip's own stays.")
            });
            let off =
                watchdog.registers().any(|(_, register, value)| register != 0x0410 && value == 0);
            let off = off.then(|| {
                "a watchdog's register of 0 is not written: the chip's own value stays.".to_owned()
            });
            let place = format!("SubDevice {} ({}): ", device.position, device.name);
            Some(pdi.into_iter().chain(off).map(move |text| format!("{place}{text}")))
        };
        self.devices.iter().filter_map(of).flatten().collect()
    }

    /// Whether a download has another transition than the one in which most tools make all of them.
    pub(super) fn has_unusual_transitions(&self) -> bool {
        let unusual = |object: &Object| object.unusual_transition().is_some();
        self.devices.iter().any(|device| device.objects.iter().any(unusual))
    }

    /// A line for each SubDevice that is not exchanged in each cycle; `which` is the tool's
    /// behaviour.
    pub fn slower(&self, which: &str) -> Vec<String> {
        let slower = self.devices.iter().filter(|device| device.every > 1);
        let line = |device: &Device| {
            let Device { position, name, every, .. } = device;
            format!(
                "SubDevice {position} ({name}) is exchanged in every {every} cycles by the plan; \
                    {which}."
            )
        };
        slower.map(line).collect()
    }
}

impl Device {
    /// SDO downloads except those that assign PDOs, for tools that have a separate list for these.
    pub fn parameters(&self) -> impl Iterator<Item = &Object> {
        self.objects.iter().filter(|object| !object.assigns())
    }

    /// A note on the parameters of drives, which no tool gets. `None` for a device without.
    pub fn drives_left_out(&self) -> Option<String> {
        let of = |step: &ParameterStep| {
            let data: String = step.data.iter().map(|byte| format!("{byte:02x}")).collect();
            format!("{} of drive {} = {data}", step.idn, step.drive)
        };
        let all: Vec<_> = self.drives.iter().map(of).collect();
        (!all.is_empty()).then(|| {
            format!(
                "parameters of drives (SoE) are not part of this output; they have to be written in PREOP beside it: {}.",
                all.join(", ")
            )
        })
    }

    /// Bytes of its outputs and of its inputs.
    pub fn bytes(&self) -> [u16; 2] {
        [true, false].map(|outputs| {
            let of = self.channels.iter().filter(|channel| channel.outputs == outputs);
            of.map(|channel| channel.bytes).sum()
        })
    }
}

impl Object {
    /// Whether it assigns PDOs to SM2 or SM3.
    pub fn assigns(&self) -> bool {
        [OUTPUT_ASSIGNMENT, INPUT_ASSIGNMENT].contains(&self.step.object.index)
    }

    /// The transition, if it is not the usual one, PREOP to SAFEOP.
    pub fn unusual_transition(&self) -> Option<String> {
        let usual = self.step.transitions.contains(&Transition::PS);
        let letters: Vec<_> = self.step.transitions.iter().map(ToString::to_string).collect();
        (!usual).then(|| letters.join(", "))
    }

    /// Its value as a number, if it has 1, 2, 4 or 8 bytes.
    pub fn number(&self) -> Option<u64> {
        let mut bytes = [0; 8];
        let data = &self.step.data;
        matches!(data.len(), 1 | 2 | 4 | 8).then(|| bytes[..data.len()].copy_from_slice(data))?;
        Some(u64::from_le_bytes(bytes))
    }
}

fn device(plan: &Plan, report: &PlanReport, of: &report::Device, list: &DeviceStartUp) -> Device {
    let found = &plan.segment.devices[of.position];
    let reason = match of.mode_reason.as_str() {
        "" => "as it is wished, or the highest that the device has",
        reason => reason,
    };
    let channels = |outputs, data: &ProcessData| -> Vec<Channel> {
        let channel = |(guarded, pdos): (Guarded, &[Pdo])| {
            let number = guarded.sync_manager;
            let mut managers = list.sync_managers.iter();
            let control = managers.find(|manager| manager.number == number)?.control;
            (guarded.length > 0).then(|| Channel {
                outputs,
                sync_manager: number,
                watchdog: control & isocat_wire::sync_manager::SyncManager::CONTROL_WATCHDOG != 0,
                bytes: guarded.length,
                pdos: pdos.to_vec(),
            })
        };
        data.assigned().filter_map(channel).collect()
    };
    let mut notes: Vec<_> = list.notes.clone();
    notes.extend(warnings(report, Some(of.position)));
    Device {
        position: of.position,
        name: of.name.clone(),
        vendor: list.vendor,
        product: list.product,
        revision: list.revision,
        mode: of.mode,
        why_mode: format!("mode {}, {reason}", of.mode),
        clock: list.dc.is_some(),
        unit: unit(report, of, list),
        channels: [channels(true, &found.outputs), channels(false, &found.inputs)].concat(),
        objects: list.objects.iter().map(object).collect(),
        drives: list.parameters.clone(),
        watchdog: watchdog(list),
        every: of.every,
        notes,
    }
}

fn watchdog(list: &DeviceStartUp) -> Option<Watchdog> {
    let word = |register: isocat_wire::Register<u16>| {
        Some(u16::from_le_bytes(*written(list, register.address)?.first_chunk()?))
    };
    let found = [
        register::WATCHDOG_DIVIDER,
        register::WATCHDOG_TIME_PDI,
        register::WATCHDOG_TIME_PROCESS_DATA,
    ]
    .map(word);
    let [divider, pdi, process_data] = found;
    found.iter().any(Option::is_some).then_some(Watchdog { divider, pdi, process_data })
}

/// Registers of the watchdogs; `None` for one that stays as after power-on.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Watchdog {
    divider: Option<u16>,
    pdi: Option<u16>,
    process_data: Option<u16>,
}

impl Watchdog {
    /// Register 0x0400.
    pub fn divider(self) -> u16 {
        self.divider.unwrap_or(2498)
    }

    /// Register 0x0420.
    pub fn steps(self) -> u16 {
        self.process_data.unwrap_or(1000)
    }

    /// Whether what is written is about the process data.
    pub fn is_of_process_data(self) -> bool {
        self.divider.or(self.process_data).is_some()
    }

    /// The time of the process data, ns.
    pub fn time_ns(self) -> i64 {
        (i64::from(self.divider()) + 2) * 40 * i64::from(self.steps())
    }

    /// What is written: the meaning, address and value of each.
    pub fn registers(self) -> impl Iterator<Item = (&'static str, u16, u16)> {
        [
            ("Unit of the watchdogs, less 2, in 40 ns.", 0x0400, self.divider),
            ("Watchdog of the PDI, in these units.", 0x0410, self.pdi),
            ("Watchdog of the process data, in units of 0x0400.", 0x0420, self.process_data),
        ]
        .into_iter()
        .filter_map(|(what, register, value)| Some((what, register, value?)))
    }
}

/// The last value that the way up writes to this register on the way to SAFEOP.
fn written(list: &DeviceStartUp, wanted: u16) -> Option<&[u8]> {
    let at = |step: &&isocat_descriptions::start_up::RegisterStep| {
        let here = matches!(step.address, Address::Physical { register, .. } if register == wanted);
        here && step.transitions.contains(&Transition::PS)
    };
    list.registers.iter().rev().find(at).map(|step| &step.data[..])
}

fn unit(report: &PlanReport, of: &report::Device, list: &DeviceStartUp) -> Option<Unit> {
    let activation = || {
        let data = written(list, register::SYNC_ACTIVATION.address)?;
        Some(AssignActivate(u16::from_le_bytes([0, *data.first()?])))
    };
    let of_description = list.assign_activate();
    let word = of_description.or_else(activation).filter(|word| *word != AssignActivate::OFF)?;
    let why_word = match of_description {
        Some(_) => format!("the word of the device's description, as mode {} needs it", of.mode),
        None => format!("the pulses of mode {}, with all units at the MainDevice", of.mode),
    };
    let dc = list.dc.unwrap_or_default();
    let line = |check| of.lines.iter().find(|line| line.check == check).map(why);
    let sync1 = [Check::Sync1CoversCopy, Check::Sync1BeforeNextSync0].into_iter().filter_map(line);
    Some(Unit {
        word,
        why_word,
        sync0_ns: dc.sync0_ns,
        why_sync0: line(Check::MinimumCycle).unwrap_or_else(|| "from the bus cycle".into()),
        sync1_ns: dc.sync1_ns,
        why_sync1: match dc.sync1_ns {
            0 => String::new(),
            _ => std::iter::once(format!("mode {}", of.mode))
                .chain(sync1)
                .collect::<Vec<_>>()
                .join("; "),
        },
        phase_ns: of.sync0_phase_ns.unwrap_or(0),
        why_phase: why_phase(report, of),
    })
}

/// The allowed phases of the acting pulse, for this device and for all.
fn why_phase(report: &PlanReport, of: &report::Device) -> String {
    let send =
        format!("the frame is at the reference clock at {}", Nanos(report.segment.send_phase_ns));
    let acting = report.segment.acting_phase_ns.map(|phase| {
        format!("the pulse that acts lies at {} in all devices with DC", Nanos(phase))
    });
    let ready = of.earliest_phase_ns.map(|phase| format!("outputs are ready at {}", Nanos(phase)));
    let late =
        of.latest_phase_ns.map(|phase| format!("inputs are too late from {} on", Nanos(phase)));
    let parts = [Some(send), acting, ready, late].into_iter().flatten();
    parts.collect::<Vec<_>>().join(", ")
}

/// A line of the budget, with its figures and their sources.
fn why(line: &Line) -> String {
    let sum = |terms: &[Term]| {
        let term =
            |term: &Term| format!("{} {} [{}]", term.what, Nanos(term.value_ns), term.origin);
        terms.iter().map(term).collect::<Vec<_>>().join(" + ")
    };
    let object = line.object.as_ref().map_or(String::new(), |object| format!("{object}: "));
    let (needed, available) = (sum(&line.needed), sum(&line.available));
    format!("{object}{needed} <= {available}, slack {}", Nanos(line.slack_ns))
}

fn object(step: &ObjectStep) -> Object {
    let of_type = |data: &[u8]| Some(SyncType(u16::from_le_bytes(data.try_into().ok()?)));
    let of_time = |data: &[u8]| Some(Nanos(i64::from(u32::from_le_bytes(data.try_into().ok()?))));
    let meaning = match (step.object.index, step.object.sub) {
        (0x1C32 | 0x1C33, 1) => of_type(&step.data).map(|kind| kind.to_string()),
        (OUTPUT_ASSIGNMENT | INPUT_ASSIGNMENT, 1..) => {
            step.data.first_chunk().map(|data| format!("0x{:04X}", u16::from_le_bytes(*data)))
        }
        (OUTPUT_ASSIGNMENT | INPUT_ASSIGNMENT, 0) => {
            step.data.first().map(|count| format!("count {count}"))
        }
        (0x1C32 | 0x1C33, 2 | 3 | 10) => of_time(&step.data).map(|time| time.to_string()),
        _ => None,
    };
    let meaning = meaning.map_or(String::new(), |meaning| format!(": {meaning}"));
    Object { step: step.clone(), why: format!("{}{meaning}", step.comment) }
}

/// The warnings of the plan about one device, or about the segment (`None`).
fn warnings(report: &PlanReport, position: Option<usize>) -> Vec<String> {
    let of = report.warnings.iter().filter(|note| note.position == position);
    of.map(|note| note.what.clone()).collect()
}
