//! A device with a mailbox whose process data are in several SyncManagers of each direction: each
//! has an assignment of its own, 0x1C10 and its number, and is mapped by an FMMU of its own.

use isocat::plan::Plan;
use isocat::start_up::{Address, DeviceStartUp};
use isocat::{Nanos, Scenario, SegmentFile, run};
use isocat_maindevice::{Cycle, Event};
use isocat_sim::{Tap, World};
use isocat_wire::ObjectAddress;
use isocat_wire::time::{Picos, Time, True};

const FILE: &str = include_str!("../esi/several.xml");

/// A segment of the device of a file with these keys.
fn segment(name: &str, text: &str, keys: &str) -> Result<SegmentFile, String> {
    let path =
        std::env::temp_dir().join(format!("isocat-several-{}-{name}.xml", std::process::id()));
    std::fs::write(&path, text).unwrap();
    let toml = format!("cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = {path:?}\n{keys}\n");
    let file = SegmentFile::parse("s.toml", &toml);
    std::fs::remove_file(&path).unwrap();
    file.map_err(|error| error.to_string())
}

fn start_up(segment: SegmentFile) -> DeviceStartUp {
    let scenario = Scenario::from(segment);
    Plan::of(&scenario).unwrap().start_up(&scenario).devices.remove(0)
}

/// Number of a SyncManager, with its first byte and its bytes.
type Manager = (u16, u16, u16);
/// First byte and bytes of an FMMU.
type Mapped = (u16, u16);

/// The SyncManagers and the FMMUs that are written.
fn written(device: &DeviceStartUp) -> (Vec<Manager>, Vec<Mapped>) {
    let (mut managers, mut fmmus) = (Vec::new(), Vec::new());
    for step in &device.registers {
        let Address::Physical { register, .. } = step.address else { continue };
        let word = |at: usize| u16::from_le_bytes([step.data[at], step.data[at + 1]]);
        match register {
            0x0800..0x0880 => managers.push(((register - 0x0800) / 8, word(0), word(2))),
            0x0600..0x0700 => fmmus.push((word(8), word(4))),
            _ => {}
        }
    }
    (managers, fmmus)
}

#[test]
fn each_sync_manager_has_its_assignment() {
    let file = segment("objects", FILE, "opmode = \"DC\"").unwrap();
    let profile = file.subdevices[0].profile.clone();
    let list = |index: u16| isocat_segment::offline::list(&profile, index);
    assert_eq!([list(0x1C12), list(0x1C14)], [vec![0x1600], vec![0x1610]]);
    assert_eq!([list(0x1C13), list(0x1C15)], [vec![0x1A00], vec![0x1A10, 0x1A11]]);
    assert_eq!(list(0x1C00), [1, 2, 3, 4, 3, 4]);
    assert_eq!(profile.value(ObjectAddress::new(0x1C14, 0)), Some(1));

    let listed = start_up(file);
    let (managers, fmmus) = written(&listed);
    let expected = [(2, 0x1100, 1), (4, 0x1300, 4), (3, 0x1200, 2), (5, 0x1400, 3)];
    assert_eq!(
        managers.iter().filter(|manager| manager.0 > 1).copied().collect::<Vec<_>>(),
        expected
    );
    assert_eq!(fmmus, [(0x1100, 1), (0x1300, 4), (0x1200, 2), (0x1400, 3)]);
    let pdos = |number: u8| {
        let manager = listed.sync_managers.iter().find(|manager| manager.number == number);
        manager.unwrap().pdos.clone()
    };
    assert_eq!(
        [2, 3, 4, 5].map(pdos),
        [vec![0x1600], vec![0x1A00], vec![0x1610], vec![0x1A10, 0x1A11]]
    );
}

struct NoTap;

impl Tap for NoTap {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

/// Writes outputs, and keeps the inputs of the last cycle.
#[derive(Default)]
struct Exchange {
    inputs: Vec<u8>,
    length: usize,
}

impl isocat_maindevice::Application for Exchange {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        self.inputs = cycle.inputs(0).to_vec();
        let outputs = cycle.outputs_mut(0);
        self.length = outputs.len();
        outputs.copy_from_slice(&[0x1F, 0x78, 0x56, 0x34, 0x12]);
    }
}

/// What the MainDevice finds over the wire is what the plan knows of the profile: the outputs are
/// in the memory of both SyncManagers, and the inputs come from both.
#[test]
fn both_sync_managers_of_a_direction_are_exchanged() {
    for keys in ["opmode = \"DC\"", "opmode = \"SM\""] {
        let file = segment("exchange", FILE, keys).unwrap();
        let setup = Scenario::from(file).run().setup;
        let mut world = World::new(setup, Exchange::default(), None::<NoTap>);
        let mut in_operation = false;
        while !in_operation {
            assert!(world.step(Time::new(60_000_000_000_000)), "not in operation after a minute");
            while let Some(event) = world.poll_event() {
                match event {
                    Event::InOperation { .. } => in_operation = true,
                    Event::Failed(error) => panic!("{keys}: {error}"),
                    _ => {}
                }
            }
        }
        let end = world.now() + Picos::from(Nanos::millis(10));
        while world.step(end) {}
        let exchange = world.application_mut();
        assert_eq!((exchange.length, exchange.inputs.len()), (5, 5), "{keys}");
        let esc = &world.segment().devices()[0].esc;
        // Each of the three buffers has the same, since the outputs do not change.
        let memory = |from: usize, count: usize| esc.ram()[from - 0x1000..][..count].to_vec();
        assert_eq!(
            (memory(0x1100, 1), memory(0x1300, 4)),
            (vec![0x1F], vec![0x78, 0x56, 0x34, 0x12])
        );
    }
}

#[test]
fn it_runs_in_sync_in_each_op_mode() {
    for (keys, mode) in [("opmode = \"DC\"", "dc-sync0"), ("opmode = \"SM\"", "sm")] {
        // A value in the second SyncManager of the outputs, by its object.
        let output = "[[output]]\ndevice = \"0\"\nplace = \"0x7010:01\"\nat = \"5ms\"\nvalue = 7";
        let file = segment("run", FILE, &format!("{keys}\n{output}")).unwrap();
        let report = run(&Scenario::from(file));
        assert!(report.in_sync, "{}", report.text());
        assert_eq!(report.devices[0].mode.name(), mode);
    }
}

/// Each other placement is refused by name, where it stands.
#[test]
fn what_has_no_assignment_of_its_own_is_refused() {
    // Outputs in SM2 and SM3, inputs in SM4 and SM5: 0x1C13 would belong to outputs.
    let other = FILE
        .replace("Sm=\"3\"", "Sm=\"x\"")
        .replace("Sm=\"4\"", "Sm=\"3\"")
        .replace("Sm=\"x\"", "Sm=\"4\"")
        .replacen(
            "#x1200\" ControlByte=\"#x20\" DefaultSize=\"2\" Enable=\"1\">Inputs",
            "#x1200\" ControlByte=\"#x64\" DefaultSize=\"4\" Enable=\"1\">Outputs",
            1,
        )
        .replacen(
            "#x1300\" ControlByte=\"#x64\" DefaultSize=\"4\" Enable=\"1\">Outputs",
            "#x1300\" ControlByte=\"#x20\" DefaultSize=\"2\" Enable=\"1\">Inputs",
            1,
        );
    let error = segment("refused", &other, "opmode = \"DC\"").unwrap_err();
    assert!(error.contains("its outputs are in SM2 and SM3"), "{error}");
}
