//! Described devices whose process data are in several SyncManagers, or are the registers of
//! digital outputs.

use isocat::esi::EsiFile;
use isocat::plan::Plan;
use isocat::profile::{Obstacle, Profile};
use isocat::{Nanos, Report, Scenario, SegmentFile, run};
use isocat_sync::SyncMode;

/// A file with one device. PDOs are made for each SyncManager: (start, control, bits).
fn described(config_data: &str, managers: &[(u16, u8, u16)], rest: &str) -> String {
    let mut text = format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Devices>\
         <Device Physics=\"YY\"><Type ProductCode=\"2\" RevisionNo=\"3\">Box</Type><Name>Box</Name>{rest}"
    );
    for (number, (start, control, bits)) in managers.iter().enumerate() {
        let outputs = control & 0x0C == 0x04;
        let (kind, tag, index) =
            if outputs { ("Outputs", "RxPdo", 0x1600) } else { ("Inputs", "TxPdo", 0x1A00) };
        let bytes = bits.div_ceil(8);
        text += &format!(
            "<Sm StartAddress=\"#x{start:04X}\" ControlByte=\"#x{control:02X}\" DefaultSize=\"{bytes}\" \
             Enable=\"1\">{kind}</Sm><{tag} Sm=\"{number}\"><Index>{}</Index><Name>P</Name>",
            index + number
        );
        text += &format!(
            "<Entry><Index>{}</Index><SubIndex>1</SubIndex><BitLen>1</BitLen><Name>B</Name>\
             <DataType>BOOL</DataType></Entry>",
            0x6000 + number
        );
        let padding = bits - 1;
        if padding > 0 {
            text += &format!("<Entry><Index>0</Index><BitLen>{padding}</BitLen></Entry>");
        }
        text += &format!("</{tag}>");
    }
    let eeprom = match config_data {
        "" => String::new(),
        data => format!("<ConfigData>{data}</ConfigData>"),
    };
    text + &format!(
        "<Eeprom><ByteSize>2048</ByteSize>{eeprom}</Eeprom></Device></Devices></Descriptions></EtherCATInfo>"
    )
}

/// Digital I/O without a program.
const DIGITAL: &str = "0401000000000000";
/// A microcontroller behind SPI.
const PROGRAM: &str = "050C0000E8030000";

/// The segment file of one such device.
fn segment(name: &str, text: &str) -> SegmentFile {
    let folder = std::env::temp_dir();
    let file = format!("isocat-image-{}-{name}.xml", std::process::id());
    std::fs::write(folder.join(&file), text).unwrap();
    let toml = format!("cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = \"{file}\"\n");
    let parsed = SegmentFile::parse(&folder.join("s.toml").display().to_string(), &toml);
    std::fs::remove_file(folder.join(&file)).unwrap();
    parsed.unwrap()
}

fn run_of(segment: SegmentFile) -> Report {
    let report = run(&Scenario::from(segment));
    assert!(report.in_sync, "{}", report.text());
    assert!(report.devices[0].registers.al_status.is_op());
    report
}

/// What the plan writes: (address, first byte, length, control or type) of SyncManagers that are
/// on, and of FMMUs with their place in the image.
type Written = (Vec<(u16, u16, u16, u8)>, Vec<(u32, u16, u16, u8)>);

fn written(segment: SegmentFile) -> Written {
    let scenario = Scenario::from(segment);
    let plan = Plan::of(&scenario).unwrap();
    let (mut managers, mut fmmus) = (Vec::new(), Vec::new());
    for step in &plan.start_up(&scenario).devices[0].registers {
        let isocat::start_up::Address::Physical { register, .. } = step.address else { continue };
        let d = &step.data;
        let word = |at: usize| u16::from_le_bytes([d[at], d[at + 1]]);
        match register {
            0x0800..0x0880 if d[6] == 1 => managers.push((register, word(0), word(2), d[4])),
            0x0600..0x0700 => {
                let logical = u32::from_le_bytes([d[0], d[1], d[2], d[3]]);
                fmmus.push((logical, word(8), word(4), d[11]));
            }
            _ => {}
        }
    }
    (managers, fmmus)
}

/// Registers as outputs, and inputs in the memory: control bytes are the file's, and one FMMU maps
/// adjacent bytes.
#[test]
fn digital_outputs_are_registers() {
    let managers = [(0x0F02, 0x44, 8), (0x0F03, 0x44, 3), (0x1000, 0x00, 16)];
    let text = described(DIGITAL, &managers, "");
    let file = segment("registers", &text);
    let profile = file.subdevices[0].profile.clone();
    assert_eq!(profile.sii[..2], [0x04, 0x01], "device emulation as the file has it");
    assert_eq!(
        written(file.clone()),
        (
            vec![(0x0800, 0x0F02, 1, 0x44), (0x0808, 0x0F03, 1, 0x44), (0x0810, 0x1000, 2, 0x00)],
            vec![(0, 0x0F02, 2, 2), (0, 0x1000, 2, 1)]
        )
    );
    assert_eq!(file.subdevices[0].mode, Some(SyncMode::SmSynchronous));
    let report = run_of(file);
    let times = &report.devices[0].true_time;
    assert!(times.outputs_age.is_some() && times.inputs_age.is_some(), "both are exchanged");
}

