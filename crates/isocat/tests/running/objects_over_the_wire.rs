//! 0x1C32 and 0x1C33 of real devices, read over the wire sub-index by sub-index, against their
//! makers' tables: type, access, value; and what happens when each is written.

use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::segment::SyncObject;
use isocat_maindevice::{Event, Motion, SdoError};
use isocat_sim::World;
use isocat_wire::coe::info::Access;
use isocat_wire::time::{Picos, Time};
use isocat_wire::{AbortCode, ObjectAddress};

/// One line of a maker's table: sub-index, bits, `rw` or `ro`, and the value where it is published.
type Line = (u8, u16, &'static str, Option<u32>);

/// AKD2G web help, object 0x1C32. Values that are not published are left open; 01 and 02 follow the
/// mode and 0A the SYNC0 cycle.
const AKD2G_OUTPUTS: [Line; 15] = [
    (0x00, 8, "ro", Some(32)),
    (0x01, 16, "ro", None),
    (0x02, 32, "ro", None),
    (0x03, 32, "rw", None),
    (0x04, 16, "ro", Some(0x0427)),
    (0x05, 32, "ro", Some(250_000)),
    (0x06, 32, "ro", None),
    (0x07, 32, "ro", None),
    (0x08, 16, "rw", None),
    (0x09, 32, "ro", None),
    (0x0A, 32, "ro", None),
    (0x0B, 16, "ro", None),
    (0x0C, 16, "ro", None),
    (0x0D, 16, "ro", None),
    (0x20, 8, "ro", None),
];

/// EL2502-0010 documentation, objects 0x1C32 and 0x1C33: both are alike. It has no 0A.
const EL2502: [Line; 14] = [
    (0x00, 8, "ro", Some(32)),
    (0x01, 16, "rw", Some(0)),
    (0x02, 32, "rw", Some(0)),
    (0x03, 32, "ro", Some(0)),
    (0x04, 16, "ro", Some(0x4001)),
    (0x05, 32, "ro", Some(0)),
    (0x06, 32, "ro", Some(0)),
    (0x07, 32, "ro", Some(0)),
    (0x08, 16, "rw", Some(0)),
    (0x09, 32, "ro", Some(0)),
    (0x0B, 16, "ro", Some(0)),
    (0x0C, 16, "ro", Some(0)),
    (0x0D, 16, "ro", Some(0)),
    (0x20, 1, "ro", Some(0)),
];

fn in_operation() -> World<Motion, NoTap> {
    let scenario = Scenario::from(SegmentFile::built_in());
    let mut world = World::new(scenario.run().setup, Motion::default(), None);
    let limit = Time::new(20_000_000_000_000);
    loop {
        match world.poll_event() {
            Some(Event::InOperation { .. }) => return world,
            Some(Event::Failed(error)) => panic!("{error}"),
            Some(_) => {}
            None => assert!(world.step(limit), "the segment does not come up"),
        }
    }
}

fn compare(name: &str, object: &SyncObject, table: &[Line]) {
    let found: Vec<u8> = object.entries.iter().map(|entry| entry.sub).collect();
    let expected: Vec<u8> = table.iter().map(|line| line.0).collect();
    assert_eq!(found, expected, "{name}: sub-indices");
    for (entry, (sub, bits, access, value)) in object.entries.iter().zip(table) {
        let (description, _) = entry.description.as_ref().expect("described by SDO information");
        assert_eq!(description.bits, *bits, "{name}:{sub:02X}");
        let rights = if description.access.has_any(Access::WRITE) { "rw" } else { "ro" };
        assert_eq!(rights, *access, "{name}:{sub:02X}");
        assert!(description.access.has(Access::READ), "{name}:{sub:02X}");
        if let Some(value) = value {
            assert_eq!(entry.number(), Some(*value), "{name}:{sub:02X}");
        }
    }
}

/// Uploads or downloads one entry in operation.
fn access(
    world: &mut World<Motion, NoTap>,
    position: usize,
    object: ObjectAddress,
    data: Option<&[u8]>,
) -> Result<Vec<u8>, SdoError> {
    let asked = match data {
        Some(data) => world.main_mut().download(position, object, data),
        None => world.main_mut().upload(position, object),
    };
    let limit = world.now() + Picos(1_000_000_000_000);
    loop {
        match world.poll_event() {
            Some(Event::Uploaded { request, result }) if request == asked => return result,
            Some(Event::Downloaded { request, result }) if request == asked => {
                return result.map(|()| Vec::new());
            }
            Some(_) => {}
            None => assert!(world.step(limit), "{object} is not answered"),
        }
    }
}

#[test]
fn the_tables_of_akd2g_and_el2502() {
    let world = in_operation();
    let devices = &world.main().segment().devices;
    let outputs = |position: usize| devices[position].output_sync.as_ref().expect("0x1C32");
    let inputs = |position: usize| devices[position].input_sync.as_ref().expect("0x1C33");
    compare("AKD2G 0x1C32", outputs(0), &AKD2G_OUTPUTS);
    compare("EL2502-0010 0x1C32", outputs(3), &EL2502);
    compare("EL2502-0010 0x1C33", inputs(3), &EL2502);
    // 0x1C33 of the AKD2G: as its 0x1C32, but for what it supports; 07 is reserved and there.
    let mut akd2g_inputs = AKD2G_OUTPUTS;
    akd2g_inputs[4].3 = Some(0x0027);
    compare("AKD2G 0x1C33", inputs(0), &akd2g_inputs);
    assert_eq!(devices[0].sm_types, [1, 2, 3, 4]);
    assert_eq!(devices[3].sm_types, [1, 2, 3, 4]);
    let pdos = |data: &isocat_maindevice::segment::ProcessData| {
        data.pdos.iter().map(|pdo| pdo.index).collect::<Vec<_>>()
    };
    assert_eq!(pdos(&devices[3].outputs), [0x1603, 0x1607]);
    assert_eq!(pdos(&devices[3].inputs), [0x1A00, 0x1A01, 0x1A02, 0x1A03]);
}

#[test]
fn writes_are_taken_or_refused_as_the_tables_say() {
    let mut world = in_operation();
    for (position, index, table) in
        [(0, 0x1C32, &AKD2G_OUTPUTS[..]), (3, 0x1C32, &EL2502), (3, 0x1C33, &EL2502)]
    {
        for (sub, _, rights, _) in table {
            let object = ObjectAddress::new(index, *sub);
            let value = access(&mut world, position, object, None).expect("readable in OP");
            let written = access(&mut world, position, object, Some(&value));
            match *rights {
                "rw" => assert_eq!(written, Ok(vec![]), "device {position} {object}"),
                _ => {
                    let refused = Err(SdoError::Abort(AbortCode::READ_ONLY));
                    assert_eq!(written, refused, "device {position} {object}");
                }
            }
            let after = access(&mut world, position, object, None);
            assert_eq!(after, Ok(value), "device {position} {object} after the write");
        }
        let absent = ObjectAddress::new(index, 0x21);
        let refused = access(&mut world, position, absent, None);
        assert_eq!(refused, Err(SdoError::Abort(AbortCode::NO_SUBINDEX)), "{absent}");
    }
    // A gap has a description but no value; the EL2502-0010's assignment is fixed.
    let gap = access(&mut world, 0, ObjectAddress::new(0x1C32, 0x0E), None);
    assert_eq!(gap, Err(SdoError::Abort(AbortCode::UNSUPPORTED_ACCESS)));
    let fixed = access(&mut world, 3, ObjectAddress::new(0x1C12, 0), Some(&[0]));
    assert_eq!(fixed, Err(SdoError::Abort(AbortCode::READ_ONLY)));
    // Values that no device of this kind has.
    let wrong = access(&mut world, 3, ObjectAddress::new(0x1C32, 1), Some(&[2, 0]));
    assert!(matches!(wrong, Err(SdoError::Abort(_))), "{wrong:?}");
    let short = access(&mut world, 0, ObjectAddress::new(0x1C32, 3), Some(&[1, 2]));
    assert!(matches!(short, Err(SdoError::Abort(_))), "{short:?}");
}
