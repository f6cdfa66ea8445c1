//! The start-up list of a plan: what the run will write, made by the code that writes it.

use isocat_descriptions::start_up::{
    Address, Area, CyclicDatagram, CyclicFrame, Dc, DeviceStartUp, ImageBits, Mailbox, ObjectStep,
    ParameterStep, Parent, ProcessSyncManager, RegisterStep, StartUp, Transition,
};
use isocat_esc::chip::PortKind;
use isocat_maindevice::plan::{Target, Write, Writes, writes};
use isocat_maindevice::segment::{ProcessData, SubDevice};
use isocat_segment::Scenario;
use isocat_segment::offline;
use isocat_segment::profile::{Profile, Startup, StartupParameter};
use isocat_sync::object::{INPUT_ASSIGNMENT, OUTPUT_ASSIGNMENT};
use isocat_wire::PortNumber;
use isocat_wire::al::AlState;
use isocat_wire::datagram;
use isocat_wire::register::{self, Register, Value};
use isocat_wire::sync_manager::SyncManager;

use super::Plan;

impl Plan {
    /// The writes to a SubDevice on the way up.
    pub fn writes(&self, scenario: &Scenario, position: usize) -> Writes {
        let profile = &scenario.devices[position].profile;
        let assigned = [OUTPUT_ASSIGNMENT, INPUT_ASSIGNMENT]
            .map(|index| offline::list(profile, index).into_iter().map(|pdo| pdo as u16).collect());
        let [outputs, inputs]: [Vec<u16>; 2] = assigned;
        writes(&self.segment, &self.config, position, [&outputs, &inputs])
    }

    /// The whole list, in the shape of a network description.
    pub fn start_up(&self, scenario: &Scenario) -> StartUp {
        let image = &self.segment.image;
        let bytes: u32 = image.chunks.iter().map(|chunk| u32::from(chunk.length)).sum();
        let off = "SYNC off, whatever ran before";
        let devices = 0..self.segment.devices.len();
        StartUp {
            name: scenario.source.clone(),
            cycle_ns: scenario.cycle.0,
            before: vec![RegisterStep::bwr(
                &[Transition::IP],
                register::SYNC_ACTIVATION.address,
                vec![0],
                off,
            )],
            devices: devices.map(|at| self.device_start_up(scenario, at)).collect(),
            after: Vec::new(),
            frames: self.cyclic_frames(),
            input_bytes: bytes,
            output_bytes: bytes,
            notes: vec![
                "offsets (0x0920), delays (0x0928) and start times (0x0990) are zeros here: the run measures them"
                    .into(),
            ],
        }
    }

