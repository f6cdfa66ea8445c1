//! The text of a profile file, written from a draft, so that it can be read again and edited.
//!
//! A description may contradict itself, which a profile must not, and may state things for which a
//! profile has no keys. `consistent` corrects the first, and the second are left out; both are
//! listed in the head of the file.

use std::fmt::Write as _;

use isocat_descriptions::document::FileError;
use isocat_descriptions::start_up::Transition;
use isocat_sync::object;
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use isocat_wire::sii::Header;
use isocat_wire::time::Nanos;

use super::draft::{Area, Draft, Entry, Item, Object, Pdo, PdoEntry, Placed, Property};
use super::{ApplicationKind, OpMode, dictionary, keys, rows, unknown};

mod consistent;

/// The text of a profile file.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ProfileText {
    /// TOML.
    pub text: String,
    /// Parts of the source that the profile does not have, and changes that make it consistent.
    /// Each is also listed in the head of the text.
    pub notes: Vec<String>,
}

/// Writes a draft; `made_of` names the source in the head. Fails if a profile cannot describe the
/// device.
pub(super) fn text(
    draft: Draft<'_>,
    made_of: &str,
    mut notes: Vec<String>,
) -> Result<ProfileText, FileError> {
    let mut draft = draft;
    consistent::mend(&mut draft, &mut notes)?;
    let generated = generated(&draft);
    for assumed in &draft.assumed {
        let item = &assumed.item.value;
        if let (Item::Key(name, value), None) = (item, assumed_item(item, &draft, &generated)) {
            notes.push(format!("assumed: {name} = {value}; {}", assumed.why));
        }
    }
    let mut out = String::new();
    let w = &mut out;
    comment(w, &format!("Made by `isocat profile` of {made_of}."));
    line(w, "# Keys: docs/profile.md; `isocat explain KEY` explains one.");
    for note in &notes {
        comment(w, &format!("- {note}"));
    }
    head(w, &draft);
    for (area, name) in [(&draft.outputs, "outputs"), (&draft.inputs, "inputs")] {
        if let Some(area) = area {
            process_data(w, area, name, &draft);
        }
    }
    for object in draft.objects.iter().filter(|object| !generated.iter().any(|g| same(g, object))) {
        write_object(w, object);
    }
    if !draft.op_modes.iter().all(has_no_times) {
        op_modes(w, &draft);
    }
    startup(w, &draft);
    times(w, &draft);
    behaviour(w, &draft);
    assumed(w, &draft, &generated);
    Ok(ProfileText { text: out, notes })
}

/// The objects that follow from the rest of the file, so that they need not be written.
fn generated(draft: &Draft<'_>) -> Vec<Object> {
    let mut bare = draft.clone();
    bare.objects.clear();
    bare.assumed.clear();
    bare.eeprom = None;
    dictionary::complete(&mut bare);
    bare.objects
}

fn same(one: &Object, other: &Object) -> bool {
    let form = |object: &Object| (object.index, object.code, object.data_type);
    let entry =
        |entry: &Entry| (entry.sub, entry.data_type, entry.bits, entry.offset, entry.access);
    let value = |entry: &Entry| {
        let end = entry.default.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
        entry.default[..end].to_vec()
    };
    form(one) == form(other)
        && one.name == other.name
        && one.entries.len() == other.entries.len()
        && one.entries.iter().zip(&other.entries).all(|(one, other)| {
            entry(one) == entry(other)
                && one.name == other.name
                // An unknown mapped value begins at 0, as all process data do.
                && value(one) == value(other)
        })
}

