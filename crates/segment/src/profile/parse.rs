//! From the file to a draft.

use std::ops::RangeInclusive;

use isocat_descriptions::document::{FileError, Source, Table, Value};
use isocat_sim::{Overrun, Unevenness};
use isocat_subdevice::description::{Behaviour, LossCodes, Mailbox, Measured, MissedEvents};
use isocat_subdevice::{MAX_MAILBOX, MAX_PROCESS_DATA};
use isocat_sync::{SupportedTypes, SyncMode};
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use isocat_wire::sii::MailboxArea;
use isocat_wire::time::Nanos;

use super::draft::{Area, Assumed, Draft, Esc, Item, Pdo, PdoEntry, Placed, Property, Times};
use super::rows::{objects, parse_access, parse_hex, parse_object, parse_type};
use super::{ApplicationKind, CHIPS, Deviation, Identity, OpMode};

/// Reads the file.
pub(super) fn parse(source: Source<'_>) -> Result<Draft<'_>, FileError> {
    let document = source.parse()?;
    let root = Table::root(source, &document);
    root.allow(&[
        "id",
        "name",
        "vendor",
        "application",
        "identity",
        "esc",
        "mailbox",
        "modes",
        "outputs",
        "inputs",
        "object",
        "opmode",
        "opmodes",
        "times",
        "behaviour",
        "assumed",
        "deviation",
    ])?;
    let text = |key, expected| Ok(root.required(key, expected)?.name(expected)?.to_owned());
    let section = |key, expected| root.required(key, expected)?.table();
    let identity = section("identity", "a table with vendor_id, product_code and revision")?;
    identity.allow(&[
        "vendor_id",
        "product_code",
        "revision",
        "serial",
        "device_type",
        "hardware_version",
        "software_version",
    ])?;
    let number = |key, expected| identity.required(key, expected)?.u32();
    let version = |key| match identity.value(key) {
        Some(value) => value.name("a version in quotes").map(str::to_owned),
        None => Ok("1.0".to_owned()),
    };
    let esc = esc(section("esc", "a table with the ESC's chip")?)?;
    let mailbox = root.table("mailbox")?.map(mailbox).transpose()?;
    let has_mailbox = mailbox.is_some();
    let area = |key, sm, pdos| {
        root.table(key)?.map(|table| area(table, sm, pdos, has_mailbox)).transpose()
    };
    let device_type = match identity.value("device_type") {
        None if !has_mailbox => 0,
        _ => number("device_type", "the profile's number, object 0x1000")?,
    };
    Ok(Draft {
        source,
        id: text("id", "the name that segment files use")?,
        name: text("name", "the product's name")?,
        vendor: text("vendor", "the maker's name")?,
        application: root
            .required("application", "\"drive\" or \"io\"")?
            .one_of(&[("drive", ApplicationKind::Drive), ("io", ApplicationKind::Io)])?,
        identity: Identity {
            vendor_id: number("vendor_id", "the maker's number, object 0x1018:01")?,
            product_code: number("product_code", "the product's number, object 0x1018:02")?,
            revision: number("revision", "the revision, object 0x1018:03")?,
            serial: identity.value("serial").map_or(Ok(0), |value| value.u32())?,
        },
        device_type,
        hardware_version: version("hardware_version")?,
        software_version: version("software_version")?,
        esc,
        mailbox,
        modes: modes(root, has_mailbox)?,
        outputs: area("outputs", 2, 0x1600..=0x17FF)?,
        inputs: area("inputs", 3, 0x1A00..=0x1BFF)?,
        objects: objects(root.tables("object")?)?,
        op_modes: op_modes(root)?,
        times: times(section("times", "a table with application and others")?)?,
        behaviour: behaviour(root.table("behaviour")?)?,
        assumed: assumed(root)?,
        deviations: deviations(root)?,
        eeprom: None,
    })
}

fn esc(table: Table<'_>) -> Result<Esc, FileError> {
    table.allow(&["chip", "sync_unit", "pulse", "alias"])?;
    let expected = "the name of an ESC";
    let pulse = match table.value("pulse") {
        Some(value) => {
            let pulse = value.duration(Nanos::ZERO..=Nanos(i64::from(u16::MAX) * 10))?;
            if pulse.0 % 10 != 0 {
                return Err(value.error(format!("pulse = {pulse}: expected whole 10 ns")));
            }
            pulse
        }
        None => Nanos::micros(10),
    };
    Ok(Esc {
        at: table.at,
        chip: table.required("chip", expected)?.one_of(&CHIPS.map(|chip| (chip.0, chip)))?,
        sync_unit: table
            .required("sync_unit", "whether SYNC0 can be generated, true or false")?
            .boolean()?,
        pulse,
        alias: table.value("alias").map_or(Ok(0), |value| value.u16())?,
    })
}

fn mailbox(table: Table<'_>) -> Result<Placed<Mailbox>, FileError> {
    table.allow(&["receive", "send"])?;
    let area = |key| {
        let area = table.required(key, "{ start = 0x1000, length = 128 }")?.table()?;
        area.allow(&["start", "length"])?;
        Ok(MailboxArea {
            start: area.required("start", "an address")?.integer(0x1000..=0xFFFF)? as u16,
            // Two headers, an SDO of 8 bytes and room to segment; what the stack can hold.
            length: area.required("length", "bytes")?.integer(32..=MAX_MAILBOX as i64)? as u16,
        })
    };
    Ok(Placed { at: table.at, value: Mailbox { receive: area("receive")?, send: area("send")? } })
}

/// What a device works by that has no mailbox to state it in 0x1C32:04.
fn modes(root: Table<'_>, has_mailbox: bool) -> Result<Option<Placed<SupportedTypes>>, FileError> {
    if has_mailbox {
        return match root.value("modes") {
            Some(value) => Err(value.error(
                "modes is given beside [mailbox]; expected 0x1C32:04 and 0x1C33:04 to state them",
            )),
            None => Ok(None),
        };
    }
    let expected = "what a device without [mailbox] works by, such as modes = [\"sm\"]";
    let value = root.required("modes", expected)?;
    let names = SyncMode::ALL.map(|mode| (mode.name(), mode));
    let mut types = SupportedTypes(0);
    for mode in value.array("modes")? {
        // In 0x1C32:04 the modes have the bits of their order.
        types.0 |= 1 << mode.one_of(&names)? as u16;
    }
    if types.0 == 0 {
        return Err(value.error(format!("modes is empty; expected {expected}")));
    }
    Ok(Some(Placed { at: value.at(), value: types }))
}

fn area(
    table: Table<'_>,
    sync_manager: u8,
    pdos: RangeInclusive<i64>,
    has_mailbox: bool,
) -> Result<Area, FileError> {
    // Without a mailbox there is no 0x1C12 or 0x1C13 to be written.
    table.allow(match has_mailbox {
        true => &["start", "length", "access", "slots", "default", "recommended", "pdo", "pdos"],
        false => &["start", "length", "default", "pdo", "pdos"],
    })?;
    let list = |key| {
        table.value(key).map(|value| {
            let indices = value.array("PDO indices")?;
            let index = |value: &Value<'_>| {
                Ok(Placed { at: value.at(), value: value.integer(pdos.clone())? as u16 })
            };
            indices.iter().map(index).collect::<Result<Vec<_>, FileError>>()
        })
    };
    let mut definitions = table
        .tables("pdo")?
        .into_iter()
        .map(|table| pdo(table, pdos.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    if let Some(rows) = table.value("pdos") {
        for row in rows.array("rows [PDO, bits]")? {
            definitions.push(bare_pdo(&row, pdos.clone())?);
        }
    }
    let default = list("default").unwrap_or(Ok(Vec::new()))?;
    let recommended = list("recommended").unwrap_or_else(|| Ok(default.clone()))?;
    let slots = match table.value("slots") {
        Some(value) => value.integer(1..=254)? as u8,
        None => definitions.len().max(default.len()).clamp(1, 254) as u8,
    };
    let access = match has_mailbox {
        true => {
            let expected = "who may write the PDO assignment, such as \"ro\"";
            parse_access(&table.required("access", expected)?)?
        }
        false => Access::READ,
    };
    Ok(Area {
        at: table.at,
        sync_manager,
        start: table.required("start", "an address")?.integer(0x1000..=0xFFFF)? as u16,
        length: table
            .required("length", "the most bytes of one buffer")?
            .integer(1..=MAX_PROCESS_DATA as i64)? as u16,
        access,
        slots,
        default,
        recommended,
        pdos: definitions,
    })
}

fn pdo(table: Table<'_>, indices: RangeInclusive<i64>) -> Result<Pdo, FileError> {
    table.allow(&["index", "name", "entries"])?;
    let entries = table.required("entries", "rows [object, type, name]")?;
    Ok(Pdo {
        at: table.at,
        index: table.required("index", "the PDO's index")?.integer(indices)? as u16,
        name: table.required("name", "the PDO's name")?.name("the PDO's name")?.to_owned(),
        entries: entries.array("rows")?.iter().map(pdo_entry).collect::<Result<_, _>>()?,
    })
}

/// A PDO of which only the length matters: `[0x1A00, 32]`.
fn bare_pdo(row: &Value<'_>, indices: RangeInclusive<i64>) -> Result<Pdo, FileError> {
    let cells = row.array("a PDO and its bits")?;
    let [index, bits] = cells[..] else { return Err(row.unexpected("a row [PDO, bits]")) };
    let (index, mut left) = (index.integer(indices)? as u16, bits.integer(0..=16_000)?);
    let mut entries = Vec::new();
    while left > 0 {
        let bits = left.min(64) as u8;
        left -= i64::from(bits);
        let (data_type, name) = (DataType::GAP, String::new());
        entries.push(PdoEntry { at: row.at(), object: None, data_type, bits, name });
    }
    let direction = if index < 0x1800 { "RxPDO" } else { "TxPDO" };
    Ok(Pdo { at: row.at(), index, name: format!("{direction} 0x{index:04X}"), entries })
}

fn pdo_entry(row: &Value<'_>) -> Result<PdoEntry, FileError> {
    if row.is_table() {
        let table = row.table()?;
        table.allow(&["pad"])?;
        let bits = table.required("pad", "bits of padding")?.integer(1..=64)? as u8;
        let (data_type, name) = (DataType::GAP, String::new());
        return Ok(PdoEntry { at: row.at(), object: None, data_type, bits, name });
    }
    let expected = "a row such as [\"6040:00\", \"UNSIGNED16\", \"Controlword\"] or { pad = 8 }";
    let cells = row.array("object, type and name")?;
    let [object, data_type, name] = cells[..] else { return Err(row.unexpected(expected)) };
    let text = object.string("an object such as \"6040:00\"")?;
    let address = parse_object(text).ok_or_else(|| {
        object.error(format!("\"{text}\": expected an object such as \"6040:00\""))
    })?;
    let kind = parse_type(&data_type)?;
    let bits = kind.bits().filter(|bits| *bits <= 64).ok_or_else(|| {
        data_type.error("a type without a fixed length can't be mapped; expected e.g. UNSIGNED16")
    })?;
    Ok(PdoEntry {
        at: row.at(),
        object: Some(address),
        data_type: kind,
        bits: bits as u8,
        name: name.name("the entry's name")?.to_owned(),
    })
}

/// Reads `[[opmode]]`, or the short form of many: rows [name, description, assign_activate, factors].
fn op_modes(root: Table<'_>) -> Result<Vec<OpMode>, FileError> {
    let mut all = root.tables("opmode")?.into_iter().map(op_mode).collect::<Result<Vec<_>, _>>()?;
    let Some(rows) = root.value("opmodes") else { return Ok(all) };
    for row in rows.array("rows")? {
        let cells = row.array("name, description, word and two factors")?;
        let [name, description, word, sync0, sync1] = cells[..] else {
            return Err(row.unexpected("[name, description, assign_activate, sync0, sync1]"));
        };
        let factor = |value: Value<'_>| value.integer(i64::from(i16::MIN)..=i64::from(i16::MAX));
        all.push(OpMode {
            name: name.name("the mode's name")?.to_owned(),
            description: description.string("a description")?.to_owned(),
            assign_activate: word.u16()?,
            sync0_factor: factor(sync0)? as i16,
            sync1_factor: factor(sync1)? as i16,
        });
    }
    Ok(all)
}

fn op_mode(table: Table<'_>) -> Result<OpMode, FileError> {
    table.allow(&["name", "description", "assign_activate", "sync0_factor", "sync1_factor"])?;
    let factor = |key| match table.value(key) {
        Some(value) => value.integer(i64::from(i16::MIN)..=i64::from(i16::MAX)).map(|n| n as i16),
        None => Ok(0),
    };
    Ok(OpMode {
        name: table.required("name", "the mode's name")?.name("the mode's name")?.to_owned(),
        description: match table.value("description") {
            Some(value) => value.name("a description")?.to_owned(),
            None => String::new(),
        },
        assign_activate: table
            .required("assign_activate", "the word for registers 0x0980 and 0x0981")?
            .u16()?,
        sync0_factor: factor("sync0_factor")?,
        sync1_factor: factor("sync1_factor")?,
    })
}

fn times(table: Table<'_>) -> Result<Times, FileError> {
    table.allow(&[
        "reaction",
        "calc_and_copy",
        "application",
        "input_copy",
        "jitter",
        "latency",
        "variation",
        "overrun",
        "timer_jitter",
    ])?;
    let time =
        |key, least| table.value(key).map(|value| value.duration(least..=LONGEST_STEP)).transpose();
    let needed = |key| {
        let expected = "a duration with its unit, such as \"20us\"";
        table.required(key, expected)?.duration(Nanos(1)..=LONGEST_STEP)
    };
    Ok(Times {
        at: table.at,
        reaction: needed("reaction")?,
        calc_and_copy: time("calc_and_copy", Nanos(1))?,
        application: needed("application")?,
        input_copy: time("input_copy", Nanos(1))?,
        jitter: time("jitter", Nanos::ZERO)?.unwrap_or(Nanos::ZERO),
        unevenness: Unevenness {
            latency: time("latency", Nanos::ZERO)?.unwrap_or(Nanos::ZERO),
            variation: match table.value("variation") {
                Some(value) => value.integer(0..=100)? as u8,
                None => 0,
            },
            overrun: table.table("overrun")?.map(overrun).transpose()?,
            timer_jitter: time("timer_jitter", Nanos::ZERO)?.unwrap_or(Nanos::ZERO),
        },
    })
}

fn overrun(table: Table<'_>) -> Result<Overrun, FileError> {
    table.allow(&["one_in", "by"])?;
    let count = table.required("one_in", "in how many cycles it happens once")?;
    let by = table.required("by", "a duration with its unit, such as \"200us\"")?;
    Ok(Overrun {
        one_in: count.integer(1..=i64::from(u32::MAX))? as u32,
        by: by.duration(Nanos(1)..=LONGEST_STEP)?,
    })
}

fn behaviour(table: Option<Table<'_>>) -> Result<Placed<Behaviour>, FileError> {
    let mut behaviour = Behaviour::default();
    let Some(table) = table else { return Ok(Placed { at: 0, value: behaviour }) };
    table.allow(&[
        "missed_events",
        "sync_error_limit",
        "safeop_to_op_timeout",
        "free_run_period",
        "maximum_cycle_time",
        "watchdog_must_agree",
        "hide_unused_sync_objects",
        "identification",
        "polls_outputs",
        "application_on_sync1",
        "subordinated_sync0_cycle",
        "cycle_granularity",
        "loss_codes",
        "measures",
        "output_toggle",
    ])?;
    if let Some(value) = table.value("missed_events") {
        behaviour.missed_events = value.one_of(&[
            ("counted", MissedEvents::Counted),
            ("slave-stack-code", MissedEvents::SlaveStackCode),
            ("balance", MissedEvents::Balance),
        ])?;
    }
    if let Some(value) = table.value("sync_error_limit") {
        behaviour.sync_error_limit = value.integer(1..=i64::from(u16::MAX))? as u16;
    }
    if let Some(value) = table.value("safeop_to_op_timeout") {
        behaviour.safeop_to_op_timeout =
            value.duration(Nanos::millis(10)..=Nanos::millis(60_000))?;
    }
    if let Some(value) = table.value("free_run_period") {
        behaviour.free_run_period = value.duration(Nanos::micros(10)..=LONGEST_STEP)?;
    }
    if let Some(value) = table.value("maximum_cycle_time") {
        behaviour.maximum_cycle_time = value.duration(Nanos(1)..=Nanos::from_u32(u32::MAX))?;
    }
    if let Some(value) = table.value("watchdog_must_agree") {
        behaviour.watchdog_must_agree = value.boolean()?;
    }
    if let Some(value) = table.value("hide_unused_sync_objects") {
        behaviour.hide_unused_sync_objects = value.boolean()?;
    }
    if let Some(value) = table.value("identification") {
        behaviour.identification = value.u16()?;
    }
    for (key, flag) in [
        ("polls_outputs", &mut behaviour.polls_outputs),
        ("application_on_sync1", &mut behaviour.application_on_sync1),
    ] {
        if let Some(value) = table.value(key) {
            *flag = value.boolean()?;
        }
    }
    for (key, time) in [
        ("subordinated_sync0_cycle", &mut behaviour.subordinated_sync0_cycle),
        ("cycle_granularity", &mut behaviour.cycle_granularity),
    ] {
        if let Some(value) = table.value(key) {
            *time = value.duration(Nanos(1)..=Nanos::from_u32(u32::MAX))?;
        }
    }
    if let Some(value) = table.value("loss_codes") {
        behaviour.loss_codes = value.one_of(&[
            ("slave-stack-code", LossCodes::SLAVE_STACK_CODE),
            ("drive", LossCodes::DRIVE),
        ])?;
    }
    if let Some(value) = table.value("measures") {
        behaviour.measured = measured(&value)?;
    }
    if let Some(value) = table.value("output_toggle") {
        let bits = 8 * MAX_PROCESS_DATA as i64;
        behaviour.output_toggle = Some(value.integer(0..=bits - 1)? as u16);
    }
    Ok(Placed { at: table.at, value: behaviour })
}

fn measured(list: &Value<'_>) -> Result<Measured, FileError> {
    let mut measured = Measured::NOTHING;
    for item in list.array("quantities such as \"calc-and-copy\"")? {
        let what: fn(&mut Measured) -> &mut bool = item.one_of(&[
            ("cycle", (|m| &mut m.cycle) as fn(&mut Measured) -> &mut bool),
            ("shift", |m| &mut m.shift),
            ("minimum-cycle", |m| &mut m.minimum_cycle),
            ("calc-and-copy", |m| &mut m.calc_and_copy),
            ("delay", |m| &mut m.delay),
        ])?;
        *what(&mut measured) = true;
    }
    Ok(measured)
}

fn assumed(root: Table<'_>) -> Result<Vec<Assumed>, FileError> {
    let mut all = Vec::new();
    for table in root.tables("assumed")? {
        table.allow(&["what", "why"])?;
        let expected = "the reason for this value";
        let why = table.required("why", expected)?;
        let why = match why.string(expected)? {
            "" => return Err(why.error(format!("why is empty; expected {expected}"))),
            text => text,
        };
        let expected = "an object such as \"1C32:06\" or a key such as \"identity.revision\"";
        let what = table.required("what", expected)?;
        let items = match what.as_string() {
            Some(_) => vec![what],
            None => what.array("objects or keys")?,
        };
        for value in items {
            let text = value.name(expected)?;
            let item = item(root, text).ok_or_else(|| {
                value
                    .error(format!("the file has no key \"{text}\" to assume; expected {expected}"))
            })?;
            let item = Placed { at: value.at(), value: item };
            all.push(Assumed { item, why: why.to_owned() });
        }
    }
    Ok(all)
}

fn deviations(root: Table<'_>) -> Result<Vec<Deviation>, FileError> {
    let mut all: Vec<Deviation> = Vec::new();
    for table in root.tables("deviation")? {
        table.allow(&["rule", "places", "why"])?;
        let expected = "a rule of isocat conform, such as \"OBJ-04\"";
        let rule = table.required("rule", expected)?;
        let id = rule.name(expected)?;
        if all.iter().any(|other| other.rule == id) {
            return Err(rule.error(format!("rule {id} stands twice; expected one deviation of it")));
        }
        let expected = "objects or entries, such as [\"1C32:05\", \"1C33\"]";
        let places = table.required("places", expected)?.array(expected)?;
        let place = |value: &Value<'_>| {
            let text = value.name(expected)?;
            match (parse_object(text), parse_hex(text, 4)) {
                (Some(entry), _) => Ok(entry.to_string()),
                (None, Some(index)) => Ok(format!("0x{index:04X}")),
                (None, None) => Err(value.error(format!("\"{text}\"; expected {expected}"))),
            }
        };
        let places = places.iter().map(place).collect::<Result<_, FileError>>()?;
        let expected = "what the maker publishes instead";
        let why = table.required("why", expected)?.name(expected)?.to_owned();
        all.push(Deviation { rule: id.to_owned(), at: rule.place(), places, why });
    }
    Ok(all)
}

/// What a text of `[[assumed]]` names; objects are looked up later, when all of them are known.
fn item(root: Table<'_>, text: &str) -> Option<Item> {
    let (text, property) = match text.split_once(' ') {
        Some((text, "access")) => (text, Property::Access),
        Some((text, "offset")) => (text, Property::Offset),
        _ => (text, Property::Value),
    };
    if let Some(index) = parse_hex(text, 4) {
        return Some(Item::Object(index as u16));
    }
    if let Some((object, last)) = text.split_once('-')
        && let (Some(first), Some(last)) = (parse_object(object), parse_hex(last, 2))
    {
        let ObjectAddress { index, sub } = first;
        return Some(Item::Entries { index, first: sub, last: last as u8, property });
    }
    if let Some(ObjectAddress { index, sub }) = parse_object(text) {
        return Some(Item::Entries { index, first: sub, last: sub, property });
    }
    root.lookup(text).map(|value| Item::Key(text.to_owned(), value))
}

const LONGEST_STEP: Nanos = Nanos::millis(1_000);
