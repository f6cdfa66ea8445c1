//! Written lists are read back equal; real files; errors of broken files have a place.

use isocat_wire::al::AlState;
use isocat_wire::soe::Idn;
use isocat_wire::{Command, ObjectAddress, StationAddress};
use proptest::prelude::*;

use super::*;
use crate::start_up::*;

fn read(text: &str) -> Result<Eni, FileError> {
    Eni::from_bytes("x.xml", text.as_bytes())
}

/// A list with one of everything.
fn list() -> StartUp {
    let station = StationAddress(1001);
    let ps = [Transition::PS];
    let patience = isocat_wire::Nanos::millis(9_000);
    let mut registers = vec![
        RegisterStep::apwr(&[Transition::IP], 0, 0x0010, vec![0xE9, 0x03], "address <1001> & more"),
        RegisterStep::fpwr(&ps, station, 0x09A0, vec![0x40, 0x42, 0x0F, 0, 0, 0, 0, 0], "cycles"),
        RegisterStep::fpwr(&ps, station, 0x0990, vec![0; 8], "start time"),
        RegisterStep::fpwr(&ps, station, 0x0980, vec![0, 3], "SYNC0"),
    ];
    registers.extend(RegisterStep::state(&ps, station, AlState::SafeOp, patience));
    let mut download = ObjectStep::new(&ps, ObjectAddress::new(0x1C12, 0), vec![1, 0, 0, 0x16], "");
    download.complete = true;
    let drive = DeviceStartUp {
        name: "Drive <1> & \"co\"".into(),
        station: station.0,
        vendor: 0xE000_059D,
        product: 7,
        revision: u32::MAX,
        serial: 0,
        physics: "Y YY".into(),
        parent: None,
        mailbox: Some(Mailbox {
            out: Area { start: 0x1000, length: 128 },
            back: Area { start: 0x1080, length: 128 },
            coe: true,
            soe: true,
        }),
        sync_managers: vec![ProcessSyncManager {
            number: 2,
            outputs: true,
            start: 0x1100,
            control: 0x64,
            enabled: true,
            pdos: vec![0x1600],
        }],
        outputs: Some(ImageBits { start: 0, length: 64 }),
        inputs: None,
        registers,
        objects: vec![download],
        parameters: vec![ParameterStep {
            transitions: ps.to_vec(),
            drive: 1,
            idn: Idn(0x800A),
            data: vec![0xFE, 0x7F, 0, 0, 0, 0, 0, 0],
            patience_ms: 100,
            comment: "Feature flags".into(),
        }],
        dc: Some(Dc { reference: true, sync0_ns: 1_000_000, sync1_ns: 0, shift_ns: -300_000 }),
        notes: Vec::new(),
    };
    let second = DeviceStartUp {
        name: "Coupler".into(),
        station: 1002,
        parent: Some(Parent { station: 1001, port: 1 }),
        ..DeviceStartUp::default()
    };
    StartUp {
        name: "bench".into(),
        cycle_ns: 1_000_000,
        before: vec![RegisterStep::bwr(&[Transition::IP], 0x0910, vec![0; 40], "clear DC")],
        devices: vec![drive, second],
        after: vec![RegisterStep::bwr(&ps, 0x0300, vec![0; 8], "clear counters")],
        frames: vec![CyclicFrame {
            every: 1,
            datagrams: vec![
                CyclicDatagram {
                    command: Command::Armw,
                    address: Address::Physical { device: 0, register: 0x0910 },
                    length: 4,
                    states: vec![AlState::PreOp, AlState::SafeOp, AlState::Op],
                    working_counter: None,
                    input_offset: 16,
                    output_offset: 16,
                    comment: String::new(),
                },
                CyclicDatagram {
                    command: Command::Lrw,
                    address: Address::Logical(0x0100_0000),
                    length: 8,
                    states: vec![AlState::SafeOp, AlState::Op],
                    working_counter: Some(3),
                    input_offset: 32,
                    output_offset: 32,
                    comment: "process data".into(),
                },
            ],
        }],
        input_bytes: 48,
        output_bytes: 48,
        notes: Vec::new(),
    }
}

#[test]
fn what_is_written_is_read_back() {
    let list = list();
    let eni = read(&write(&list)).unwrap();
    assert_eq!(eni.start_up, list);
    assert_eq!(eni.warnings, []);
    assert_eq!((eni.version.as_str(), eni.cycles_ns.as_slice()), ("1.3", &[Some(1_000_000)][..]));
    assert_eq!(eni.runnable(), Ok(&list));
    assert_eq!(eni.slaves[1].auto_increment, Some(65535));
    assert_eq!(write(&eni.start_up), write(&list));
}

