//! A line of SubDevices with 256 bytes each way, five to a frame, that count what they do.

use std::sync::Arc;

use isocat_esc::LAN9252;
use isocat_maindevice::{AssumedTimes, Config, DeviceConfig};
use isocat_sim::{Cable, ClockModel, Connection, CpuModel, DeviceSetup};
use isocat_subdevice::Application;
use isocat_subdevice::description::{Behaviour, Description, ProcessDataArea};
use isocat_sync::SyncMode;
use isocat_wire::PortNumber;
use isocat_wire::sii::{Header, PdoEntryRecord, PdoRecord, SmRecord, Writer, category, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Nanos, Time};

/// SubDevices that share a frame.
pub const IN_A_FRAME: usize = 5;

const BYTES: u16 = 256;
const OUTPUTS_AT: u16 = 0x1000;
const INPUTS_AT: u16 = 0x1800;

/// A device without mailbox and dictionary.
static DESCRIPTION: Description = Description {
    objects: &[],
    mailbox: None,
    outputs: ProcessDataArea { sync_manager: 2, start: OUTPUTS_AT, max_length: BYTES },
    inputs: ProcessDataArea { sync_manager: 3, start: INPUTS_AT, max_length: BYTES },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// What the device does: its inputs are how often it has latched them, and the first of its
/// outputs.
#[derive(Default)]
struct Counter {
    latched: u64,
    outputs: [u8; 8],
}

impl Application for Counter {
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.outputs.copy_from_slice(&outputs[..8]);
    }

    fn latch_inputs(&mut self) {
        self.latched += 1;
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        inputs[..8].copy_from_slice(&self.latched.to_le_bytes());
        inputs[8..16].copy_from_slice(&self.outputs);
        // The first and the last byte are of one moment.
        inputs[255] = self.latched as u8;
    }
}

/// The intent: DC SYNC0 everywhere. The last `slow` of `count` devices have a cycle of `every` bus
/// cycles.
pub fn config(cycle: Nanos, count: usize, slow: usize, every: i64) -> Config {
    let mut config = Config::new(cycle);
    config.drift_threshold = Nanos(300);
    let time = Some(Nanos(20_000));
    let assumed = AssumedTimes {
        outputs_calc_and_copy: time,
        inputs_calc_and_copy: time,
        ..AssumedTimes::default()
    };
    let device = DeviceConfig { mode: Some(SyncMode::DcSync0), assumed, ..DeviceConfig::default() };
    config.devices = vec![device; count];
    for device in &mut config.devices[count - slow..] {
        device.cycle = Some(Nanos(cycle.0 * every));
    }
    config
}

/// The line itself. Clocks deviate by up to 20 ppm.
pub fn connections(count: usize) -> Vec<Connection> {
    let sii: Arc<[u8]> = sii().into();
    let device = |position: usize| DeviceSetup {
        chip: LAN9252,
        sii: sii.clone(),
        description: DESCRIPTION.clone(),
        application: Box::new(Counter::default()),
        cpu: CpuModel::default(),
        clock: ClockModel::constant(((position as i64 * 7919 + 20) % 41 - 20) * 1000),
        local_time: Time::ZERO,
        sampling: None,
    };
    (0..count)
        .map(|position| {
            let parent = position.checked_sub(1).map(|parent| (parent, PortNumber::P1));
            Connection::new(parent, Cable::of_length(1_000), device(position))
        })
        .collect()
}

fn sii() -> Vec<u8> {
    let mut image = vec![0; 1024];
    // SPI; SYNC unit on; SYNC0 pulses of 1 us.
    let configuration = [0x05, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let header =
        Header { configuration, vendor_id: 1, product_code: 1, size: 7, ..Header::default() };
    let mut writer = Writer::new(&mut image, &header).expect("room for the header");
    let manager = |start, length, control, kind| SmRecord {
        start,
        length,
        control,
        status: 0,
        enable: 1,
        kind,
    };
    let unused = manager(0, 0, 0, sm_type::UNUSED);
    let managers: Vec<u8> = [
        unused,
        unused,
        manager(OUTPUTS_AT, BYTES, SyncManager::OUTPUTS, sm_type::OUTPUTS),
        manager(INPUTS_AT, BYTES, SyncManager::INPUTS, sm_type::INPUTS),
    ]
    .iter()
    .flat_map(SmRecord::emit)
    .collect();
    writer.category(category::SYNC_MANAGER, &managers).expect("room");
    let entries = (BYTES / 8) as u8;
    for (kind, index, sm) in [(category::TX_PDO, 0x1A00, 3), (category::RX_PDO, 0x1600, 2)] {
        let head = PdoRecord { index, entries, sm, sync_unit: 0, name: 0, flags: 0x11 };
        let mut data = head.emit().to_vec();
        for sub in 1..=entries {
            let object = if sm == 3 { 0x6000 } else { 0x7000 };
            let entry =
                PdoEntryRecord { index: object, sub, name: 0, data_type: 0x1B, bits: 64, flags: 0 };
            data.extend(entry.emit());
        }
        writer.category(kind, &data).expect("room");
    }
    writer.finish().expect("room for the end mark");
    image
}
