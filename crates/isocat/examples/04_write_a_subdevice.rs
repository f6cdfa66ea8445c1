//! A SubDevice of one's own: a thermostat with a dictionary, an SII and an application, brought
//! into synchronization and judged.
//!
//! The same description and application run on a microcontroller (`firmware/` shows how); here the
//! device stands in a simulated segment, so that every instant of it can be looked at.
//!
//! `cargo run --release -p isocat --example 04_write_a_subdevice`

use isocat_esc::LAN9252;
use isocat_maindevice::{Config, Cycle, DeviceConfig, Event};
use isocat_sim::run::intent;
use isocat_sim::{Cable, ClockModel, Connection, CpuModel, DeviceSetup, HostModel, Setup, World};
use isocat_subdevice::describe::{
    RO, SyncStatement, assignment, end, identity, mapping, object, sync_manager_types,
    sync_parameter, value,
};
use isocat_subdevice::description::{Behaviour, Mailbox, ProcessDataArea, Speaks};
use isocat_subdevice::{Application, Description, Entry, Object, SyncMode};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::{Header, MailboxArea, SmRecord, Writer, category, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Nanos, Picos, Time};

/// What is fixed about the device. Values of the dictionary lie one behind the other: each begins
/// where the one before ends.
static DESCRIPTION: Description = Description {
    objects: &OBJECTS,
    mailbox: Some(Mailbox { receive: RECEIVE, send: SEND, speaks: Speaks::COE }),
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1100, max_length: 4 },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1400, max_length: 4 },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};
const RECEIVE: MailboxArea = MailboxArea { start: 0x1000, length: 64 };
const SEND: MailboxArea = MailboxArea { start: 0x1080, length: 64 };

const OBJECTS: [Object; 11] = [
    object(0x1000, "Device type", ObjectCode::VAR, DataType::UNSIGNED32, &DEVICE_TYPE),
    object(0x1018, "Identity", ObjectCode::RECORD, DataType::IDENTITY, &IDENTITY),
    object(0x1600, "RxPDO", ObjectCode::RECORD, DataType::PDO_MAPPING, &RX_PDO),
    object(0x1A00, "TxPDO", ObjectCode::RECORD, DataType::PDO_MAPPING, &TX_PDO),
    object(0x1C00, "SM types", ObjectCode::ARRAY, DataType::UNSIGNED8, &SM_TYPES),
    object(0x1C12, "RxPDO assign", ObjectCode::ARRAY, DataType::UNSIGNED16, &RX_ASSIGNMENT),
    object(0x1C13, "TxPDO assign", ObjectCode::ARRAY, DataType::UNSIGNED16, &TX_ASSIGNMENT),
    object(0x1C32, "SM output", ObjectCode::RECORD, DataType::SYNC_PAR, &SYNC_OUTPUT),
    object(0x1C33, "SM input", ObjectCode::RECORD, DataType::SYNC_PAR, &SYNC_INPUT),
    object(0x6000, "Temperature, mK", ObjectCode::VAR, DataType::UNSIGNED32, &TEMPERATURE),
    object(0x7000, "Set point, mK", ObjectCode::VAR, DataType::UNSIGNED32, &SET_POINT),
];
const DEVICE_TYPE: [Entry; 1] = value(0, "Device type", DataType::UNSIGNED32, RO, &[]);
const IDENTITY: [Entry; 5] =
    identity(end(&DEVICE_TYPE), &VENDOR.to_le_bytes(), &PRODUCT.to_le_bytes(), &[0; 4], &[0; 4]);
const RX_PDO: [Entry; 2] = mapping(end(&IDENTITY), &0x7000_0020u32.to_le_bytes());
const TX_PDO: [Entry; 2] = mapping(end(&RX_PDO), &0x6000_0020u32.to_le_bytes());
const SM_TYPES: [Entry; 5] = sync_manager_types(end(&TX_PDO));
const RX_ASSIGNMENT: [Entry; 2] = assignment(end(&SM_TYPES), &0x1600u16.to_le_bytes());
const TX_ASSIGNMENT: [Entry; 2] = assignment(end(&RX_ASSIGNMENT), &0x1A00u16.to_le_bytes());
const SYNC_OUTPUT: [Entry; 14] = sync_parameter(end(&TX_ASSIGNMENT), SYNC);
const SYNC_INPUT: [Entry; 14] = sync_parameter(end(&SYNC_OUTPUT), SYNC);
const TEMPERATURE: [Entry; 1] =
    value(end(&SYNC_INPUT), "Temperature", DataType::UNSIGNED32, RO.with(Access::TX_MAPPABLE), &[]);
const SET_POINT: [Entry; 1] =
    value(end(&TEMPERATURE), "Set point", DataType::UNSIGNED32, RO.with(Access::RX_MAPPABLE), &[]);
const VENDOR: u32 = 0xE000_0001;
const PRODUCT: u32 = 7;

