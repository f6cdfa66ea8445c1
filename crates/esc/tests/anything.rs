//! Arbitrary frames and arbitrary accesses of the PDI. The fuzz targets in `fuzz/` run the same
//! stories.

mod checking;

use proptest::prelude::*;

fn story() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![2 => any::<u8>(), 1 => Just(0u8), 1 => 0u8..16];
    proptest::collection::vec(byte, 0..1500)
}

proptest! {
    #[test]
    fn frames_of_any_form(bytes in story()) {
        checking::frames(&bytes);
    }

    #[test]
    fn frames_and_the_pdi_in_any_order(bytes in story()) {
        checking::pdi_sequence(&bytes);
    }
}