#[test]
fn what_eni_can_not_say_stands_in_comments() {
    let mut list = list();
    list.cycle_ns = 62_500;
    list.notes = vec!["wait -- until 0x092C < 100 ns --->".into()];
    list.devices[0].notes = vec!["mode dc-sync0".into()];
    let text = write(&list);
    assert!(text.contains("<!-- wait - - until 0x092C &lt; 100 ns - - -&gt; -->"), "{text}");
    assert!(text.contains("<!-- mode dc-sync0 -->"));
    assert!(text.contains("<!-- The cycle is 62500 ns"));
    let eni = read(&text).unwrap();
    // The cycle of SYNC0 remains as the source.
    assert_eq!(eni.start_up.cycle_ns, 1_000_000);
    assert_eq!(eni.warnings[0].kind, WarningKind::CycleTimeMissing);
    assert!(eni.start_up.notes.is_empty());
}

/// The smallest file around a part.
fn around(slave: &str, rest: &str) -> String {
    format!(
        "<EtherCATConfig>\n<Config>\n<Slave><Info><PhysAddr>1001</PhysAddr></Info>\n{slave}</Slave>\n{rest}\n\
         </Config></EtherCATConfig>"
    )
}

#[test]
fn what_is_broken_says_where() {
    let step = |inner: &str| {
        around(
            &format!(
                "<InitCmds><InitCmd>\n<Transition>PS</Transition>{inner}</InitCmd></InitCmds>"
            ),
            "",
        )
    };
    for (text, place, words) in [
        ("<EtherCATConfig><Config></EtherCATConfig>".to_owned(), "1:", "not well-formed XML"),
        ("".into(), "1:1", "not well-formed"),
        ("<EtherCATInfo/>".into(), "1:1", "root element is EtherCATInfo; expected EtherCATConfig"),
        ("<EtherCATConfig/>".into(), "1:1", "no Config"),
        ("<!DOCTYPE a><EtherCATConfig/>".into(), "1:1", "without <!DOCTYPE>"),
        (step("<Cmd>15</Cmd>"), "5:", "unknown command 0x0f"),
        (step("<Cmd>5</Cmd><Adp>65536</Adp>"), "5:", "Adp 65536 is out of range"),
        (step("<Cmd>five</Cmd>"), "5:", "Cmd \"five\" is no number"),
        (step("<Cmd>5</Cmd><Data>123</Data>"), "5:", "two hex digits"),
        (step("<Cmd>5</Cmd><Data>é1</Data>"), "5:", "two hex digits"),
        (step("<Cmd>10</Cmd>"), "4:", "without Addr"),
        (step(""), "4:", "without Cmd"),
        (step("<Cmd>5</Cmd><DataLength>9999</DataLength>"), "5:", "holds 1486"),
        (step("<Cmd>5</Cmd><Data>00</Data><Requires>luck</Requires>"), "4:", "frame or cycle"),
        (step("<Transition>XY</Transition>"), "5:", "two letters of I, P, B, S, O"),
        (step("<Disabled>yes</Disabled>"), "5:", "no flag"),
        (around("<DC><ShiftTime>2147483648</ShiftTime></DC>", ""), "4:", "out of range"),
        (around("<PreviousPort><Port>X</Port></PreviousPort>", ""), "4:", "A, B, C or D"),
        (around("<ProcessData><TxPdo/></ProcessData>", ""), "4:", "PDO without Index"),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("x.xml:{place}")) && error.contains(words),
            "{error}\n{text}"
        );
    }
    let utf16 = Eni::from_bytes("x.xml", &[0xFF, 0xFE, b'<', 0]).unwrap_err().to_string();
    assert!(utf16.contains("UTF-16"), "{utf16}");
    let bytes = [b"<EtherCATConfig>\n".as_slice(), &[0xE9], b"</EtherCATConfig>"].concat();
    let error = Eni::from_bytes("x.xml", &bytes).unwrap_err().to_string();
    assert!(error.starts_with("x.xml:2:1") && error.contains("0xE9"), "{error}");
    let declared = [b"<?xml version='1.0' encoding='ISO-8859-1'?>".as_slice(), &bytes].concat();
    let error = Eni::from_bytes("x.xml", &declared).unwrap_err().to_string();
    assert!(error.contains("no Config"), "{error}");
    // Deep nesting gives an error or is accepted, but never causes a crash.
    let deep = format!(
        "<EtherCATConfig>{}{}</EtherCATConfig>",
        "<a>".repeat(20_000),
        "</a>".repeat(20_000)
    );
    assert!(read(&deep).is_err());
}

