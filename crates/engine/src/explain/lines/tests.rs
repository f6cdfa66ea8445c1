//! Lines as the programs print them: what the first meaning must be, and what no line may be taken
//! for.

use super::super::{Found, Meaning, explain, text};

/// The line, and words of its first meaning.
const ANSWERS: &[(&str, &str)] = &[
    // IgH EtherCAT Master.
    ("EtherCAT WARNING 0: 1 datagram TIMED OUT!", "did not come back"),
    ("EtherCAT WARNING 0: 34 datagrams UNMATCHED!", "no longer waits for"),
    (
        "EtherCAT WARNING: Datagram 0000000034347194 (domain0-0-main) was SKIPPED 17 times.",
        "before its answer",
    ),
    ("[ 5283.110] EtherCAT WARNING 0: 2 frames CORRUPTED!", "no valid EtherCAT answer"),
    ("EtherCAT 0: Domain 0: Working counter changed to 0/21.", "working counter"),
    ("EtherCAT 0: Domain 0: 4 working counter changes - now 3/3", "working counter"),
    ("EtherCAT WARNING 0-2: Slave did not sync after 5000 ms.", "0x092C"),
    (
        "EtherCAT WARNING 0: No app_time received up to now, abort DC time offset calculation.",
        "application time",
    ),
    (
        "EtherCAT ERROR 0-3: AL status message 0x001B: \"Sync manager watchdog\".",
        "0x001B, AL status",
    ),
    (
        "EtherCAT ERROR 0-1: AL status message 0x0030: \"Invalid DC SYNC configuration\".",
        "0x0030, AL status",
    ),
    ("EtherCAT ERROR 0-0: Unknown AL status code 0x8003.", "0x8003, AL status"),
    (
        "EtherCAT ERROR 0-1: Failed to set SAFEOP state, slave refused state change (PREOP + \
             ERROR).",
        "refused a change",
    ),
    ("EtherCAT ERROR 0-0: Timeout while setting state OP.", "within the time-out"),
    ("EtherCAT 0: Link state of ecm0 changed to DOWN.", "host's own port"),
    ("EtherCAT 0: 3 slave(s) responding on main device.", "number of devices"),
    ("EtherCAT 0: Slave states on main device: SAFEOP, OP + ERROR.", "or-ed together"),
    ("EtherCAT WARNING 0: No DC reference clock found.", "could lead"),
    (
        "EtherCAT ERROR 0-2: SDO abort message 0x06010002: \"Attempt to write to a read-only \
             object\".",
        "0x06010002, SDO",
    ),
    ("EtherCAT ERROR 0-0: SDO download 0x1C12:00 (1 bytes) aborted.", "0x1C12, object"),
    (
        "EtherCAT ERROR 0-0: SDO 0x6060:00 download response failed with timeout after 1000 ms: ",
        "no answer in time",
    ),
    ("EtherCAT ERROR 0-1: Slave does not support assigning PDOs!", "process data does not fit"),
    ("EtherCAT ERROR 0-0: SII: Read timeout.", "EEPROM"),
    (
        "EtherCAT ERROR 0-4: Failed to receive AL state datagram: Datagram initialized.",
        "did not come back",
    ),
    ("EtherCAT WARNING 0: Domain 0: Redundant link in use!", "ring is open"),
    (
        "EtherCAT ERROR 0-0: Slave type mismatch. Slave was 0x00000002/0x044c2c52 before.",
        "not the configured one",
    ),
    ("Failed to request master: Device or resource busy", "phase"),
    // SOEM.
    ("No slaves found!", "nothing answers"),
    ("ERROR : slave 2 lost", "does not answer"),
    ("MESSAGE : slave 2 recovered", "answers again"),
    ("ERROR : slave 1 is in SAFE_OP + ERROR, attempting ack.", "error bit"),
    ("WARNING : slave 3 is in SAFE_OP, change to OPERATIONAL.", "SAFEOP without an error"),
    ("OK : all slaves resumed OPERATIONAL.", "nothing is wrong"),
    ("Not all slaves reached operational state.", "at least one device"),
    ("Slave 3 State=0x14 StatusCode=0x001a : Synchronization error", "0x001A, AL status"),
    ("Slave 1 State=12 StatusCode=  1e : Invalid input configuration", "0x001E, AL status"),
    ("Slave 1 State=0x04 StatusCode=0x0000 : No error", "stuck in SAFEOP"),
    (
        "SDO slave:1 index:1c12.00 error:06020000 The object does not exist in the object \
             directory",
        "0x06020000",
    ),
    (
        "Time:1234.567 SDO slave:2 index:1600.01 error:06010002 Attempt to write to a read only \
             object",
        "0x06010002",
    ),
    ("Processdata cycle  123, WKC 2 , O: 00 I: 00", "working counter"),
    ("WKC -1", "no frame came back"),
    ("No socket connection on eth0\nExecute as root", "raw frames"),
    ("HW_RX: received idx 166, but we did not send one?", "no longer waits for"),
    // pysoem.
    (
        "pysoem.pysoem.SdoError: (1, 7186, 1, 100794368, 'The object does not exist in the object \
             directory')",
        "0x06020000, SDO",
    ),
    ("pysoem.pysoem.WkcError", "did not count"),
    ("pysoem.pysoem.ConfigMapError: [SdoError(1, 7186, 1, 101056512, 'x')]", "0x06060000, SDO"),
    ("ConnectionError: could not open interface eth1", "raw frames"),
    // ethercrab.
    ("Error: WorkingCounter { expected: 3, received: 1 }", "working counter"),
    ("working counter expected 4, got 0", "working counter"),
    ("called `Result::unwrap()` on an `Err` value: Timeout(Pdu)", "did not come back"),
    ("Error: Timeout(MailboxResponse)", "no answer in time"),
    ("Error: Mailbox(Aborted { code: NotFound, address: 7186, sub_index: 1 })", "abort code"),
    ("Error: StateTransition", "refused a change"),
    (
        "[ERROR] --> SubDevice 0x1003 status code 0x001d: Invalid output configuration",
        "0x001D, AL status",
    ),
    ("Error: SubDevice(SynchronizationError)", "0x001A, AL status"),
    ("Error: NotFound { item: SubDevice, index: Some(2) }", "number or the order"),
    (
        "No SubDevices were discovered. Check NIC device, connections and PDU response timeouts",
        "nothing answers",
    ),
    ("Error: DistributedClock(NoReference)", "could lead"),
    // KickCAT.
    ("Invalid working counter: expected 6, got 3", "working counter"),
    ("DC slave 2 NOT synchronized: drift = 5230 ns (threshold = 1000 ns)", "0x092C"),
    (
        "terminate called after throwing an instance of 'kickcat::Error': No slave detected",
        "nothing answers",
    ),
    ("Error while reading SDO - Timeout", "no answer in time"),
    ("State transition PRE_OP -> SAFE_OP: error 0x1e", "0x001E, AL status"),
    // TwinCAT.
    (
        "'Box 1 (Drive1)': abnormal state change from 'OP' to 'SAFEOP' with code 0x001b",
        "0x001B, AL status",
    ),
    ("Verbindung zum Slave unterbrochen", "does not answer"),
    ("Falscher Arbeitszähler", "working counter"),
    (
        "'Drive 3 (AX5203)' (1003): state change aborted (requested 'OP', back to 'SAFEOP'). AL \
             Status Code 0x001A",
        "0x001A, AL status",
    ),
    ("'Term 4 (EL3102)' (1004): CRC error counter port A = 3", "wrong checksum"),
    ("Frame missed 12 times (frame no. 0)", "did not come back"),
    ("Box 1: 'INIT NO_COMM'", "does not answer"),
    ("Drive 2: SAFEOP ERR", "error bit"),
    ("DC out of sync", "reference clock"),
    ("'Achse 2' (1002): Init Cmd failed: set DC cycle time", "start-up list"),
    ("DevState 0x1000", "reference clock"),
    ("Klemme 3 (EL2008): kein Kontakt", "does not answer"),
    ("Antrieb 1: Synchronisation verloren", "reference clock"),
    ("Zustandswechsel von SAFEOP nach OP fehlgeschlagen", "refused a change"),
    // CODESYS, acontis.
    ("EtherCAT_Master: Distributed clock not synchronized", "reference clock"),
    ("ETCSlave: Sync window exceeded", "reference clock"),
    (
        "DCM Status: ERROR: controller error - synchronisation out of limit (0x981201C2)",
        "reference clock",
    ),
    ("0x981201C2", "reference clock"),
    (
        "eUsrJob_ProcessAllRxFrames - not all previously sent frames are received/processed (frame \
             loss)!",
        "did not come back",
    ),
    ("No response on cyclic Ethernet frame", "did not come back"),
    // LinuxCNC, ROS 2, robots.
    ("Unexpected realtime delay on task 0 with period 1000000", "machine was late"),
    (
        "LCEC: unable to sync master 0 cycle to reference clock, RTAPI_TASK_PLL_SUPPORT not \
             present",
        "cannot shift",
    ),
    ("LCEC: failed to configure slave 0.x1 sdo 1c32:01", "0x1C32:01"),
    ("joint 1 following error", "not where it was told"),
    (
        "MASTER_RECV_PD_GROUP: group  0: working counter mismatch got 8, expected 9",
        "working counter",
    ),
    ("[FATAL] [ethercat_driver]: Activate EcMaster failed", "phase"),
    (
        "Overrun detected! The controller manager missed its desired rate of 1000 Hz",
        "machine was late",
    ),
    ("lcec.0.pll-err 250000", "reference clock"),
    ("RecvPD: WKC error group 0: expected 9, act 6", "working counter"),
    ("enp2s0: Link is Down", "host's own port"),
    ("the drive loses OP after two hours", "A device left OP by itself"),
    ("slave 0.1 not in OP", "At least one device did not reach the state"),
    ("lcec: slave 0.1 not in OP", "At least one device did not reach the state"),
    // Our own reports.
    (
        "PREOP to SAFEOP failed! Error: 'check device state for SAFEOP'. AL Status '0x0012' read \
             and '0x0004' expected. AL Status Code '0x001e - SM input cfg'",
        "0x001E, AL status",
    ),
    ("drive 2 left OP with AL status code 0x001A", "0x001A, AL status"),
    ("The device refused SAFEOP: 0x0134 is 0x001D", "0x001D, AL status"),
];