/// What 0x1C32 and 0x1C33 state: Free Run, SM-synchronous and DC SYNC0; 250 us at least, 40 us to
/// copy, 10 us from SYNC0 to outputs.
const SYNC: SyncStatement = SyncStatement {
    supported: &[0x07, 0],
    minimum_cycle: &250_000u32.to_le_bytes(),
    calc_and_copy: &40_000u32.to_le_bytes(),
    delay: &10_000u32.to_le_bytes(),
};

/// What the EEPROM holds: who it is, its mailbox, its SyncManagers.
fn sii() -> Vec<u8> {
    let mut image = vec![0; 512];
    // PDI: SPI; the SYNC unit is on; SYNC0 pulses of 1 us.
    let header = Header {
        configuration: [0x05, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        vendor_id: VENDOR,
        product_code: PRODUCT,
        receive: RECEIVE,
        send: SEND,
        protocols: Header::COE,
        size: 3,
        ..Header::default()
    };
    let mut writer = Writer::new(&mut image, &header).expect("room for the header");
    let manager = |area: MailboxArea, control, kind| SmRecord {
        start: area.start,
        length: area.length,
        control,
        status: 0,
        enable: 1,
        kind,
    };
    let data = |area: ProcessDataArea| MailboxArea { start: area.start, length: area.max_length };
    let managers = [
        manager(RECEIVE, SyncManager::MAILBOX_OUT, sm_type::MAILBOX_OUT),
        manager(SEND, SyncManager::MAILBOX_IN, sm_type::MAILBOX_IN),
        manager(data(DESCRIPTION.outputs), SyncManager::OUTPUTS, sm_type::OUTPUTS),
        manager(data(DESCRIPTION.inputs), SyncManager::INPUTS, sm_type::INPUTS),
    ];
    let managers: Vec<u8> = managers.iter().flat_map(SmRecord::emit).collect();
    writer.category(category::SYNC_MANAGER, &managers).expect("room");
    writer.finish().expect("room for the end mark");
    image
}

/// The application: an oven that follows its set point with a time constant of 20 ms.
struct Oven {
    set_point: f64,
    temperature: f64,
}

impl Application for Oven {
    fn map_outputs(&mut self, outputs: &[u8]) {
        let bytes = outputs.first_chunk().copied().unwrap_or_default();
        self.set_point = f64::from(u32::from_le_bytes(bytes));
    }

    fn application(&mut self, cycle: Nanos) {
        self.temperature += (self.set_point - self.temperature) * cycle.0 as f64 / 20e6;
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        inputs.copy_from_slice(&(self.temperature as u32).to_le_bytes());
    }

    fn safe_outputs(&mut self) {
        self.set_point = 293_150.0;
    }
}

fn main() {
    let device = DeviceSetup {
        chip: LAN9252,
        sii: sii().into(),
        description: DESCRIPTION.clone(),
        application: Box::new(Oven { set_point: 293_150.0, temperature: 293_150.0 }),
        cpu: CpuModel {
            copy_outputs: Nanos::micros(30),
            application: Nanos::micros(10),
            copy_inputs: Nanos::micros(10),
            ..CpuModel::default()
        },
        // 35 ppm fast.
        clock: ClockModel::constant(35_000),
        local_time: Time::ZERO,
        sampling: None,
    };
    let mut config = Config::new(Nanos::millis(1));
    let mode = Some(SyncMode::DcSync0);
    config.devices = vec![DeviceConfig { mode, ..DeviceConfig::default() }];
    let segment = vec![Connection::new(None, Cable::of_length(10_000), device)];
    let setup = Setup::new(1, config, HostModel::default(), segment);

    // The MainDevice's side: it asks for 350 K as soon as the oven is in OP.
    let heat = |cycle: &mut Cycle<'_>| {
        for mut device in cycle.devices().filter(|device| device.is_in_operation()) {
            device.outputs_mut().copy_from_slice(&350_000u32.to_le_bytes());
        }
    };
    let mut world = World::new(setup, heat, None::<isocat::NoTap>);
    let mut end = Time::ZERO + Picos::from(Nanos::millis(20_000));
    while world.step(end) {
        while let Some(event) = world.poll_event() {
            match event {
                Event::InOperation { .. } => {
                    let device = &world.main().segment().devices[0];
                    println!("station {}, mode {}: in operation", device.station, device.mode);
                    world.catch_up();
                    world.begin_judging(intent(world.main(), Nanos::micros(1)));
                    end = world.now() + Nanos::millis(200).into();
                }
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
    }
    let judges = world.end_judging();
    let device = &judges.devices()[0];
    println!("{} SM events missed in 200 ms", device.missed.count());
    let margin = Nanos(device.margin.margin().least() / 1000);
    println!("outputs ready at least {margin} before SYNC0");
    let inputs = world.main().inputs(0);
    let temperature = u32::from_le_bytes(inputs.try_into().expect("4 bytes"));
    println!("the oven is at {temperature} mK");
    assert!((349_000..350_001).contains(&temperature), "ten time constants are over");
}
