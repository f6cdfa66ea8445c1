//! ethercrab as it comes from the registry, as the MainDevice of a segment that somebody else
//! serves.
//!
//! `interop-ethercrab INTERFACE TASK.json ROLE`; prints one JSON object a line for every step, as
//! `tests/interop/peer.py` describes it.

use std::cell::Cell;
use std::time::{Duration, Instant};

use ethercrab::error::Error;
use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::subdevice_group::{DcConfiguration, HasDc, NoDc, Op, PreOpPdi};
use ethercrab::{
    Command, DcSync, DefaultLock, MainDevice, MainDeviceConfig, PduStorage, RegisterAddress,
    SubDeviceGroup, SubDeviceState, Timeouts,
};

use crate::partner::{Partner, Task};

mod partner;

const MAX_SUBDEVICES: usize = 64;
const MAX_PDI: usize = 4096;
/// ethercrab 0.7 reads no more than the MTU, 1500 bytes, headers included: a full frame would end
/// its task.
const MAX_PDU: usize = PduStorage::element_size(1472);
static STORAGE: PduStorage<32, MAX_PDU> = PduStorage::new();

type Group<S, DC> = SubDeviceGroup<MAX_SUBDEVICES, MAX_PDI, DefaultLock, S, DC>;
type Failure = Box<dyn std::error::Error>;

/// Register 0x0420, time of the process data watchdog in units of 100 us.
const WATCHDOG: u16 = 0x0420;
/// Register 0x0934 and the next: the filters of the drift loop.
const FILTERS: u16 = 0x0934;
/// Activation of SM2 and SM3.
const ACTIVATION: [u16; 2] = [0x0816, 0x081E];

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (Some(interface), Some(task), Some(role)) =
        (arguments.next(), arguments.next(), arguments.next())
    else {
        eprintln!("usage: interop-ethercrab INTERFACE TASK.json ROLE");
        std::process::exit(2);
    };
    let task = Task::read(&task).expect("the task file is readable");
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let wire = tx_rx_task(&interface, tx, rx).expect("a raw socket on the interface");
    std::thread::spawn(move || {
        let error = async_io::block_on(wire).err();
        eprintln!("the send and receive task ended: {error:?}");
        std::process::exit(3);
    });
    let timeouts = Timeouts {
        state_transition: Duration::from_secs(10),
        pdu: Duration::from_millis(200),
        eeprom: Duration::from_millis(500),
        wait_loop_delay: Duration::from_millis(1),
        mailbox_echo: Duration::from_secs(1),
        mailbox_response: Duration::from_secs(2),
    };
    let usual = MainDeviceConfig::default();
    let by_itself = if task.drift_frames > 0 { 0 } else { usual.dc_static_sync_iterations };
    let config = MainDeviceConfig { dc_static_sync_iterations: by_itself, ..usual };
    let main_device = MainDevice::new(pdu_loop, timeouts, config);
    let step = Cell::new("scan");
    let noticed = Cell::new(None);
    let session = Session { task: &task, role: &role, step: &step, noticed: &noticed };
    if let Err(error) = async_io::block_on(session.run(&main_device)) {
        say(step.get(), "failed", &error.to_string(), noticed.get());
        std::process::exit(1);
    }
    std::process::exit(0);
}

fn say(step: &str, result: &str, what: &str, noticed: Option<Noticed>) {
    let mut line = serde_json::json!({ "step": step, "result": result, "what": what });
    if let Some(Noticed { wrong_counters, fell }) = noticed {
        line["noticed"] = serde_json::json!({ "wrong_counters": wrong_counters, "fell": fell });
    }
    println!("{line}");
}

struct Session<'a> {
    task: &'a Task,
    role: &'a str,
    /// What is being tried.
    step: &'a Cell<&'static str>,
    /// What ethercrab told in the cycles, while they go on.
    noticed: &'a Cell<Option<Noticed>>,
}

/// What a library tells its application.
#[derive(Clone, Copy, Default)]
struct Noticed {
    /// Cycles whose working counter was not as expected, or whose frame was lost.
    wrong_counters: u32,
    /// SubDevices that were found to have left OP.
    fell: u32,
}

