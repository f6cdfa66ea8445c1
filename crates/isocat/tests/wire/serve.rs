//! `isocat serve` and `isocat control` on veth pairs: what is served answers on raw sockets, faults
//! come and go while it serves, and it ends by a signal, by a request and by its expectations.
//!
//! Needs root and the command `ip`; without them each test says so.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use isocat::host::{RawSocket, clock};
use isocat_wire::Command as Access;
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter, MAX_LEN};
use isocat_wire::time::Nanos;

use crate::alone::not_shown;
use crate::service::{ISOCAT, Service, isocat, permitted, text};

/// Far beyond what an answer takes, so that a machine that stalls does not lose one.
const ANSWER: Nanos = Nanos::millis(1_000);

/// Counts the SubDevices: the working counter of a broadcast read, and how long the answer took;
/// `None` if nothing comes back within `ANSWER`.
fn count(socket: &mut RawSocket) -> Option<(u16, Nanos)> {
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Access::Brd, 7, Address::Broadcast(0), &[0]).expect("it fits");
    let len = writer.finish();
    let began = clock::now();
    socket.send(&buffer[..len]).expect("sent");
    let mut reply = [0; 2048];
    while clock::now() - began < ANSWER {
        socket.wait(Some(began + ANSWER)).expect("waited");
        if let Some(received) = socket.receive(&mut reply).expect("received") {
            let payload = frame::payload(&reply[..received.len]).expect("EtherCAT");
            let datagram = datagrams(payload).next().expect("a datagram").expect("whole");
            return Some((datagram.wkc, clock::now() - began));
        }
    }
    None
}

/// Tries until it comes true: links take their time to come and go.
fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A ring of three.
const RING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/faults/ring.toml");

/// What a broadcast read from one port of a MainDevice counts, and at which of its ports it comes
/// back: 0 or 1.
fn count_in_ring(sockets: &mut [RawSocket; 2], from: usize) -> Option<(usize, u16)> {
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Access::Brd, 7, Address::Broadcast(0), &[0]).expect("it fits");
    let len = writer.finish();
    let until = Instant::now() + Duration::from_nanos(ANSWER.0 as u64);
    sockets[from].send(&buffer[..len]).expect("sent");
    let mut reply = [0; 2048];
    while Instant::now() < until {
        for (port, socket) in sockets.iter_mut().enumerate() {
            if let Some(received) = socket.receive(&mut reply).expect("received") {
                let payload = frame::payload(&reply[..received.len]).expect("EtherCAT");
                let datagram = datagrams(payload).next().expect("a datagram").expect("whole");
                return Some((port, datagram.wkc));
            }
        }
    }
    None
}

#[test]
fn a_ring_is_served_on_two_interfaces() {
    for busy in [&[][..], &["--busy"]] {
        let ring = [busy, &["--json", RING]].concat();
        let Some(service) = Service::start("isct-ring", &ring) else { return };
        let open =
            |end: &str| RawSocket::open(end, Some("isct-ring")).expect("the MainDevice's end");
        let mut sockets = [open("isct-ring"), open("isct-ring-2")];
        assert_eq!(count_in_ring(&mut sockets, 0), Some((1, 3)));
        assert_eq!(count_in_ring(&mut sockets, 1), Some((0, 0)));
        assert!(
            service.done(&["pull", "axis", "1"]).contains("the cable to SubDevice 1 is pulled")
        );
        eventually("it turns", || count_in_ring(&mut sockets, 0) == Some((0, 1)));
        assert_eq!(count_in_ring(&mut sockets, 1), Some((1, 2)));
        service.done(&["plug", "axis", "1"]);
        eventually("it is whole", || count_in_ring(&mut sockets, 0) == Some((1, 3)));
        service.done(&["pull", "ring"]);
        eventually("all turn", || count_in_ring(&mut sockets, 0) == Some((0, 3)));
        assert_eq!(count_in_ring(&mut sockets, 1), None);
        service.done(&["plug", "ring"]);
        eventually("it is whole", || count_in_ring(&mut sockets, 0) == Some((1, 3)));
        // The MainDevice's own end goes down: the last device loses its link.
        let link = |state: &str| {
            let arguments = ["-n", "isct-ring", "link", "set", "isct-ring-2", state];
            let done = Command::new("ip").args(arguments).status().expect("ip starts");
            assert!(done.success());
        };
        link("down");
        let mut first = [open("isct-ring"), open("isct-ring")];
        eventually("all turn", || matches!(count_in_ring(&mut first, 0), Some((_, 3))));
        link("up");
        let mut sockets = [open("isct-ring"), open("isct-ring-2")];
        eventually("it is whole", || count_in_ring(&mut sockets, 0) == Some((1, 3)));
        service.done(&["stop"]);
        let (rest, code) = service.finish();
        assert_eq!(code, Some(1), "no MainDevice came to show what the file expects");
        for event in ["interface down", "interface up"] {
            assert!(rest.contains(event), "{event}: {rest}");
        }
    }
}

