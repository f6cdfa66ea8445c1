use std::vec;
use std::vec::Vec;

use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{self, EntryDescription, ObjectDescription};
use isocat_wire::{AbortCode, AlState};

use super::bench::Bench;
use super::device::{NAME, description};

fn bench() -> Bench {
    Bench::in_state(description(|_| {}), AlState::PreOp)
}

#[test]
fn values_of_each_length_go_both_ways() {
    let mut bench = bench();
    assert_eq!(bench.upload(0x1000, 0), Ok(vec![0x92, 1, 2, 0]));
    assert_eq!(bench.upload(0x1C00, 3), Ok(vec![3]));
    assert_eq!(bench.upload(0x2000, 5), Ok(vec![1, 2, 3]));
    assert_eq!(bench.upload(0x1008, 0), Ok(NAME.as_bytes().to_vec()), "in segments");
    for len in [1, 7, 48, 49, 55, 56, 48 + 55, 48 + 56, NAME.len()] {
        let text: Vec<u8> = (0..len as u8).collect();
        assert_eq!(bench.download(0x1008, 0, &text), Ok(()), "{len}");
        let mut expected = text.clone();
        expected.resize(NAME.len(), 0);
        assert_eq!(bench.upload(0x1008, 0), Ok(expected), "{len}");
    }
}

#[test]
fn each_refusal_has_its_code() {
    let mut bench = bench();
    assert_eq!(bench.upload(0x1001, 0), Err(AbortCode::NO_OBJECT));
    assert_eq!(bench.upload(0x1C32, 7), Err(AbortCode::NO_SUBINDEX));
    assert_eq!(bench.upload(0x1C32, 33), Err(AbortCode::NO_SUBINDEX));
    assert_eq!(bench.upload(0x2000, 3), Err(AbortCode::UNSUPPORTED_ACCESS), "a gap");
    assert_eq!(bench.download(0x2000, 3, &[0]), Err(AbortCode::UNSUPPORTED_ACCESS));
    assert_eq!(bench.upload(0x2000, 4), Err(AbortCode::WRITE_ONLY));
    assert_eq!(bench.download(0x1000, 0, &[1, 2, 3, 4]), Err(AbortCode::READ_ONLY));
    assert_eq!(bench.download(0x10F1, 2, &[1]), Err(AbortCode::TOO_SHORT));
    assert_eq!(bench.download(0x10F1, 2, &[1, 2, 3]), Err(AbortCode::TOO_LONG));
    let too_long = vec![b'x'; NAME.len() + 1];
    assert_eq!(bench.download(0x1008, 0, &too_long), Err(AbortCode::TOO_LONG));
    assert_eq!(bench.sdo(&[0xA0, 0, 0x10, 0, 0, 0, 0, 0]), Err(AbortCode::COMMAND_SPECIFIER));
    assert_eq!(bench.sdo(&[0x60, 0, 0, 0, 0, 0, 0, 0]), Err(AbortCode::COMMAND_SPECIFIER));
    assert_eq!(bench.sdo(&[0x00, 0, 0, 0, 0, 0, 0, 0]), Err(AbortCode::COMMAND_SPECIFIER));
    bench.device.application_mut().refuse_writes = true;
    assert_eq!(bench.download(0x10F1, 2, &[9, 0]), Err(AbortCode::LOCAL_CONTROL));
    assert_eq!(bench.number(0x10F1, 2), 4, "and nothing is stored");
}

#[test]
fn a_write_without_size_takes_the_bytes_of_the_entry() {
    let mut bench = bench();
    assert_eq!(bench.sdo(&[0x22, 0xF1, 0x10, 2, 7, 0, 9, 9]).unwrap()[0], 0x60);
    assert_eq!(bench.number(0x10F1, 2), 7);
}

