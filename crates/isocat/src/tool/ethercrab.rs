//! ethercrab 0.7: a program in Rust that brings the segment up and keeps it in operation.

use isocat_wire::dc::AssignActivate;

use super::page::Page;
use super::sheet::Object;
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("// ");
    page.head(sheet, "The segment for ethercrab 0.7: PROGRAM INTERFACE [CYCLES].");
    page.note(
        0,
        "Cargo.toml: ethercrab = { version = \"0.7.1\", default-features = false, \
        features = [\"std\"] }, async-io = \"2.0\".",
    );
    page.limits(0, &limits(sheet));
    page.line(IMPORTS);
    page.note(0, format!("Bus cycle: {}", sheet.why_cycle));
    page.line(format!("const CYCLE: Duration = Duration::from_nanos({});", sheet.cycle_ns));
    let grid = Grid::of(sheet);
    page.note(
        0,
        format!(
            "ethercrab puts SYNC0 at 0 of the cycle and the frame behind it: the \
        frame at {} ns by the plan, SYNC0 at {} ns. The frame may be late by {} ns.",
            sheet.send_phase_ns, grid.sync0_ns, sheet.send_jitter_ns
        ),
    );
    page.line(format!(
        "const FRAME_BEHIND_SYNC0: Duration = Duration::from_nanos({});",
        grid.behind(sheet.send_phase_ns)
    ));
    expected(&mut page, sheet);
    units(&mut page, sheet, &grid);
    page.line(MAIN);
    set_up(&mut page, sheet, &grid);
    page.end() + if sheet.with_pulses().next().is_some() { WITH_DC } else { WITHOUT_DC }
}

/// The place of ethercrab's grid in the system-time cycle of the plan.
struct Grid {
    /// Phase of the SYNC0 that `configure_dc_sync` sets: that of the first device for which it is
    /// suitable.
    sync0_ns: i64,
    cycle_ns: i64,
}

impl Grid {
    fn of(sheet: &Sheet) -> Self {
        let cycle_ns = sheet.cycle_ns;
        let first = sheet.with_pulses().find(|(_, unit)| has_words(unit, cycle_ns));
        Self { sync0_ns: first.map_or(0, |(_, unit)| unit.phase_ns), cycle_ns }
    }

    /// A phase of the plan, counted from ethercrab's SYNC0.
    fn behind(&self, phase_ns: i64) -> i64 {
        (phase_ns - self.sync0_ns).rem_euclid(self.cycle_ns)
    }

    /// Whether `configure_dc_sync` can set all that this unit needs.
    fn suits(&self, unit: &Unit) -> bool {
        has_words(unit, self.cycle_ns) && unit.phase_ns == self.sync0_ns
    }
}

/// Whether ethercrab can express the unit: it has one period for all, and two AssignActivate words.
fn has_words(unit: &Unit, cycle_ns: i64) -> bool {
    let known = [AssignActivate::SYNC0, AssignActivate::SYNC0_AND_SYNC1].contains(&unit.word);
    known && i64::from(unit.sync0_ns) == cycle_ns
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits = sheet.slower(
        "ethercrab exchanges a group as a whole: give it a group of its \
        own and exchange that as rarely",
    );
    let add = |limits: &mut Vec<String>, text: &str| limits.push(text.to_owned());
    let grid = Grid::of(sheet);
    if sheet.with_pulses().any(|(_, unit)| !grid.suits(unit)) {
        add(
            &mut limits,
            "ethercrab has one SYNC0 period and one phase for a group, and AssignActivate 0x0300 \
                or 0x0700; the units in BY_HAND are programmed by their registers.",
        );
    }
    if sheet.with_pulses().next().is_some() {
        add(
            &mut limits,
            "ethercrab does not look whether SYNC0 runs; the program reads 0x0990 twice.",
        );
    }
    limits.extend(sheet.reference_not_first());
    if sheet.devices.iter().any(|device| device.objects.iter().any(|object| object.step.complete)) {
        add(
            &mut limits,
            "ethercrab does not download with complete access; what the plan writes so is left \
                out below.",
        );
    }
    limits
}

