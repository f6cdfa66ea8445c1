//! The command line: verbs, exit codes, where words go.
//!
//! Results go to standard output, everything else to standard error. What the exit codes of each
//! verb mean stands in docs/commands.md, and in short at the end of `isocat --help`.

mod calibrate;
mod conform;
mod devices;
mod diagnose;
mod eni;
#[cfg(target_os = "linux")]
mod eni_interface;
mod eni_run;
mod explain;
mod files;
#[cfg(target_os = "linux")]
mod interface;
mod junit;
#[cfg(target_os = "linux")]
mod listen;
mod new;
mod output;
mod plan;
mod profile;
#[cfg(target_os = "linux")]
mod record;
mod replay;
mod run;
mod scan;
#[cfg(target_os = "linux")]
mod serve;
mod sii;
mod sweep;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod virtual_time;
mod watch;

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{LazyLock, OnceLock};

use clap::{CommandFactory, Parser, Subcommand};
use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_descriptions::document::{FileError, name_hint};
use isocat_segment::{Scenario, SegmentFile};

/// In sync.
const IN_SYNC: u8 = 0;
/// Not in sync, or lost it.
const NOT_IN_SYNC: u8 = 1;
/// The input can't be used.
const BAD_INPUT: u8 = 2;
/// Nothing was found against it, but not all was read that decides.
const NOT_KNOWN: u8 = 3;

const EXAMPLES: &str = "\
Examples:
  isocat                              run the built-in segment for 10 s of virtual time
  isocat run my.toml --for 1min       run a segment of your own
  isocat run --json | jq .in_sync     the whole report for a program
  isocat run --capture run.pcapng     every frame, for Wireshark
  isocat run --trace run.perfetto-trace
                                      pulses, steps, states and frames, for Perfetto
  isocat run --series run.parquet     a row for each SubDevice and cycle, for statistics of your own
  isocat run --no-drift-compensation  see clocks run apart
  isocat run --interface eth0 --any   bring up what is on a real wire, for 10 s of host time
  isocat run my.toml --interface eth0 expect the devices of my.toml there
  isocat run --interface eth0 --preflight
                                      what on this machine harms punctuality
  isocat plan my.toml --suggest       does it fit, with how much slack, and what would fit better
  isocat plan my.toml --prove         ... and what really happens, next to each line of the plan
  isocat plan my.toml --what-if       each cable pulled, each device without power: what becomes of the others
  isocat plan my.toml --for igh       the plan for another tool: TwinCAT, IgH, LinuxCNC, ROS 2, SOEM, pysoem, ethercrab, KickCAT
  isocat scan --interface eth0        what is on a wire: tree, delays, clocks, ESCs, objects, doubts
  isocat calibrate --interface eth0   what no data sheet tells: law of the drift loops, crystals, hops, times
  isocat serve --setup-veth ecat      a virtual segment for your MainDevice (root)
  isocat control ecat-seg pull 2      ... and something that happens to it
  isocat virtual -- ./my_master vt0    your MainDevice in virtual time, without root or interface
  isocat watch my.toml                see it run
  isocat watch --until 100ns --for 5s --within 1min
                                      wait until it is in sync; exit 0 it is, 1 not in time
  isocat sweep my.toml --seeds 1000   a thousand runs with other crystals, jitter and chances
  isocat diagnose field.pcapng        what is in a capture, what went wrong first, and what to do
  isocat record --interface eth0      listen beside any MainDevice; what goes wrong goes to a file
  isocat replay field.pcapng          where a captured segment differs from the model of its chips
  isocat conform kollmorgen_akd2g     does a device synchronize as it says
  isocat example > my.toml            the built-in segment as a start for your own
  isocat devices                      the device profiles there are
  isocat eni network.xml              what a configuration tool's ENI file writes, and its doubts
  isocat new --esi vendor.xml EL7041  a segment file of makers' descriptions, of an ENI, or of what a scan found
  isocat profile vendor.xml --type EL7041
                                      a device profile to be edited, also of an EEPROM or of what a scan found
  isocat sii eeprom.bin               what is in an EEPROM, and its doubts; --from vendor.xml writes one
  isocat run network.xml --esi esi/   the same executed to the letter, judged, and compared with our plan
  isocat explain 0x001A               what a code, an object, a register or a mode means
  isocat devices vendor.xml           what a maker's description (ESI) holds; --modules: slots of modular devices
  isocat explain modes                what each synchronization mode needs of a device

Exit codes:
  0  run, virtual, watch: in sync, or every [[expect]] was met; plan, new: fits; conform: each rule
     holds; scan, calibrate: everything was found; replay: agrees with the model; diagnose, record:
     no fault; sweep: each run as expected; other verbs: done
  1  the contrary
  2  bad input, or it could not begin
  3  on a real wire, and virtual: nothing contradicts synchronization, but a value that decides is unknown
  4  virtual: in sync, but the program failed