#[test]
fn a_wrong_toggle_ends_the_transfer() {
    let mut bench = bench();
    let initiate = [0x40, 0x08, 0x10, 0, 0, 0, 0, 0];
    let aborted = |answer: (u8, Vec<u8>)| {
        (answer.1[0] == 0x80)
            .then(|| AbortCode(u32::from_le_bytes(answer.1[4..8].try_into().unwrap())))
    };
    bench.sdo(&initiate).unwrap();
    let toggled = [0x70, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(aborted(bench.coe(2, &toggled)), Some(AbortCode::TOGGLE));
    assert_eq!(aborted(bench.coe(2, &toggled)), Some(AbortCode::COMMAND_SPECIFIER));

    let download = [0x21, 0x08, 0x10, 0, 60, 0, 0, 0];
    bench.sdo(&download).unwrap();
    let segment = [0x10, 1, 2, 3, 4, 5, 6, 7];
    assert_eq!(aborted(bench.coe(2, &segment)), Some(AbortCode::TOGGLE));
    assert_eq!(bench.upload(0x1008, 0), Ok(NAME.as_bytes().to_vec()), "nothing was written");
}

#[test]
fn a_download_must_bring_what_it_announced() {
    let mut bench = bench();
    let announce = |total: u8| [0x21, 0x08, 0x10, 0, total, 0, 0, 0];
    let code = |answer: (u8, Vec<u8>)| u32::from_le_bytes(answer.1[4..8].try_into().unwrap());
    bench.sdo(&announce(6)).unwrap();
    assert_eq!(code(bench.coe(2, &[0x01, 1, 2, 3, 4, 5, 6, 7])), AbortCode::TOO_LONG.0);
    bench.sdo(&announce(8)).unwrap();
    assert_eq!(code(bench.coe(2, &[0x01, 1, 2, 3, 4, 5, 6, 7])), AbortCode::TOO_SHORT.0);
    let more_than_said = [&announce(1)[..], &[1, 2]].concat();
    assert_eq!(bench.sdo(&more_than_said), Err(AbortCode::LENGTH_MISMATCH));
}

#[test]
fn the_main_device_may_abort() {
    let mut bench = bench();
    bench.sdo(&[0x40, 0x08, 0x10, 0, 0, 0, 0, 0]).unwrap();
    let abort = [0, 0x20, 0x80, 0x08, 0x10, 0, 0, 0, 4, 5];
    bench.send(isocat_wire::mailbox::Protocol::COE, &abort);
    bench.poll();
    assert_eq!(bench.receive(), None, "an abort is not answered");
    let segment = [0x60, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(bench.sdo(&segment), Err(AbortCode::COMMAND_SPECIFIER));
}

#[test]
fn complete_access_packs_by_offset() {
    let mut bench = bench();
    let whole = bench.upload_as(true, 0x1C32, 0).unwrap();
    assert_eq!(whole.len(), 61, "488 bits");
    assert_eq!(whole[..2], [32, 0], "sub-index 0 takes 16 bits");
    assert_eq!(whole[12..18], [0x27, 0, 0x90, 0xD0, 0x03, 0]);
    assert_eq!(bench.upload_as(true, 0x1C32, 1).unwrap(), whole[2..]);
    // Bits: 1, 101, a gap of four, then 16 that cannot be read, then 24.
    assert_eq!(bench.upload_as(true, 0x2000, 1), Ok(vec![0b1011, 0, 0, 1, 2, 3]));
    assert_eq!(bench.upload_as(true, 0x1C00, 0), Ok(vec![4, 0, 1, 2, 3, 4]));
    assert_eq!(bench.upload_as(true, 0x1C12, 0), Ok(vec![1, 0, 0, 0x16]), "what is assigned");
    assert_eq!(bench.upload_as(true, 0x1C32, 2), Err(AbortCode::UNSUPPORTED_ACCESS));
    assert_eq!(bench.upload_as(true, 0x1000, 0), Err(AbortCode::UNSUPPORTED_ACCESS));
}

#[test]
fn complete_access_writes_all_or_nothing() {
    let mut bench = bench();
    // Sub-index 5 is read-only: it is accepted with its present value.
    let bits = [0b0100, 0x34, 0x12, 1, 2, 3];
    assert_eq!(bench.download_as(true, 0x2000, 1, &bits), Ok(()));
    assert_eq!((bench.number(0x2000, 1), bench.number(0x2000, 2)), (0, 0b010));
    let changed = [0b1111, 0, 0, 1, 2, 4];
    assert_eq!(bench.download_as(true, 0x2000, 1, &changed), Err(AbortCode::READ_ONLY));
    assert_eq!((bench.number(0x2000, 1), bench.number(0x2000, 2)), (0, 0b010));
    assert_eq!(bench.download_as(true, 0x2000, 1, &[0b1111]), Ok(()), "the first entries alone");
    assert_eq!((bench.number(0x2000, 1), bench.number(0x2000, 2)), (1, 0b111));
    assert_eq!(
        bench.download_as(true, 0x2000, 1, &[0, 0x34]),
        Err(AbortCode::LENGTH_MISMATCH),
        "an entry cut in two"
    );
    let too_long = [0; 9];
    assert_eq!(bench.download_as(true, 0x2000, 0, &too_long), Err(AbortCode::TOO_LONG));
    assert_eq!(bench.download_as(true, 0x1C00, 0, &[4, 0, 1]), Err(AbortCode::READ_ONLY));
}

#[test]
fn assignments_are_written_in_order() {
    let mut bench = bench();
    let (pdo, other) = ([0x00, 0x16], [0x01, 0x16]);
    assert_eq!(bench.download(0x1C12, 1, &pdo), Ok(()), "the same value");
    assert_eq!(bench.download(0x1C12, 1, &other), Err(AbortCode::SUB0_NOT_ZERO));
    assert_eq!(bench.download(0x1C12, 0, &[0]), Ok(()));
    assert_eq!(bench.download(0x1C12, 1, &other), Ok(()));
    assert_eq!(bench.download(0x1C12, 1, &[0x00, 0x1A]), Err(AbortCode::VALUE_RANGE));
    assert_eq!(bench.download(0x1C12, 1, &[0xFF, 0x15]), Err(AbortCode::VALUE_RANGE));
    assert_eq!(bench.download(0x1C12, 1, &[0x00, 0x18]), Err(AbortCode::VALUE_RANGE));
    assert_eq!(bench.download(0x1C12, 1, &[0xFF, 0x17]), Ok(()));
    assert_eq!(bench.download(0x1C12, 1, &[0, 0]), Ok(()), "an empty slot");
    assert_eq!(bench.download(0x1C12, 4, &pdo), Err(AbortCode::NO_SUBINDEX));
    assert_eq!(bench.download(0x1C12, 0, &[4]), Err(AbortCode::TOO_HIGH));
    assert_eq!(bench.download(0x1C12, 0, &[3]), Ok(()));

    assert_eq!(bench.download_as(true, 0x1C13, 0, &[1, 0, 0x00, 0x1A]), Ok(()));
    assert_eq!(bench.download_as(true, 0x1C13, 0, &[2, 0, 0x00, 0x1A]), Err(AbortCode::TOO_SHORT));
    let four = [4, 0, 0, 0x1A, 0, 0x1A, 0, 0x1A];
    assert_eq!(bench.download_as(true, 0x1C13, 0, &four), Err(AbortCode::TOO_HIGH));
    assert_eq!(bench.download_as(true, 0x1C13, 1, &[1, 0x1A]), Err(AbortCode::SUB0_NOT_ZERO));
    assert_eq!(bench.download_as(true, 0x1C13, 0, &[1, 0, 0, 0x16]), Err(AbortCode::VALUE_RANGE));
    assert_eq!(bench.upload_as(true, 0x1C13, 0), Ok(vec![1, 0, 0x00, 0x1A]));
    assert_eq!(bench.download_as(true, 0x1C13, 0, &[0, 0]), Ok(()));
    assert_eq!(bench.upload_as(true, 0x1C13, 0), Ok(vec![0, 0]));
}

#[test]
fn mappings_name_entries_that_can_be_mapped() {
    let mut bench = bench();
    let mut map = |value: u32| bench.download(0x1600, 1, &value.to_le_bytes());
    assert_eq!(map(0x607A_0020), Err(AbortCode::SUB0_NOT_ZERO));
    bench.download(0x1600, 0, &[0]).unwrap();
    let mut map = |value: u32| bench.download(0x1600, 1, &value.to_le_bytes());
    assert_eq!(map(0x607A_0020), Ok(()));
    assert_eq!(map(0x607A_0010), Err(AbortCode::PARAMETER_INCOMPATIBLE));
    assert_eq!(map(0x6064_0020), Err(AbortCode::NOT_MAPPABLE), "an input");
    assert_eq!(map(0x607A_0120), Err(AbortCode::NO_SUBINDEX));
    assert_eq!(map(0x607B_0020), Err(AbortCode::NO_OBJECT));
    assert_eq!(map(0x0000_0005), Ok(()), "bits left free");
}

#[test]
fn rights_depend_on_the_state() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::SafeOp);
    assert_eq!(bench.download(0x1C12, 0, &[0]), Err(AbortCode::WRONG_STATE));
    assert_eq!(bench.download(0x10F1, 2, &[9, 0]), Ok(()));
    assert_eq!(bench.download(0x1C32, 1, &[1, 0]), Err(AbortCode::WRONG_STATE));
    let anytime = description(|d| {
        d.edit(0x1C32, 1, |entry| entry.access = super::device::RW);
        d.edit(0x1000, 0, |entry| entry.access = info::Access(0x0001));
    });
    let mut bench = Bench::in_state(anytime, AlState::SafeOp);
    assert_eq!(bench.download(0x1C32, 1, &[1, 0]), Ok(()), "the same value");
    assert_eq!(bench.download(0x1C32, 1, &[0, 0]), Err(AbortCode::WRONG_STATE));
    assert_eq!(bench.upload(0x1000, 0), Err(AbortCode::WRONG_STATE));
}