    fn device_start_up(&self, scenario: &Scenario, position: usize) -> DeviceStartUp {
        let device = &self.segment.devices[position];
        let timeouts = &self.config.timeouts;
        let (ip, ps, so) = ([Transition::IP], [Transition::PS], [Transition::SO]);
        let writes = self.writes(scenario, position);
        let address = register::STATION_ADDRESS.address;
        let station = device.station.0.to_bytes().to_vec();
        let position16 = u16::try_from(position).unwrap_or(u16::MAX);
        let mut registers =
            vec![RegisterStep::apwr(&ip, position16, address, station, "station address")];
        let profile = &scenario.devices[position].profile;
        // The first writes in PREOP are those of the description, here with their own transitions.
        let mut of_description = if device.has_coe() { &profile.startup[..] } else { &[] };
        let values = self.config.devices.get(position).map(|wish| &wish.startup[..]);
        let written = of_description.iter().zip(values.unwrap_or_default());
        let mut objects: Vec<_> = written.map(|(wanted, value)| download(wanted, value)).collect();
        for (transition, list) in [(&ip, &writes.to_preop), (&ps, &writes.to_safeop)] {
            for write in list {
                let Write { target, comment, .. } = write;
                let data = write.data.clone().unwrap_or_else(|| zeros(*target));
                match *target {
                    Target::Register(register) => registers.push(RegisterStep::fpwr(
                        transition,
                        device.station,
                        register,
                        data,
                        *comment,
                    )),
                    Target::Object(_) if !of_description.is_empty() => {
                        of_description = &of_description[1..];
                    }
                    Target::Object(object) => {
                        objects.push(ObjectStep::new(transition, object, data, *comment));
                    }
                    // They follow below, with their own transitions.
                    Target::Parameter(..) => {}
                }
            }
        }
        for (transition, state, patience) in [
            (&ip, AlState::PreOp, timeouts.preop),
            (&ps, AlState::SafeOp, timeouts.safeop),
            (&so, AlState::Op, timeouts.op),
        ] {
            registers.extend(RegisterStep::state(transition, device.station, state, patience));
        }
        DeviceStartUp {
            name: device.name.clone(),
            station: device.station.0,
            vendor: device.identity.vendor,
            product: device.identity.product,
            revision: device.identity.revision,
            serial: device.identity.serial,
            physics: physics(scenario, position),
            parent: device.parent.map(|(parent, port)| Parent {
                station: self.segment.devices[parent].station.0,
                port: port.index() as u8,
            }),
            mailbox: device.has_mailbox().then(|| {
                let header = &device.sii.header;
                let area = |area: isocat_wire::sii::MailboxArea| Area {
                    start: area.start,
                    length: area.length,
                };
                let (out, back) = (area(header.receive), area(header.send));
                Mailbox { out, back, coe: device.has_coe(), soe: device.has_soe() }
            }),
            sync_managers: [(true, &device.outputs), (false, &device.inputs)]
                .into_iter()
                .flat_map(|(outputs, data)| sync_managers(device, outputs, data))
                .collect(),
            outputs: bits(&device.outputs),
            inputs: bits(&device.inputs),
            registers,
            objects,
            parameters: self.parameters(profile, position),
            dc: self.dc(position),
            notes: profile.doubts.iter().map(|doubt| doubt.what.clone()).collect(),
        }
    }

    /// SoE writes: the values of the run, at the transitions of the description.
    fn parameters(&self, profile: &Profile, position: usize) -> Vec<ParameterStep> {
        let values = self.config.devices.get(position).map(|wish| &wish.parameters[..]);
        let written = profile.parameters.iter().zip(values.unwrap_or_default());
        let step = |(wanted, value): (&StartupParameter, &isocat_maindevice::StartupParameter)| {
            let what = match wanted.comment.as_str() {
                "" => "InitCmd of the description",
                comment => comment,
            };
            let cycle = if value.data == wanted.data { "" } else { "; the bus cycle, us" };
            ParameterStep {
                transitions: vec![wanted.transition],
                drive: value.drive,
                idn: value.idn,
                data: value.data.clone(),
                patience_ms: 0,
                comment: format!("{what}{cycle}"),
            }
        };
        written.map(step).collect()
    }

    fn dc(&self, position: usize) -> Option<Dc> {
        let device = &self.segment.devices[position];
        let planned = &self.timing().devices[position].0;
        let narrow = |ns: i64| u32::try_from(ns).unwrap_or(u32::MAX);
        device.dc.has_clock().then(|| Dc {
            reference: self.segment.reference == Some(position),
            sync0_ns: narrow(planned.pulses.sync0_cycle.0),
            sync1_ns: narrow(planned.pulses.sync1.0),
            shift_ns: match self.timing().sync0.filter(|_| planned.mode.uses_dc()) {
                Some(shift) => i32::try_from(planned.sync0_phase(shift).0).unwrap_or(i32::MAX),
                None => 0,
            },
        })
    }

