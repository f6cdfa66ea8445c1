//! Segments whose process data need several frames a cycle. Without a tap, these frames pass each
//! SubDevice together, and no result may show it.

use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::Nanos;

use crate::witness::Digest;
use crate::{Digests, Nobody, number, results, scenarios, try_each, written};

/// What a run without a tap leaves behind, and how many frames passed together.
fn run(scenario: &Scenario, lane: bool) -> (Digests, u64) {
    let scenario = Scenario { lane, ..scenario.clone() };
    let mut outcome = scenario.run().execute(None::<Nobody>, &mut |_| {});
    let mut digests = results(&outcome);
    outcome.world.catch_up();
    let mut devices = Digest::default();
    devices.look(outcome.world.segment());
    digests.push(("devices", devices.value()));
    (digests, outcome.world.segment().passed_together())
}

fn try_one(name: &str, text: &str) -> Result<bool, String> {
    let Ok(file) = SegmentFile::parse("random.toml", text) else { return Ok(false) };
    let mut scenario = Scenario::from(file);
    scenario.duration = scenario.duration.max(Nanos(scenario.cycle.0 * 40));
    scenario.force = true;
    let ((short, together), (long, one_by_one)) = (run(&scenario, true), run(&scenario, false));
    assert_eq!(one_by_one, 0);
    if short == long {
        return Ok(together > 0);
    }
    let differ = short.iter().zip(&long).filter(|(one, other)| one != other);
    let differ: Vec<_> = differ.map(|((what, _), _)| *what).collect();
    Err(format!("{name}: {differ:?} differ\n{text}"))
}

/// A random scenario, and some of these devices behind it.
fn with_bulk(number: u64, esi: &str) -> String {
    let mut text = scenarios::scenario(number);
    for place in 0..4 + number % 3 {
        let mode = ["sm", "dc-sync0", "free-run"][((number + place) % 3) as usize];
        let device = format!("[[subdevice]]\nesi = {esi:?}\ntype = \"Bulk\"\nmode = \"{mode}\"\n");
        text.push_str(&device);
    }
    text
}

#[test]
fn frames_of_a_cycle_pass_together_as_they_pass_one_by_one() {
    let esi = written("bulk.xml", &description());
    let (from, count) = (number("ISOCAT_SEGMENTS_FROM", 0), number("ISOCAT_SEGMENTS", 24));
    let all: Vec<_> = (from..from + count)
        .map(|number| (format!("scenario {number}"), with_bulk(number, &esi)))
        .collect();
    let (together, failures) = try_each(&all, try_one);
    println!("in {together} of {} frames passed together", all.len());
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert!(together * 3 >= all.len(), "in {together} of {} frames passed together", all.len());
}

/// A device with 480 bytes in each direction.
fn description() -> String {
    let entries = |index: u16| -> String {
        (1..=120)
            .map(|sub| {
                format!(
                    "<Entry><Index>#x{index:04X}</Index><SubIndex>{sub}</SubIndex><BitLen>32</BitLen><Name>{sub}</Name>\
                     <DataType>UDINT</DataType></Entry>"
                )
            })
            .collect()
    };
    let (outputs, inputs) = (entries(0x7000), entries(0x6000));
    format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group><Type>G</Type></Group></Groups>\
         <Devices><Device Physics=\"YY\"><Type ProductCode=\"3\" RevisionNo=\"1\">Bulk</Type><GroupType>G</GroupType>\
         <Sm StartAddress=\"#x1000\" ControlByte=\"#x64\" Enable=\"1\">Outputs</Sm>\
         <Sm StartAddress=\"#x1800\" ControlByte=\"#x20\" Enable=\"1\">Inputs</Sm>\
         <RxPdo Fixed=\"1\" Sm=\"0\"><Index>#x1600</Index><Name>Out</Name>{outputs}</RxPdo>\
         <TxPdo Fixed=\"1\" Sm=\"1\"><Index>#x1A00</Index><Name>In</Name>{inputs}</TxPdo>\
         <Dc><OpMode><Name>Free</Name><AssignActivate>#x0000</AssignActivate></OpMode>\
         <OpMode><Name>Sync0</Name><AssignActivate>#x0300</AssignActivate>\
         <CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0></OpMode></Dc><Eeprom><ByteSize>2048</ByteSize>\
         <ConfigData>050E03440A00</ConfigData></Eeprom></Device></Devices></Descriptions></EtherCATInfo>"
    )
}
