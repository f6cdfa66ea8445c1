//! The IgH EtherCAT Master: calls of its application interface, version 1.5.2 and later.

use super::page::Page;
use super::sheet::{Channel, Object};
use super::{Device, Sheet, Unit};

/// The file.
pub(super) fn text(sheet: &Sheet) -> String {
    let mut page = Page::new("// ");
    page.head(sheet, "The segment for the IgH EtherCAT Master.");
    page.limits(0, &limits(sheet));
    page.line("\n#include <stddef.h>\n#include <stdint.h>\n#include <ecrt.h>\n");
    page.note(0, format!("Bus cycle: {}", sheet.why_cycle));
    page.line(format!("#define CYCLE_NS {}", sheet.cycle_ns));
    page.note(
        0,
        "Frames are sent at this phase of the application time, and late by no more than \
        the jitter.",
    );
    page.line(format!("#define SEND_PHASE_NS {}", sheet.send_phase_ns));
    page.line(format!("#define SEND_JITTER_NS {}", sheet.send_jitter_ns));
    page.line(format!("#define DEVICES {}", sheet.devices.len()));
    for device in &sheet.devices {
        tables(&mut page, device);
    }
    configure(&mut page, sheet);
    exchange(&mut page);
    page.end()
}

fn limits(sheet: &Sheet) -> Vec<String> {
    let mut limits =
        sheet.slower("put it into a domain of its own and queue that domain as rarely");
    if sheet.has_unusual_transitions() {
        limits.push(
            "this master writes every configured SDO in PREOP; another transition stands \
            with its call."
                .into(),
        );
    }
    let uneven =
        |(_, unit): &(&Device, &Unit)| unit.sync1_ns > 0 && unit.sync1_ns % unit.sync0_ns != 0;
    if sheet.with_pulses().any(|found| uneven(&found)) {
        limits.push(
            "up to 1.5.2 the start time lies on a grid of sync0_cycle + sync1_cycle, so that a \
                SYNC1 that is no \
             multiple of SYNC0 puts SYNC0 on another phase at each start. Compare 0x0990 \
             with the plan's phase."
                .into(),
        );
    }
    limits.extend(sheet.watchdogs_at_igh());
    limits
}

/// PDO entries, PDOs and SyncManagers of a device.
fn tables(page: &mut Page, device: &Device) {
    let at = device.position;
    page.line("");
    page.device(0, device);
    for channel in &device.channels {
        let sm = channel.sync_manager;
        for pdo in channel.pdos.iter().filter(|pdo| !pdo.entries.is_empty()) {
            page.line(format!("static ec_pdo_entry_info_t entries_{at}_{:04x}[] = {{", pdo.index));
            for entry in &pdo.entries {
                page.line(format!(
                    "   {{0x{:04X}, 0x{:02X}, {}}},",
                    entry.index, entry.sub, entry.bits
                ));
            }
            page.line("};");
        }
        page.line(format!("static ec_pdo_info_t pdos_{at}_sm{sm}[] = {{"));
        for pdo in &channel.pdos {
            let entries = match pdo.entries.len() {
                0 => "0, NULL".to_owned(),
                count => format!("{count}, entries_{at}_{:04x}", pdo.index),
            };
            page.line(format!("   {{0x{:04X}, {entries}}},", pdo.index));
        }
        page.line("};");
    }
    if device.channels.is_empty() {
        return;
    }
    let [outputs, inputs] = device.bytes();
    page.note(
        0,
        format!(
            "{outputs} bytes of outputs, {inputs} of inputs; the watchdog as the \
        SyncManager's control byte has it."
        ),
    );
    page.line(format!("static const ec_sync_info_t syncs_{at}[] = {{"));
    for Channel { outputs, sync_manager, watchdog, pdos, .. } in &device.channels {
        let direction = if *outputs { "EC_DIR_OUTPUT" } else { "EC_DIR_INPUT" };
        let watchdog = if *watchdog { "EC_WD_ENABLE" } else { "EC_WD_DISABLE" };
        let count = pdos.len();
        page.line(format!(
            "   {{{sync_manager}, {direction}, {count}, pdos_{at}_sm{sync_manager}, {watchdog}}},"
        ));
    }
    page.line("   {0xff, EC_DIR_INVALID, 0, NULL, EC_WD_DEFAULT},\n};");
}

fn configure(page: &mut Page, sheet: &Sheet) {
    page.line("");
    page.note(
        0,
        "First bytes of the outputs and inputs of each device in the domain; -1 for none.",
    );
    page.line("static int outputs_at[DEVICES], inputs_at[DEVICES];\n");
    page.note(0, "Before ecrt_master_activate(). 0, or the error of the call that failed.");
    page.line(
        "int configure(ec_master_t *master, ec_domain_t *domain, ec_slave_config_t \
        *sc[DEVICES])\n{",
    );
    page.line("   int code = 0, i;\n");
    page.line("   for (i = 0; i < DEVICES; i++)\n      outputs_at[i] = inputs_at[i] = -1;");
    if sheet.devices.iter().all(|device| device.channels.is_empty()) {
        page.note(3, "No device has process data.");
        page.line("   (void)domain;");
    }
    for device in &sheet.devices {
        let Device { position: at, vendor, product, revision, .. } = device;
        page.line("");
        page.note(
            3,
            format!(
                "{} ({at}); revision 0x{revision:08X} is not checked by this master.",
                device.name
            ),
        );
        page.line(format!(
            "   if (!(sc[{at}] = ecrt_master_slave_config(master, 0, {at}, \
            0x{vendor:08X}, 0x{product:08X})))"
        ));
        page.line("      return -1;");
        device_calls(page, device);
    }
    if let Some(reference) = sheet.reference {
        page.line("");
        page.note(
            3,
            "The reference clock of the plan: its first device with a clock, or the one \
            that was chosen.",
        );
        page.line(format!(
            "   if ((code = ecrt_master_select_reference_clock(master, \
            sc[{reference}])))\n      return code;"
        ));
    }
    page.line("   return code;\n}");
}