docs/commands.md has them verb by verb.";

/// For reports of faults: what was built, for which system, and the formats that it writes.
static LONG_VERSION: LazyLock<String> = LazyLock::new(|| {
    let built = if cfg!(debug_assertions) { "debug" } else { "optimized" };
    let formats = [
        isocat_engine::report::FORMAT,
        isocat_engine::plan::report::FORMAT,
        isocat_engine::report::scan::FORMAT,
        #[cfg(target_os = "linux")]
        isocat_engine::report::interface::FORMAT,
        isocat_diagnose::report::FORMAT,
    ];
    let (os, arch) = (std::env::consts::OS, std::env::consts::ARCH);
    let (version, formats) = (env!("CARGO_PKG_VERSION"), formats.join(", "));
    format!("{version}\nsystem:  {os} {arch}, {built}\nformats: {formats}")
});

const ABOUT: &str = "\
Brings an EtherCAT segment into synchronization, runs it and proves how good it is";

/// Brings an EtherCAT segment into synchronization, runs it and proves how good it is.
#[derive(Parser, Debug)]
#[command(version, long_version = LONG_VERSION.as_str(), about = ABOUT, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct CommandLine {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    run: run::Arguments,
}

#[derive(Subcommand, Debug)]
enum Verb {
    /// Bring a segment up, run it, judge it, report (the default verb)
    #[command(after_help = run::EXAMPLES)]
    Run(Box<run::Arguments>),
    /// Plan the cycle of a segment without sending anything: frames, phases, the slack of every
    /// demand
    Plan(plan::Arguments),
    /// Examine a segment before cyclic operation: topology, delays, clocks, SII, objects, and what
    /// is doubtful
    ///
    /// Every SubDevice goes to INIT, to PREOP and back: do not scan a segment that another
    /// MainDevice operates.
    Scan(scan::Arguments),
    /// Measure values of a segment that no data sheet states: crystals, law and sign of each drift
    /// loop, hops, times
    ///
    /// All devices have to be in INIT or PREOP: a segment in operation is refused. Offsets, delays,
    /// filters and states are put back as they were found, on Ctrl-C too.
    Calibrate(calibrate::Arguments),
    /// Test whether a SubDevice synchronizes as it states, rule by rule
    Conform(conform::Arguments),
    /// Serve the virtual segment on a network interface, for any MainDevice
    #[cfg(target_os = "linux")]
    Serve(Box<serve::Arguments>),
    /// Run an unmodified MainDevice program on the virtual segment, in deterministic virtual time
    #[cfg(all(target_os = "linux", target_arch = "x86_64"))]
    #[command(after_help = virtual_time::EXAMPLES)]
    Virtual(Box<virtual_time::Arguments>),
    /// Send a command to a running `isocat serve`: inject a fault, print its state, end it
    #[cfg(target_os = "linux")]
    Control(serve::ControlArguments),
    /// Show a segment as it runs: a simulation, a real wire or a served one; or wait until it is in
    /// sync
    Watch(Box<watch::Arguments>),
    /// Run a segment many times: over a grid of values, over seeds, with random faults
    #[command(after_help = sweep::EXAMPLES)]
    Sweep(sweep::Arguments),
    /// Say what a code, an object, a register or a mode means, and what to do about it
    Explain(explain::Arguments),
    /// Replay a capture of a real segment through modelled ESCs, and show where silicon and model
    /// differ
    #[command(after_help = replay::EXAMPLES)]
    Replay(replay::Arguments),
    /// Listen to an interface, and write the last seconds of frames when a fault occurs
    #[cfg(target_os = "linux")]
    #[command(after_help = record::EXAMPLES)]
    Record(Box<record::Arguments>),
    /// Read captures of any MainDevice's segment: devices, set-up, states, what went wrong first
    #[command(after_help = diagnose::EXAMPLES)]
    Diagnose(diagnose::Arguments),
    /// Read an ENI file: what it writes at start and in each cycle, what is doubtful, whether it
    /// can be run
    Eni(eni::Arguments),
    /// Read the content of an EEPROM (SII), or write one from a maker's description or a profile
    #[command(after_help = sii::EXAMPLES)]
    Sii(sii::Arguments),
    /// Make a segment file from vendors' descriptions and types, an ENI, or the result of a scan
    #[command(after_help = new::EXAMPLES)]
    New(new::Arguments),
    /// Make a profile file from a vendor's description, an EEPROM or a scan
    #[command(after_help = profile::EXAMPLES)]
    Profile(profile::Arguments),
    /// Print the built-in segment file
    Example,
    /// Print the completions of a shell: bash, zsh, fish, elvish or powershell
    Completions {
        /// For which shell
        shell: clap_complete::Shell,
    },
    /// Write the manual pages into a folder, one for each verb
    Man {
        /// Where to
        folder: PathBuf,
    },
    /// List the built-in device profiles; with a name, print that profile; with a maker's
    /// description, list it
    Devices(devices::Arguments),
}

