//! Images made by hand, with both sides of every limit; real ones are in the command's tests.

use proptest::prelude::*;

use super::*;
use isocat_wire::sii::{MailboxArea, sm_type};

/// A device with one of everything.
fn sample() -> Sii {
    let mut configuration = [0; 14];
    configuration[..6].copy_from_slice(&[0x05, 0x0E, 0x03, 0x06, 0x10, 0x27]);
    let receive = MailboxArea { start: 0x1000, length: 128 };
    let send = MailboxArea { start: 0x1080, length: 128 };
    let sm = |area: MailboxArea, control, kind| SmRecord {
        start: area.start,
        length: area.length,
        control,
        status: 0,
        enable: 1,
        kind,
    };
    let entry = |index, name: &str| SiiEntry {
        index,
        sub: u8::from(index > 0),
        name: name.to_owned(),
        data_type: 5,
        bits: 8,
        flags: 0,
    };
    Sii {
        header: Header {
            configuration,
            vendor_id: 1,
            product_code: 2,
            receive,
            send,
            protocols: Header::COE,
            size: 15,
            ..Header::default()
        },
        general: Some(General {
            order: "BOX".to_owned(),
            name: "A box".to_owned(),
            ebus_ma: -20,
            ports: 0x0031,
            ..General::default()
        }),
        fmmus: vec![1, 2],
        sync_managers: vec![
            sm(receive, 0x26, sm_type::MAILBOX_OUT),
            sm(send, 0x22, sm_type::MAILBOX_IN),
            sm(MailboxArea { start: 0x1100, length: 2 }, 0x64, sm_type::OUTPUTS),
            sm(MailboxArea { start: 0x1180, length: 2 }, 0x20, sm_type::INPUTS),
        ],
        inputs: vec![SiiPdo {
            index: 0x1A00,
            sync_manager: Some(3),
            name: "Inputs".to_owned(),
            flags: SiiPdo::FIXED,
            entries: vec![entry(0x6000, "Value"), entry(0, "")],
            ..SiiPdo::default()
        }],
        outputs: Vec::new(),
        op_modes: vec![SiiOpMode {
            name: "DC".to_owned(),
            assign_activate: 0x0300,
            shift_time_0: -5,
            sync0_factor: 1,
            ..SiiOpMode::default()
        }],
        others: vec![OtherCategory { kind: 0x0801, data: vec![1, 2] }],
    }
}

fn read(image: &[u8]) -> SiiFile {
    SiiFile::from_bytes("a.bin", image).expect("it has a header")
}

fn kinds(image: &[u8]) -> Vec<&'static str> {
    read(image).doubts.iter().map(|doubt| doubt.kind.name()).collect()
}

/// Offset of a category's data.
fn place(image: &[u8], wanted: u16) -> usize {
    let mut at = 0x80;
    loop {
        let half = |at: usize| u16::from_le_bytes([image[at], image[at + 1]]);
        if half(at) == wanted {
            return at + 4;
        }
        at += 4 + 2 * usize::from(half(at + 2));
    }
}

#[test]
fn what_is_written_is_read_again() {
    let sii = sample();
    let image = sii.image(0, Names::All).expect("short");
    assert_eq!(image.len(), 2_048);
    let file = read(&image);
    assert_eq!((file.sii, file.doubts), (sii, Vec::new()));
    assert_eq!(image[file.used - 2..file.used], [0xFF, 0xFF]);
    assert!(image[file.used..].iter().all(|byte| *byte == 0xFF));
}