impl Session<'_> {
    fn ok(&self, what: &str, next: &'static str) {
        say(self.step.get(), "ok", what, self.noticed.get());
        self.noticed.set(None);
        self.step.set(next);
    }

    async fn run(&self, main_device: &MainDevice<'static>) -> Result<(), Failure> {
        let mut group =
            main_device.init_single_group::<MAX_SUBDEVICES, MAX_PDI>(ethercat_now).await?;
        self.scan(main_device, &group)?;
        // init ends when all are in PREOP.
        main_device.wait_for_state(SubDeviceState::PreOp).await?;
        self.ok("", "sdo");
        self.sdo(main_device, &group).await?;
        let mut reference = None;
        for (mut device, expected) in group.iter_mut(main_device).zip(&self.task.devices) {
            for &(index, sub, size, value) in &expected.startup {
                match size {
                    1 => device.sdo_write(index, sub, value as u8).await?,
                    2 => device.sdo_write(index, sub, value as u16).await?,
                    _ => device.sdo_write(index, sub, value).await?,
                }
            }
            device.register_write(WATCHDOG, self.task.watchdog_ms * 10).await?;
            if expected.sync0 {
                device.set_dc_sync(DcSync::Sync0);
                if self.task.drift_frames > 0 {
                    // The drift loops' filters: with those of reset, 0 and 12, a loop learns its
                    // speed too slowly.
                    device.register_write(FILTERS, [4u8, 6]).await?;
                }
            }
            reference.get_or_insert(device.configured_address());
        }
        for _ in 0..self.task.drift_frames {
            async_io::Timer::after(Duration::from_millis(1)).await;
            let time = Command::frmw(reference.unwrap_or_default(), 0x0910).ignore_wkc();
            time.receive::<u64>(main_device).await?;
        }
        let group = group.into_pre_op_pdi(main_device).await?;
        for (device, expected) in group.iter(main_device).zip(&self.task.devices) {
            let found = (device.outputs_raw().len(), device.inputs_raw().len());
            if found != (expected.outputs, expected.inputs) {
                let wanted = (expected.outputs, expected.inputs);
                return Err(format!("{}: {found:?} bytes, not {wanted:?}", expected.name).into());
            }
        }
        let mut by_hand = 0;
        for (device, expected) in group.iter(main_device).zip(&self.task.devices) {
            // ethercrab enables SyncManagers as the SII says, and that says no where no PDO is
            // assigned by default.
            if !expected.startup.is_empty() {
                for sync_manager in ACTIVATION {
                    device.register_write(sync_manager, 1u8).await?;
                }
                by_hand += 1;
            }
        }
        let what = match by_hand {
            0 => String::new(),
            devices => format!(
                "SM2 and SM3 of {devices} switched on by hand: its SII says disabled, ethercrab obeys"
            ),
        };
        self.ok(&what, "dc");
        let sync0 = self.task.devices.iter().filter(|device| device.sync0).count();
        if sync0 == 0 {
            self.ok("delays and offsets; nobody wants SYNC0", "safeop");
            return self.operate(main_device, group, exchange_without_dc).await;
        }
        let cycle = Duration::from_micros(self.task.cycle_us);
        let plan = DcConfiguration {
            start_delay: Duration::from_millis(100),
            sync0_period: cycle,
            sync0_shift: cycle / 2,
        };
        let group = group.configure_dc_sync(main_device, plan).await?;
        let mut active = 0;
        for device in group.iter(main_device) {
            let cyclic = device.register_read::<u8>(RegisterAddress::DcSyncActive).await?;
            active += usize::from(cyclic & 0b11 == 0b11);
        }
        if active != sync0 {
            return Err(format!("SYNC0 active in {active} of {sync0}").into());
        }
        self.ok(&format!("SYNC0 in {sync0}"), "safeop");
        self.operate(main_device, group, exchange_with_dc).await
    }

    fn scan(
        &self,
        main_device: &MainDevice<'static>,
        group: &SubDeviceGroup<MAX_SUBDEVICES, MAX_PDI>,
    ) -> Result<(), Failure> {
        let (found, wanted) = (group.len(), self.task.devices.len());
        if found != wanted {
            return Err(format!("{found} SubDevices, not {wanted}").into());
        }
        for (device, expected) in group.iter(main_device).zip(&self.task.devices) {
            let id = device.identity();
            let found = (id.vendor_id, id.product_id, id.revision);
            if found != (expected.vendor, expected.product, expected.revision) {
                return Err(format!("{}: it says that it is {id}", expected.name).into());
            }
        }
        self.ok(&format!("{found} SubDevices"), "preop");
        Ok(())
    }

    async fn sdo(
        &self,
        main_device: &MainDevice<'static>,
        group: &SubDeviceGroup<MAX_SUBDEVICES, MAX_PDI>,
    ) -> Result<(), Failure> {
        if !self.task.devices.iter().any(|device| device.mailbox) {
            say("sdo", "n/a", "no device has a mailbox", None);
            self.step.set("map");
            return Ok(());
        }
        let mut read = 0;
        let devices = group.iter(main_device).zip(&self.task.devices);
        for (device, expected) in devices.filter(|_| self.role == "whole") {
            for &(index, sub, size, constant) in &expected.entries {
                let value = match size {
                    1 => device.sdo_read::<u8>(index, sub).await.map(u32::from),
                    2 => device.sdo_read::<u16>(index, sub).await.map(u32::from),
                    _ => device.sdo_read::<u32>(index, sub).await,
                };
                let place = format!("{}: 0x{index:04X}:{sub:02X}", expected.name);
                let value = value.map_err(|error| format!("{place}: {error}"))?;
                if constant.is_some_and(|constant| constant != value) {
                    return Err(format!("{place} is {value}, not {constant:?}").into());
                }
                read += 1;
            }
        }
        self.ok(&format!("{read} entries"), "map");
        Ok(())
    }

    async fn operate<DC>(
        &self,
        main_device: &MainDevice<'static>,
        group: Group<PreOpPdi, DC>,
        exchange: impl AsyncFn(&MainDevice<'static>, &Group<Op, DC>) -> Result<Exchanged, Error>,
    ) -> Result<(), Failure> {
        let group = group.into_safe_op(main_device).await?;
        self.ok("", "op");
        let group = group.request_into_op(main_device).await?;
        let mut partner = Partner::new(self.task);
        let cycle = Duration::from_micros(self.task.cycle_us);
        let asked = Instant::now();
        let mut due = Instant::now();
        loop {
            let exchanged = exchange(main_device, &group).await?;
            if exchanged.all_op {
                break;
            }
            if asked.elapsed() > Duration::from_secs(10) {
                for device in group.iter(main_device) {
                    eprintln!("{:?}", device.status().await);
                }
                return Err("not all in OP after 10 s".into());
            }
            due = exchanged.next(due, cycle);
            async_io::Timer::at(due).await;
        }
        self.ok("", "cycles");
        // ethercrab cuts the image at any byte: who lies across two frames counts in both.
        let wanted = self.task.working_counter();
        let most = wanted + 3;
        let cycles = match self.role {
            "whole" => self.task.cycles,
            // So that a drive that fell once is there for most of them.
            "again" => 1000,
            _ => u32::MAX,
        };
        let (mut bad, mut lost, mut fell, mut away, mut worst) = (0, 0, 0, 0, Duration::ZERO);
        // Wrong counters without a right one between: of a SubDevice that fell they belong to its
        // fall.
        let mut since = 0;
        let mut asked = [false; MAX_SUBDEVICES];
        let mut noticed = Noticed::default();
        let mut last = Instant::now();
        for number in 0..cycles {
            for (at, device) in group.iter(main_device).enumerate() {
                partner.outputs(number, at, &mut device.outputs_raw_mut());
            }
            let exchanged = match exchange(main_device, &group).await {
                Ok(exchanged) => exchanged,
                // The frame of a cycle was late or lost: not a reason to give up.
                Err(Error::Timeout(_)) => {
                    lost += 1;
                    Exchanged::default()
                }
                Err(error) => return Err(error.into()),
            };
            if (wanted..=most).contains(&exchanged.working_counter) {
                since = 0;
                for (at, device) in group.iter(main_device).enumerate() {
                    partner.inputs(number, at, &device.inputs_raw());
                }
            } else {
                noticed.wrong_counters += 1;
                bad += u32::from(number > away);
                since += u32::from(number > away);
            }
            // At the last one too: who fell since the last question would be counted as wrong.
            let question = number % 10 == 0 || number + 1 == cycles;
            if !exchanged.all_op && question {
                let began = recover(main_device, &group, &mut asked).await?;
                if began > 0 {
                    fell += began;
                    noticed.fell = fell;
                    away = number + 400;
                    bad -= since;
                    since = 0;
                }
            }
            self.noticed.set(Some(noticed));
            worst = worst.max(last.elapsed());
            last = Instant::now();
            due = exchanged.next(due, cycle);
            async_io::Timer::at(due).await;
        }
        let mut what = format!(
            "{cycles} cycles, {bad} with a wrong working counter, {lost} of these late; longest {} ms",
            worst.as_millis()
        );
        if fell > 0 {
            what += &format!(
                "; SubDevices that left OP after late frames and were brought back: {fell}"
            );
        }
        let complaints = partner.complaints(cycles);
        if bad * 50 > cycles || !complaints.is_empty() {
            return Err(format!("{what}; {complaints}").into());
        }
        self.ok(&what, "down");
        let group = group.into_safe_op(main_device).await?;
        let group = group.into_pre_op(main_device).await?;
        let _group = group.into_init(main_device).await?;
        self.ok("", "");
        Ok(())
    }
}

