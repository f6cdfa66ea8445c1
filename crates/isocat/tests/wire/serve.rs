//! `isocat serve` and `isocat control` as commands. What needs raw sockets runs in a network
//! namespace that the command itself makes, and is skipped with a word where that is not permitted.
#![cfg(target_os = "linux")]

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{MutexGuard, OnceLock};
use std::time::{Duration, Instant};

use isocat::host::{RawSocket, clock};
use isocat_wire::Command as Access;
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter, MAX_LEN};
use isocat_wire::time::Nanos;

use crate::alone::alone;

fn isocat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("it starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Raw sockets and namespaces can be had; says a word if not.
fn permitted() -> bool {
    static PERMITTED: OnceLock<bool> = OnceLock::new();
    *PERMITTED.get_or_init(|| {
        let probe = format!("isct-probe-{}", std::process::id());
        let made = Command::new("ip").args(["netns", "add", &probe]).output();
        let permitted = made.is_ok_and(|output| output.status.success());
        let _ = Command::new("ip").args(["netns", "del", &probe]).output();
        if !permitted {
            eprintln!("skipped: it needs root and the command ip (iproute2)");
        }
        permitted
    })
}

/// A service in a namespace of its own, ended when dropped.
struct Service {
    child: Child,
    name: &'static str,
    output: BufReader<std::process::ChildStdout>,
    _alone: MutexGuard<'static, ()>,
}

impl Service {
    fn start(name: &'static str, more: &[&str]) -> Self {
        let alone = alone();
        let mut child = Command::new(env!("CARGO_BIN_EXE_isocat"))
            .args(["serve", "--setup-veth", name])
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("it starts");
        let mut output = BufReader::new(child.stdout.take().expect("a pipe"));
        let mut line = String::new();
        output.read_line(&mut line).expect("a first line");
        assert!(line.contains("erving"), "{line}");
        Self { child, name, output, _alone: alone }
    }

    fn control(&self, words: &[&str]) -> Output {
        let interface = format!("{}-seg", self.name);
        let mut arguments = vec!["control", &interface];
        arguments.extend(words);
        isocat(&arguments)
    }

    fn done(&self, words: &[&str]) -> String {
        let output = self.control(words);
        assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    fn socket(&self) -> RawSocket {
        RawSocket::open(self.name, Some(self.name)).expect("the MainDevice's end")
    }

    /// The rest of the output, and the exit code, after the end.
    fn finish(mut self) -> (String, Option<i32>) {
        let mut rest = String::new();
        self.output.read_to_string(&mut rest).expect("UTF-8");
        let code = self.child.wait().expect("it ends").code();
        (rest, code)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Ended already, if all went well.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = Command::new("ip").args(["netns", "del", self.name]).output();
    }
}

/// Counts the SubDevices: the working counter of a broadcast read, and how long the answer took;
/// `None` if nothing comes back within 100 ms.
fn count(socket: &mut RawSocket) -> Option<(u16, Nanos)> {
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    writer.push(Access::Brd, 7, Address::Broadcast(0), &[0]).expect("it fits");
    let len = writer.finish();
    let began = clock::now();
    socket.send(&buffer[..len]).expect("sent");
    let mut reply = [0; 2048];
    while clock::now() - began < Nanos::millis(100) {
        socket.wait(Some(began + Nanos::millis(100))).expect("waited");
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
        assert!(began.elapsed() < Duration::from_secs(10), "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn what_can_not_be_served_on_is_told() {
    for (arguments, expected) in [
        (&["serve"][..], "--interface"),
        (&["serve", "nowhere.toml", "--interface", "lo"], "nowhere.toml"),
        (&["serve", "--setup-veth", "a name that is far too long"], "expected 1 to 11"),
        (&["serve", "--interface", "lo", "--netns", "no-such-namespace"], "no-such-namespace"),
        (&["serve", "--interface", "lo", "--secondary", "eth7"], "expected ring = true in it"),
        (&["serve", RING, "--interface", "lo"], "expected --secondary IF beside --interface lo"),
        (&["serve", RING, "--interface", "lo", "--secondary", "lo"], "expected another interface"),
        (&["run", RING, "--interface", "lo"], "is a ring, which has two ports"),
        (&["watch", RING, "--interface", "lo"], "is a ring, which has two ports"),
        (&["control", "no-such-if", "status"], "no isocat serves on no-such-if"),
    ] {
        let output = isocat(arguments);
        // Lines are broken where they are full, and paths are of any length.
        let message = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{message}");
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
    let until = Instant::now() + Duration::from_millis(200);
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
    if !permitted() {
        return;
    }
    for busy in [&[][..], &["--busy"]] {
        let service = Service::start("isct-ring", &[busy, &["--json", RING]].concat());
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

/// Nobody may open raw sockets: the message says what to grant, to which program.
#[test]
fn a_user_without_the_capability_is_told_what_to_grant() {
    if !permitted() {
        return;
    }
    // In /tmp, so that the system user `nobody` can run it.
    let program = Path::new("/tmp").join(format!("isocat-of-nobody-{}", std::process::id()));
    std::fs::copy(env!("CARGO_BIN_EXE_isocat"), &program).expect("copied");
    let output = Command::new(&program)
        .args(["serve", "--interface", "lo"])
        .uid(65534)
        .gid(65534)
        .output()
        .expect("it starts");
    std::fs::remove_file(&program).expect("removed");
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    let path = program.display().to_string();
    for expected in ["not permitted", "setcap cap_net_raw", path.as_str()] {
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn faults_come_and_go_while_it_serves() {
    if !permitted() {
        return;
    }
    let service = Service::start("isct-fault", &[]);
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
    if !permitted() {
        return;
    }
    let service = Service::start("isct-two", &[]);
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
    if !permitted() {
        return;
    }
    let service = Service::start("isct-sig", &["--json", "--busy"]);
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
    assert_eq!(summary["format"], "isocat-serve-summary/6");
    assert_eq!((&summary["frames"], &summary["answered"]), (&1.into(), &1.into()));
    assert!(!Path::new("/run/netns/isct-sig").exists(), "the namespace is gone");
}

#[test]
fn the_schema_of_the_summary_is_committed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/serve-summary.schema.json");
    let now = serde_json::to_string_pretty(&isocat::serve::summary::schema()).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).expect("the schema is committed");
    assert_eq!(now, committed, "the summary changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
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
        let (summary, ended) = served_in_operation(path, xml);
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
/// a machine that stalls the way up may fail, and is tried again.
fn served_in_operation(segment: &str, junit: &str) -> (serde_json::Value, Option<i32>) {
    for _ in 0..5 {
        let service = Service::start("isct-expect", &[segment, "--junit", junit, "--json"]);
        let program = env!("CARGO_BIN_EXE_isocat");
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
            return (summary, ended);
        }
        eprintln!("it did not come to OP: {}{}", text(&run.stdout), text(&run.stderr));
    }
    panic!("it never came to OP");
}