#[test]
fn an_unknown_interface_is_told_with_those_there_are() {
    if !permitted() {
        return;
    }
    let output = isocat(&["serve", "--interface", "no-such-if"]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2));
    assert!(message.contains("no-such-if") && message.contains("lo"), "{message}");
}

#[test]
fn faults_come_and_go_while_it_serves() {
    let Some(service) = Service::start("isct-fault", &[]) else { return };
    let mut socket = service.socket();
    let mut there = || count(&mut socket).map(|(count, _)| count);
    assert_eq!(there(), Some(5));

    assert!(service.done(&["pull", "2"]).contains("SubDevice 2 is pulled"));
    eventually("two SubDevices are left", || there() == Some(2));
    service.done(&["plug", "EK1100"]);
    eventually("all are back", || there() == Some(5));

    service.done(&["power-cycle", "4", "200ms"]);
    eventually("four SubDevices are left", || there() == Some(4));
    eventually("all are back", || there() == Some(5));

    service.done(&["pull", "2", "for", "100ms"]);
    eventually("two SubDevices are left", || there() == Some(2));
    eventually("all are back", || there() == Some(5));
    let refused = service.control(&["stall", "5ms"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("is not simulated"), "{}", text(&refused.stderr));

    service.done(&["drop", "2"]);
    assert_eq!([there(), there(), there()], [None, None, Some(5)]);

    service.done(&["delay", "20ms"]);
    let (_, late) = count(&mut socket).expect("an answer");
    assert!(late >= Nanos::millis(20), "{late}");
    service.done(&["delay", "0"]);

    let status = service.done(&["status"]);
    let status: serde_json::Value = serde_json::from_str(&status).expect("JSON");
    assert_eq!(status["devices"].as_array().map(Vec::len), Some(5));
    assert_eq!(status["devices"][0]["state"], "INIT");
    let wrong = service.control(&["pull", "9"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text(&wrong.stderr).contains("0 to 4"), "{}", text(&wrong.stderr));

    service.done(&["stop"]);
    let (summary, code) = service.finish();
    assert_eq!(code, Some(0), "{summary}");
    for expected in ["1 session", "counts the SubDevices", "the next 2 frames are lost"] {
        assert!(summary.contains(expected), "{summary}");
    }
    assert!(!Path::new("/run/netns/isct-fault").exists(), "the namespace is gone");
}

/// Who would serve where somebody serves already is refused, and nothing of the other's is touched;
/// a report that can't be written is refused before anything is served.
#[test]
fn a_second_service_leaves_the_first_alone() {
    let Some(service) = Service::start("isct-two", &[]) else { return };
    let second = isocat(&["serve", "--setup-veth", "isct-two"]);
    let message = text(&second.stderr);
    assert_eq!(second.status.code(), Some(2), "{message}");
    assert!(message.contains("another isocat serves on isct-two-seg already"), "{message}");
    assert!(Path::new("/run/netns/isct-two").exists(), "the first one's namespace is still there");
    assert_eq!(count(&mut service.socket()).map(|(count, _)| count), Some(5));
    service.done(&["stop"]);
    let report =
        isocat(&["serve", "--setup-veth", "isct-rep", "--report", "/nonexistent/report.txt"]);
    let message = text(&report.stderr);
    assert_eq!(report.status.code(), Some(2), "{message}");
    assert!(message.contains("/nonexistent/report.txt can't be written"), "{message}");
}

/// A signal ends it as a request does; `--json` is a line for each event and the summary last.
#[test]
fn a_signal_ends_it_cleanly() {
    let Some(service) = Service::start("isct-sig", &["--json", "--busy"]) else { return };
    let mut socket = service.socket();
    assert_eq!(count(&mut socket).map(|(count, _)| count), Some(5));
    let pid = service.child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &pid]).status().expect("kill").success());
    let (output, code) = service.finish();
    assert_eq!(code, Some(0), "{output}");
    let lines: Vec<serde_json::Value> =
        output.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    assert_eq!(lines[0]["event"], "session began");
    let summary = lines.last().expect("a summary");
    assert_eq!(summary["format"], "isocat-serve-summary/7");
    assert_eq!((&summary["frames"], &summary["answered"]), (&1.into(), &1.into()));
    assert!(!Path::new("/run/netns/isct-sig").exists(), "the namespace is gone");
}

