//! Built-in profiles compared with lists that were written independently.

use isocat_subdevice::description::MissedEvents;
use isocat_subdevice::{Entry, Object};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::ObjectCode;
use isocat_wire::sii::{self, Header, PdoEntryRecord, PdoRecord, SmRecord, category};

use super::*;

mod published;
mod refused;
mod simple;
mod written;

fn object(profile: &Profile, index: u16) -> &'static Object {
    let objects = profile.description.objects;
    objects.iter().find(|object| object.index == index).unwrap_or_else(|| panic!("{index:#06x}"))
}

fn with_mailbox() -> impl Iterator<Item = Arc<Profile>> {
    built_in_ids().map(|id| built_in(id).unwrap()).filter(|profile| profile.has_mailbox())
}

/// One line for each entry: sub-index, type, bits, offset, access word, value.
fn table(profile: &Profile, index: u16) -> String {
    let line = |entry: &Entry| {
        let address = ObjectAddress::new(index, entry.sub);
        format!(
            "{:02X} {} {} {} {:04X} {}\n",
            entry.sub,
            entry.data_type.name().unwrap_or("?"),
            entry.bits,
            entry.complete_access_offset,
            entry.access.0,
            profile.value(address).map_or_else(
                || String::from_utf8_lossy(entry.default).into_owned(),
                |value| value.to_string()
            )
        )
    };
    object(profile, index).entries.iter().map(line).collect()
}

fn lines(text: &str) -> String {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).map(|l| format!("{l}\n")).collect()
}

#[test]
fn akd2g_states_what_its_pages_say() {
    let drive = built_in("kollmorgen_akd2g").unwrap();
    let gaps: String =
        (14..=31).map(|sub| format!("{sub:02X} GAP 8 {} 0007 0\n", 336 + 8 * (sub - 14))).collect();
    let head = "
        00 UNSIGNED8 8 0 0007 32
        01 UNSIGNED16 16 16 0007 0
        02 UNSIGNED32 32 32 0007 0
        03 UNSIGNED32 32 64 003F 0";
    let outputs = lines(&format!(
        "{head}
        04 UNSIGNED16 16 96 0007 1063
        05 UNSIGNED32 32 112 0007 250000
        06 UNSIGNED32 32 144 0007 60000
        07 UNSIGNED32 32 176 0007 29500
        08 UNSIGNED16 16 208 003F 0
        09 UNSIGNED32 32 224 0007 30000
        0A UNSIGNED32 32 256 0007 0
        0B UNSIGNED16 16 288 0007 0
        0C UNSIGNED16 16 304 0007 0
        0D UNSIGNED16 16 320 0007 0
        {gaps}
        20 UNSIGNED8 8 480 0087 0"
    ));
    assert_eq!(table(&drive, 0x1C32), outputs);
    let inputs = outputs
        .replace("0007 1063", "0007 39")
        .replace("0007 60000", "0007 40000")
        .replace("0007 29500", "0007 0")
        .replace("0007 30000", "0007 1000")
        .replace("480 0087", "480 0007");
    assert_eq!(table(&drive, 0x1C33), inputs);
    let shift = &drive.description.behaviour;
    assert!(shift.shift_outputs && shift.shift_inputs);
    assert_eq!(drive.modes().collect::<Vec<_>>(), SyncMode::ALL[..3]);
    assert_eq!(object(&drive, 0x1C32).data_type, DataType::SYNC_PAR);
    assert_eq!(object(&drive, 0x1C32).code, ObjectCode::RECORD);
    assert_eq!(object(&drive, 0x1C32).entries[31].name, "Gap entry 31");
}