#[test]
fn lines_of_programs() {
    let mut wrong = Vec::new();
    for (line, expected) in ANSWERS {
        match explain(line) {
            Ok(meanings) => {
                let first = text(&meanings[..1]);
                let flat = first.split_whitespace().collect::<Vec<_>>().join(" ");
                if !flat.to_lowercase().contains(&expected.to_lowercase()) {
                    wrong.push(format!(
                        "{line}\n  expected {expected:?}: {}",
                        &flat[..flat.len().min(160)]
                    ));
                }
            }
            Err(unknown) => wrong.push(format!("{line}\n  {}", unknown.reason)),
        }
    }
    assert!(wrong.is_empty(), "{} of {}:\n{}", wrong.len(), ANSWERS.len(), wrong.join("\n"));
}

fn first(line: &str) -> Meaning {
    explain(line).unwrap_or_else(|unknown| panic!("{unknown}")).remove(0)
}

#[test]
fn numbers_of_a_line_that_is_not_known() {
    for (line, kind, what) in [
        ("axis 3 tripped, AL status code 0x001A", "AL status code", "0x001A"),
        ("slave went SAFEOP, ALstatuscode: 0x2c", "AL status code", "0x002C"),
        ("config step 7: abort 06090030 from unit 2", "SDO abort code", "0x06090030"),
        ("writing 0x1C32:01 to unit 2 went wrong", "object", "0x1C32:01"),
        ("index 1c13 was not accepted", "object", "0x1C13"),
        ("wrote 10F1h", "object", "0x10F1"),
        ("read back register 0x092C of unit 2", "register", "0x092C"),
        ("unit 2 state 0x14", "register", "0x0130"),
        ("error code 0x8700 of unit 3", "number of a maker", "8700"),
        ("assignActivate=x300 of unit 3", "AssignActivate", "0x0300"),
        ("unit 5 shows alarm F7011", "number of a maker", "F7011"),
    ] {
        let meaning = first(line);
        assert_eq!((meaning.kind, meaning.what.as_str()), (kind, what), "{line}");
        assert_eq!(meaning.found, Found::Number, "{line}");
        let text = text(&explain(line).unwrap());
        assert!(text.starts_with("Nothing is known of this line"), "{text}");
    }
}