fn expected(page: &mut Page, sheet: &Sheet) {
    page.note(0, "By position: vendor, product, bytes of outputs, bytes of inputs.");
    page.line(format!("const DEVICES: [(u32, u32, usize, usize); {}] = [", sheet.devices.len()));
    for device in &sheet.devices {
        let [outputs, inputs] = device.bytes();
        page.device(4, device);
        page.line(format!(
            "    (0x{:08X}, 0x{:08X}, {outputs}, {inputs}),",
            device.vendor, device.product
        ));
    }
    page.line("];");
    page.note(0, "A power of two, as ethercrab asks for.");
    page.line(format!(
        "const MAX_SUBDEVICES: usize = {};",
        sheet.devices.len().next_power_of_two().max(2)
    ));
    page.line(format!("const MAX_PDI: usize = {};", (2 * sheet.image_bytes).max(64)));
}

/// Units that are set by registers, and the devices with pulses.
fn units(page: &mut Page, sheet: &Sheet, grid: &Grid) {
    let positions: Vec<_> =
        sheet.with_pulses().map(|(device, _)| device.position.to_string()).collect();
    page.note(0, "Positions of the SubDevices with SYNC pulses.");
    page.line(format!(
        "const WITH_PULSES: [usize; {}] = [{}];",
        positions.len(),
        positions.join(", ")
    ));
    let by_hand: Vec<_> = sheet.with_pulses().filter(|(_, unit)| !grid.suits(unit)).collect();
    page.note(
        0,
        "Units by registers: position, AssignActivate, periods of SYNC0 and from SYNC0 \
        to SYNC1, phase behind ethercrab's SYNC0, in ns.",
    );
    page.line(format!("const BY_HAND: [(usize, u16, [u32; 2], u64); {}] = [", by_hand.len()));
    for (device, unit) in by_hand {
        reasons(page, 4, unit);
        page.line(format!(
            "    ({}, 0x{:04X}, [{}, {}], {}),",
            device.position,
            unit.word.0,
            unit.sync0_ns,
            unit.sync1_ns,
            grid.behind(unit.phase_ns)
        ));
    }
    page.line("];");
}

fn reasons(page: &mut Page, indent: usize, unit: &Unit) {
    page.note(indent, format!("AssignActivate {}: {}.", unit.word, unit.why_word));
    page.note(indent, format!("SYNC0 every {} ns: {}.", unit.sync0_ns, unit.why_sync0));
    page.note(indent, format!("Phase {} ns by the plan: {}.", unit.phase_ns, unit.why_phase));
    if unit.sync1_ns > 0 {
        page.note(indent, format!("SYNC1 {} ns after SYNC0: {}.", unit.sync1_ns, unit.why_sync1));
    }
}

/// Objects, AssignActivate words and modes of each device, in PREOP.
fn set_up(page: &mut Page, sheet: &Sheet, grid: &Grid) {
    page.note(0, "What a SubDevice gets in PREOP, before its process data are mapped.");
    page.line(
        "async fn set_up(device: &mut SubDeviceRef<'_, &mut SubDevice>, at: usize) -> \
        Result<(), Error> {",
    );
    page.line("    match at {");
    for device in &sheet.devices {
        page.line(format!("        {} => {{", device.position));
        for object in &device.objects {
            download(page, object);
        }
        registers(page, device, grid);
        page.line("        }");
    }
    page.line("        _ => {}\n    }\n    Ok(())\n}\n");
    page.note(
        0,
        "SyncManagers that ethercrab leaves off where the SII has no PDO by default: 0x0806 + 8 n.",
    );
    let assigned = |device: &&Device| device.objects.iter().any(Object::assigns);
    let on = sheet.devices.iter().filter(assigned).flat_map(|device| {
        device.channels.iter().map(|channel| {
            format!("({}, 0x{:04X})", device.position, 0x0806 + 8 * u16::from(channel.sync_manager))
        })
    });
    let on: Vec<_> = on.collect();
    page.line(format!("const SWITCHED_ON: [(usize, u16); {}] = [{}];\n", on.len(), on.join(", ")));
}

fn download(page: &mut Page, object: &Object) {
    let step = &object.step;
    if let Some(transition) = object.unusual_transition() {
        page.note(12, format!("The plan writes the next one in {transition}."));
    }
    page.note(12, &object.why);
    if step.complete {
        return page.limits(12, &[format!("{} with complete access.", step.object)]);
    }
    let value = match (object.number(), step.data.len()) {
        (Some(pdo), 2) if object.assigns() => format!("0x{pdo:04X}u16"),
        (Some(value), length) => format!("{value}u{}", 8 * length),
        (None, _) => {
            let bytes: Vec<_> = step.data.iter().map(|byte| format!("0x{byte:02X}u8")).collect();
            format!("[{}]", bytes.join(", "))
        }
    };
    page.line(format!(
        "            device.sdo_write(0x{:04X}, 0x{:02X}u8, {value}).await?;",
        step.object.index, step.object.sub
    ));
}