fn head(w: &mut String, draft: &Draft<'_>) {
    line(w, "");
    line(w, &format!("id = {}", quoted(&draft.id)));
    line(w, &format!("name = {}", quoted(&draft.name)));
    line(w, &format!("vendor = {}", quoted(&draft.vendor)));
    let application = match draft.application {
        ApplicationKind::Io => "io",
        ApplicationKind::Drive | ApplicationKind::DriveAt(_) => "drive",
    };
    line(w, &format!("application = \"{application}\""));
    if let Some(modes) = draft.modes {
        let announced = keys::MODES.iter().filter(|(_, _, mode)| mode.is_supported(modes.value));
        let words: Vec<_> = announced.map(|(word, ..)| format!("\"{word}\"")).collect();
        line(w, &format!("modes = [{}]", words.join(", ")));
    }
    let in_short = draft.op_modes.iter().all(has_no_times);
    if in_short && !draft.op_modes.is_empty() {
        line(w, "opmodes = [");
        line(w, "  # name, description, AssignActivate, factors of SYNC0 and SYNC1");
        for mode in &draft.op_modes {
            line(
                w,
                &format!(
                    "  [{}, {}, {:#06x}, {}, {}],",
                    quoted(&mode.name),
                    quoted(&mode.description),
                    mode.assign_activate,
                    mode.sync0_factor,
                    mode.sync1_factor
                ),
            );
        }
        line(w, "]");
    }
    let identity = draft.identity;
    line(w, "\n[identity]");
    line(w, &format!("vendor_id = {:#010x}", identity.vendor_id));
    line(w, &format!("product_code = {:#010x}", identity.product_code));
    line(w, &format!("revision = {:#010x}", identity.revision));
    if identity.serial != 0 {
        line(w, &format!("serial = {:#010x}", identity.serial));
    }
    line(w, &format!("device_type = {:#010x}", draft.device_type));
    line(w, &format!("hardware_version = {}", quoted(&draft.hardware_version)));
    line(w, &format!("software_version = {}", quoted(&draft.software_version)));
    let esc = &draft.esc;
    line(w, "\n[esc]");
    line(w, &format!("chip = \"{}\"", esc.chip.0));
    line(w, &format!("ports = \"{}\"", super::ports::letters(&esc.chip.1)));
    let usual = keys::CHIPS.iter().find(|(name, ..)| *name == esc.chip.0);
    if usual.is_none_or(|(_, _, (_, chip))| chip.ram_kib != esc.chip.1.ram_kib) {
        line(w, &format!("ram_kib = {}", esc.chip.1.ram_kib));
    }
    line(w, &format!("sync_unit = {}", esc.sync_unit));
    line(w, &format!("pulse = {}", duration(esc.pulse)));
    if esc.alias != 0 {
        line(w, &format!("alias = {}", esc.alias));
    }
    for (name, value) in [
        ("watchdog_divider", esc.watchdog.divider),
        ("watchdog_pdi", esc.watchdog.pdi),
        ("watchdog_process_data", esc.watchdog.process_data),
    ] {
        if let Some(value) = value {
            line(w, &format!("{name} = {value}"));
        }
    }
    if let Some(Placed { value: mailbox, .. }) = draft.mailbox {
        line(w, "\n[mailbox]");
        for (name, area) in [("receive", mailbox.receive), ("send", mailbox.send)] {
            line(
                w,
                &format!("{name} = {{ start = {:#06x}, length = {} }}", area.start, area.length),
            );
        }
        if draft.protocols != Header::COE {
            let carried = keys::PROTOCOLS.iter().filter(|(.., bit)| draft.protocols & bit != 0);
            let words: Vec<_> = carried.map(|(word, ..)| format!("\"{word}\"")).collect();
            line(w, &format!("protocols = [{}]", words.join(", ")));
        }
    }
}

fn process_data(w: &mut String, area: &Area, name: &str, draft: &Draft<'_>) {
    let list = |list: &[Placed<u16>]| {
        let indices: Vec<_> = list.iter().map(|pdo| format!("{:#06X}", pdo.value)).collect();
        indices.join(", ").replace("0X", "0x")
    };
    let has_mailbox = draft.mailbox.is_some();
    line(w, &format!("\n[{name}]"));
    line(w, &format!("start = {:#06x}", area.start));
    line(w, &format!("length = {}", area.length));
    let usual = if name == "outputs" { 2 } else { 3 };
    if area.sync_manager != usual {
        line(w, &format!("sync_manager = {}", area.sync_manager));
    }
    if has_mailbox {
        line(w, &format!("access = \"{}\"", access(area.access)));
        line(w, &format!("slots = {}", area.slots));
    }
    line(w, &format!("default = [{}]", list(&area.default)));
    let same = area.default.iter().map(|p| p.value).eq(area.recommended.iter().map(|p| p.value));
    if has_mailbox && !same {
        line(w, &format!("recommended = [{}]", list(&area.recommended)));
    }
    for pdo in &area.pdos {
        write_pdo(w, pdo, name);
    }
}

