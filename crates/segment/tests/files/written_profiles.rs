//! A profile written from a description gives the same device as the description.

use std::collections::BTreeMap;
use std::path::Path;

use isocat_descriptions::esi::{EsiDevice, EsiFile};
use isocat_descriptions::sii::{Sii, SiiFile, SiiOpMode, SiiPdo};
use isocat_segment::profile::{ApplicationKind, Profile, ProfileText};
use isocat_subdevice::{Entry, Object};
use isocat_wire::coe::info::Access;
use isocat_wire::sii::{Header, MailboxArea, SmRecord, sm_type};

/// The flags of mapping, which descriptions often lack although a PDO maps the entry.
const MAPPABLE: u16 = Access::RX_MAPPABLE.0 | Access::TX_MAPPABLE.0;

/// A value without trailing zeros.
fn value(profile: &Profile, entry: &Entry) -> Vec<u8> {
    let value = profile.description.power_on(entry);
    let end = value.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    value[..end].to_vec()
}

/// The differences of the dictionaries. Added entries and mapping flags, and changes to an unknown
/// 0x1C32:04, are corrected on purpose, and counted.
fn differences(real: &Profile, read: &Profile) -> (Vec<String>, usize) {
    let (mut all, mut mended) = (Vec::new(), 0);
    for object in real.description.objects {
        let same = |other: &&Object| other.index == object.index;
        let Some(found) = read.description.objects.iter().find(same) else {
            all.push(format!("0x{:04X} is missing", object.index));
            continue;
        };
        if (found.name, found.code) != (object.name, object.code) {
            all.push(format!("0x{:04X}: {} became {}", object.index, object.name, found.name));
        }
        let added = found.entries.len() - object.entries.len();
        mended += added;
        for entry in object.entries {
            let place = format!("0x{:04X}:{:02X}", object.index, entry.sub);
            let Some(other) = found.entries.iter().find(|other| other.sub == entry.sub) else {
                all.push(format!("{place} is missing"));
                continue;
            };
            // A profile has no word for an entry without any access.
            let open = |access: u16| if access == 0 { Access::READ.0 } else { access };
            let form =
                |entry: &Entry| (entry.data_type, entry.bits, open(entry.access.0 & !MAPPABLE));
            if form(entry) != form(other) || entry.name != other.name {
                all.push(format!("{place}: {entry:?} became {other:?}"));
            }
            mended += usize::from(entry.access != other.access);
            if added == 0 && entry.complete_access_offset != other.complete_access_offset {
                all.push(format!("{place} is elsewhere"));
            }
            let (before, after) = (value(real, entry), value(read, other));
            let is_types = matches!(object.index, 0x1C32 | 0x1C33) && entry.sub == 4;
            let is_count = added > 0 && entry.sub == 0;
            if before != after && is_types && before.is_empty() || is_count {
                mended += 1;
            } else if before != after {
                all.push(format!("{place}: {before:X?} became {after:X?}"));
            }
        }
    }
    for (what, before, after) in [
        ("identity", format!("{:?}", real.identity), format!("{:?}", read.identity)),
        ("startup", format!("{:?}", real.startup), format!("{:?}", read.startup)),
        ("OpModes", format!("{:?}", real.op_modes), format!("{:?}", read.op_modes)),
        ("PDOs", format!("{:?}", real.assignment), format!("{:?}", read.assignment)),
        ("ports", real.esc().port_descriptor.to_string(), read.esc().port_descriptor.to_string()),
        (
            "areas",
            format!("{:?}", (real.description.outputs, real.description.inputs)),
            format!("{:?}", (read.description.outputs, read.description.inputs)),
        ),
        ("mailbox", format!("{:?}", mailbox(real)), format!("{:?}", mailbox(read))),
        (
            "behaviour",
            format!("{:?}", real.description.behaviour),
            format!("{:?}", read.description.behaviour),
        ),
        ("application", application(real), application(read)),
        ("pulse", real.pulse().to_string(), read.pulse().to_string()),
    ] {
        if before != after {
            all.push(format!("{what}: {before} became {after}"));
        }
    }
    all.extend(differences_of_sii(real, read));
    if real.times != read.times {
        // Times are shortened if they do not fit into the minimum cycle.
        mended += 1;
        let work = |profile: &Profile| {
            let times = &profile.times;
            times.calc_and_copy.0 + times.application.0 + times.input_copy.0
        };
        if work(read) >= work(real) {
            all.push(format!("times: {:?} became {:?}", real.times, read.times));
        }
    }
    (all, mended)
}

/// Areas and protocols of the mailbox. Parameters of drives behind SoE have no key in a profile.
fn mailbox(profile: &Profile) -> Option<(MailboxArea, MailboxArea, u16)> {
    let mailbox = profile.description.mailbox?;
    Some((mailbox.receive, mailbox.send, mailbox.speaks.protocols))
}

/// The layout of a drive; a plain drive has the usual one.
fn application(profile: &Profile) -> String {
    match profile.application {
        ApplicationKind::Io => "io".to_owned(),
        ApplicationKind::Drive => "0 2 Some(6) 0 2 Some(6)".to_owned(),
        ApplicationKind::DriveAt(at) => {
            let outputs = format!("{} {} {:?}", at.control, at.target, at.mode);
            format!("{outputs} {} {} {:?}", at.status, at.position, at.mode_display)
        }
    }
}

