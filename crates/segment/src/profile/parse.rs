//! Reads the file into a draft.

use isocat_descriptions::document::section::{Keys, Row};
use isocat_descriptions::document::{FileError, Source, Table, Value};
use isocat_esc::chip::Chip;
use isocat_maindevice::WatchdogRegisters;
use isocat_sim::{Overrun, Unevenness};
use isocat_subdevice::description::{Behaviour, Mailbox, Measured, Speaks};
use isocat_sync::{SupportedTypes, SyncMode};
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use isocat_wire::sii::{Header, MailboxArea};
use isocat_wire::time::Nanos;

use super::draft::{Area, Assumed, Draft, Esc, Item, Pdo, PdoEntry, Placed, Property, Times};
use super::rows::{bytes_of, objects, parse_access, parse_hex, parse_object, parse_type};
use super::{Deviation, Identity, OpMode, Startup, keys, ports};
use crate::chips;

/// Reads the file.
pub(super) fn parse(source: Source<'_>) -> Result<Draft<'_>, FileError> {
    let document = source.parse()?;
    let file = Table::root(source, &document);
    let root = Keys::open(file, &keys::FILE)?;
    let identity = root.required_table("identity")?;
    let esc = esc(&root.required_table("esc")?)?;
    let mailbox = root.table("mailbox")?.map(|keys| mailbox(&keys)).transpose()?;
    let has_mailbox = mailbox.is_some();
    let (mailbox, protocols) = mailbox.unzip();
    let behaviour = behaviour(&root.table_or_empty("behaviour")?)?;
    let area = |key, bare| root.table(key)?.map(|keys| area(&keys, bare, has_mailbox)).transpose();
    let device_type = match identity.value("device_type") {
        None if !has_mailbox => 0,
        _ => identity.get("device_type")?,
    };
    Ok(Draft {
        source,
        id: root.get("id")?,
        name: root.get("name")?,
        vendor: root.get("vendor")?,
        application: root.choice("application", &keys::APPLICATIONS)?,
        identity: Identity {
            vendor_id: identity.get("vendor_id")?,
            product_code: identity.get("product_code")?,
            revision: identity.get("revision")?,
            serial: identity.get("serial")?,
        },
        device_type,
        hardware_version: identity.get("hardware_version")?,
        software_version: identity.get("software_version")?,
        esc,
        mailbox,
        protocols: protocols.unwrap_or(0),
        modes: modes(&root, has_mailbox)?,
        outputs: area("outputs", &keys::RX_PDO_ROW)?,
        inputs: area("inputs", &keys::TX_PDO_ROW)?,
        objects: objects(root.tables("object")?)?,
        op_modes: op_modes(&root)?,
        startup: startup(&root)?,
        parameters: Vec::new(),
        times: match root.table("times")? {
            None if behaviour.value.device_emulation => Times::none(behaviour.at),
            _ => times(&root.required_table("times")?)?,
        },
        behaviour,
        dynamic_times: root.table_or_empty("behaviour")?.get("dynamic_times")?,
        assumed: assumed(&root, file)?,
        deviations: deviations(&root)?,
        eeprom: None,
    })
}

fn esc(keys: &Keys<'_>) -> Result<Esc, FileError> {
    Ok(Esc {
        at: keys.at(),
        chip: chip(keys)?,
        sync_unit: keys.get("sync_unit")?,
        pulse: keys.get("pulse")?,
        alias: keys.get("alias")?,
        clock_tolerance: keys.find("clock_tolerance")?,
        watchdog: WatchdogRegisters {
            divider: keys.find("watchdog_divider")?,
            pdi: keys.find("watchdog_pdi")?,
            process_data: keys.find("watchdog_process_data")?,
        },
    })
}

/// The chip, with the ports, drift loop, EEPROM and jitter of the file.
fn chip(keys: &Keys<'_>) -> Result<(&'static str, Chip), FileError> {
    let (name, chip) = keys.choice("chip", &keys::CHIPS)?;
    let chip = &Chip { ram_kib: keys.find("ram_kib")?.unwrap_or(chip.ram_kib), ..*chip };
    let Some(value) = keys.value("ports") else { return Ok((name, chips::measured(chip, keys)?)) };
    let letters: String = keys.get("ports")?;
    if let Some(letter) = letters.chars().find(|letter| !"YK ".contains(*letter)) {
        let message = format!("ports: \"{letter}\" is no kind of port; expected {}", keys::PORTS);
        return Err(value.error(message));
    }
    if letters.chars().count() > 4 || !letters.starts_with(['Y', 'K']) {
        let message = format!(
            "ports = \"{letters}\" has no port 0, or more than four ports; expected {}",
            keys::PORTS
        );
        return Err(value.error(message));
    }
    if letters.contains('K') && !chip.can_have_ebus() {
        let message =
            format!("ports = \"{letters}\" has EBUS, which {name} can't have; expected Y");
        return Err(value.error(message));
    }
    let chip = chip.with_ports(ports::descriptor(&letters));
    Ok((name, chips::measured(&chip, keys)?))
}

/// `[mailbox]`: its areas and its protocols.
fn mailbox(keys: &Keys<'_>) -> Result<(Placed<Mailbox>, u16), FileError> {
    let area = |key| {
        let area = keys.required_table(key)?;
        Ok(MailboxArea { start: area.get("start")?, length: area.get("length")? })
    };
    let protocols = match keys.value("protocols") {
        None => Header::COE,
        Some(list) => {
            let mut all = 0;
            for protocol in list.array("protocols such as \"CoE\"")? {
                all |= protocol.one_of(&keys::PROTOCOLS)?;
            }
            all
        }
    };
    let speaks = Speaks { protocols, drives: 0, parameters: &[] };
    let value = Mailbox { receive: area("receive")?, send: area("send")?, speaks };
    Ok((Placed { at: keys.at(), value }, protocols))
}

/// Modes of a device without mailbox, which cannot state them in 0x1C32:04.
fn modes(root: &Keys<'_>, has_mailbox: bool) -> Result<Option<Placed<SupportedTypes>>, FileError> {
    if has_mailbox {
        return match root.value("modes") {
            Some(value) => Err(value.error(
                "modes is given beside [mailbox]; expected 0x1C32:04 and 0x1C33:04 to state them",
            )),
            None => Ok(None),
        };
    }
    let value = root.required("modes")?;
    let mut types = SupportedTypes(0);
    for mode in value.array("modes")? {
        types.0 |= announcement(mode.one_of(&keys::MODES)?);
    }
    if types.0 == 0 {
        return Err(value.error(
            "modes is empty; expected what a device without [mailbox] works by, such as modes = [\"sm\"]",
        ));
    }
    Ok(Some(Placed { at: value.at(), value: types }))
}

/// The bits of 0x1C32:04 that announce a mode.
const fn announcement(mode: SyncMode) -> u16 {
    const SYNC0: u16 = 1 << 2;
    const SYNC1: u16 = 1 << 3;
    match mode {
        SyncMode::FreeRun => 1 << 0,
        SyncMode::SmSynchronous => 1 << 1,
        SyncMode::DcSync0 => SYNC0,
        SyncMode::DcShiftSync1 => SYNC0 | SYNC1,
        SyncMode::DcSync1 => SYNC1,
        SyncMode::DcSubordinated => SYNC1 | 1 << 4,
    }
}

/// `[outputs]` or `[inputs]`; `bare` is the form of the rows of its `pdos`.
fn area(keys: &Keys<'_>, bare: &'static Row, has_mailbox: bool) -> Result<Area, FileError> {
    let of_assignment = ["access", "slots", "recommended"];
    if let Some(key) = of_assignment.into_iter().find(|key| keys.value(key).is_some())
        && !has_mailbox
    {
        let message = format!(
            "{key} is given, but the PDO assignment of a device without mailbox is fixed; expected a table \
             [mailbox], or no {key}"
        );
        return Err(keys.error_at(key, message));
    }
    let list = |key| {
        let indices = keys.items(key, "PDO indices")?.into_iter();
        Ok(indices.map(|(place, value)| Placed { at: place.at(), value }).collect::<Vec<_>>())
    };
    let definitions = keys.tables("pdo")?;
    let mut definitions = definitions.iter().map(pdo).collect::<Result<Vec<_>, _>>()?;
    for row in keys.list("pdos", "rows [PDO, bits]")? {
        definitions.push(bare_pdo(&row, bare)?);
    }
    let default = list("default")?;
    let recommended = match keys.value("recommended") {
        Some(_) => list("recommended")?,
        None => default.clone(),
    };
    let usual = definitions.len().max(default.len()).clamp(1, 254) as u8;
    Ok(Area {
        at: keys.at(),
        sync_manager: keys.get("sync_manager")?,
        start: keys.get("start")?,
        length: keys.get("length")?,
        access: match has_mailbox {
            true => parse_access(&keys.required("access")?)?,
            false => Access::READ,
        },
        slots: keys.find("slots")?.unwrap_or(usual),
        default,
        recommended,
        pdos: definitions,
        further: Vec::new(),
    })
}

fn pdo(keys: &Keys<'_>) -> Result<Pdo, FileError> {
    let entries = keys.required("entries")?.array("rows")?;
    Ok(Pdo {
        at: keys.at(),
        index: keys.get("index")?,
        name: keys.get("name")?,
        entries: entries.iter().map(pdo_entry).collect::<Result<_, _>>()?,
    })
}

/// A PDO that is defined by its length only: `[0x1A00, 32]`.
fn bare_pdo(row: &Value<'_>, bare: &'static Row) -> Result<Pdo, FileError> {
    let cells = bare.open(row)?;
    let (index, mut left) = (cells.get("PDO")?, cells.get::<i64>("bits")?);
    let mut entries = Vec::new();
    while left > 0 {
        let bits = left.min(64) as u8;
        left -= i64::from(bits);
        entries.push(padding(row, bits));
    }
    let direction = if index < 0x1800 { "RxPDO" } else { "TxPDO" };
    Ok(Pdo { at: row.at(), index, name: format!("{direction} 0x{index:04X}"), entries })
}

fn padding(row: &Value<'_>, bits: u8) -> PdoEntry {
    let (data_type, name) = (DataType::GAP, String::new());
    PdoEntry { at: row.at(), object: None, data_type, bits, name }
}

fn pdo_entry(row: &Value<'_>) -> Result<PdoEntry, FileError> {
    if row.is_table() {
        let keys = Keys::open(row.table()?, &keys::PADDING)?;
        return Ok(padding(row, keys.get("pad")?));
    }
    let cells = keys::PDO_ROW.open(row)?;
    let object = cells.value("object");
    let text = object.string("an object such as \"6040:00\"")?;
    let address = parse_object(text).ok_or_else(|| {
        object.error(format!("\"{text}\": expected an object such as \"6040:00\""))
    })?;
    let data_type = cells.value("type");
    let kind = parse_type(&data_type)?;
    let given = cells.more()?.map(|more| more.get("bits")).transpose()?;
    let bits = given.or(kind.bits().filter(|bits| *bits <= 64)).ok_or_else(|| {
        data_type.error(
            "a type without a fixed length can't be mapped; expected e.g. UNSIGNED16, or bits behind the row",
        )
    })?;
    Ok(PdoEntry {
        at: row.at(),
        object: Some(address),
        data_type: kind,
        bits: bits as u8,
        name: cells.get("name")?,
    })
}

/// Reads `[[opmode]]`, or the short form: rows [name, description, assign_activate, factors].
fn op_modes(root: &Keys<'_>) -> Result<Vec<OpMode>, FileError> {
    let tables = root.tables("opmode")?;
    let mut all = tables.iter().map(op_mode).collect::<Result<Vec<_>, _>>()?;
    for row in root.list("opmodes", "rows")? {
        let cells = keys::OP_MODE_ROW.open(&row)?;
        all.push(OpMode {
            name: cells.get("name")?,
            description: cells.get("description")?,
            assign_activate: cells.get("assign_activate")?,
            sync0_factor: cells.get("sync0")?,
            sync1_factor: cells.get("sync1")?,
            sync0_cycle: Nanos::ZERO,
            sync0_shift: Nanos::ZERO,
            sync1_shift: Nanos::ZERO,
        });
    }
    Ok(all)
}

fn op_mode(keys: &Keys<'_>) -> Result<OpMode, FileError> {
    Ok(OpMode {
        name: keys.get("name")?,
        description: keys.find("description")?.unwrap_or_default(),
        assign_activate: keys.get("assign_activate")?,
        sync0_factor: keys.get("sync0_factor")?,
        sync1_factor: keys.get("sync1_factor")?,
        sync0_cycle: keys.get("sync0_cycle")?,
        sync0_shift: keys.get("sync0_shift")?,
        sync1_shift: keys.get("sync1_shift")?,
    })
}

fn startup(root: &Keys<'_>) -> Result<Vec<Placed<Startup>>, FileError> {
    let download = |keys: &Keys<'_>| {
        let object = keys.required("object")?;
        let text = object.string("an object such as \"8000:01\"")?;
        let data = keys.required("data")?;
        let digits = data.string("bytes such as \"0A FF\"")?;
        let bytes = bytes_of(digits).filter(|bytes| !bytes.is_empty()).ok_or_else(|| {
            data.error(format!("\"{digits}\": expected pairs of hex digits, as in \"0A FF\""))
        })?;
        let value = Startup {
            transition: keys.choice("transition", &keys::TRANSITIONS)?,
            object: parse_object(text).ok_or_else(|| {
                object.error(format!("\"{text}\": expected an object such as \"8000:01\""))
            })?,
            data: bytes,
            complete_access: keys.get("complete_access")?,
        };
        Ok(Placed { at: keys.at(), value })
    };
    root.tables("startup")?.iter().map(download).collect()
}