fn write_pdo(w: &mut String, pdo: &Pdo, name: &str) {
    line(w, &format!("\n[[{name}.pdo]]"));
    line(w, &format!("index = 0x{:04X}", pdo.index));
    line(w, &format!("name = {}", quoted(&pdo.name)));
    line(w, "entries = [");
    for entry in &pdo.entries {
        let PdoEntry { object, data_type, bits, name, .. } = entry;
        let Some(ObjectAddress { index, sub }) = object else {
            line(w, &format!("  {{ pad = {bits} }},"));
            continue;
        };
        let kind = data_type.name().unwrap_or("OCTET_STRING");
        let more = match data_type.bits() == Some((*bits).into()) {
            true => String::new(),
            false => format!(", {{ bits = {bits} }}"),
        };
        let name = quoted(name);
        line(w, &format!("  [\"{index:04X}:{sub:02X}\", \"{kind}\", {name}{more}],"));
    }
    line(w, "]");
}

fn write_object(w: &mut String, object: &Object) {
    line(w, "\n[[object]]");
    line(w, &format!("index = 0x{:04X}", object.index));
    line(w, &format!("name = {}", quoted(&object.name)));
    let code = keys::CODES.iter().find(|(_, _, code)| *code == object.code);
    line(w, &format!("code = \"{}\"", code.map_or("record", |(word, ..)| word)));
    let of_words = keys::TYPES.iter().any(|(_, _, kind)| *kind == object.data_type);
    if let Some(name) = object.data_type.name().filter(|_| of_words) {
        line(w, &format!("type = \"{name}\""));
    }
    if let Some(why) = &object.contradiction {
        line(w, &format!("contradiction = {}", quoted(why)));
    }
    line(w, "entries = [");
    let mut before: Vec<Entry> = Vec::new();
    for entry in &object.entries {
        line(w, &format!("  {},", row(object.index, entry, &before)));
        before.push(entry.clone());
    }
    line(w, "]");
}

/// `[sub-index, type, access, value, name]`, followed by properties that do not have their default.
fn row(index: u16, entry: &Entry, before: &[Entry]) -> String {
    if entry.data_type == DataType::GAP {
        let (sub, bits) = (entry.sub, entry.bits);
        return format!("{{ gaps = [{sub}, {sub}], bits = {bits} }}");
    }
    let kind = entry.data_type.name().unwrap_or("OCTET_STRING");
    let value = value(index, entry);
    let mut more = Vec::new();
    if entry.offset != rows::next_offset(index, entry.sub, before) {
        more.push(format!("offset = {}", entry.offset));
    }
    let follows = entry.data_type.bits().unwrap_or(8 * written_len(entry) as u16);
    if entry.bits != follows {
        more.push(format!("bits = {}", entry.bits));
    }
    let more = match more.is_empty() {
        true => String::new(),
        false => format!(", {{ {} }}", more.join(", ")),
    };
    format!(
        "[0x{:02X}, \"{kind}\", \"{}\", {value}, {}{more}]",
        entry.sub,
        access(entry.access),
        quoted(&entry.name)
    )
}

/// Bytes of a text without trailing zeros; all bytes of other values.
fn written_len(entry: &Entry) -> usize {
    match as_text(entry) {
        Some(text) => text.len(),
        None => entry.default.len(),
    }
}

fn as_text(entry: &Entry) -> Option<&str> {
    if entry.data_type != DataType::VISIBLE_STRING {
        return None;
    }
    let end = entry.default.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let text = std::str::from_utf8(&entry.default[..end]).ok()?;
    (!text.starts_with(rows::HEX)).then_some(text)
}

