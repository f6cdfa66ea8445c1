//! Profiles of devices without mailbox.

use isocat_sync::{SupportedTypes, SyncMode};
use isocat_wire::sii::{self, Header, PdoRecord, SmRecord, category};

use crate::profile::{Profile, built_in};

/// The minimal profile without mailbox. Line 1 is `id`.
const SIMPLE: &str = r#"id = "simple"
name = "Simple"
vendor = "Nobody"
application = "io"
modes = ["sm"]
identity = { vendor_id = 1, product_code = 2, revision = 3 }
esc = { chip = "ET1100", sync_unit = false }
times = { reaction = "20us", calc_and_copy = "10us", application = "5us", input_copy = "5us" }

[outputs]
start = 0x1000
length = 3
default = [0x1600]

[[outputs.pdo]]
index = 0x1600
name = "Outputs"
entries = [["7000:01", "UNSIGNED16", "Value"], { pad = 8 }]
"#;

fn category(profile: &Profile, kind: u16) -> &[u8] {
    sii::categories(&profile.sii).map(Result::unwrap).find(|c| c.kind == kind).unwrap().data
}

fn sync_managers(profile: &Profile) -> Vec<(u16, u16, u8, u8, u8)> {
    category(profile, category::SYNC_MANAGER)
        .chunks_exact(8)
        .map(|bytes| SmRecord::parse(bytes.try_into().unwrap()))
        .map(|sm| (sm.start, sm.length, sm.control, sm.enable, sm.kind))
        .collect()
}

#[test]
fn built_in_simple_devices_tell_all_in_their_sii() {
    for (id, bytes, inputs) in [("simple_io16", 16u16, 0x1100), ("simple_io4", 4, 0x1080)] {
        let profile = built_in(id).unwrap();
        assert!(!profile.has_mailbox() && profile.description.objects.is_empty());
        let header = Header::parse(&profile.sii).unwrap();
        let nowhere = sii::MailboxArea::default();
        assert_eq!((header.receive, header.send, header.protocols), (nowhere, nowhere, 0), "{id}");
        assert_eq!((header.vendor_id, header.revision), (0x6973_6F63, 1));
        assert_eq!(header.product_code, u32::from(bytes) << 16 | u32::from(bytes));
        // SM0 and SM1 exist, so that SM2 and SM3 have their places, but guard nothing.
        assert_eq!(
            sync_managers(&profile),
            [
                (0, 0, 0x26, 0, 0),
                (0, 0, 0x22, 0, 0),
                (0x1000, bytes, 0x64, 1, 3),
                (inputs, bytes, 0x20, 1, 4)
            ]
        );
        assert_eq!(category(&profile, category::FMMU), [1, 2]);
        assert_eq!(category(&profile, category::GENERAL)[5], 0, "no CoE");
        for (kind, index, sm) in [(category::RX_PDO, 0x1600, 2), (category::TX_PDO, 0x1A00, 3)] {
            let data = category(&profile, kind);
            let record = PdoRecord::parse(data[..8].try_into().unwrap());
            let (number, rest) = (u16::from(record.entries), &data[8..]);
            assert_eq!((record.index, record.sm, number), (index, sm, bytes), "{id}");
            assert_eq!(rest.len(), 8 * usize::from(bytes));
            assert!(rest.chunks_exact(8).all(|entry| entry[5] == 8), "bytes");
        }
        assert_eq!(profile.modes().collect::<Vec<_>>(), [SyncMode::SmSynchronous]);
        assert!(profile.assumptions.is_empty());
    }
}

#[test]
fn a_simple_profile_by_hand_is_short() {
    let profile = Profile::from_toml("simple.toml", SIMPLE).unwrap();
    let description = &profile.description;
    assert_eq!((description.outputs.max_length, description.inputs.max_length), (3, 0));
    assert_eq!(description.behaviour.undeclared_types, SupportedTypes(0b010));
    assert_eq!(sync_managers(&profile)[2..], [(0x1000, 3, 0x64, 1, 3), (0, 0, 0x20, 0, 0)]);
    let listening = SIMPLE.replace("[\"sm\"]", "[\"dc-sync0\", \"sm\"]").replace("false", "true");
    let profile = Profile::from_toml("simple.toml", &listening).unwrap();
    assert_eq!(profile.modes().collect::<Vec<_>>(), [SyncMode::SmSynchronous, SyncMode::DcSync0]);
}

#[test]
fn what_a_device_without_mailbox_cannot_have() {
    let object = "[[object]]\nindex = 0x1000\nname = \"x\"\ncode = \"var\"\n\
                  entries = [[0, \"UNSIGNED8\", \"ro\", 1, \"x\"]]\n";
    let mailbox = "[mailbox]\nreceive = { start = 0x1100, length = 128 }\n\
                   send = { start = 0x1180, length = 128 }\n";
    for (text, expected) in [
        (
            SIMPLE.replace("modes = [\"sm\"]", ""),
            "1:1 the top level lacks the key \"modes\"; expected what a device without [mailbox] \
             works by, such as modes = [\"sm\"]",
        ),
        (SIMPLE.replace("[\"sm\"]", "[\"smm\"]"), "5:10 unknown modes \"smm\""),
        (
            SIMPLE.replace("[\"sm\"]", "[]"),
            "5:9 modes is empty; expected what a device without [mailbox] works by, such as modes \
             = [\"sm\"]",
        ),
        (
            SIMPLE.replace("[\"sm\"]", "[\"dc-sync0\"]"),
            "7:7 esc.sync_unit is false, but modes has \"dc-sync0\"; expected true",
        ),
        (
            SIMPLE.to_owned() + object,
            "19:1 object 0x1000 is given, but it cannot be read without a mailbox; expected a \
             table [mailbox], or no objects",
        ),
        (
            SIMPLE.replace("length = 3", "length = 4"),
            "10:1 outputs.length is 4, but outputs.default needs 3 bytes and nobody can assign \
             more without a mailbox; expected 3",
        ),
        (
            SIMPLE.replace("length = 3", "length = 2"),
            "13:12 outputs.default needs 3 bytes; expected at most 2, the length of the area",
        ),
        (
            SIMPLE.replace("length = 3", "length = 3\naccess = \"ro\""),
            "13:10 access is given, but the PDO assignment of a device without mailbox is fixed; \
             expected a table [mailbox], or no access",
        ),
        (
            SIMPLE.to_owned() + mailbox,
            "6:12 identity lacks the key \"device_type\"; expected the profile's number, object \
             0x1000",
        ),
        (
            SIMPLE
                .replace("revision = 3", "revision = 3, device_type = 0")
                .replace("length = 3", "length = 3\naccess = \"ro\"")
                + mailbox,
            "5:9 modes is given beside [mailbox]; expected 0x1C32:04 and 0x1C33:04 to state them",
        ),
    ] {
        let error = Profile::from_toml("s.toml", &text).unwrap_err();
        assert_eq!(format!("{}:{} {}", error.line, error.column, error.message), expected);
    }
}