/// What is expected of a served segment ends in exit code, summary and JUnit: met, not met, and
/// nothing to judge by.
#[test]
fn a_service_ends_by_what_is_expected_of_it() {
    if !permitted() {
        return;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve-expect");
    std::fs::create_dir_all(&folder).expect("a folder");
    let [segment, junit] = ["machine.toml", "junit.xml"].map(|name| folder.join(name));
    let [path, xml] = [&segment, &junit].map(|path| path.to_str().expect("UTF-8"));
    let machine =
        "cycle = \"4ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis\"\n";
    for (expected, code, failures, errors) in [
        ("in_sync_at = \"in-operation + 1ns\"", Some(0), "0", "0"),
        ("in_sync_at = \"in-operation + 1h\"", Some(1), "1", "0"),
        ("in_sync_at = \"in-operation + 1ns\"\nrecovers_within = \"0s\"", Some(3), "0", "1"),
    ] {
        let fault = "[[fault]]\nat = \"in-operation\"\nwhat = \"stall 5ms\"\n";
        let text = format!("{machine}{fault}[[expect]]\n{expected}\n");
        std::fs::write(&segment, text).expect("written");
        let Some((summary, ended)) = served_in_operation(path, xml) else {
            return not_shown(
                "serve::a_service_ends_by_what_is_expected_of_it",
                "no run came to OP",
            );
        };
        assert_eq!(ended, code, "{:#}", summary["expected"]);
        let met = |key: &str| {
            let all = summary["expected"].as_array().expect("a list");
            all.iter().find(|one| one["key"] == key).map(|one| one["met"].clone())
        };
        assert_eq!(met("in_sync_at"), Some((code != Some(1)).into()));
        assert_eq!(met("recovers_within"), (code == Some(3)).then_some(serde_json::Value::Null));
        let document = std::fs::read_to_string(&junit).expect("it was written");
        let document = roxmltree::Document::parse(&document).expect("XML");
        let suite = document.descendants().find(|node| node.has_tag_name("testsuite"));
        let suite = suite.expect("a suite");
        assert_eq!(suite.attribute("failures"), Some(failures));
        assert_eq!(suite.attribute("errors"), Some(errors));
    }
}

/// Serves a segment to our own MainDevice, which brings it to OP; the summary and the exit code. On
/// a machine that stalls the way up may fail, and is tried again; `None` if it always does.
fn served_in_operation(segment: &str, junit: &str) -> Option<(serde_json::Value, Option<i32>)> {
    for _ in 0..5 {
        let service = Service::start("isct-expect", &[segment, "--junit", junit, "--json"])?;
        let program = ISOCAT;
        let run = Command::new("ip")
            .args(["netns", "exec", "isct-expect", program, "run", segment])
            .args(["--interface", "isct-expect", "--for", "300ms"])
            .output()
            .expect("it starts");
        service.done(&["stop"]);
        let (output, ended) = service.finish();
        let summary = output.lines().last().expect("a summary");
        let summary: serde_json::Value = serde_json::from_str(summary).expect("JSON");
        let sessions = summary["sessions"].as_array().expect("a list");
        if sessions.iter().any(|session| !session["judged"].is_null()) {
            return Some((summary, ended));
        }
        eprintln!("it did not come to OP: {}{}", text(&run.stdout), text(&run.stderr));
    }
    None
}