fn value(index: u16, entry: &Entry) -> String {
    if let Some(text) = as_text(entry) {
        return quoted(text);
    }
    if unknown::is_unknown(entry) {
        return format!("\"{}\"", rows::UNKNOWN);
    }
    let bytes = &entry.default[..];
    let bits = entry.data_type.bits().unwrap_or(0);
    let number = bytes.iter().rev().fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte));
    // A value that is too large for its type can only be written as bytes.
    let is_number = !matches!(entry.data_type, DataType::REAL32 | DataType::REAL64)
        && bits > 0
        && bytes.len() == usize::from(bits.div_ceil(8))
        && (bits == 64 || number >> bits == 0);
    let is_sync = matches!(index, object::OUTPUT_PARAMETER | object::INPUT_PARAMETER);
    match is_number {
        true if rows::is_signed(entry.data_type) => {
            let shift = 64 - u32::from(bits);
            ((number << shift) as i64 >> shift).to_string()
        }
        true if is_sync && entry.data_type == DataType::UNSIGNED32 && number > 0 => {
            duration(Nanos(number as i64))
        }
        true if number < 256 => number.to_string(),
        true if i64::try_from(number).is_ok() => format!("{number:#x}"),
        _ => {
            let pairs: Vec<_> = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
            format!("\"{}{}\"", rows::HEX, pairs.join(" "))
        }
    }
}

fn has_no_times(mode: &OpMode) -> bool {
    [mode.sync0_cycle, mode.sync0_shift, mode.sync1_shift].iter().all(|time| *time == Nanos::ZERO)
}

/// `[[opmode]]`, since the short rows have no times.
fn op_modes(w: &mut String, draft: &Draft<'_>) {
    for mode in &draft.op_modes {
        line(w, "\n[[opmode]]");
        line(w, &format!("name = {}", quoted(&mode.name)));
        if !mode.description.is_empty() {
            line(w, &format!("description = {}", quoted(&mode.description)));
        }
        line(w, &format!("assign_activate = {:#06x}", mode.assign_activate));
        for (name, factor) in
            [("sync0_factor", mode.sync0_factor), ("sync1_factor", mode.sync1_factor)]
        {
            if factor != 0 {
                line(w, &format!("{name} = {factor}"));
            }
        }
        for (name, time) in [
            ("sync0_cycle", mode.sync0_cycle),
            ("sync0_shift", mode.sync0_shift),
            ("sync1_shift", mode.sync1_shift),
        ] {
            if time != Nanos::ZERO {
                line(w, &format!("{name} = {}", duration(time)));
            }
        }
    }
}

fn startup(w: &mut String, draft: &Draft<'_>) {
    for Placed { value, .. } in &draft.startup {
        let pairs: Vec<_> = value.data.iter().map(|byte| format!("{byte:02X}")).collect();
        let ObjectAddress { index, sub } = value.object;
        line(w, "\n[[startup]]");
        let transition = if value.transition == Transition::IP { "IP" } else { "PS" };
        line(w, &format!("transition = \"{transition}\""));
        line(w, &format!("object = \"{index:04X}:{sub:02X}\""));
        line(w, &format!("data = \"{}\"", pairs.join(" ")));
        if value.complete_access {
            line(w, "complete_access = true");
        }
    }
}

fn times(w: &mut String, draft: &Draft<'_>) {
    let times = &draft.times;
    if draft.behaviour.value.device_emulation {
        return;
    }
    line(w, "\n[times]");
    line(w, &format!("reaction = {}", duration(times.reaction)));
    for (name, time) in [
        ("calc_and_copy", times.calc_and_copy),
        ("application", Some(times.application)),
        ("input_copy", times.input_copy),
        ("acknowledge", times.acknowledge),
    ] {
        if let Some(time) = time {
            line(w, &format!("{name} = {}", duration(time)));
        }
    }
}

/// Behaviour that differs from that of most devices.
fn behaviour(w: &mut String, draft: &Draft<'_>) {
    let behaviour = &draft.behaviour.value;
    let mut lines = Vec::new();
    for (name, is, usual) in [
        ("watchdog_must_agree", behaviour.watchdog_must_agree, true),
        ("application_on_sync1", behaviour.application_on_sync1, false),
        ("unit_without_pulses", behaviour.unit_without_pulses, false),
        ("device_emulation", behaviour.device_emulation, false),
        ("ignores_sync1", behaviour.ignores_sync1, false),
    ] {
        if is != usual {
            lines.push(format!("{name} = {is}"));
        }
    }
    if !lines.is_empty() {
        line(w, "\n[behaviour]");
        lines.iter().for_each(|text| line(w, text));
    }
}

/// `[[assumed]]`, for the items in the file.
fn assumed(w: &mut String, draft: &Draft<'_>, generated: &[Object]) {
    for assumed in &draft.assumed {
        let Some(what) = assumed_item(&assumed.item.value, draft, generated) else { continue };
        line(w, "\n[[assumed]]");
        line(w, &format!("what = \"{what}\""));
        line(w, &format!("why = {}", quoted(&assumed.why)));
    }
}