#[test]
fn words_of_a_line_that_is_not_known() {
    for (line, what) in [
        ("my motor makes a grinding sound in CSP", "vibration"),
        ("the drive clicks each 12 s", "clicking"),
        ("do I need interrupt coalescing here?", "coalescing"),
        ("which one is the reference clock", "reference clock"),
    ] {
        let meaning = first(line);
        assert_eq!((meaning.what.as_str(), meaning.found), (what, Found::Word), "{line}");
    }
}

#[test]
fn alarm_numbers_of_makers_are_no_al_status_codes() {
    for what in ["F414", "8303", "Er.E08", "A.A12", "F7011", "88.0", "83.03", "AL180", "Err80.3"] {
        for meaning in explain(what).unwrap_or_else(|unknown| panic!("{unknown}")) {
            assert_eq!(meaning.kind, "number of a maker", "{what}");
        }
    }
    assert_eq!(first("AL 0xF414").kind, "AL status code");
    assert_eq!(first("0xF414").kind, "AL status code");
    assert_eq!(first("C007").kind, "value of 0x1C32:04 and 0x1C33:04");
    for what in ["EL1008", "EK1100", "AX5000", "dead", "M8", "SM2", "eth0", "CiA402"] {
        let taken = explain(what).is_ok_and(|all| all[0].kind == "number of a maker");
        assert!(!taken, "{what}");
    }
}