fn times(keys: &Keys<'_>) -> Result<Times, FileError> {
    Ok(Times {
        at: keys.at(),
        reaction: keys.get("reaction")?,
        calc_and_copy: keys.find("calc_and_copy")?,
        application: keys.get("application")?,
        input_copy: keys.find("input_copy")?,
        jitter: keys.get("jitter")?,
        acknowledge: keys.find("acknowledge")?,
        unevenness: Unevenness {
            latency: keys.get("latency")?,
            variation: keys.get("variation")?,
            overrun: keys.table("overrun")?.map(|keys| overrun(&keys)).transpose()?,
            timer_jitter: keys.get("timer_jitter")?,
        },
    })
}

fn overrun(keys: &Keys<'_>) -> Result<Overrun, FileError> {
    Ok(Overrun { one_in: keys.get("one_in")?, by: keys.get("by")? })
}

fn behaviour(keys: &Keys<'_>) -> Result<Placed<Behaviour>, FileError> {
    let usual = Behaviour::default();
    let value = Behaviour {
        missed_events: keys.choice("missed_events", &keys::MISSED_EVENTS)?,
        sync_error_limit: keys.get("sync_error_limit")?,
        safeop_to_op_timeout: keys.get("safeop_to_op_timeout")?,
        free_run_period: keys.get("free_run_period")?,
        maximum_cycle_time: keys.find("maximum_cycle_time")?.unwrap_or(usual.maximum_cycle_time),
        watchdog_must_agree: keys.get("watchdog_must_agree")?,
        hide_unused_sync_objects: keys.get("hide_unused_sync_objects")?,
        identification: keys.get("identification")?,
        polls_outputs: keys.get("polls_outputs")?,
        application_on_sync1: keys.get("application_on_sync1")?,
        unit_without_pulses: keys.get("unit_without_pulses")?,
        device_emulation: keys.get("device_emulation")?,
        ignores_sync1: keys.get("ignores_sync1")?,
        subordinated_sync0_cycle: keys
            .find("subordinated_sync0_cycle")?
            .unwrap_or(usual.subordinated_sync0_cycle),
        cycle_granularity: keys.find("cycle_granularity")?.unwrap_or(usual.cycle_granularity),
        loss_codes: keys.choice("loss_codes", &keys::LOSS_CODES)?,
        measured: keys.value("measures").map_or(Ok(usual.measured), |list| measured(&list))?,
        output_toggle: keys.find("output_toggle")?,
        ..usual
    };
    Ok(Placed { at: keys.at(), value })
}