#[test]
fn el2502_states_free_run_only() {
    let terminal = built_in("beckhoff_el2502-0010").unwrap();
    let sync = lines(
        "00 UNSIGNED8 8 0 0007 32
        01 UNSIGNED16 16 16 003F 0
        02 UNSIGNED32 32 32 003F 0
        03 UNSIGNED32 32 64 0007 0
        04 UNSIGNED16 16 96 0007 16385
        05 UNSIGNED32 32 112 0007 0
        06 UNSIGNED32 32 144 0007 0
        07 UNSIGNED32 32 176 0007 0
        08 UNSIGNED16 16 208 003F 0
        09 UNSIGNED32 32 224 0007 0
        0B UNSIGNED16 16 288 0007 0
        0C UNSIGNED16 16 304 0007 0
        0D UNSIGNED16 16 320 0007 0
        20 BOOLEAN 1 480 0007 0",
    );
    assert_eq!(table(&terminal, 0x1C32), sync);
    assert_eq!(table(&terminal, 0x1C33), sync);
    assert_eq!(object(&terminal, 0x1C33).entries[9].name, "Maximum Delay time");
    assert_eq!(
        table(&terminal, 0x1C00),
        lines(
            "00 UNSIGNED8 8 0 0007 4
            01 UNSIGNED8 8 16 0007 1
            02 UNSIGNED8 8 24 0007 2
            03 UNSIGNED8 8 32 0007 3
            04 UNSIGNED8 8 40 0007 4"
        )
    );
    assert_eq!(
        table(&terminal, 0x1C12),
        lines(
            "00 UNSIGNED8 8 0 0007 2
            01 UNSIGNED16 16 16 0007 5635
            02 UNSIGNED16 16 32 0007 5639"
        )
    );
    assert_eq!(
        table(&terminal, 0x1C13),
        lines(
            "00 UNSIGNED8 8 0 0007 4
            01 UNSIGNED16 16 16 0007 6656
            02 UNSIGNED16 16 32 0007 6657
            03 UNSIGNED16 16 48 0007 6658
            04 UNSIGNED16 16 64 0007 6659"
        )
    );
    assert_eq!(terminal.modes().collect::<Vec<_>>(), [SyncMode::FreeRun]);
    assert_eq!((terminal.identity.vendor_id, terminal.identity.product_code), (2, 0x09C6_3052));
    assert_eq!(terminal.assignment.outputs, [0x1603, 0x1607]);
    assert_eq!(terminal.application, ApplicationKind::Io);
}

#[test]
fn ssc_drive_states_what_its_esi_says() {
    let drive = built_in("hpmicro_ecat_cia402_ssc").unwrap();
    let outputs = lines(
        "00 UNSIGNED8 8 0 0007 32
        01 UNSIGNED16 16 16 000F 1
        02 UNSIGNED32 32 32 0007 0
        04 UNSIGNED16 16 96 0007 32775
        05 UNSIGNED32 32 112 0007 31200
        06 UNSIGNED32 32 144 0007 15000
        08 UNSIGNED16 16 208 003F 0
        09 UNSIGNED32 32 224 0007 1000
        0A UNSIGNED32 32 256 003F 0
        0B UNSIGNED16 16 288 0007 0
        0C UNSIGNED16 16 304 0007 0
        0D UNSIGNED16 16 320 0007 0
        20 BOOLEAN 1 480 0007 0",
    );
    assert_eq!(table(&drive, 0x1C32), outputs);
    let inputs = outputs
        .replace("000F 1\n", "000F 34\n")
        .replace("0007 15000", "0007 8000")
        .replace("0007 1000\n", "0007 500\n");
    assert_eq!(table(&drive, 0x1C33), inputs);
    assert_eq!(
        table(&drive, 0x10F1),
        lines("00 UNSIGNED8 8 0 0007 2\n01 UNSIGNED32 32 16 0007 1\n02 UNSIGNED16 16 48 003F 4")
    );
    assert_eq!(table(&drive, 0x1C12), lines("00 UNSIGNED8 8 0 000F 0\n01 UNSIGNED16 16 16 000F 0"));
    let identity = (0x0048_504D, 3, 1, 0);
    let Identity { vendor_id, product_code, revision, serial } = drive.identity;
    assert_eq!((vendor_id, product_code, revision, serial), identity);
    let behaviour = &drive.description.behaviour;
    assert_eq!(behaviour.missed_events, MissedEvents::SlaveStackCode);
    assert_eq!(behaviour.safeop_to_op_timeout, Nanos::millis(9_000));
    assert!(!behaviour.shift_outputs && !behaviour.hide_unused_sync_objects);
    assert_eq!(drive.assignment.outputs, [0x1600]);
    assert_eq!((drive.chip, drive.esc().name), ("LAN9252", "LAN9252"));
    let modes: Vec<_> = drive
        .op_modes
        .iter()
        .map(|m| (m.name.as_str(), m.assign_activate, m.sync0_factor, m.sync1_factor))
        .collect();
    assert_eq!(modes, [("Synchron", 0, 0, 0), ("DC", 0x0300, 1, 1)]);
}