fn registers(page: &mut Page, device: &Device, grid: &Grid) {
    for (what, register, value) in device.watchdog.iter().flat_map(|one| one.registers()) {
        page.note(12, what);
        page.line(format!(
            "            device.register_write(0x{register:04X}u16, {value}u16).await?;"
        ));
    }
    let Some(unit) = &device.unit else { return };
    if unit.sync0_ns == 0 {
        page.note(12, format!("AssignActivate {}: {}.", unit.word, unit.why_word));
        page.line(format!(
            "            device.register_write(0x0980u16, 0x{:04X}u16).await?;",
            unit.word.0
        ));
        return;
    }
    if grid.suits(unit) {
        reasons(page, 12, unit);
        match unit.sync1_ns {
            0 => page.line("            device.set_dc_sync(DcSync::Sync0);"),
            sync1 => page.line(format!(
                "            device.set_dc_sync(DcSync::Sync01 {{ \
                sync1_period: Duration::from_nanos({sync1}) }});"
            )),
        }
    }
    page.note(
        12,
        "Filters of the drift loop: with those of reset, 0 and 12, a loop learns its \
        speed too slowly.",
    );
    page.line("            device.register_write(0x0934u16, [4u8, 6]).await?;");
}

const IMPORTS: &str = "
#![allow(unused, clippy::all)]

use std::time::{Duration, Instant};

use ethercrab::error::Error;
use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::subdevice_group::DcConfiguration;
use ethercrab::{
    Command, DcSync, MainDevice, MainDeviceConfig, PduStorage, SubDevice, SubDeviceRef, Timeouts,
};
";

const MAIN: &str = r#"static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

fn main() {
    let interface = std::env::args().nth(1).expect("usage: PROGRAM INTERFACE [CYCLES]");
    let cycles = std::env::args().nth(2).map_or(3000, |count| count.parse().expect("a number"));
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let wire = tx_rx_task(&interface, tx, rx).expect("a raw socket on the interface");
    std::thread::spawn(move || async_io::block_on(wire));
    let timeouts = Timeouts { pdu: Duration::from_millis(50), ..Timeouts::default() };
    let main_device = MainDevice::new(pdu_loop, timeouts, MainDeviceConfig::default());
    if let Err(error) = async_io::block_on(run(&main_device, cycles)) {
        eprintln!("{error}");
        std::process::exit(1);
    }
}
"#;

