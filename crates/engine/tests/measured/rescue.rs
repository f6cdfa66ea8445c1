//! Dead lines of virtual segments: each is found at its port, and what is before it answers again.

use std::sync::atomic::AtomicBool;

use isocat_conform::wire::VirtualWire;
use isocat_engine::rescue::{DeadPort, Rescue, rescue};
use isocat_segment::{Scenario, SegmentFile};

/// A line of three, of which the second has a branch of two at port 2 beside one at port 1.
const TREE: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    name = "first"
    device = "simple_io16"
    [[subdevice]]
    name = "junction"
    device = "model_every_mode"
    [[subdevice]]
    name = "straight"
    device = "simple_io16"
    connect = "junction:1"
    [[subdevice]]
    name = "aside"
    device = "kollmorgen_akd2g"
    connect = "junction:2"
    [[subdevice]]
    name = "end"
    device = "simple_io16"
"#;

fn rescued(faults: &[&str]) -> Rescue {
    let fault = |what: &&str| format!("[[fault]]\nat = \"0ms\"\nwhat = \"{what}\"\n");
    let text = TREE.to_owned() + &faults.iter().map(fault).collect::<String>();
    let scenario = Scenario::from(SegmentFile::parse("tree.toml", &text).expect("a segment"));
    let mut wire = VirtualWire::with_faults(scenario);
    let first = rescue(&mut wire, &AtomicBool::new(false)).expect("a rescue");
    // What it leaves works.
    if let Rescue::Rescued { devices, .. } = first {
        let again = rescue(&mut wire, &AtomicBool::new(false));
        assert_eq!(again, Ok(Rescue::Alive(devices)));
    }
    first
}

fn found(devices: usize, dead: &[(usize, u8)]) -> Rescue {
    let dead = dead.iter().map(|&(device, port)| DeadPort { device, port }).collect();
    Rescue::Rescued { devices, dead }
}

#[test]
fn the_port_before_a_dead_line_is_found_and_closed() {
    assert_eq!(rescued(&[]), Rescue::Alive(5));
    assert_eq!(rescued(&["break first out"]), Rescue::FirstLine);
    assert_eq!(rescued(&["break junction out"]), found(1, &[(0, 1)]));
    assert_eq!(rescued(&["break straight out"]), found(4, &[(1, 1)]));
    assert_eq!(rescued(&["break aside out"]), found(3, &[(1, 2)]));
    assert_eq!(rescued(&["break end out"]), found(4, &[(3, 1)]));
    let both = ["break straight out", "break end out"];
    assert_eq!(rescued(&both), found(3, &[(1, 1), (2, 1)]));
}

/// The port that receives over the broken pair loses its link, and closes by itself.
#[test]
fn a_line_that_is_broken_on_the_way_back_is_closed_already() {
    assert_eq!(rescued(&["break aside back"]), Rescue::Alive(3));
    assert_eq!(rescued(&["pull end"]), Rescue::Alive(4));
}

/// The far end of a line as makers build it.
#[test]
fn a_long_line() {
    let text = "cycle = \"100ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 400\n[[subdevice]]\nname = \"last\"\n\
                device = \"simple_io16\"\n[[fault]]\nat = \"0ms\"\nwhat = \"break last out\"\n";
    let scenario = Scenario::from(SegmentFile::parse("long.toml", text).expect("a segment"));
    let result = rescue(&mut VirtualWire::with_faults(scenario), &AtomicBool::new(false));
    assert_eq!(result, Ok(found(400, &[(399, 1)])));
}
