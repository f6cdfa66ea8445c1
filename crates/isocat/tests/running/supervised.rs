//! A test of this program as a program under supervision: it finds the segment behind the packet
//! socket of `vt0` and runs in virtual time, so the loop of a real interface is the same each time.

use std::ffi::OsString;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isocat_sim::{Segment, Watcher};
use isocat_virtual::kernel::{Costs, Luck, MachineFault};
use isocat_virtual::supervisor::{self, Ended, Ending, How, Options, Program, START};
use isocat_virtual::{Wire, WireAnswer};
use isocat_wire::datagram::datagrams;
use isocat_wire::time::{Host, Nanos, Picos, Time, True};
use isocat_wire::{Command, frame};

/// The file into which a test under supervision writes what it saw.
const WRITES_TO: &str = "SUPERVISED_TEST_WRITES_TO";

/// Where this process is under supervision: the file for what it sees.
pub fn writes_to() -> Option<PathBuf> {
    std::env::var_os(WRITES_TO).map(PathBuf::from)
}

/// A segment on a wire that may lose frames.
pub struct Line {
    segment: Segment,
    /// When the wire is free again.
    free: Time<True>,
    /// Within these instants one of this number of frames of the cycle is lost on its way back.
    pub loses: Option<(Range<Time<Host>>, u64)>,
    cyclic: u64,
    /// The logical address in each frame that was lost.
    pub lost: Vec<u32>,
}

impl Line {
    pub fn new(segment: Segment) -> Self {
        Self { segment, free: Time::ZERO, loses: None, cyclic: 0, lost: Vec::new() }
    }

    /// The logical address in a frame of the cycle that is lost on its way back.
    fn loses(&mut self, at: Time<Host>, bytes: &[u8]) -> Option<u32> {
        let (_, one_of) = self.loses.as_ref().filter(|(when, _)| when.contains(&at))?;
        let payload = frame::payload(bytes).expect("our own frame");
        let headers = datagrams(payload).map(|datagram| datagram.expect("it is whole").header);
        let mut image = headers.filter(|header| header.command() == Ok(Command::Lrw));
        // Frames of the cycle have the upper half of the indices.
        let address = image.next().filter(|_| payload[1] >= 0x80)?.address;
        self.cyclic += 1;
        self.cyclic.is_multiple_of(*one_of).then_some(address)
    }
}

impl Wire for Line {
    fn send(&mut self, _: usize, at: Time<Host>, frame: &[u8], answers: &mut Vec<WireAnswer>) {
        let mut bytes = frame.to_vec();
        let start = (Time::ZERO + Picos::from(at - START)).max(self.free);
        self.free = start + Picos::from(Nanos(frame::duration_ns(bytes.len()) as i64 + 960));
        let fate = self.segment.pass(&mut bytes, start, &mut Watcher::blind());
        let Some(back) = fate.ok().filter(|back| back.good) else { return };
        if let Some(address) = self.loses(at, &bytes) {
            return self.lost.push(address);
        }
        let at = START + Nanos(back.last_bit.as_nanos() as i64 + 1);
        answers.push(WireAnswer { at, interface: 0, bytes });
    }

    fn advance(&mut self, now: Time<Host>) {
        let now = Time::ZERO + Picos::from(now - START);
        self.segment.advance(now, &mut Watcher::blind());
    }

    fn next_timeout(&self, _: Time<Host>) -> Option<Time<Host>> {
        None
    }

    fn take_machine_faults(&mut self) -> Vec<MachineFault> {
        Vec::new()
    }
}

/// Starts the named test again under supervision, with the line behind `vt0`; what it wrote.
/// `None`, with a word: programs can't be supervised here.
pub fn again(test: &str, line: &mut Line) -> Option<String> {
    let folder = std::env::temp_dir();
    let place = format!("isocat-{}-{}", test.replace(':', "-"), std::process::id());
    let [wrote, printed] = ["wrote", "printed"].map(|name| folder.join(format!("{place}.{name}")));
    let ended = supervise(test, [&wrote, &printed], line)?;
    let read = |path: &Path| {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        // It is there, but where the program did not come so far.
        let _ = std::fs::remove_file(path);
        text
    };
    let (wrote, printed) = (read(&wrote), read(&printed));
    assert_eq!(ended.how, How::Itself(Ending::Exited(0)), "{printed}{:?}", ended.notes);
    println!("{test}: {} of virtual time, {:?}", ended.lasted, ended.figures);
    Some(wrote)
}

fn supervise(test: &str, [wrote, printed]: [&Path; 2], line: &mut Line) -> Option<Ended> {
    let own = std::env::current_exe().expect("a test has a binary");
    let script = format!(
        "{WRITES_TO}='{}' exec '{}' {test} --exact --nocapture >'{}' 2>&1",
        wrote.display(),
        own.display(),
        printed.display()
    );
    let arguments = [OsString::from("-c"), OsString::from(script)];
    let program = Program::find("sh".as_ref(), &arguments).expect("there is a shell");
    let options = Options {
        interfaces: vec!["vt0".into()],
        costs: Costs::default(),
        luck: Luck::default(),
        limit: Some(Nanos::millis(600_000)),
        stop: Arc::default(),
    };
    match supervisor::run(&program, &options, line) {
        Ok(ended) => Some(ended),
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
}