#[test]
fn lists_come_in_fragments() {
    let mut bench = bench();
    let all: Vec<u16> = bench.device.description().objects.iter().map(|o| o.index).collect();
    bench.send(isocat_wire::mailbox::Protocol::COE, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
    let mut found = Vec::new();
    let mut expected_left = 1;
    loop {
        bench.poll();
        let (header, body) = bench.receive().expect("a fragment");
        assert!(header.length <= 58);
        let info = info::Header::parse(body[2..6].try_into().unwrap());
        assert_eq!(info.opcode, info::Opcode::LIST_RESPONSE);
        let data = if found.is_empty() { &body[8..] } else { &body[6..] };
        found.extend(data.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])));
        if !info.incomplete {
            assert_eq!(info.fragments_left, 0);
            break;
        }
        // The first fragment has 25 indices.
        assert_eq!(usize::from(info.fragments_left), (all.len() - found.len()).div_ceil(26));
        expected_left -= 1;
        assert!(expected_left >= 0);
    }
    assert_eq!(found, all);
    bench.poll();
    assert_eq!(bench.receive(), None);

    let (_, counts) = bench.coe(8, &[1, 0, 0, 0, 0, 0]);
    let counts: Vec<u16> =
        counts[4..].chunks(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    assert_eq!(counts, [0, all.len() as u16, 3, 5, 0, 0]);
    let (_, mappable) = bench.coe(8, &[1, 0, 0, 0, 2, 0]);
    assert_eq!(mappable, [2, 0, 0, 0, 2, 0, 0x40, 0x60, 0x60, 0x60, 0x7A, 0x60]);
}