/// Nothing in these is known, or what looks like a number of ours is another one.
#[test]
fn lines_that_are_no_answer() {
    for line in [
        "Hello world",
        "cycle took longer, error 50000 ns",
        "recv: Resource temporarily unavailable",
        "usb 1-2: new high-speed USB device number 5 using xhci_hcd",
        "slave 0x1001 vendor 0x00000002 product 0x044c2c52",
        "systemd[1]: Started Session 12 of user root.",
        "10:15:32 axis homed",
        "serial number 06020001",
        "temperature 26 degrees",
        "statusword 0x0237",
        "position 1234 velocity 0x1234",
        "translate the oscillators' rings",
    ] {
        if let Ok(meanings) = explain(line) {
            panic!("{line}: {}", text(&meanings));
        }
    }
}

#[test]
fn every_entry_has_sentences_and_lines_and_each_print_fits_itself() {
    for program in super::PROGRAMS {
        for line in program.lines {
            let entry = line.entry;
            assert!(entry.means.ends_with('.') && !entry.means.contains("  "), "{}", entry.means);
            assert!(!entry.read.is_empty() && !entry.change.is_empty(), "{}", entry.means);
            for words in entry.causes.iter().chain(entry.read).chain(entry.change) {
                assert!(
                    !words.is_empty() && !words.ends_with('.') && !words.contains("  "),
                    "{words}"
                );
            }
            for print in line.prints {
                let filled = print.replace(['#', '*'], " 7 ");
                let fits = super::words::Pattern::new(print).fits(&super::tokens(&filled));
                assert!(fits.is_some(), "{print}");
            }
        }
    }
}