/// A device with a program takes both: 5 bits and 9 bits are one and two bytes.
#[test]
fn a_program_has_several_sync_managers() {
    let managers = [(0x1000, 0x64, 5), (0x1200, 0x64, 9), (0x1400, 0x20, 24), (0x1500, 0x20, 1)];
    let file = segment("program", &described(PROGRAM, &managers, ""));
    assert_eq!(
        written(file.clone()),
        (
            vec![
                (0x0800, 0x1000, 1, 0x64),
                (0x0808, 0x1200, 2, 0x64),
                (0x0810, 0x1400, 3, 0x20),
                (0x0818, 0x1500, 1, 0x20)
            ],
            vec![(0, 0x1000, 1, 2), (1, 0x1200, 2, 2), (0, 0x1400, 3, 1), (3, 0x1500, 1, 1)]
        )
    );
    run_of(file);
}

/// SYNC0 moves outputs where an OpMode says so, without a program as well.
#[test]
fn sync0_moves_digital_outputs() {
    let dc = "<Dc><OpMode><Name>DC</Name><AssignActivate>#x300</AssignActivate>\
              <CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0></OpMode></Dc>";
    // Dc stands behind the PDOs in a description; the reader takes it anywhere.
    let text = described("04050000E8030000", &[(0x0F00, 0x44, 8)], dc);
    let file = segment("sync0", &text);
    assert_eq!(file.subdevices[0].mode, Some(SyncMode::DcSync0));
    let report = run_of(file);
    let delay = report.devices[0].true_time.outputs_delay.unwrap();
    assert_eq!((delay.min_ns, delay.max_ns), (0.0, 0.0), "the pulse itself moves them");
}