#[test]
fn each_doubt_has_its_word() {
    let good = sample().image(0, Names::All).expect("short");
    let broken = |at: usize, byte: u8| {
        let mut image = good.clone();
        image[at] = byte;
        read(&image).doubts.iter().map(|doubt| (doubt.kind.name(), doubt.word)).collect::<Vec<_>>()
    };
    assert_eq!(broken(14, good[14] ^ 1), [("checksum", 7)]);
    assert_eq!(broken(0x10, 0), [("identity", 8)]);
    assert_eq!(broken(0x7C, 16), [("size", 0x3E)]);
    assert_eq!(broken(0x7E, 2), [("version", 0x3F)]);
    assert_eq!(broken(0x30, 1), [("mailbox-area", place(&good, 41) / 2)]);
    assert_eq!(broken(0x38, 0), [("mailbox-protocols", 0x1C)]);
    let fmmu = place(&good, 40);
    assert_eq!(broken(fmmu + 1, 4), [("fmmu-use", fmmu / 2)]);
    assert_eq!(broken(fmmu + 1, 3), []);
    let sm = place(&good, 41);
    assert_eq!(broken(sm + 23, 5), [("sync-manager-type", sm / 2 + 11)]);
    let pdo = place(&good, 50);
    assert_eq!(broken(pdo + 3, 4), [("pdo-sync-manager", pdo / 2 + 1)]);
    assert_eq!(broken(pdo + 3, 1), [("pdo-sync-manager", pdo / 2 + 1)]);
    assert_eq!(broken(pdo + 3, 2), []);
    assert_eq!(broken(pdo + 3, 0xFF), []);
    assert_eq!(broken(pdo + 2, 3), [("pdo-cut", pdo / 2)]);
    assert_eq!(broken(pdo + 5, 99), [("string-missing", pdo / 2 + 2)]);
    let strings = place(&good, 10);
    assert_eq!(broken(strings + 2, 0x1B), [("string-unprintable", strings / 2)]);
    // The first missing string would begin in the last word, which is padded.
    assert_eq!(broken(strings, 99)[0], ("strings-cut", place(&good, 30) / 2 - 3));
}

#[test]
fn a_checksum_can_be_switched_off() {
    let mut image = sample().image(0, Names::All).expect("short");
    image[14..16].copy_from_slice(&0x88A4_u16.to_le_bytes());
    assert_eq!(kinds(&image), [""; 0]);
}

#[test]
fn an_image_without_its_end_is_read_as_far_as_it_goes() {
    let image = sample().image(0, Names::All).expect("short");
    let used = read(&image).used;
    assert_eq!(kinds(&image[..used]), ["size"]);
    assert_eq!(kinds(&image[..used - 2]), ["size", "end-mark"]);
    assert_eq!(kinds(&image[..used - 1]), ["size", "half-word", "end-mark"]);
    assert_eq!(kinds(&image[..used - 4]), ["size", "category-cut"]);
    let nothing = ["size", "end-mark", "sync-managers-missing", "general-missing"];
    assert_eq!(kinds(&image[..0x80]), nothing);
    let error = SiiFile::from_bytes("a.bin", &image[..0x7F]).expect_err("too short");
    assert_eq!(
        error.to_string(),
        "a.bin: word 0x003f: the image ends; expected a header of 64 words, found 127 bytes"
    );
}