fn measured(list: &Value<'_>) -> Result<Measured, FileError> {
    let mut measured = Measured::NOTHING;
    for item in list.array("quantities such as \"calc-and-copy\"")? {
        *item.one_of(&keys::MEASURED)?(&mut measured) = true;
    }
    Ok(measured)
}

fn assumed(root: &Keys<'_>, file: Table<'_>) -> Result<Vec<Assumed>, FileError> {
    let mut all = Vec::new();
    for keys in root.tables("assumed")? {
        let why: String = keys.get("why")?;
        if why.is_empty() {
            return Err(keys.error_at("why", "why is empty; expected the reason for this value"));
        }
        let expected = "an object such as \"1C32:06\" or a key such as \"identity.revision\"";
        let what = keys.required("what")?;
        let items = match what.as_string() {
            Some(_) => vec![what],
            None => what.array("objects or keys")?,
        };
        for value in items {
            let text = value.name(expected)?;
            let item = item(file, text).ok_or_else(|| {
                value
                    .error(format!("the file has no key \"{text}\" to assume; expected {expected}"))
            })?;
            let item = Placed { at: value.at(), value: item };
            all.push(Assumed { item, why: why.clone() });
        }
    }
    Ok(all)
}

fn deviations(root: &Keys<'_>) -> Result<Vec<Deviation>, FileError> {
    let mut all: Vec<Deviation> = Vec::new();
    for keys in root.tables("deviation")? {
        let expected = "a rule of isocat conform, such as \"OBJ-04\"";
        let rule = keys.required("rule")?;
        let id = rule.name(expected)?;
        if all.iter().any(|other| other.rule == id) {
            return Err(rule.error(format!("rule {id} stands twice; expected one deviation of it")));
        }
        let expected = "objects or entries, such as [\"1C32:05\", \"1C33\"]";
        let places = keys.required("places")?.array(expected)?;
        let place = |value: &Value<'_>| {
            let text = value.name(expected)?;
            match (parse_object(text), parse_hex(text, 4)) {
                (Some(entry), _) => Ok(entry.to_string()),
                (None, Some(index)) => Ok(format!("0x{index:04X}")),
                (None, None) => Err(value.error(format!("\"{text}\"; expected {expected}"))),
            }
        };
        let places = places.iter().map(place).collect::<Result<_, FileError>>()?;
        all.push(Deviation {
            rule: id.to_owned(),
            at: rule.place(),
            places,
            why: keys.get("why")?,
        });
    }
    Ok(all)
}

/// The item that a text of `[[assumed]]` names; objects are looked up later, when all of them are
/// known.
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