#[test]
fn objects_that_follow_from_short_fields() {
    let drive = built_in("kollmorgen_akd2g").unwrap();
    assert_eq!(table(&drive, 0x1000), "00 UNSIGNED32 32 0 0007 131474\n");
    assert_eq!(
        table(&drive, 0x1008),
        "00 VISIBLE_STRING 40 0 0007 AKD2G\n".replace("AKD2G", "305786014529")
    );
    assert_eq!(object(&drive, 0x1008).entries[0].default, b"AKD2G");
    assert_eq!(
        table(&drive, 0x1018),
        lines(
            "00 UNSIGNED8 8 0 0007 4
            01 UNSIGNED32 32 16 0007 106
            02 UNSIGNED32 32 48 0007 11325952
            03 UNSIGNED32 32 80 0007 1
            04 UNSIGNED32 32 112 0007 0"
        )
    );
    assert_eq!(
        table(&drive, 0x1600),
        lines(&format!(
            "00 UNSIGNED8 8 0 0007 3
            01 UNSIGNED32 32 16 0007 {}
            02 UNSIGNED32 32 48 0007 {}
            03 UNSIGNED32 32 80 0007 {}",
            0x6040_0010, 0x607A_0020, 0x6060_0008
        ))
    );
    assert_eq!(table(&drive, 0x6040), "00 UNSIGNED16 16 0 007F 0\n");
    assert_eq!(table(&drive, 0x6041), "00 UNSIGNED16 16 0 0087 0\n");
    assert_eq!(table(&drive, 0x607A), "00 INTEGER32 32 0 007F 0\n");
    assert_eq!(table(&drive, 0x6502), "00 UNSIGNED32 32 0 0007 128\n");
    assert_eq!(
        table(&drive, 0x1C00),
        lines(
            "00 UNSIGNED8 8 0 0007 4
            01 UNSIGNED8 8 16 0007 1
            02 UNSIGNED8 8 24 0007 2
            03 UNSIGNED8 8 32 0007 3
            04 UNSIGNED8 8 40 0007 4"
        )
    );
    let terminal = built_in("beckhoff_el2502-0010").unwrap();
    assert_eq!(
        table(&terminal, 0x6000),
        lines("00 UNSIGNED8 8 0 0007 17\n01 UNSIGNED8 8 16 0087 0\n11 UNSIGNED16 16 24 0087 0")
    );
}

#[test]
fn dictionaries_are_in_order_and_values_have_places_of_their_own() {
    for profile in with_mailbox() {
        let objects = profile.description.objects;
        assert!(objects.windows(2).all(|pair| pair[0].index < pair[1].index), "{}", profile.id);
        let mut free = 0;
        for entry in objects.iter().flat_map(|object| object.entries) {
            assert_eq!(usize::from(entry.store), free, "{} {}", profile.id, entry.name);
            free += entry.len();
            assert!(entry.default.is_empty() || entry.default.len() == entry.len());
        }
        for index in [0x1000, 0x1008, 0x1018, 0x1C00, 0x1C13] {
            object(&profile, index);
        }
        let sync = objects.iter().filter(|object| matches!(object.index, 0x1C32 | 0x1C33)).count();
        assert!(sync >= 1, "{}", profile.id);
    }
}

#[test]
fn equal_texts_are_one_profile() {
    let id = "kollmorgen_akd2g";
    let again = Profile::from_toml("elsewhere.toml", built_in_text(id).unwrap()).unwrap();
    assert!(Arc::ptr_eq(&again, &built_in(id).unwrap()));
    assert!(built_in("akd2g").is_none());
}