#[test]
fn doubts_have_names() {
    let kinds = |text: &str| -> Vec<&'static str> {
        let eni = read(text).unwrap();
        eni.warnings.iter().map(|warning| warning.kind.name()).collect()
    };
    let step =
        |inner: &str| around(&format!("<InitCmds><InitCmd>{inner}</InitCmd></InitCmds>"), "");
    let ps = "<Transition>PS</Transition>";
    assert_eq!(kinds(&around("", "")), [""; 0]);
    assert_eq!(kinds(&step("<Cmd>5</Cmd>")), ["command-left-out"]);
    assert_eq!(
        kinds(&step(&format!("{ps}<Cmd>5</Cmd><Ado>0x10</Ado><Data>e903</Data>"))),
        ["hex-number"]
    );
    assert_eq!(
        kinds(&step(&format!("{ps}<Cmd>5</Cmd><Ado>16</Ado><Data>ea03</Data>"))),
        ["station-differs"]
    );
    let start = format!("{ps}<Cmd>5</Cmd><Ado>2448</Ado><Data>0100000000000000</Data>");
    assert_eq!(kinds(&step(&start)), ["start-time"]);
    assert_eq!(kinds(&step(&format!("{ps}<Cmd>5</Cmd>"))), ["no-data"]);
    let check = format!("{ps}<Cmd>4</Cmd><Data>0000</Data><Validate><Data>01</Data></Validate>");
    assert_eq!(kinds(&step(&check)), ["check-length"]);
    let dc = "<DC><ReferenceClock>0</ReferenceClock><CycleTime0>1000000</CycleTime0></DC>";
    assert_eq!(kinds(&around(dc, "")), ["cycle-time-missing", "reference-clock-missing"]);
    let cyclic = "<Cyclic><CycleTime>1500</CycleTime></Cyclic>";
    assert_eq!(kinds(&around(dc, cyclic)), ["cycle-time-differs", "reference-clock-missing"]);
    let only_potential = "<DC><PotentialReferenceClock>0</PotentialReferenceClock></DC>";
    assert_eq!(kinds(&around(only_potential, "")), [""; 0]);
    let cycles = "<InitCmds><InitCmd><Transition>PS</Transition><Cmd>5</Cmd><Ado>2464</Ado>\
                  <Data>00000000</Data></InitCmd></InitCmds>";
    let reference = "<DC><ReferenceClock>1</ReferenceClock><CycleTime0>1000000</CycleTime0></DC>";
    let both = format!("{cycles}{reference}");
    assert_eq!(kinds(&around(&both, "")), ["cycles-differ", "cycle-time-missing"]);
    assert_eq!(kinds(&around("", "<Surprise/>")), ["element-unknown"]);
    let foe = "<Mailbox><FoE><InitCmds><InitCmd/></InitCmds></FoE></Mailbox>";
    assert_eq!(kinds(&around(foe, "")), ["protocol-left-out"]);
    let soe = |command: &str| {
        let command = format!("<InitCmd>{ps}{command}<IDN>32</IDN><Data>0b00</Data></InitCmd>");
        format!("<Mailbox><SoE><InitCmds>{command}</InitCmds></SoE></Mailbox>")
    };
    for read in ["<OpCode>1</OpCode>", "<Elements>2</Elements>", "<Elements>66</Elements>"] {
        assert_eq!(kinds(&around(&soe(read), "")), ["protocol-left-out"], "{read}");
    }
    assert_eq!(kinds(&around(&soe("<OpCode>3</OpCode><DriveNo>7</DriveNo>"), "")), [""; 0]);
    let error = read(&around(&soe("<DriveNo>8</DriveNo>"), "")).unwrap_err().to_string();
    assert!(error.contains("drive 8; expected 0 to 7"), "{error}");
    let upload = format!(
        "<Mailbox><CoE><InitCmds><InitCmd>{ps}<Index>7186</Index></InitCmd></InitCmds></CoE></Mailbox>"
    );
    assert_eq!(kinds(&around(&upload, "")), ["upload-left-out"]);
    let text = read(&around("", "<Surprise/>")).unwrap().warnings[0].to_string();
    assert_eq!(text, "5:1: Surprise in Config is not known: skipped (element-unknown)");
}

