//! The word of an OpMode for registers 0x0980 and 0x0981: what of it the wire and the start-up list
//! get, and what devices say to it.

use std::cell::RefCell;
use std::rc::Rc;

use isocat::plan::Plan;
use isocat::{Scenario, SegmentFile};
use isocat_sim::observation::Observation;
use isocat_sim::{Segment, Tap};
use isocat_sync::SyncMode;
use isocat_wire::time::{Time, True};
use isocat_wire::{Command, register};

const BOX: &str = include_str!("../esi/box.xml");

/// A segment of the one drive, whose second OpMode has this word.
fn segment(word: &str) -> Scenario {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("sync-words");
    std::fs::create_dir_all(&folder).expect("a folder");
    let text = BOX.replace("#x300</AssignActivate>", &format!("{word}</AssignActivate>"));
    std::fs::write(folder.join(format!("{word}.xml")), text).expect("written");
    let toml = format!(
        "cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = \"{word}.xml\"\ntype = \"Drive\"\n\
         opmode = \"DC\"\n"
    );
    let at = folder.join("segment.toml").display().to_string();
    Scenario::from(SegmentFile::parse(&at, &toml).unwrap_or_else(|error| panic!("{error}")))
}

/// Writes to 0x0980 and 0x0981 of the one device: address and bytes.
#[derive(Clone, Default)]
struct Unit(Rc<RefCell<Writes>>);

type Writes = Vec<(u16, Vec<u8>)>;

impl Tap for Unit {
    fn frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        let Ok(payload) = isocat_wire::frame::payload(bytes) else { return };
        for datagram in isocat_wire::datagram::datagrams(payload).flatten().filter(|_| sent) {
            let at = datagram.header.ado();
            let unit = [register::CYCLIC_UNIT_CONTROL.address, register::SYNC_ACTIVATION.address];
            if datagram.header.command() == Ok(Command::Fpwr) && unit.contains(&at) {
                self.0.borrow_mut().push((at, datagram.data.to_vec()));
            }
        }
    }
    fn observed(&mut self, _: &Segment, _: Time<True>, _: &Observation) {}
}

#[test]
fn the_whole_word_is_written_and_listed() {
    for (word, written, mode) in [
        ("#x0300", &[0x00, 0x03][..], SyncMode::DcSync0),
        ("#x0310", &[0x10, 0x03], SyncMode::DcSync0),
        ("#x0320", &[0x20, 0x03], SyncMode::DcSync0),
        ("#x0330", &[0x30, 0x03], SyncMode::DcSync0),
        // SYNC1 comes with SYNC0: a device may listen to it alone.
        ("#x0700", &[0x00, 0x07], SyncMode::DcSync0),
        ("#x0730", &[0x30, 0x07], SyncMode::DcSync0),
        // No pulse, but time stamps.
        ("#x0100", &[0x00, 0x01], SyncMode::SmSynchronous),
        ("#x0120", &[0x20, 0x01], SyncMode::SmSynchronous),
        ("#x0030", &[0x30, 0x00], SyncMode::SmSynchronous),
        ("#x0000", &[], SyncMode::SmSynchronous),
    ] {
        let scenario = segment(word);
        let plan = Plan::of(&scenario).expect("a plan");
        assert_eq!(plan.segment.devices[0].mode, mode, "{word}");
        let listed = plan.start_up(&scenario).devices[0].assign_activate();
        let expected = written.first_chunk().map(|bytes| u16::from_le_bytes(*bytes));
        assert_eq!(listed.map(|word| word.0), expected, "{word}");

        let unit = Unit::default();
        let outcome = scenario.run().execute(Some(unit.clone()), &mut |_| {});
        assert!(outcome.failure.is_none(), "{word}: {:?}", outcome.failure);
        let found = unit.0.borrow().last().cloned();
        let whole = (!written.is_empty())
            .then(|| (register::CYCLIC_UNIT_CONTROL.address, written.to_vec()));
        assert_eq!(found, whole, "{word}");
        let report = isocat::run(&scenario);
        assert!(report.in_sync, "{word}: {}", report.text());
    }
}