/// Brings back SubDevices that left OP, a step a call; gives how many it began with. The machine
/// may stall for longer than a drive forgives.
async fn recover<DC>(
    main_device: &MainDevice<'static>,
    group: &Group<Op, DC>,
    asked: &mut [bool; MAX_SUBDEVICES],
) -> Result<u32, Error> {
    let mut began = 0;
    for (device, asked) in group.iter(main_device).zip(asked) {
        let status = device.register_read::<u16>(RegisterAddress::AlStatus).await?;
        let control: u16 = match status & 0x1F {
            0x14 => 0x14,
            0x04 if !*asked => 0x08,
            _ => continue,
        };
        *asked = control == 0x08;
        began += u32::from(control == 0x14);
        device.register_write(RegisterAddress::AlControl, control).await?;
    }
    Ok(began)
}

#[derive(Default)]
struct Exchanged {
    working_counter: u16,
    all_op: bool,
    /// How long the stack itself wants to wait, with SYNC0.
    wait: Option<Duration>,
}

impl Exchanged {
    /// When the next cycle begins, if this one was due then.
    fn next(&self, due: Instant, cycle: Duration) -> Instant {
        let now = Instant::now();
        match self.wait {
            // As ethercrab's own example does it, but counted from the answer, which is when it was
            // computed.
            Some(wait) => now + wait,
            None => (due + cycle).max(now),
        }
    }
}

async fn exchange_without_dc(
    main_device: &MainDevice<'static>,
    group: &Group<Op, NoDc>,
) -> Result<Exchanged, Error> {
    // This also distributes the time, if there is a reference clock.
    let response = group.tx_rx_sync_system_time(main_device).await?;
    let (working_counter, all_op) = (response.working_counter, response.all_op());
    Ok(Exchanged { working_counter, all_op, wait: None })
}

async fn exchange_with_dc(
    main_device: &MainDevice<'static>,
    group: &Group<Op, HasDc>,
) -> Result<Exchanged, Error> {
    let response = group.tx_rx_dc(main_device).await?;
    let (working_counter, all_op) = (response.working_counter, response.all_op());
    Ok(Exchanged { working_counter, all_op, wait: Some(response.extra.next_cycle_wait) })
}
