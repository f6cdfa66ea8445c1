//! `isocat watch` at both ends of a wire: a segment is served on one end and run on the other, and
//! both say that it is in sync, one by registers, the other in true time.
//!
//! Needs root and the command `ip`; without them the test says so.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Output, Stdio};

use crate::alone::not_shown;
use crate::service::{ISOCAT, Service, isocat, text};

/// Ended when dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let pid = rustix::process::Pid::from_child(&self.0);
        // It may have ended by itself.
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        let _ = self.0.wait();
    }
}

fn gate(arguments: &[&str]) -> Output {
    let gate = ["--plain", "--until", "1us", "--for", "2s", "--within", "30s"];
    isocat(&[&["watch"], arguments, &gate].concat())
}

fn metrics(port: u16) -> String {
    let mut client = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
    client.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").expect("it reads");
    let mut answer = String::new();
    client.read_to_string(&mut answer).expect("it answers");
    answer
}

#[test]
fn both_ends_of_a_wire_are_watched() {
    let name = "ic-watch";
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("watch.toml");
    let devices = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 2\n";
    std::fs::write(&file, format!("cycle = \"10ms\"\n{devices}")).expect("a scratch file");
    let file = file.to_str().expect("UTF-8");
    let free = std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr());
    let port = free.expect("a free port").port();
    let served = Service::start(name, &["--metrics", &port.to_string(), file]);
    let Some(_served) = served else { return };
    let interface = ["--interface", name, "--netns", name, file];
    let held = "2 SubDevices with SYNC within 1 us for 2 s";
    let mut why = String::new();
    for _ in 0..4 {
        let alone = gate(&interface);
        why = text(&alone.stderr);
        if alone.status.code() != Some(0) {
            eprintln!("the machine stalls: {why}");
            continue;
        }
        assert!(why.contains(held) && why.contains("[r]"), "{why}");
        let mut run = Command::new(ISOCAT);
        run.arg("watch").args(interface).arg("--plain").stdout(Stdio::null());
        let main = Running(run.stderr(Stdio::null()).spawn().expect("it starts"));
        let beside = gate(&["--serve", name]);
        why = text(&beside.stderr);
        if beside.status.code() != Some(0) {
            eprintln!("the machine stalls: {why}");
            continue;
        }
        assert!(why.contains(held) && why.contains("[t]"), "{why}");
        let lines = text(&beside.stdout);
        assert!(lines.contains(" in sync  2 of 2 in OP  error at most "), "{lines}");
        let metrics = metrics(port);
        assert!(metrics.starts_with("HTTP/1.1 200 OK"), "{metrics}");
        for sample in [
            "isocat_in_operation 1",
            "isocat_sync0_error_seconds{position=\"1\"",
            "kind=\"served\"",
        ] {
            assert!(metrics.contains(sample), "no {sample} in\n{metrics}");
        }
        drop(main);
        return;
    }
    not_shown("watch::both_ends_of_a_wire_are_watched", &why);
}