#[test]
fn times_can_be_overridden() {
    let drive = built_in("kollmorgen_akd2g").unwrap();
    let item = |profile: &Profile| {
        profile.assumptions.iter().any(|assumption| assumption.item == "0x1C32:06")
    };
    let stated = Overrides { stated_calc_and_copy: Some(Nanos(1)), ..Overrides::default() };
    let changed = drive.with(stated).unwrap();
    assert_eq!(changed.value(ObjectAddress::new(0x1C32, 6)), Some(1));
    assert_eq!(changed.value(ObjectAddress::new(0x1C33, 6)), Some(40_000));
    assert_eq!(changed.times.calc_and_copy, Nanos(1));
    // A value from the user is not an assumption.
    assert!(item(&drive) && !item(&changed));
    assert!(Arc::ptr_eq(&drive, &drive.with(Overrides::default()).unwrap()));
    let (before, after) = (&drive.description, &changed.description);
    assert!(std::ptr::eq(before.objects, after.objects));
    for (index, sub) in
        before.objects.iter().flat_map(|o| o.entries.iter().map(|e| (o.index, e.sub)))
    {
        let entry = ObjectAddress::new(index, sub);
        assert_eq!(drive.value(entry) == changed.value(entry), (index, sub) != (0x1C32, 6));
    }

    let text = refused::MINIMAL
        .replace("  [0x06, \"UNSIGNED32\", \"ro\", \"10us\", \"Calc and copy time\"],\n", "");
    let bare = Profile::from_toml("bare.toml", &text).unwrap();
    assert_eq!(bare.with(stated).unwrap_err(), ObjectAddress::new(0x1C32, 6));
}

#[test]
fn assumptions_say_item_value_and_reason() {
    let drive = built_in("kollmorgen_akd2g").unwrap();
    let value = |item: &str| {
        let found = drive.assumptions.iter().find(|assumption| assumption.item == item);
        found.unwrap_or_else(|| panic!("{item} of {:#?}", drive.assumptions)).value.as_str()
    };
    assert_eq!(value("0x1C32:06"), "60us");
    assert_eq!(value("0x1C32:0B-0D"), "0");
    assert_eq!(value("0x1C33:03 access"), "rw");
    assert_eq!(value("0x1600"), "6040:00/16, 607A:00/32, 6060:00/8");
    assert_eq!(value("0x1C12:00 access"), "rw preop");
    assert_eq!(value("identity.vendor_id"), "0x0000_006A");
    assert_eq!(value("esc.chip"), "ET1100");
    assert_eq!(value("mailbox"), "2 values");
    for profile in built_in_ids().map(|id| built_in(id).unwrap()) {
        for assumption in &profile.assumptions {
            assert!(assumption.why.len() > 20, "{assumption:?}");
        }
    }
    let terminal = built_in("beckhoff_el2502-0010").unwrap();
    assert!(
        terminal.assumptions.iter().any(|a| a.item == "0x1C32:20 offset" && a.value == "bit 480")
    );
}

