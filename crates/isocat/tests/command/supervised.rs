//! Programs under `isocat virtual`, shared by the tests that run one: a folder of their own, how a
//! program is started, and what it and the segment told.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::Duration;

use isocat::host::{RawSocket, clock};
use isocat_wire::Command as Access;
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::time::Nanos;
use serde_json::Value;

pub const ISOCAT: &str = env!("CARGO_BIN_EXE_isocat");

/// What this test program is to do where it is itself the program under supervision.
const ROLE: &str = "SUPERVISED_TEST_ROLE";

/// The role of this process; `None` where it is not under supervision.
pub fn role() -> Option<String> {
    std::env::var(ROLE).ok()
}

/// The line of a shell that runs the named test of this program in a role of its own.
pub fn in_the_role(role: &str, test: &str) -> String {
    let own = std::env::current_exe().expect("a test has a binary");
    format!("{ROLE}={role} '{}' {test} --exact --nocapture >&2", own.display())
}

/// Sends a frame with one broadcast from a program under supervision, and gives the frame that
/// comes back.
pub fn broadcast(command: Access, ado: u16, data: &[u8]) -> Vec<u8> {
    assert!(role().is_some(), "the clock is virtual under supervision alone");
    let mut socket = RawSocket::open("vt0", None).expect("the end of the segment");
    let (mut sent, mut buffer) = ([0; 60], [0; 2048]);
    let mut writer = FrameWriter::new(&mut sent, [0x10, 0, 0, 0, 0, 1]);
    writer.push(command, 0x55, Address::Broadcast(ado), data).expect("it is short");
    let len = writer.finish();
    socket.send(&sent[..len]).expect("an interface that is up");
    assert!(socket.wait(Some(clock::now() + Nanos::millis(10))).expect("it is up"), "no answer");
    let received = socket.receive(&mut buffer).expect("it is up").expect("an answer");
    assert_eq!(buffer[17], 0x55, "the index of the datagram");
    buffer[..received.len].to_vec()
}

/// Lets virtual time pass in a program under supervision.
pub fn pause(time: Nanos) {
    assert!(role().is_some(), "the clock is virtual under supervision alone");
    std::thread::sleep(Duration::from_nanos(time.0 as u64));
}

/// A folder of a test's own, which goes with it.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("isocat-vt-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    /// A file in it.
    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.join(name), text).expect("it can be written");
    }

    /// What a file in it holds.
    pub fn read(&self, name: &str) -> String {
        let text = std::fs::read_to_string(self.0.join(name));
        text.unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Runs the command in this folder, so that no message depends on where it lies.
    pub fn isocat(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(ISOCAT);
        command.current_dir(&self.0).args(arguments).output().expect("the command runs")
    }

    /// Runs a program on a segment file of this folder; what was told. `None`, with a word:
    /// programs can't be supervised here.
    pub fn supervised(&self, segment: &str, program: &[&str]) -> Option<Told> {
        Told::of(&self.isocat(&[&["virtual", segment, "--json", "--"], program].concat()))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What was told of a program under supervision.
pub struct Told {
    /// What the program printed to standard output.
    pub printed: String,
    /// The summary of the segment, and of the program.
    pub summary: Value,
    /// Standard error of both.
    pub errors: String,
    /// The exit code of `isocat virtual`.
    pub exit: Option<i32>,
}

impl Told {
    /// Reads the output of `isocat virtual --json`. `None`, with a word: programs can't be
    /// supervised here.
    pub fn of(output: &Output) -> Option<Self> {
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        if cannot_be_supervised(&errors) {
            return None;
        }
        let text = String::from_utf8_lossy(&output.stdout);
        let text = text.trim_end();
        let (printed, summary) = text.rsplit_once('\n').unwrap_or(("", text));
        let summary = serde_json::from_str(summary);
        let summary = summary.unwrap_or_else(|error| panic!("{error}: {text}{errors}"));
        Some(Self { printed: printed.to_owned(), summary, errors, exit: output.status.code() })
    }

    /// The exit code of the program.
    pub fn code(&self) -> Option<i64> {
        self.summary["program"]["code"].as_i64()
    }

    /// The JSON that the program printed.
    pub fn report(&self) -> Value {
        let report = serde_json::from_str(&self.printed);
        report.unwrap_or_else(|error| panic!("{error}: {}{}", self.printed, self.errors))
    }

    /// Standard error without the ends of lines, where a message is folded.
    pub fn message(&self) -> String {
        self.errors.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    /// A number of the summary.
    pub fn counted(&self, key: &str) -> u64 {
        self.summary[key].as_u64().unwrap_or_else(|| panic!("{key}: {}", self.summary))
    }
}

/// Whether `isocat virtual` said that no program can be supervised on this machine; it then started
/// none, and this says so.
pub fn cannot_be_supervised(errors: &str) -> bool {
    let refused = errors.contains("can't be supervised here");
    if refused {
        println!("skipped: {errors}");
    }
    refused
}