const WITH_DC: &str = r#"async fn run(main_device: &MainDevice<'static>, cycles: u32) -> Result<(), Error> {
    // PREOP, with delays, offsets and 10 000 drift frames.
    let mut group =
        main_device.init_single_group::<MAX_SUBDEVICES, MAX_PDI>(ethercat_now).await?;
    assert_eq!(group.len(), DEVICES.len(), "SubDevices");
    let mut reference = None;
    for (at, mut device) in group.iter_mut(main_device).enumerate() {
        let identity = device.identity();
        let (vendor, product, _, _) = DEVICES[at];
        assert_eq!((identity.vendor_id, identity.product_id), (vendor, product), "SubDevice {at}");
        if device.dc_support().any() {
            reference.get_or_insert(device.configured_address());
        }
        set_up(&mut device, at).await?;
    }
    let reference = reference.unwrap_or_default();
    // With the filters of operation the clocks converge once more: in a burst, then as in the
    // cycle.
    for at in 0..15_750 {
        let time = Command::frmw(reference, 0x0910).ignore_wkc();
        time.receive::<u64>(main_device).await?;
        if at >= 15_000 {
            async_io::Timer::after(CYCLE).await;
        }
    }
    let group = group.into_pre_op_pdi(main_device).await?;
    for (device, (_, _, outputs, inputs)) in group.iter(main_device).zip(DEVICES) {
        let found = (device.outputs_raw().len(), device.inputs_raw().len());
        assert_eq!(found, (outputs, inputs), "bytes of {}", device.name());
    }
    for (at, register) in SWITCHED_ON {
        group.subdevice(main_device, at)?.register_write(register, 1u8).await?;
    }
    let start = DcConfiguration {
        start_delay: Duration::from_millis(100),
        sync0_period: CYCLE,
        sync0_shift: FRAME_BEHIND_SYNC0,
    };
    let group = group.configure_dc_sync(main_device, start).await?;
    let cycle = CYCLE.as_nanos() as u64;
    for (at, word, [sync0, sync1], phase) in BY_HAND {
        let device = group.subdevice(main_device, at)?;
        device.register_write(0x0981u16, 0u8).await?;
        let now = device.register_read::<u64>(0x0910u16).await?;
        // On the grid of all periods: the longer of the bus cycle and that of the pulses.
        let grid = (u64::from(sync1) / u64::from(sync0) + 1) * u64::from(sync0);
        let grid = grid.max(cycle);
        let first = (now + 100_000_000) / grid * grid + grid + phase;
        device.register_write(0x0990u16, first).await?;
        device.register_write(0x09A0u16, sync0).await?;
        device.register_write(0x09A4u16, sync1).await?;
        device.register_write(0x0980u16, word).await?;
    }
    // Until after the first pulse; without drift frames the clocks would run apart.
    for _ in 0..Duration::from_millis(200).as_nanos() / CYCLE.as_nanos() + 1 {
        let time = Command::frmw(reference, 0x0910).ignore_wkc();
        time.receive::<u64>(main_device).await?;
        async_io::Timer::after(CYCLE).await;
    }
    for at in WITH_PULSES {
        let device = group.subdevice(main_device, at)?;
        let pulse = device.register_read::<u64>(0x0990u16).await?;
        // Ten cycles are longer than any period of SYNC0 that is used with them.
        async_io::Timer::after(10 * CYCLE).await;
        let runs = device.register_read::<u64>(0x0990u16).await? != pulse;
        println!("{at}: SYNC0 {}", if runs { "runs" } else { "stands" });
    }
    let group = group.into_safe_op(main_device).await?.request_into_op(main_device).await?;
    let (mut in_op, mut unanswered) = (0, 0);
    for _ in 0..cycles {
        // Read inputs and write outputs here.
        let wait = match group.tx_rx_dc(main_device).await {
            Ok(response) => {
                in_op += u32::from(response.all_op());
                response.extra.next_cycle_wait
            }
            Err(Error::Timeout(_)) => {
                unanswered += 1;
                Duration::ZERO
            }
            Err(error) => return Err(error),
        };
        // The wait was computed when the answer came, so it counts from there.
        async_io::Timer::at(Instant::now() + wait).await;
    }
    println!("all in OP in {in_op} of {cycles} cycles, {unanswered} without an answer");
    Ok(())
}
"#;

const WITHOUT_DC: &str = r#"async fn run(main_device: &MainDevice<'static>, cycles: u32) -> Result<(), Error> {
    let mut group =
        main_device.init_single_group::<MAX_SUBDEVICES, MAX_PDI>(ethercat_now).await?;
    assert_eq!(group.len(), DEVICES.len(), "SubDevices");
    for (at, mut device) in group.iter_mut(main_device).enumerate() {
        let identity = device.identity();
        let (vendor, product, _, _) = DEVICES[at];
        assert_eq!((identity.vendor_id, identity.product_id), (vendor, product), "SubDevice {at}");
        set_up(&mut device, at).await?;
    }
    let group = group.into_pre_op_pdi(main_device).await?;
    for (device, (_, _, outputs, inputs)) in group.iter(main_device).zip(DEVICES) {
        let found = (device.outputs_raw().len(), device.inputs_raw().len());
        assert_eq!(found, (outputs, inputs), "bytes of {}", device.name());
    }
    for (at, register) in SWITCHED_ON {
        group.subdevice(main_device, at)?.register_write(register, 1u8).await?;
    }
    let group = group.into_safe_op(main_device).await?.request_into_op(main_device).await?;
    let (mut in_op, mut unanswered, mut due) = (0, 0, Instant::now());
    for _ in 0..cycles {
        // Read inputs and write outputs here.
        match group.tx_rx(main_device).await {
            Ok(response) => in_op += u32::from(response.all_op()),
            Err(Error::Timeout(_)) => unanswered += 1,
            Err(error) => return Err(error),
        }
        due += CYCLE;
        async_io::Timer::at(due).await;
    }
    println!("all in OP in {in_op} of {cycles} cycles, {unanswered} without an answer");
    Ok(())
}
"#;
