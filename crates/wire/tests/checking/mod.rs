//! Rules for the parsers under arbitrary bytes: they end, they stay within the bytes, and a parsed
//! value is the same after it is written and parsed again.

use isocat_wire::datagram::{Layouts, datagrams};
use isocat_wire::sii::{self, PdoEntryRecord, PdoRecord, SmRecord, Writer};
use isocat_wire::{coe, frame, mailbox};

/// Checks an EEPROM image.
pub fn sii(bytes: &[u8]) {
    let Some(header) = sii::Header::parse(bytes) else {
        assert!(bytes.len() < sii::HEADER_LEN, "{} bytes hold a header", bytes.len());
        return;
    };
    let mut whole = Vec::new();
    let mut truncated = None;
    for category in sii::categories(bytes) {
        assert!(truncated.is_none(), "an error ends the walk");
        match category {
            Ok(category) => {
                assert!(category.data.len().is_multiple_of(2), "{category:?}");
                (0..=u8::MAX).for_each(|number| _ = sii::string(category.data, number));
                records(category.data);
                whole.push(category);
            }
            Err(error) => truncated = Some(error),
        }
    }
    if let Some(error) = truncated {
        assert!(2 * error.word >= sii::HEADER_LEN && !error.to_string().is_empty());
    }
    let mut image = vec![0; bytes.len() + sii::HEADER_LEN];
    let mut writer = Writer::new(&mut image, &header).expect("it holds a header");
    for category in &whole {
        writer.category(category.kind, category.data).expect("it held them before");
    }
    let len = writer.finish().expect("an end mark fits behind");
    assert_eq!(sii::Header::parse(&image[..len]), Some(header));
    let again: Vec<_> = sii::categories(&image[..len]).map(Result::unwrap).collect();
    assert_eq!(again, whole);
}

fn records(data: &[u8]) {
    for record in data.chunks_exact(SmRecord::LEN).filter_map(|bytes| bytes.first_chunk()) {
        assert_eq!(SmRecord::parse(record).emit(), *record);
        let pdo = PdoRecord::parse(record);
        assert_eq!(PdoRecord::parse(&pdo.emit()), pdo);
        let entry = PdoEntryRecord::parse(record);
        assert_eq!(PdoEntryRecord::parse(&entry.emit()), entry);
    }
}

/// Checks a frame with datagrams, and mailbox messages with CoE services.
pub fn answers(bytes: &[u8]) {
    if let Ok(payload) = frame::payload(bytes) {
        let mut end = 0;
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(payload) {
            assert_eq!(layout.start, end, "datagrams follow each other");
            end = layout.end();
            assert!(end <= payload.len());
        }
        for datagram in datagrams(payload).map_while(Result::ok) {
            assert!(!datagram.to_string().is_empty());
        }
    }
    let Some((head, rest)) = bytes.split_first_chunk() else { return };
    let header = mailbox::Header::parse(head);
    assert_eq!(mailbox::Header::parse(&header.emit()), header);
    if let Some(detail) = rest.first_chunk() {
        assert!(!mailbox::ErrorDetail::parse(detail).to_string().is_empty());
    }
    let Some((head, rest)) = rest.split_first_chunk::<2>() else { return };
    let header = coe::Header::parse(*head);
    assert_eq!(coe::Header::parse(header.emit()), header);
    if let Some(initiate) = rest.first_chunk() {
        let initiate = coe::sdo::Initiate::parse(initiate);
        assert_eq!(coe::sdo::Initiate::parse(&initiate.emit()), initiate);
        assert!(initiate.command.expedited_len() <= initiate.data.len());
    }
    if let Some(&command) = rest.first() {
        let command = coe::sdo::SegmentCommand(command);
        assert!(command.data_len(rest.len() - 1) < rest.len());
    }
    if let Some(info) = rest.first_chunk() {
        let info = coe::info::Header::parse(info);
        assert_eq!(coe::info::Header::parse(&info.emit()), info);
    }
}