#[test]
fn what_can_not_be_run_says_why() {
    let reasons = |change: fn(&mut StartUp)| {
        let mut list = list();
        change(&mut list);
        read(&write(&list)).unwrap().runnable().unwrap_err().join("; ")
    };
    assert!(
        reasons(|list| list.devices[1].station = 0).contains("SubDevice 1 has no station address")
    );
    assert!(reasons(|list| list.devices[1].station = 1001).contains("one station address, 0x03E9"));
    assert!(reasons(|list| list.frames.clear()).contains("no cyclic frames"));
    assert!(reasons(|list| list.devices.clear()).contains("names no SubDevice"));
    let no_cycle = |list: &mut StartUp| {
        list.cycle_ns = 0;
        list.devices[0].dc = None;
    };
    assert!(reasons(no_cycle).contains("no cycle time"));
    let slower = |micros: u32| {
        let cyclic = format!("</Cyclic><Cyclic><CycleTime>{micros}</CycleTime></Cyclic>");
        read(&write(&list()).replace("</Cyclic>", &cyclic)).unwrap()
    };
    assert!(slower(2000).runnable().is_ok());
    assert!(slower(2500).runnable().unwrap_err()[0].contains("1000000 ns and 2500000 ns"));
    let hot = write(&list()).replace("<DC>", "<HotConnect/><DC>");
    assert!(read(&hot).unwrap().runnable().unwrap_err()[0].contains("HotConnect"));
}

fn any_text() -> impl Strategy<Value = String> {
    "[ -~\t\n\ré&<>\u{4e00}]{0,12}".prop_map(|text| text.trim().to_owned())
}

fn any_transitions() -> impl Strategy<Value = Vec<Transition>> {
    let letter = proptest::sample::select(vec![
        AlState::Init,
        AlState::PreOp,
        AlState::Boot,
        AlState::SafeOp,
        AlState::Op,
    ]);
    let one = (letter.clone(), letter).prop_map(|(from, to)| Transition { from, to });
    proptest::collection::vec(one, 1..4)
}

fn any_address() -> impl Strategy<Value = (Command, Address)> {
    proptest::sample::select(Command::ALL.to_vec()).prop_flat_map(|command| {
        (Just(command), any::<u16>(), any::<u16>(), any::<u32>()).prop_map(
            |(command, device, register, logical)| match command.is_logical() {
                true => (command, Address::Logical(logical)),
                false => (command, Address::Physical { device, register }),
            },
        )
    })
}

fn any_step() -> impl Strategy<Value = RegisterStep> {
    let bytes = || proptest::collection::vec(prop_oneof![Just(0), any::<u8>()], 0..40);
    let check = proptest::option::of((bytes(), any::<bool>(), any::<u32>()));
    let own = proptest::sample::select(vec![Own::Nothing, Own::Frame, Own::Cycle]);
    let limits = (any::<Option<u16>>(), any::<u16>(), any::<Option<u32>>());
    (any_transitions(), any_address(), bytes(), own, limits, check, any_text()).prop_map(
        |(transitions, (command, address), data, own, limits, check, comment)| RegisterStep {
            transitions,
            command,
            address,
            data,
            own,
            working_counter: limits.0,
            retries: limits.1,
            patience_ms: limits.2,
            check: check.map(|(data, masked, patience_ms)| Check {
                mask: masked.then(|| vec![0x1F; data.len()]),
                data,
                patience_ms,
            }),
            comment,
        },
    )
}