/// The name of an assumption in a profile; `None` if it has none.
fn assumed_item(item: &Item, draft: &Draft<'_>, generated: &[Object]) -> Option<String> {
    let known = |text: &str| {
        let (text, suffix) = match text.strip_suffix(" access") {
            Some(text) => (text, " access"),
            None => (text, ""),
        };
        let entry = rows::parse_object(text)?;
        let object = draft.objects.iter().find(|object| object.index == entry.index)?;
        let found = object.entries.iter().find(|found| found.sub == entry.sub)?;
        let ObjectAddress { index, sub } = entry;
        // An unknown value is listed automatically.
        (!suffix.is_empty() || !unknown::is_unknown(found))
            .then(|| format!("{index:04X}:{sub:02X}{suffix}"))
    };
    let in_draft = |index: u16| draft.objects.iter().chain(generated).any(|o| o.index == index);
    match item {
        Item::Key(name, _) if name == "ESC" => Some("esc.chip".to_owned()),
        Item::Key(name, _) => known(name).or_else(|| match &name[..] {
            // The CPU needs this time although the device does not state it.
            CALC_AND_COPY => Some("times.calc_and_copy".to_owned()),
            INPUT_COPY => Some("times.input_copy".to_owned()),
            key if KEYS.contains(&key) => Some(key.to_owned()),
            _ => None,
        }),
        Item::Object(index) => in_draft(*index).then(|| format!("{index:04X}")),
        Item::Entries { index, first, last, property } => {
            let property = match property {
                Property::Value => "",
                Property::Access => " access",
                Property::Offset => " offset",
            };
            let range = if first == last { String::new() } else { format!("-{last:02X}") };
            in_draft(*index).then(|| format!("{index:04X}:{first:02X}{range}{property}"))
        }
    }
}

/// Names of the times of the objects in assumptions.
const CALC_AND_COPY: &str = "0x1C32:06";
const INPUT_COPY: &str = "0x1C33:06";
/// Keys that are written for each device for which they are assumed.
const KEYS: [&str; 9] = [
    "times.reaction",
    "times.calc_and_copy",
    "times.application",
    "times.input_copy",
    "identity.device_type",
    "identity.hardware_version",
    "identity.software_version",
    "esc.pulse",
    "modes",
];

/// Access as text: `ro`, `rw preop tx` and so on.
fn access(access: Access) -> String {
    let writes = access.has_any(Access::WRITE);
    let mut words = vec![match (access.has(Access::READ), writes) {
        (true, true) => "rw",
        (false, true) => "wo",
        _ => "ro",
    }];
    if writes && !access.has(Access::WRITE) {
        for (right, word) in [
            (Access::WRITE_PREOP, "preop"),
            (Access::WRITE_SAFEOP, "safeop"),
            (Access::WRITE_OP, "op"),
        ] {
            words.extend(access.has(right).then_some(word));
        }
    }
    for (right, word) in [
        (Access::RX_MAPPABLE, "rx"),
        (Access::TX_MAPPABLE, "tx"),
        (Access::BACKUP, "backup"),
        (Access::SETTINGS, "settings"),
    ] {
        words.extend(access.has(right).then_some(word));
    }
    words.join(" ")
}

/// A duration in the notation of files: `"62.5us"`.
fn duration(time: Nanos) -> String {
    format!("\"{time}\"").replace(' ', "")
}

/// A text as a TOML string.
fn quoted(text: &str) -> String {
    let mut all = String::from("\"");
    for letter in text.chars() {
        match letter {
            '"' => all.push_str("\\\""),
            '\\' => all.push_str("\\\\"),
            control if control.is_control() => {
                _ = write!(all, "\\u{:04X}", u32::from(control));
            }
            other => all.push(other),
        }
    }
    all.push('"');
    all
}

/// File names may contain any character, but a comment has one line.
fn comment(w: &mut String, text: &str) {
    let one_line = text.replace(char::is_control, " ");
    line(w, &format!("# {one_line}"));
}

fn line(w: &mut String, text: &str) {
    w.push_str(text);
    w.push('\n');
}