    fn cyclic_frames(&self) -> Vec<CyclicFrame> {
        use isocat_wire::Command;
        let image = &self.segment.image;
        let datagram = |part: &isocat_maindevice::segment::DatagramPlan| {
            let chunk = part.chunk.and_then(|chunk| image.chunks.get(chunk));
            let counter = chunk.map(|chunk| match part.command {
                Command::Lrw => 2 * chunk.writers + chunk.readers,
                Command::Lwr => chunk.writers,
                _ => chunk.readers,
            });
            let at = chunk.map_or(0, |chunk| chunk.logical);
            CyclicDatagram {
                command: part.command,
                address: match part.address {
                    datagram::Address::Logical(logical) => Address::Logical(logical),
                    datagram::Address::Station(station, register) => {
                        Address::Physical { device: station.0, register }
                    }
                    datagram::Address::Position(position, register) => {
                        Address::Physical { device: position.0, register }
                    }
                    datagram::Address::Broadcast(register) => {
                        Address::Physical { device: 0, register }
                    }
                },
                length: u16::try_from(part.length).unwrap_or(u16::MAX),
                states: match chunk {
                    Some(_) => vec![AlState::SafeOp, AlState::Op],
                    None => vec![AlState::PreOp, AlState::SafeOp, AlState::Op],
                },
                working_counter: counter,
                input_offset: at,
                output_offset: at,
                comment: match (chunk, part.command) {
                    (Some(_), _) => "process data",
                    (None, Command::Brd) => "AL status of all",
                    (None, _) => "system time",
                }
                .into(),
            }
        };
        let frame = |frame: &isocat_maindevice::segment::FramePlan| CyclicFrame {
            every: frame.every,
            datagrams: frame.datagrams.iter().map(datagram).collect(),
        };
        self.timing().frames.iter().map(frame).collect()
    }
}

/// Zeros in the length of a value that only the run knows.
fn zeros(target: Target) -> Vec<u8> {
    let length = match target {
        Target::Register(address) if address == register::SYSTEM_TIME_DELAY.address => {
            Register::<u32>::LEN
        }
        _ => Register::<u64>::LEN,
    };
    vec![0; length]
}

fn sync_managers(
    device: &SubDevice,
    outputs: bool,
    data: &ProcessData,
) -> impl Iterator<Item = ProcessSyncManager> {
    let usual = if outputs { SyncManager::OUTPUTS } else { SyncManager::INPUTS };
    data.assigned().map(move |(guarded, pdos)| {
        let record = device.sii.sync_managers.get(usize::from(guarded.sync_manager));
        ProcessSyncManager {
            number: guarded.sync_manager,
            outputs,
            start: guarded.start,
            control: record.map_or(usual, |record| record.control),
            enabled: guarded.length > 0 && !guarded.window,
            pdos: pdos.iter().map(|pdo| pdo.index).collect(),
        }
    })
}

fn bits(data: &ProcessData) -> Option<ImageBits> {
    let (start, length) = (8 * data.logical, 8 * u32::from(data.length));
    (length > 0).then_some(ImageBits { start, length })
}

/// A download that the description of the device asks for.
fn download(wanted: &Startup, value: &isocat_maindevice::StartupDownload) -> ObjectStep {
    let comment = match value.data == wanted.data {
        true => "InitCmd of the description",
        false => "InitCmd of the description; the cycle",
    };
    let step = ObjectStep::new(&[wanted.transition], wanted.object, value.data.clone(), comment);
    ObjectStep { complete: wanted.complete_access, ..step }
}

fn physics(scenario: &Scenario, position: usize) -> String {
    let profile = &scenario.devices[position].profile;
    if let Some(letters) = &profile.physics {
        return letters.trim_end().to_owned();
    }
    let chip = profile.esc();
    let kind = |port| match chip.port(port) {
        PortKind::Mii => 'Y',
        PortKind::Ebus => 'K',
        PortKind::None | PortKind::NotConfigured => ' ',
    };
    PortNumber::ALL.into_iter().map(kind).collect::<String>().trim_end().to_owned()
}
