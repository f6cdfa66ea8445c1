//! Arbitrary mailbox messages and SDO requests, as in the fuzz targets in `fuzz/`.

mod checking;

use std::path::Path;

use proptest::prelude::*;

fn story() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![2 => any::<u8>(), 1 => Just(0u8), 1 => 0u8..16];
    proptest::collection::vec(byte, 0..600)
}

proptest! {
    #[test]
    fn mailbox_messages_of_any_form(bytes in story()) {
        checking::mailbox(&bytes);
    }

    #[test]
    fn sdo_requests_in_any_order(bytes in story()) {
        checking::sdo(&bytes);
    }
}

#[test]
fn the_seeds_hold() {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds");
    for (target, tell) in [("mailbox", checking::mailbox as fn(&[u8])), ("sdo", checking::sdo)] {
        let mut told = 0;
        for file in std::fs::read_dir(seeds.join(target)).expect("the seeds of this target") {
            let path = file.expect("a seed").path();
            tell(&std::fs::read(path).expect("a story"));
            told += 1;
        }
        assert!(told >= 5, "{target}: only {told} stories");
    }
}
