//! Order, text and JSON of the list.

use super::*;

/// A drive that gets its address, its PDOs, SYNC0, and goes to SAFEOP.
fn list() -> StartUp {
    let station = StationAddress(0x1001);
    let ps = [Transition::PS];
    let patience = Nanos::millis(10_000);
    let mut cycles = 1_000_000u32.to_le_bytes().to_vec();
    cycles.extend([0; 4]);
    let mut registers = vec![
        RegisterStep::apwr(&[Transition::IP], 0, 0x0010, vec![0x01, 0x10], "station address"),
        RegisterStep::fpwr(&ps, station, 0x09A0, cycles, "cycles"),
        RegisterStep::fpwr(&ps, station, 0x0990, vec![0; 8], "start time, to be replaced"),
        RegisterStep::fpwr(&ps, station, 0x0980, vec![0x00, 0x03], "SYNC0 on"),
    ];
    registers.extend(RegisterStep::state(&ps, station, AlState::SafeOp, patience));
    let object = ObjectAddress::new(0x1C12, 0);
    let drive = DeviceStartUp {
        name: String::from("drive"),
        station: station.0,
        vendor: 0x6A,
        registers,
        objects: vec![
            ObjectStep::new(&ps, object, vec![2], "two PDOs"),
            ObjectStep::new(&[Transition::IP], object, vec![0], "no PDOs"),
        ],
        parameters: vec![ParameterStep {
            transitions: ps.to_vec(),
            drive: 1,
            idn: Idn(32),
            data: vec![0x0B, 0],
            patience_ms: 0,
            comment: "operation mode".into(),
        }],
        dc: Some(Dc { reference: true, sync0_ns: 1_000_000, sync1_ns: 0, shift_ns: -500 }),
        ..DeviceStartUp::default()
    };
    StartUp {
        name: String::from("bench"),
        cycle_ns: 1_000_000,
        before: vec![RegisterStep::bwr(&[Transition::IP], 0x0981, vec![0], "SYNC off")],
        devices: vec![drive],
        frames: vec![CyclicFrame {
            every: 1,
            datagrams: vec![CyclicDatagram {
                command: Command::Armw,
                address: Address::Physical { device: 0, register: 0x0910 },
                length: 4,
                states: vec![AlState::SafeOp, AlState::Op],
                working_counter: None,
                input_offset: 0,
                output_offset: 0,
                comment: String::from("system time"),
            }],
        }],
        ..StartUp::default()
    }
}

#[test]
fn objects_come_first_but_where_there_is_no_mailbox_yet() {
    let list = list();
    let kinds = |transition| -> Vec<bool> {
        let steps = list.devices[0].at(transition);
        steps.iter().map(|step| !matches!(step, Step::Register(_))).collect()
    };
    assert_eq!(kinds(Transition::IP), [false, true]);
    assert_eq!(kinds(Transition::PS), [true, true, false, false, false, false, false]);
    assert!(kinds(Transition::SO).is_empty());
    assert_eq!(list.devices[0].assign_activate(), Some(AssignActivate::SYNC0));
}

#[test]
fn transitions_by_their_letters() {
    for text in ["IP", "PS", "SO", "OI", "IB", "PP"] {
        assert_eq!(text.parse::<Transition>().unwrap().to_string(), text);
    }
    for text in ["", "I", "IPS", "ps", "XP"] {
        assert_eq!(text.parse::<Transition>(), Err(UnknownTransition(text.to_owned())));
    }
}

#[test]
fn the_list_in_words() {
    let expected = "\
Start-up of bench: cycle 1 ms, 1 SubDevice

all SubDevices, before each one
  IP  BWR  0x0981     00                                  SYNC off

0 drive, station 0x1001
  vendor 0x0000006A, product 0x00000000, revision 0x00000000
  IP  APWR 0x0010     0110                                station address
  IP  SDO  0x1C12:00  00                                  no PDOs
  PS  SDO  0x1C12:00  02                                  two PDOs
  PS  SoE  1 S-0-0032 0b00                                operation mode
  PS  FPWR 0x09A0     40420f00 00000000                   cycles
  PS  FPWR 0x0990     00000000 00000000                   start time, to be replaced
  PS  FPWR 0x0980     0003                                SYNC0 on
  PSc FPWR 0x0120     0400                                SAFEOP is asked for
  PSc FPRD 0x0130     = 04000000 0000 & 1f000000 0000     SAFEOP must be reached
  DC: SYNC0 1 ms, SYNC1 0 ns after it, shift -500 ns, AssignActivate 0x0300, its clock leads

each cycle, with a process image of 0 bytes of inputs, 0 of outputs
  frame 0  ARMW 0x0910         4 bytes  in SAFEOP, OP  system time

c, f: in a cycle or frame of its own; SDO*: complete access; = what a read must find
SoE: number of the drive, and the parameter that is written
";
    assert_eq!(list().text(), expected);
}

#[test]
fn what_is_not_there_is_not_shown_as_zero() {
    let mut list = list();
    (list.name, list.cycle_ns) = (String::new(), 0);
    list.devices[0].dc = Some(Dc { reference: true, sync0_ns: 0, sync1_ns: 0, shift_ns: 0 });
    let text = list.text();
    let title = "Start-up of a segment without a name: no cycle told, 1 SubDevice\n";
    assert!(text.starts_with(title), "{text}");
    assert!(text.contains("\n  DC: no SYNC, AssignActivate 0x0300, its clock leads\n"), "{text}");
}

#[test]
fn the_list_for_programs() {
    let json: serde_json::Value = serde_json::from_str(&list().json()).unwrap();
    assert_eq!(json["format"], FORMAT);
    let drive = &json["devices"][0];
    assert_eq!(drive["station"], "0x1001");
    let step = &drive["registers"][1];
    assert_eq!((&step["command"], &step["transitions"][0]), (&"FPWR".into(), &"PS".into()));
    assert_eq!(step["address"]["physical"]["register"], "0x09A0");
    assert_eq!(step["data"], "40420f0000000000");
    assert_eq!(drive["objects"][0]["object"], "0x1C12:00");
    assert_eq!(json["frames"][0]["datagrams"][0]["states"][1], "OP");
}