fn device_calls(page: &mut Page, device: &Device) {
    let at = device.position;
    if !device.channels.is_empty() {
        page.note(
            3,
            "PDO assignment and mapping; the master writes 0x1C12, 0x1C13 and mappings \
            where they differ.",
        );
        page.line(format!(
            "   if ((code = ecrt_slave_config_pdos(sc[{at}], EC_END, \
            syncs_{at})))\n      return code;"
        ));
    }
    let mut begun = [false; 2];
    for channel in &device.channels {
        let (name, sm) = (if channel.outputs { "outputs" } else { "inputs" }, channel.sync_manager);
        let call =
            format!("ecrt_slave_config_reg_pdo_entry_pos(sc[{at}], {sm}, 0, 0, domain, NULL)");
        // The bytes of further SyncManagers follow those of the first one.
        if std::mem::replace(&mut begun[usize::from(channel.outputs)], true) {
            page.line(format!("   i = {call};\n   if (i < 0)\n      return i;"));
            continue;
        }
        page.line(format!("   {name}_at[{at}] = {call};"));
        page.line(format!("   if ({name}_at[{at}] < 0)\n      return {name}_at[{at}];"));
    }
    for object in device.parameters() {
        if let Some(transition) = object.unusual_transition() {
            page.note(3, format!("The plan writes the next one in {transition}."));
        }
        page.note(3, &object.why);
        download(page, at, object);
    }
    if let Some(watchdog) = device.watchdog.filter(|watchdog| watchdog.is_of_process_data()) {
        let (divider, steps) = (watchdog.divider(), watchdog.steps());
        page.note(
            3,
            format!(
                "Watchdog of the process data: {steps} steps of {divider} + 2 \
            clocks of 40 ns each."
            ),
        );
        page.line(format!("   ecrt_slave_config_watchdog(sc[{at}], {divider}, {steps});"));
    }
    if let Some(unit) = &device.unit {
        dc(page, at, unit);
    }
}

fn download(page: &mut Page, at: usize, object: &Object) {
    let (address, data) = (object.step.object, &object.step.data);
    let entry = format!("sc[{at}], 0x{:04X}, 0x{:02X}", address.index, address.sub);
    let bytes: Vec<_> = data.iter().map(|byte| format!("0x{byte:02X}")).collect();
    let bytes = format!("(const uint8_t[]){{{}}}, {}", bytes.join(", "), data.len());
    let call = match (object.step.complete, object.number(), data.len()) {
        (true, ..) if address.sub != 0 => {
            let limit = format!(
                "complete access begins at sub-index 0 here: {address} is left out. Write it as {bytes} by an \
                 SDO request, or entry by entry."
            );
            return page.limits(3, &[limit]);
        }
        (true, ..) => {
            format!("ecrt_slave_config_complete_sdo(sc[{at}], 0x{:04X}, {bytes})", address.index)
        }
        (false, Some(value), length @ (1 | 2 | 4)) => {
            format!("ecrt_slave_config_sdo{}({entry}, {value}u)", 8 * length)
        }
        (false, ..) => format!("ecrt_slave_config_sdo({entry}, {bytes})"),
    };
    page.line(format!("   if ((code = {call}))\n      return code;"));
}

fn dc(page: &mut Page, at: usize, unit: &Unit) {
    page.note(3, format!("AssignActivate {}: {}.", unit.word, unit.why_word));
    page.note(3, format!("sync0_cycle {} ns: {}.", unit.sync0_ns, unit.why_sync0));
    page.note(
        3,
        format!(
            "sync0_shift {} ns, against multiples of the cycle in the application time: {}.",
            unit.phase_ns, unit.why_phase
        ),
    );
    if unit.sync1_ns > 0 {
        page.note(
            3,
            format!(
                "sync1_cycle {} ns, register 0x09A4: {}. sync1_shift is ignored, or added to it.",
                unit.sync1_ns, unit.why_sync1
            ),
        );
    }
    page.line(format!(
        "   ecrt_slave_config_dc(sc[{at}], {}, {}, {}, {}, 0);",
        unit.word, unit.sync0_ns, unit.phase_ns, unit.sync1_ns
    ));
}

fn exchange(page: &mut Page) {
    page.line("");
    page.note(
        0,
        "Once in each cycle, at the instant whose application time is `app_time`; in \
        operation and already on the way up.",
    );
    page.note(
        0,
        "The first application time that the master gets must be a multiple of CYCLE_NS: \
        it becomes the grid of all start times.",
    );
    page.line("void exchange(ec_master_t *master, ec_domain_t *domain, uint64_t app_time)\n{");
    page.line("   ecrt_master_receive(master);\n   ecrt_domain_process(domain);");
    page.note(3, "Read inputs and write outputs here.");
    page.line("   ecrt_master_application_time(master, app_time);");
    page.note(
        3,
        "The reference clock follows the host. The plan counts with a host that follows \
        the reference clock, whose jitter does not reach SYNC0: for that leave this call out and \
        steer by ecrt_master_reference_clock_time().",
    );
    page.line("   ecrt_master_sync_reference_clock(master);");
    page.note(3, "All other clocks follow the reference clock.");
    page.line("   ecrt_master_sync_slave_clocks(master);");
    page.line("   ecrt_domain_queue(domain);\n   ecrt_master_send(master);\n}");
}