#[test]
fn a_long_list_is_continued_after_each_read() {
    let mut bench = Bench::in_state(
        description(|d| {
            for index in 0x3000..0x3100 {
                d.var(index, "more", DataType::UNSIGNED8, super::device::RO, &[0]);
            }
        }),
        AlState::PreOp,
    );
    let total = bench.device.description().objects.len();
    bench.send(isocat_wire::mailbox::Protocol::COE, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
    let (mut found, mut left) = (0, None);
    loop {
        bench.poll();
        let (_, body) = bench.receive().expect("a fragment");
        let info = info::Header::parse(body[2..6].try_into().unwrap());
        found += (body.len() - 6) / 2;
        if let Some(left) = left {
            assert_eq!(info.fragments_left + 1, left, "counts down");
        }
        left = Some(info.fragments_left);
        if !info.incomplete {
            break;
        }
    }
    assert_eq!(found, total + 1, "indices, and the list type once");

    bench.poll();
    bench.send(isocat_wire::mailbox::Protocol::COE, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
    bench.poll();
    bench.receive().unwrap();
    // The second fragment is read too, then another request comes: the rest of the list is dropped.
    bench.poll();
    bench.receive().unwrap();
    bench.poll();
    bench.receive().unwrap();
    assert_eq!(bench.device.state(), AlState::PreOp);
}

#[test]
fn descriptions_are_those_of_the_device() {
    let mut bench = bench();
    let (_, body) = bench.coe(8, &[3, 0, 0, 0, 0x32, 0x1C]);
    assert_eq!(body[..4], [4, 0, 0, 0]);
    let object = ObjectDescription::parse(body[4..10].try_into().unwrap());
    assert_eq!((object.index, object.max_sub, object.code.0), (0x1C32, 32, 9));
    assert_eq!(object.data_type, DataType::SYNC_PAR.0);
    assert_eq!(&body[10..], b"Sync");

    let (_, body) = bench.coe(8, &[5, 0, 0, 0, 0x32, 0x1C, 4, 7]);
    let entry = EntryDescription::parse(body[4..14].try_into().unwrap());
    assert_eq!((entry.sub, entry.bits, entry.data_type, entry.value_info), (4, 16, 6, 7));
    assert_eq!(entry.access.0, 0x0007);
    assert_eq!(&body[14..], b"an entry");

    let (_, body) = bench.coe(8, &[5, 0, 0, 0, 0x32, 0x1C, 4, 0x17]);
    assert_eq!(body[7], 0x17);
    assert_eq!(&body[14..], b"\x27\x00an entry", "with the value after power-on");

    let (_, gap) = bench.coe(8, &[5, 0, 0, 0, 0x00, 0x20, 3, 0]);
    let gap = EntryDescription::parse(gap[4..14].try_into().unwrap());
    assert_eq!((gap.data_type, gap.bits, gap.access.0), (0, 4, 0));

    let error = |body: Vec<u8>| (body[0], u32::from_le_bytes(body[4..8].try_into().unwrap()));
    let (_, body) = bench.coe(8, &[3, 0, 0, 0, 1, 0x10]);
    assert_eq!(error(body), (7, AbortCode::NO_OBJECT.0));
    let (_, body) = bench.coe(8, &[5, 0, 0, 0, 0x32, 0x1C, 7, 0]);
    assert_eq!(error(body), (7, AbortCode::NO_SUBINDEX.0));
    let (_, body) = bench.coe(8, &[9, 0, 0, 0, 0, 0]);
    assert_eq!(error(body), (7, AbortCode::COMMAND_SPECIFIER.0));
    let (_, body) = bench.coe(8, &[1, 0, 0, 0, 6, 0]);
    assert_eq!(error(body), (7, AbortCode::UNSUPPORTED_ACCESS.0));
}