/// The parts of the SII that a MainDevice reads, and the doubts about it.
fn parts_of_sii(profile: &Profile) -> [(&'static str, String); 6] {
    let file = SiiFile::from_bytes("image", &profile.sii).expect("an image");
    let Sii { header, sync_managers, outputs, inputs, op_modes, .. } = &file.sii;
    let Header { vendor_id, product_code, revision, serial, receive, send, .. } = header;
    let identity = (vendor_id, product_code, revision, serial);
    let used = |record: &&SmRecord| {
        record.kind != sm_type::UNUSED && record.length > 0 && !record.is_window()
    };
    let guarded = sync_managers.iter().enumerate().filter(|(_, record)| used(record));
    let guarded =
        guarded.map(|(number, record)| (number, record.start, record.length, record.kind));
    let pdo = |pdo: &SiiPdo| (pdo.index, pdo.sync_manager, pdo.bits());
    let on_window = |pdo: &&SiiPdo| {
        pdo.sync_manager.is_some_and(|number| is_mapped_window(&sync_managers[usize::from(number)]))
    };
    let pdos: Vec<_> =
        outputs.iter().chain(inputs).filter(|one| !on_window(one)).map(pdo).collect();
    let op_modes: Vec<_> = op_modes.iter().map(SiiOpMode::record).collect();
    let doubts: Vec<_> = file.doubts.iter().map(|doubt| doubt.kind).collect();
    [
        ("header", format!("{:?}", (identity, receive, send, header.protocols))),
        ("alias", format!("{:?}", &header.configuration[8..10])),
        ("SyncManagers", format!("{:?}", guarded.collect::<Vec<_>>())),
        ("PDOs", format!("{pdos:?}")),
        ("OpModes", format!("{op_modes:?}")),
        ("doubts", format!("{doubts:?}")),
    ]
}

/// Whether an FMMU maps it without a SyncManager. A profile has no key for windows.
fn is_mapped_window(record: &SmRecord) -> bool {
    record.is_window() && record.length > 0
}

/// Names are not compared, since an image without space for them leaves them out.
fn differences_of_sii(real: &Profile, read: &Profile) -> Vec<String> {
    let both = parts_of_sii(real).into_iter().zip(parts_of_sii(read));
    let different = both.filter(|((_, before), (_, after))| before != after);
    let words = different
        .map(|((what, before), (_, after))| format!("{what} of the SII: {before} became {after}"));
    words.collect()
}

/// Every OpMode of a device; none for a device without.
fn modes(device: &EsiDevice) -> Vec<Option<usize>> {
    match device.op_modes().len() {
        0 => vec![None],
        count => (0..count).map(Some).collect(),
    }
}

/// The results for the devices of a file: the number of those written, and reasons why others were
/// not.
#[derive(Default)]
struct Counts {
    equal: usize,
    mended: usize,
    refused: BTreeMap<String, usize>,
}

fn check(path: &str, counts: &mut Counts) {
    let Ok(file) = EsiFile::read(path) else { return };
    for device in file.usable() {
        for mode in modes(device) {
            let Ok(real) = Profile::from_esi(&file, device, mode) else { continue };
            check_device(&file, device, mode, &real, counts);
        }
    }
}

fn check_device(
    file: &EsiFile,
    device: &EsiDevice,
    mode: Option<usize>,
    real: &Profile,
    counts: &mut Counts,
) {
    let written = match ProfileText::from_esi(file, device, mode, "a test") {
        Ok(written) => written,
        Err(error) => {
            let reason = error.message.split_once(": ").expect("a reason").1;
            let reason = reason.split([';', ',']).next().expect("words");
            *counts.refused.entry(reason.to_owned()).or_default() += 1;
            return;
        }
    };
    let place = format!("{}: {} {mode:?}", file.path, device.type_name);
    let read = Profile::from_toml("written.toml", &written.text)
        .unwrap_or_else(|error| panic!("{place}: {error}"));
    let (differences, mended) = differences(real, &read);
    let notes = written.notes.join("\n");
    assert!(differences.is_empty(), "{place}\n{}\n{notes}", differences.join("\n"));
    let sii = SiiFile::from_bytes("image", &real.sii).expect("an image").sii;
    let has_windows = sii.sync_managers.iter().any(is_mapped_window);
    assert_eq!(notes.contains("window-left-out"), has_windows, "{place}\n{notes}");
    let drives = real.description.mailbox.map_or(0, |mailbox| mailbox.speaks.parameters.len());
    assert_eq!(notes.contains("soe-parameters-left-out"), drives > 0, "{place}\n{notes}");
    counts.equal += 1;
    counts.mended += usize::from(mended > 0);
}

#[test]
fn the_descriptions_of_the_project_become_profiles() {
    let mut counts = Counts::default();
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../isocat/tests/esi");
    for file in std::fs::read_dir(folder).expect("a folder") {
        let path = file.expect("a file").path();
        check(&path.display().to_string(), &mut counts);
    }
    assert!(counts.equal > 3, "{}", counts.equal);
}

#[test]
fn real_descriptions_become_profiles() {
    let shared = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        std::path::PathBuf::from,
    );
    let mut counts = Counts::default();
    for folder in ["esi", "esi-more"] {
        let Ok(files) = std::fs::read_dir(shared.join(folder)) else {
            eprintln!("skipped: no folder {folder} beside the project");
            return;
        };
        for file in files {
            check(&file.expect("a file").path().display().to_string(), &mut counts);
        }
    }
    println!("{} profiles, {} of them mended", counts.equal, counts.mended);
    for (reason, count) in &counts.refused {
        println!("{count:4} refused: {reason}");
    }
    // No key can express this.
    let known = |reason: &String| reason.ends_with("in several SyncManagers");
    assert!(counts.refused.keys().all(known), "{:?}", counts.refused);
    assert!(counts.equal > counts.refused.values().sum(), "{}", counts.equal);
}