/// Runs the command with the arguments of the process.
pub fn main() -> ExitCode {
    run_with(std::env::args_os()).into()
}

/// Runs the command inside another program, as Python's interpreter; gives its exit code. `itself`
/// is the program with the arguments that make it the command, for runs that are processes of their
/// own.
pub fn main_as(itself: Vec<OsString>, arguments: Vec<OsString>) -> u8 {
    // A program is one command in its life.
    let _ = ITSELF.set(itself);
    run_with(std::iter::once("isocat".into()).chain(arguments))
}

/// What starts this command again, where that is not the executable alone.
static ITSELF: OnceLock<Vec<OsString>> = OnceLock::new();

/// The error that the first argument is no verb: a word that is neither a flag nor a path. Without
/// it the words behind it would be called wrong.
fn unknown_verb(words: &[OsString]) -> Option<String> {
    let word = words.get(1)?.to_str()?;
    let command = CommandLine::command();
    let verbs: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
    let is_word = word.starts_with(|c: char| c.is_ascii_alphabetic())
        && !word.contains(['.', '/'])
        && !verbs.contains(&word)
        && word != "help"
        && !std::path::Path::new(word).exists();
    is_word.then(|| format!("no verb is named \"{word}\"; {}", name_hint(word, verbs)))
}

/// This command once more, as a process to come.
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn once_more() -> std::io::Result<std::process::Command> {
    match ITSELF.get().map(Vec::as_slice) {
        Some([program, arguments @ ..]) => {
            let mut command = std::process::Command::new(program);
            command.args(arguments);
            Ok(command)
        }
        _ => Ok(std::process::Command::new(std::env::current_exe()?)),
    }
}

fn run_with(arguments: impl Iterator<Item = OsString>) -> u8 {
    let words: Vec<OsString> = arguments.collect();
    let arguments = match CommandLine::try_parse_from(&words) {
        Ok(arguments) => arguments,
        Err(error) => {
            if let Some(unknown) = unknown_verb(&words).filter(|_| error.use_stderr()) {
                return fail(&unknown);
            }
            // Help and version are no errors; clap's own code for bad usage is 2 as ours.
            let code = if error.use_stderr() { BAD_INPUT } else { IN_SYNC };
            let _ = error.print();
            return code;
        }
    };
    match arguments.verb {
        None => run::run(&arguments.run),
        Some(Verb::Run(arguments)) => run::run(&arguments),
        Some(Verb::Plan(arguments)) => plan::run(&arguments),
        Some(Verb::Scan(arguments)) => scan::run(&arguments),
        Some(Verb::Calibrate(arguments)) => calibrate::run(&arguments),
        Some(Verb::Conform(arguments)) => conform::run(&arguments),
        #[cfg(target_os = "linux")]
        Some(Verb::Serve(arguments)) => serve::run(&arguments),
        #[cfg(all(target_os = "linux", target_arch = "x86_64"))]
        Some(Verb::Virtual(arguments)) => virtual_time::run(&arguments),
        #[cfg(target_os = "linux")]
        Some(Verb::Control(arguments)) => serve::control(&arguments),
        Some(Verb::Watch(arguments)) => watch::run(&arguments),
        Some(Verb::Sweep(arguments)) => sweep::run(&arguments),
        Some(Verb::Explain(arguments)) => explain::run(&arguments),
        Some(Verb::Replay(arguments)) => replay::run(&arguments),
        #[cfg(target_os = "linux")]
        Some(Verb::Record(arguments)) => record::run(&arguments),
        Some(Verb::Diagnose(arguments)) => diagnose::run(&arguments),
        Some(Verb::Eni(arguments)) => eni::run(&arguments),
        Some(Verb::Sii(arguments)) => sii::run(&arguments),
        Some(Verb::New(arguments)) => new::run(&arguments),
        Some(Verb::Profile(arguments)) => profile::run(&arguments),
        Some(Verb::Example) => print(SegmentFile::built_in_text()),
        Some(Verb::Devices(arguments)) => devices::run(&arguments),
        Some(Verb::Completions { shell }) => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut CommandLine::command(), "isocat", &mut text);
            print(&String::from_utf8_lossy(&text))
        }
        Some(Verb::Man { folder }) => {
            match clap_mangen::generate_to(CommandLine::command(), &folder) {
                Ok(()) => IN_SYNC,
                Err(error) => fail(&format!("{} can't be written: {error}", folder.display())),
            }
        }
    }
}

