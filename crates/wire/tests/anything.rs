//! Arbitrary bytes for the parsers of received data. The fuzz targets in `fuzz/` do the same.

mod checking;

use isocat_wire::sii::{self, Writer, category};
use proptest::prelude::*;

fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![2 => any::<u8>(), 1 => Just(0u8), 1 => 0u8..16];
    proptest::collection::vec(byte, 0..600)
}

proptest! {
    #[test]
    fn images_of_any_form(bytes in bytes()) {
        checking::sii(&bytes);
    }

    /// An image of whole categories that is cut anywhere.
    #[test]
    fn images_that_are_cut(strings in bytes(), pdos in bytes(), cut in 0usize..1400) {
        let mut image = vec![0; 1400];
        let mut writer = Writer::new(&mut image, &sii::Header::default()).unwrap();
        writer.category(category::STRINGS, &strings).unwrap();
        writer.category(category::TX_PDO, &pdos).unwrap();
        let len = writer.finish().unwrap();
        checking::sii(&image[..len]);
        checking::sii(&image[..len.min(cut)]);
    }

    #[test]
    fn answers_of_any_form(mut bytes in bytes(), is_frame in any::<bool>()) {
        if is_frame && bytes.len() > 16 {
            bytes[12..14].copy_from_slice(&[0x88, 0xA4]);
            bytes[15] = 0x10 | bytes[15] & 7;
        }
        checking::answers(&bytes);
    }
}