/// Names of doubts, each with its word.
type Told = Vec<(&'static str, usize)>;

/// What keeps from OP, and lesser doubts.
fn judged(sii: &Sii) -> (Told, Told) {
    let file = read(&sii.image(0, Names::All).expect("short"));
    let told = |keeps: bool| {
        let doubts = file.doubts.iter().filter(move |doubt| doubt.keeps_from_op == keeps);
        doubts.map(|doubt| (doubt.kind.name(), doubt.word)).collect()
    };
    (told(true), told(false))
}

/// A device without a mailbox whose ESC has a CPU.
fn without_mailbox() -> Sii {
    let mut sii = sample();
    sii.header.protocols = 0;
    (sii.header.receive, sii.header.send) = Default::default();
    sii.sync_managers.drain(..2);
    sii.inputs[0].sync_manager = Some(1);
    sii
}

const NONE: (Told, Told) = (Vec::new(), Vec::new());

#[test]
fn without_sync_managers_there_is_no_way_to_op() {
    let lack = |sii: &Sii| judged(sii).0.into_iter().map(|(kind, _)| kind).collect::<Vec<_>>();
    let mut sii = sample();
    sii.sync_managers.clear();
    assert_eq!(lack(&sii), ["sync-managers-missing"]);
    sii.inputs.clear();
    assert_eq!(lack(&sii), ["sync-managers-missing"], "the mailbox needs its own");
    let mut sii = without_mailbox();
    sii.sync_managers.clear();
    assert_eq!(lack(&sii), ["sync-managers-missing"], "the PDOs need theirs");
    // A coupler has neither.
    sii.inputs.clear();
    assert_eq!(judged(&sii), NONE);
    // The word is the one at which the categories end.
    sii.general = None;
    sii.header.protocols = Header::COE;
    (sii.header.receive, sii.header.send) = (sample().header.receive, sample().header.send);
    let image = sii.image(0, Names::All).expect("short");
    let file = read(&image);
    let missing = file.doubts.iter().find(|doubt| doubt.kind == DoubtKind::SyncManagersMissing);
    assert_eq!(missing.map(|doubt| 2 * doubt.word), Some(file.used - 2), "{:?}", file.doubts);
}

#[test]
fn protocols_need_a_mailbox() {
    let mut sii = sample();
    sii.header.send.length = 0;
    let at = place(&sii.image(0, Names::All).expect("short"), 41) / 2 + 4;
    assert_eq!(judged(&sii), (vec![("mailbox-missing", 0x1A)], vec![("mailbox-area", at)]));
    sii.header.send = MailboxArea { start: 0, length: 128 };
    assert_eq!(judged(&sii).0, [("mailbox-missing", 0x1A)]);
    sii.header.receive = MailboxArea::default();
    assert_eq!(judged(&sii).0, [("mailbox-missing", 0x18)]);
    // The other way round: the header has it, its SyncManager does not.
    let mut sii = sample();
    sii.sync_managers[1].length = 0;
    assert_eq!(judged(&sii), (vec![], vec![("mailbox-area", at)]));
    sii.sync_managers[1].length = 127;
    assert_eq!(judged(&sii), (vec![], vec![("mailbox-area", at)]));
    // Neither a mailbox nor protocols is right; and a device without a CPU needs no mailbox.
    let mut sii = without_mailbox();
    assert_eq!(judged(&sii), NONE);
    sii.header.protocols = Header::COE;
    assert_eq!(judged(&sii).0, [("mailbox-missing", 0x18)]);
    sii.header.configuration[1] |= Header::DEVICE_EMULATION;
    assert_eq!(judged(&sii), (vec![], vec![("mailbox-protocols", 0x1C)]));
}

#[test]
fn a_pdo_needs_a_sync_manager_for_process_data() {
    for number in [0, 4] {
        let mut sii = without_mailbox();
        sii.sync_managers[0].kind = sm_type::MAILBOX_OUT;
        sii.inputs[0].sync_manager = Some(number);
        let at = place(&sii.image(0, Names::All).expect("short"), 50) / 2 + 1;
        assert_eq!(judged(&sii).0, [("pdo-sync-manager", at)], "{number}");
        // An unknown type may go by the direction of its PDOs.
        sii.sync_managers[0].kind = sm_type::UNUSED;
        let keeps = if number == 0 { vec![] } else { vec![("pdo-sync-manager", at)] };
        assert_eq!(judged(&sii).0, keeps, "{number}");
        // Objects of a device with CoE tell its assignment, too.
        let mut sii = sample();
        sii.inputs[0].sync_manager = Some(number);
        assert_eq!(judged(&sii), (vec![], vec![("pdo-sync-manager", at + 8)]), "{number}");
    }
    // A window on registers is mapped by an FMMU alone.
    let mut sii = without_mailbox();
    (sii.sync_managers[0].kind, sii.sync_managers[0].enable) = (sm_type::UNUSED, SmRecord::VIRTUAL);
    sii.inputs[0].sync_manager = Some(0);
    assert_eq!(judged(&sii), NONE);
}

/// What makers leave to the MainDevice: the length (AKD, EL2004), enabling with the PDOs (UR20), a
/// direction without PDOs (EL5001), SyncManagers in OP only (EL2004), ESCs without a CPU (EL1004).
#[test]
fn lengths_and_flags_may_be_the_maindevices() {
    let with = |change: fn(&mut Sii)| {
        let mut sii = sample();
        change(&mut sii);
        let at = place(&sii.image(0, Names::All).expect("short"), 41) / 2;
        (judged(&sii), at)
    };
    let all_right: [fn(&mut Sii); 6] = [
        |sii| sii.sync_managers[3].length = 0,
        |sii| (sii.sync_managers[3].length, sii.sync_managers[3].enable) = (0, 0),
        |sii| sii.sync_managers[2].length = 0,
        |sii| sii.sync_managers[3].enable = SmRecord::OP_ONLY | SmRecord::ENABLED,
        |sii| {
            sii.sync_managers[3].enable = 0;
            sii.header.configuration[1] |= Header::DEVICE_EMULATION;
        },
        |sii| (sii.sync_managers[2].kind, sii.sync_managers[2].enable) = (sm_type::UNUSED, 0),
    ];
    for (number, change) in all_right.into_iter().enumerate() {
        assert_eq!(with(change).0, NONE, "{number}");
    }
    let (found, at) = with(|sii| sii.sync_managers[3].enable = 0);
    assert_eq!(found, (vec![], vec![("sync-manager-off", at + 15)]));
    let (found, at) = with(|sii| sii.sync_managers[2].kind = sm_type::UNUSED);
    assert_eq!(found, (vec![], vec![("sync-manager-untyped", at + 11)]));
}

/// Type and control byte of a SyncManager name one direction; each end of the pair may be wrong.
#[test]
fn types_agree_with_control_bytes() {
    let with = |number: usize, kind, coe: bool| {
        let mut sii = if coe { sample() } else { without_mailbox() };
        sii.sync_managers[number].kind = kind;
        let at = place(&sii.image(0, Names::All).expect("short"), 41) / 2;
        (judged(&sii), at)
    };
    // Objects tell what the SyncManagers are for, and without them nothing does.
    let (found, at) = with(2, sm_type::INPUTS, true);
    assert_eq!(found, (vec![], vec![("sync-manager-direction", at + 11)]));
    let (found, at) = with(3, sm_type::OUTPUTS, true);
    assert_eq!(found, (vec![], vec![("sync-manager-direction", at + 15)]));
    let (found, at) = with(0, sm_type::INPUTS, false);
    assert_eq!(found, (vec![("sync-manager-direction", at + 3)], vec![]));
    // Right, and what says nothing: no bytes, a control byte of 0.
    let changes: [fn(&mut SmRecord); 3] =
        [|_| {}, |sm| (sm.kind, sm.length) = (sm_type::INPUTS, 0), |sm| sm.control = 0];
    for (number, change) in changes.into_iter().enumerate() {
        let mut sii = sample();
        change(&mut sii.sync_managers[2]);
        assert_eq!(judged(&sii), NONE, "{number}");
    }
}

/// Whose PDOs the EEPROM does not list is no doubt, and the text says where they must come from.
#[test]
fn bytes_without_a_pdo_are_told() {
    let told = |change: fn(&mut Sii)| {
        let mut sii = sample();
        change(&mut sii);
        assert_eq!(judged(&sii), NONE);
        read(&sii.image(0, Names::All).expect("short")).text()
    };
    let text = told(|sii| sii.inputs.clear());
    assert!(text.contains("no RxPDO for its bytes in the EEPROM (category 51)"), "{text}");
    assert!(text.contains("from object 0x1C13 or the description"), "{text}");
    // PDOs of one direction: the other may have none.
    assert!(!told(|_| {}).contains("for its bytes"));
    let off = told(|sii| {
        sii.inputs.clear();
        (sii.sync_managers[2].length, sii.sync_managers[3].enable) = (0, 0);
    });
    assert!(!off.contains("for its bytes"), "{off}");
}

#[test]
fn a_blank_image_has_no_other_doubt() {
    for byte in [0x00, 0xFF] {
        let file = read(&[byte; 2_048]);
        let doubts = file.doubts.iter().map(|doubt| (doubt.kind, doubt.word, doubt.keeps_from_op));
        assert_eq!(doubts.collect::<Vec<_>>(), [(DoubtKind::Blank, 0, true)]);
        assert!(file.text().contains("never written"), "{}", file.text());
    }
    let mut image = [0xFF; 2_048];
    image[0x10] = 0;
    assert!(!kinds(&image).contains(&"blank"));
}

#[test]
fn a_device_without_a_name_comes_to_op() {
    let mut sii = sample();
    sii.general = None;
    let (keeps, lesser) = judged(&sii);
    assert_eq!((keeps, lesser[0].0), (vec![], "general-missing"));
}

#[test]
fn what_is_written_twice_counts_once() {
    let mut image = sample().image(0, Names::All).expect("short");
    let used = read(&image).used;
    let again = [40, 0, 1, 0, 3, 3, 0xFF, 0xFF];
    image[used - 2..used + 6].copy_from_slice(&again);
    let file = read(&image);
    assert_eq!(file.sii.fmmus, [1, 2]);
    assert_eq!((kinds(&image), file.doubts[0].word), (vec!["category-repeated"], used / 2 - 1));
}

#[test]
fn empty_categories_end() {
    let mut image = sample().image(65_536, Names::All).expect("short");
    image[0x80..].fill(0);
    let all = ["many-categories", "sync-managers-missing", "general-missing"];
    assert_eq!(kinds(&image), all);
}

#[test]
fn names_have_their_room() {
    let mut sii = sample();
    let general = sii.general.as_mut().expect("it has one");
    general.name = "x".repeat(255);
    assert!(sii.image(0, Names::All).is_ok());
    let general = sii.general.as_mut().expect("it has one");
    general.name = "x".repeat(256);
    assert!(matches!(sii.image(0, Names::All), Err(Unwritable::Name(_))));
    let cut = read(&sii.image(0, Names::Fitting).expect("cut"));
    assert_eq!(cut.sii.general.map(|general| general.name.len()), Some(255));
    let mut sii = sample();
    let texts = 255 - 4;
    let mode = |number: usize| SiiOpMode { name: format!("{number}"), ..SiiOpMode::default() };
    sii.op_modes = (0..texts).map(mode).collect();
    assert!(sii.image(0, Names::All).is_ok());
    sii.op_modes.push(mode(texts));
    assert_eq!(sii.image(0, Names::All), Err(Unwritable::Names(256)));
    assert!(sii.image(0, Names::Fitting).is_ok());
}

#[test]
fn intel_hex_is_an_image_too() {
    let image = sample().image(0, Names::All).expect("short");
    let mut text = String::new();
    for (number, data) in image.chunks(16).enumerate() {
        let at = (16 * number as u16).to_be_bytes();
        let head = [&[data.len() as u8, at[0], at[1], 0][..], data].concat();
        let sum = head.iter().fold(0_u8, |sum, byte| sum.wrapping_sub(*byte));
        let digits: String = head.iter().chain([&sum]).map(|byte| format!("{byte:02X}")).collect();
        text += &format!(":{digits}\r\n");
    }
    let whole = format!("{text}:00000001FF\r\n");
    assert_eq!(read(whole.as_bytes()).image, image);
    let error =
        |text: &str| SiiFile::from_bytes("a.hex", text.as_bytes()).map_err(|e| e.to_string());
    assert!(error(&text).is_err_and(|e| e.contains("expected the end record")));
    let broken = whole.replacen(":10", ":11", 1);
    assert!(error(&broken).is_err_and(|e| e == "a.hex:1:2: 16 bytes of data; expected 17"));
    let broken = whole.replacen("0E", "0F", 1);
    assert!(error(&broken).is_err_and(|e| e.contains("expected 0x00")));
}

proptest! {
    /// An image written from any readable one has the same content, and no new doubts.
    #[test]
    fn anything_is_read(bytes in proptest::collection::vec(any::<u8>(), 0..600), tame in any::<bool>()) {
        let mut image = sample().image(0, Names::All).expect("short");
        let used = read(&image).used;
        // Half of the images are almost right.
        match tame {
            true => {
                for (number, byte) in bytes.chunks(40).enumerate() {
                    let at = (usize::from(byte[0]) * 7 + number * 31) % used;
                    image[at] = byte[byte.len() - 1];
                }
            }
            false => image = bytes,
        }
        let Ok(file) = SiiFile::from_bytes("a.bin", &image) else { return Ok(()) };
        prop_assert!(!file.text().is_empty());
        if file.doubts.iter().any(|doubt| doubt.kind == DoubtKind::Blank) { return Ok(()) }
        prop_assert!(file.used <= image.len() && file.doubts.len() <= 256);
        let Ok(written) = file.sii.image(0, Names::All) else { return Ok(()) };
        let mut again = read(&written).sii;
        again.header.size = file.sii.header.size;
        prop_assert_eq!(again, file.sii);
    }
}