/// Prints a result. A reader that went away (`isocat | head`) is no error.
fn print(text: &str) -> u8 {
    use std::io::Write;
    // In plain text there is nothing to strip: a long document goes out in one piece.
    let is_plain = text.bytes().all(|byte| byte == b'\n' || !byte.is_ascii_control());
    let written = match is_plain {
        true => std::io::stdout().write_all(text.as_bytes()),
        false => anstream::stdout().write_all(text.as_bytes()),
    };
    match written {
        Ok(()) => IN_SYNC,
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => IN_SYNC,
        Err(error) => fail(&format!("standard output can't be written: {error}")),
    }
}

/// Gives the devices of a scenario the chips that a file tells, if there is one.
fn apply_chips(
    path: Option<&str>,
    scenario: &mut isocat_segment::Scenario,
) -> Result<(), FileError> {
    match path {
        None => Ok(()),
        Some(path) => isocat_segment::ChipFile::read(path)?.apply(scenario),
    }
}

/// The segment of a file; without one, the built-in segment.
fn segment_or_built_in(path: Option<&str>) -> Result<SegmentFile, FileError> {
    match path {
        None => Ok(SegmentFile::built_in()),
        Some(path) => SegmentFile::read(path),
    }
}

/// What is wrong with a ring on a network interface, which is one port.
#[cfg(target_os = "linux")]
fn refused_ring(scenario: &Scenario, interface: &str) -> Option<String> {
    scenario.ring.map(|_| {
        let source = &scenario.source;
        format!(
            "{source} is a ring, which has two ports, and --interface {interface} is one; expected a segment file without \
             ring = true, and no cable at the end of the line"
        )
    })
}

/// Says that a verb that has one port takes a ring for a line.
fn note_ring(scenario: &Scenario, verb: &str) {
    if scenario.ring.is_some() {
        anstream::eprintln!(
            "isocat {verb}: {} is a ring; {verb} has one port and sees the line that the ring is without its last cable",
            scenario.source
        );
    }
}

/// Says why the input can't be used.
fn fail(message: &str) -> u8 {
    let lines = message.lines().flat_map(|line| wrap(line, WIDTH - "error: ".len()));
    for (i, line) in lines.enumerate() {
        if i == 0 {
            anstream::eprintln!("{BAD}error:{BAD:#} {line}");
        } else {
            anstream::eprintln!("       {line}");
        }
    }
    BAD_INPUT
}

const BAD: anstyle::Style = anstyle::AnsiColor::Red.on_default().bold();

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::process::Command;

    use super::*;

    /// The lines of shell blocks of a document that call the command, each with its number.
    fn lines(text: &str) -> Vec<(usize, &str)> {
        let mut in_shell = false;
        let mut found = Vec::new();
        for (number, line) in text.lines().enumerate() {
            if let Some(language) = line.trim_start().strip_prefix("```") {
                in_shell = language == "sh";
            } else if in_shell && line.trim_start_matches("sudo ").starts_with("isocat ") {
                found.push((number + 1, line));
            }
        }
        found
    }

    /// The arguments of each call of `isocat` in a line, as a shell splits them. The shell gets
    /// programs that do nothing but tell how they were called.
    fn calls(line: &str, folder: &Path) -> Vec<Vec<String>> {
        let _ = fs::remove_file(folder.join("calls"));
        let functions = "isocat() { printf '%s\\n' isocat \"$@\" '' >> \"$CALLS\"; }; \
                         sudo() { \"$@\"; }; jq() { cat; }; echo() { :; }; ";
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("{functions}{line}")]).current_dir(folder);
        shell.env("CALLS", folder.join("calls")).output().expect("a shell");
        let told = fs::read_to_string(folder.join("calls")).expect("a call");
        told.trim_end()
            .split("\n\n")
            .map(|call| call.lines().map(str::to_owned).collect())
            .collect()
    }

    #[test]
    fn each_line_of_the_documentation_is_one_that_the_command_takes() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let folder = std::env::temp_dir().join(format!("isocat-lines-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a temporary folder");
        let mut documents = vec![root.join("README.md"), root.join("CONTRIBUTING.md")];
        for entry in fs::read_dir(root.join("docs")).expect("the documents") {
            documents.push(entry.expect("a readable folder").path());
        }
        let (mut taken, mut refused) = (0, Vec::new());
        for document in documents.iter().filter(|path| path.extension().is_some_and(|e| e == "md"))
        {
            let text = fs::read_to_string(document).expect("a document");
            for (number, line) in lines(&text) {
                for call in calls(line, &folder) {
                    match CommandLine::try_parse_from(call) {
                        Ok(_) => taken += 1,
                        Err(error) => {
                            refused
                                .push(format!("{}:{number}: {line}\n{error}", document.display()));
                        }
                    }
                }
            }
        }
        fs::remove_dir_all(&folder).expect("a temporary folder");
        assert!(refused.is_empty(), "{}", refused.join("\n"));
        assert!(taken > 100, "{taken} lines were found");
    }
}
