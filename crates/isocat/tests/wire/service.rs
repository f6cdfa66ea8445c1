//! A segment that `isocat serve` serves on a veth pair, in a network namespace that goes with it:
//! shared by the tests that need one.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::sync::{MutexGuard, OnceLock};

use isocat::host::RawSocket;

use crate::alone::{alone, skipped};

pub const ISOCAT: &str = env!("CARGO_BIN_EXE_isocat");

pub fn isocat(arguments: &[&str]) -> Output {
    Command::new(ISOCAT).args(arguments).output().expect("isocat starts")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Whether raw sockets and namespaces can be had; says a word if not.
pub fn permitted() -> bool {
    static PERMITTED: OnceLock<bool> = OnceLock::new();
    let permitted = *PERMITTED.get_or_init(|| {
        let probe = format!("isct-probe-{}", std::process::id());
        let made = Command::new("ip").args(["netns", "add", &probe]).output();
        let permitted = made.is_ok_and(|output| output.status.success());
        // Where it was not made there is nothing to remove.
        let _ = Command::new("ip").args(["netns", "del", &probe]).output();
        permitted
    });
    if !permitted {
        skipped("it needs root and the command ip (iproute2)");
    }
    permitted
}

/// A service in a namespace of its own, ended when dropped.
pub struct Service {
    pub child: Child,
    pub name: &'static str,
    output: BufReader<ChildStdout>,
    _alone: MutexGuard<'static, ()>,
}

impl Service {
    /// Serves what `more` says; `None`, with a word, where that is not permitted.
    pub fn start(name: &'static str, more: &[&str]) -> Option<Self> {
        if !permitted() {
            return None;
        }
        let alone = alone();
        let mut child = Command::new(ISOCAT)
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
        Some(Self { child, name, output, _alone: alone })
    }

    pub fn control(&self, words: &[&str]) -> Output {
        let interface = format!("{}-seg", self.name);
        isocat(&[&["control", &interface], words].concat())
    }

    pub fn done(&self, words: &[&str]) -> String {
        let output = self.control(words);
        assert!(output.status.success(), "{words:?}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs the command on the MainDevice's end.
    pub fn run(&self, arguments: &[&str]) -> Output {
        isocat(&[arguments, &["--interface", self.name, "--netns", self.name]].concat())
    }

    pub fn socket(&self) -> RawSocket {
        RawSocket::open(self.name, Some(self.name)).expect("the MainDevice's end")
    }

    /// The rest of the output, and the exit code, after the end.
    pub fn finish(mut self) -> (String, Option<i32>) {
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