/// A terminal that samples five times in a cycle: the samples of both channels are exchanged, and
/// their instants, the SYNC0 pulses, are in the waveforms.
#[test]
fn the_instants_of_samples_are_in_the_waveforms() {
    let dc = "<Dc><OpMode><Name>5</Name><AssignActivate>#x730</AssignActivate>\
              <CycleTimeSync0 Factor=\"-5\">0</CycleTimeSync0>\
              <CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1></OpMode></Dc>";
    let channels = [(0x1000, 0x20, 80), (0x1200, 0x20, 80)];
    let folder = std::env::temp_dir().join(format!("isocat-samples-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let text = described("0605000010000100", &channels, dc);
    std::fs::write(folder.join("box.xml"), text).unwrap();
    let toml = "cycle = \"1ms\"\n[[subdevice]]\nesi = \"box.xml\"\nclock = \"0ppm\"\n";
    std::fs::write(folder.join("s.toml"), toml).unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.arg("run").arg(folder.join("s.toml")).args(["--for", "20ms", "--waves"]);
    let done = command.arg(folder.join("s.vcd")).output().unwrap();
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let waves = std::fs::read_to_string(folder.join("s.vcd")).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();

    let (sync0, sync1) = (instants(&waves, "sync0"), instants(&waves, "sync1"));
    assert!(sync0.len() > 100, "{} pulses", sync0.len());
    // In ps: a fifth of the cycle, on the ticks of 10 ns of a clock that others lead nowhere.
    assert!(sync0.windows(2).all(|pair| pair[1] - pair[0] == 200_000_000));
    assert!(sync1.windows(2).all(|pair| pair[1] - pair[0] == 1_000_000_000));
    assert!(sync1.iter().all(|at| sync0.contains(at)), "each set of samples begins with one");
}

/// When an event of a waveform file happens.
fn instants(waves: &str, event: &str) -> Vec<u64> {
    let named = format!(" {event} $end");
    let declared = waves.lines().find(|line| line.contains("$var event") && line.ends_with(&named));
    let mark = format!("1{}", declared.unwrap().split(' ').nth(3).unwrap());
    let mut at = 0;
    let mut found = Vec::new();
    for line in waves.lines() {
        if let Some(instant) = line.strip_prefix('#') {
            at = instant.parse().unwrap();
        } else if line == mark {
            found.push(at);
        }
    }
    found
}

#[test]
fn where_the_limits_are() {
    let obstacle = |config: &str, managers: &[(u16, u8, u16)], rest: &str| {
        let text = described(config, managers, rest);
        let file = EsiFile::from_bytes("box.xml", text.as_bytes()).unwrap();
        Profile::from_esi(&file, &file.devices[0], None).map_err(|stopped| stopped.obstacle).err()
    };
    let digital = |start, bits| obstacle(DIGITAL, &[(start, 0x44, bits)], "");
    let registers = Some(Obstacle::ProcessDataInRegisters);
    // The last byte of the digital outputs is at 0x0F03.
    for (start, bits, expected) in [
        (0x0F00, 32, None),
        (0x0F00, 33, registers),
        (0x0F03, 8, None),
        (0x0F03, 9, registers),
        (0x0F04, 1, registers),
        (0x0EFF, 1, registers),
    ] {
        assert_eq!(digital(start, bits), expected, "{bits} bits at {start:#06x}");
    }
    assert_eq!(obstacle(DIGITAL, &[(0x0F00, 0x00, 8)], ""), registers, "nothing is read there");
    let several = |count: u16| {
        let managers: Vec<_> = (0..count).map(|at| (0x1000 + 16 * at, 0x64, 8)).collect();
        obstacle(PROGRAM, &managers, "")
    };
    assert_eq!((several(8), several(9)), (None, Some(Obstacle::SeveralSyncManagers)));
    let long = |bits| obstacle(PROGRAM, &[(0x1000, 0x64, 8 * 1000), (0x2000, 0x64, bits)], "");
    assert_eq!(long(8 * 486), None, "1486 bytes in all");
    assert_eq!(long(8 * 486 + 1), Some(Obstacle::ProcessDataTooLong));
    // Their three buffers: 0x1100 to 0x1105.
    let overlap = |start| obstacle(PROGRAM, &[(0x1100, 0x64, 16), (start, 0x64, 16)], "");
    assert_eq!((overlap(0x1106), overlap(0x1105)), (None, Some(Obstacle::MemoryOverlap)));
}

/// Process data of hundreds of bytes come up; what one datagram carries beside the drift datagram
/// and AL status is the most, and one byte more is refused by the plan.
#[test]
fn long_process_data() {
    let device = |outputs: u16, inputs: u16| {
        let managers = [(0x1000, 0x64, 8 * outputs), (0x1000 + 3 * outputs, 0x20, 8 * inputs)];
        segment("long", &described(PROGRAM, &managers, ""))
    };
    for (outputs, inputs) in [(257, 416), (1452, 8), (8, 1452)] {
        let (managers, _) = written(device(outputs, inputs));
        let lengths: Vec<_> = managers.iter().map(|manager| manager.2).collect();
        assert_eq!(lengths, [outputs, inputs]);
        run_of(device(outputs, inputs));
    }
    for (outputs, inputs) in [(1453, 8), (8, 1453)] {
        let plan = Plan::of(&Scenario::from(device(outputs, inputs)));
        let words = plan.expect_err("it does not fit into a datagram").to_string();
        assert!(words.contains("1453") && words.contains("1452"), "{words}");
    }
}

/// What a file leaves open is filled in, and said.
#[test]
fn registers_without_config_data_are_digital_io() {
    for (config, value, bytes) in
        [("", "0401", [0x04, 0x01]), ("0500000000000000", "on", [0x05, 0x01])]
    {
        let text = described(config, &[(0x0F00, 0x44, 8)], "");
        let file = EsiFile::from_bytes("box.xml", text.as_bytes()).unwrap();
        let profile = Profile::from_esi(&file, &file.devices[0], None).unwrap();
        assert_eq!(profile.sii[..2], bytes);
        let said = profile
            .assumptions
            .iter()
            .any(|assumed| assumed.item.starts_with("Eeprom/ConfigData") && assumed.value == value);
        assert!(said, "{:?}", profile.assumptions);
        assert_eq!(profile.times.calc_and_copy, Nanos::ZERO);
    }
}

/// No rule is made for them, and none may seem broken.
#[test]
fn conform_does_not_try_what_it_can_not_judge() {
    let managers = [(0x1000, 0x64, 8), (0x1200, 0x64, 8)];
    for (name, config, managers, why) in [
        ("conform-digital", DIGITAL, &[(0x0F00, 0x44, 8)][..], "device emulation"),
        ("conform-several", PROGRAM, &managers, "several SyncManagers"),
    ] {
        let folder = std::env::temp_dir().join(format!("isocat-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("box.xml"), described(config, managers, "")).unwrap();
        let toml = "cycle = \"1ms\"\n[[subdevice]]\nesi = \"box.xml\"\n";
        std::fs::write(folder.join("s.toml"), toml).unwrap();
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_isocat"));
        let done =
            command.arg("conform").arg(folder.join("s.toml")).arg("--json").output().unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
        let rules = report["devices"][0]["rules"].as_array().unwrap();
        assert!(rules.len() > 50);
        for rule in rules {
            let told = rule["why"].to_string();
            assert!(rule["verdict"] == "not_applicable" && told.contains(why), "{rule}");
        }
        assert_eq!(done.status.code(), Some(0));
    }
}