#[test]
fn the_sii_image_reads_back() {
    for profile in with_mailbox() {
        let image = &profile.sii;
        assert!(image.len() == 2048 || profile.op_modes.len() > 10, "{}", profile.id);
        let header = Header::parse(image).unwrap();
        assert_eq!(image[14], sii::checksum(&header.configuration));
        assert_eq!(header.configuration[..6], [0x05, 0x0C, 0x00, 0xCC, 0xE8, 0x03]);
        let Identity { vendor_id, product_code, revision, serial } = profile.identity;
        assert_eq!(
            (header.vendor_id, header.product_code, header.revision, header.serial),
            (vendor_id, product_code, revision, serial)
        );
        let mailbox = profile.description.mailbox.unwrap();
        assert_eq!((header.receive, header.send), (mailbox.receive, mailbox.send));
        let size = image.len() / 128 - 1;
        assert_eq!((header.protocols, usize::from(header.size)), (Header::COE, size));

        let categories: Vec<_> = sii::categories(image).map(Result::unwrap).collect();
        let kinds: Vec<_> = categories.iter().map(|category| category.kind).collect();
        let find = |kind| categories.iter().find(|category| category.kind == kind).unwrap().data;
        assert_eq!(kinds[..4], [10, 30, 40, 41]);
        let strings = find(category::STRINGS);
        let general = find(category::GENERAL);
        assert_eq!(general.len(), 32);
        assert_eq!(sii::string(strings, general[3]).unwrap(), profile.name.as_bytes());
        assert_eq!(sii::string(strings, general[0]).unwrap(), profile.vendor.as_bytes());
        // The fourth byte fills up the word: 0xFF means no FMMU.
        assert_eq!(find(category::FMMU), [1, 2, 3, 0xFF]);

        let sync_managers: Vec<_> = find(category::SYNC_MANAGER)
            .chunks_exact(8)
            .map(|bytes| SmRecord::parse(bytes.try_into().unwrap()))
            .map(|sm| (sm.start, sm.control, sm.kind))
            .collect();
        let description = &profile.description;
        let kind = |max_length, kind| if max_length > 0 { kind } else { 0 };
        let outputs = kind(description.outputs.max_length, 3);
        assert_eq!(
            sync_managers,
            [
                (mailbox.receive.start, 0x26, 1),
                (mailbox.send.start, 0x22, 2),
                (description.outputs.start, 0x64, outputs),
                (description.inputs.start, 0x20, 4)
            ]
        );
    }
}

#[test]
fn the_sii_image_tells_pdos_and_op_modes() {
    let ssc = built_in("hpmicro_ecat_cia402_ssc").unwrap();
    let akd2g = built_in("kollmorgen_akd2g").unwrap();
    fn find(profile: &Profile, kind: u16) -> &[u8] {
        sii::categories(&profile.sii).map(Result::unwrap).find(|c| c.kind == kind).unwrap().data
    }
    let pdo = |profile, kind| {
        let data: &[u8] = find(profile, kind);
        let head = PdoRecord::parse(data[..8].try_into().unwrap());
        let entries: Vec<_> = data[8..]
            .chunks_exact(8)
            .map(|bytes| PdoEntryRecord::parse(bytes.try_into().unwrap()))
            .map(|entry| (entry.index, entry.sub, entry.data_type, entry.bits))
            .collect();
        (head.index, head.entries, head.sm, entries)
    };
    let outputs = vec![(0x6040, 0, 6, 16), (0x607A, 0, 4, 32), (0x6060, 0, 2, 8)];
    let inputs = vec![(0x6041, 0, 6, 16), (0x6064, 0, 4, 32), (0x6061, 0, 2, 8)];
    assert_eq!(pdo(&akd2g, category::RX_PDO), (0x1600, 3, 2, outputs.clone()));
    assert_eq!(pdo(&akd2g, category::TX_PDO), (0x1A00, 3, 3, inputs));
    // The standard drive has no assignment until it is written.
    assert_eq!(pdo(&ssc, category::RX_PDO), (0x1600, 3, 0xFF, outputs));

    let lengths = |profile| {
        let records: Vec<_> = find(profile, category::SYNC_MANAGER)
            .chunks_exact(8)
            .map(|bytes| SmRecord::parse(bytes.try_into().unwrap()))
            .map(|sm| (sm.length, sm.enable))
            .collect();
        records
    };
    assert_eq!(lengths(&akd2g), [(256, 1), (256, 1), (7, 1), (7, 1)]);
    assert_eq!(lengths(&ssc), [(128, 1), (128, 1), (0, 0), (0, 0)]);

    let modes = find(&ssc, category::DC);
    assert_eq!(modes.len(), 48);
    assert_eq!(modes[24 + 0x0C..24 + 0x12], [1, 0, 0x00, 0x03, 1, 0]);
    let strings = find(&ssc, category::STRINGS);
    assert_eq!(sii::string(strings, modes[24 + 0x12]), Some(&b"DC"[..]));
    assert_eq!(sii::string(strings, modes[24 + 0x13]), Some(&b"DC-Synchron"[..]));
    let coe = |profile| find(profile, category::GENERAL)[5];
    assert_eq!((coe(&ssc), coe(&built_in("beckhoff_el2502-0010").unwrap())), (0x27, 0x23));
}