fn any_device() -> impl Strategy<Value = DeviceStartUp> {
    let registers = proptest::collection::vec(any_step(), 0..4);
    let object = (
        any_transitions(),
        any::<(u16, u8, bool, u32)>(),
        proptest::collection::vec(any::<u8>(), 1..20),
        any_text(),
    )
        .prop_map(|(transitions, (index, sub, complete, patience_ms), data, comment)| ObjectStep {
            transitions,
            object: ObjectAddress::new(index, sub),
            complete,
            data,
            patience_ms,
            comment,
        });
    let objects = proptest::collection::vec(object, 0..4);
    let parameter =
        (
            any_transitions(),
            (0..8u8, any::<(u16, u32)>()),
            proptest::collection::vec(any::<u8>(), 0..20),
            any_text(),
        )
            .prop_map(|(transitions, (drive, (idn, patience_ms)), data, comment)| {
                ParameterStep { transitions, drive, idn: Idn(idn), data, patience_ms, comment }
            });
    let parameters = proptest::collection::vec(parameter, 0..4);
    let bits = || proptest::option::of(any::<(u32, u32)>());
    let manager = any::<(u8, bool, u16, bool, Vec<u16>)>();
    let managers = proptest::collection::vec(manager, 0..3);
    let dc = proptest::option::of(any::<(bool, u32, u32, i32)>());
    let mailbox = proptest::option::of(any::<(u16, u16, u16, bool)>());
    let parent = proptest::option::of((any::<u16>(), 0..4u8));
    let numbers = any::<(u16, u32, u32, u32, u32)>();
    (
        (any_text(), any_text(), numbers),
        (registers, objects, parameters),
        (bits(), bits(), managers),
        (dc, mailbox, parent),
    )
        .prop_map(|((name, physics, numbers), lists, image, (dc, mailbox, parent))| {
            let (registers, objects, parameters) = lists;
            let bits =
                |bits: Option<(u32, u32)>| bits.map(|(start, length)| ImageBits { start, length });
            // A mailbox of 0 bytes is none; a device with SDO downloads speaks CoE, and so on.
            let (coe, soe) = (!objects.is_empty(), !parameters.is_empty());
            DeviceStartUp {
                name,
                station: numbers.0,
                vendor: numbers.1,
                product: numbers.2,
                revision: numbers.3,
                serial: numbers.4,
                physics,
                parent: parent.map(|(station, port)| Parent { station, port }),
                mailbox: mailbox.map(|(start, length, back, speaks)| Mailbox {
                    out: Area { start, length: length.max(1) },
                    back: Area { start: back, length },
                    coe: speaks || coe,
                    soe: speaks || soe,
                }),
                sync_managers: image
                    .2
                    .into_iter()
                    .map(|(number, outputs, start, enabled, pdos)| ProcessSyncManager {
                        number: number % 16,
                        outputs,
                        start,
                        control: if outputs { 0x64 } else { 0x20 },
                        enabled,
                        pdos,
                    })
                    .collect(),
                outputs: bits(image.0),
                inputs: bits(image.1),
                registers,
                objects,
                parameters,
                dc: dc.map(|(reference, sync0_ns, sync1_ns, shift_ns)| Dc {
                    reference,
                    sync0_ns,
                    sync1_ns,
                    shift_ns,
                }),
                notes: Vec::new(),
            }
        })
}

fn any_list() -> impl Strategy<Value = StartUp> {
    let steps = || proptest::collection::vec(any_step(), 0..3);
    let states = proptest::sample::subsequence(
        vec![AlState::Init, AlState::PreOp, AlState::Boot, AlState::SafeOp, AlState::Op],
        0..=5,
    );
    let datagram =
        (any_address(), 0..=1_486u16, states, any::<(Option<u16>, u32, u32)>(), any_text())
            .prop_map(|((command, address), length, states, numbers, comment)| CyclicDatagram {
                command,
                address,
                length,
                states,
                working_counter: numbers.0,
                input_offset: numbers.1,
                output_offset: numbers.2,
                comment,
            });
    // Faster frames first, in sending order.
    let frame = (1..6u32, proptest::collection::vec(datagram, 0..4))
        .prop_map(|(every, datagrams)| CyclicFrame { every, datagrams });
    let frames = proptest::collection::vec(frame, 0..3).prop_map(|mut frames| {
        frames.sort_by_key(|frame| frame.every);
        frames
    });
    let devices = proptest::collection::vec(any_device(), 0..4);
    (any_text(), 1..100_000i64, steps(), devices, steps(), frames, any::<(u32, u32)>()).prop_map(
        |(name, micros, before, devices, after, frames, (input_bytes, output_bytes))| StartUp {
            name,
            cycle_ns: micros * 1_000,
            before,
            devices,
            after,
            frames,
            input_bytes,
            output_bytes,
            notes: Vec::new(),
        },
    )
}

proptest! {
    /// Any list is read back as it was written.
    #[test]
    fn any_list_is_read_back(list in any_list()) {
        let text = write(&list);
        let eni = read(&text).map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
        prop_assert_eq!(&eni.start_up, &list);
        prop_assert_eq!(write(&eni.start_up), text);
    }

    /// A damaged file gives an error with a place, or a result; never a panic.
    #[test]
    fn a_damaged_file_does_not_panic(at in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = write(&list()).into_bytes();
        let at = at.index(bytes.len());
        if cut { bytes.truncate(at) } else { bytes[at] = byte }
        match Eni::from_bytes("x.xml", &bytes) {
            Ok(eni) => { let _ = eni.runnable(); }
            Err(error) => prop_assert!(error.line > 0 && !error.message.is_empty()),
        }
    }
}
