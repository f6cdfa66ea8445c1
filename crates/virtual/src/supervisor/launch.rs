//! Checks a program before it is started.

use std::ffi::{CString, OsStr, OsString};
use std::fmt;
use std::fs;
use std::io::{self, Read};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::filter;
use crate::sys::{self, Launched};

/// A program that can be started.
#[derive(Clone, Debug)]
pub struct Program {
    path: PathBuf,
    arguments: Vec<OsString>,
}

/// The reason why a program cannot be started.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Refusal(String);

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refusal {}

/// Largest depth of scripts whose interpreters are scripts, as in the kernel.
const MOST_SCRIPTS: usize = 4;
/// `e_machine` of x86-64.
const X86_64: u16 = 62;

impl Program {
    /// Finds a program as a shell does: by its path, or by its name in `PATH`.
    ///
    /// # Errors
    ///
    /// The program does not exist, is not a program, is not executable, or is for another kind of
    /// machine.
    pub fn find(name: &OsStr, arguments: &[OsString]) -> Result<Self, Refusal> {
        let shown = name.to_string_lossy();
        let path = if name.as_bytes().contains(&b'/') {
            PathBuf::from(name)
        } else {
            let folders = std::env::var_os("PATH").unwrap_or_default();
            let there = |folder: PathBuf| Some(folder.join(name)).filter(|path| is_program(path));
            let found = std::env::split_paths(&folders).find_map(there);
            found.ok_or_else(|| {
                Refusal(format!("{shown}: there is no such program in PATH; expected one, or a path as ./{shown}"))
            })?
        };
        check(&path, MOST_SCRIPTS)?;
        let arguments = [name.to_owned()].into_iter().chain(arguments.iter().cloned()).collect();
        Ok(Self { path, arguments })
    }
}

fn is_program(path: &Path) -> bool {
    let may_run = |about: &fs::Metadata| about.is_file() && about.permissions().mode() & 0o111 != 0;
    fs::metadata(path).is_ok_and(|about| may_run(&about))
}

/// Whether a file is a program for this machine, or a script whose interpreter is one.
fn check(path: &Path, scripts: usize) -> Result<(), Refusal> {
    let refuse = |what: String| Err(Refusal(format!("{}: {what}", path.display())));
    let about = match fs::metadata(path) {
        Ok(about) => about,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return refuse("there is no such file; expected a program".into());
        }
        Err(error) => return refuse(error.to_string()),
    };
    if about.is_dir() {
        return refuse("this is a folder; expected a program".into());
    }
    if !is_program(path) {
        return refuse("this file may not be executed; chmod +x allows it".into());
    }
    if about.permissions().mode() & 0o6000 != 0 {
        return refuse("this program takes another user's rights (setuid), and those are not given to supervised programs; a copy without them runs, as it needs none".into());
    }
    let mut head = [0; 256];
    let read = fs::File::open(path).and_then(|mut file| file.read(&mut head));
    let head = match read {
        Ok(read) => &head[..read],
        Err(error) => return refuse(error.to_string()),
    };
    if head.starts_with(b"#!") {
        let line = head[2..].split(|byte| *byte == b'\n').next().unwrap_or_default();
        let line = String::from_utf8_lossy(line);
        let Some(interpreter) = line.split_whitespace().next().filter(|_| scripts > 0) else {
            return refuse("a script whose first line names no interpreter".into());
        };
        return check(Path::new(interpreter), scripts - 1);
    }
    if !head.starts_with(b"\x7fELF") {
        return refuse("this is neither a program (ELF) nor a script (#!)".into());
    }
    let machine = head.get(18..20).map_or(0, |bytes| u16::from_le_bytes([bytes[0], bytes[1]]));
    match (head.get(4), machine) {
        (Some(2), X86_64) => Ok(()),
        (Some(1), _) => refuse("this is a program of 32 bits; expected one for x86-64".into()),
        _ => refuse(format!(
            "this program is for another machine (number {machine} in its head); expected x86-64 (62)"
        )),
    }
}

/// Starts the program; it stops at its first call.
pub(super) fn start(program: &Program) -> io::Result<Launched> {
    let text = |text: &OsStr| CString::new(text.as_bytes()).map_err(io::Error::other);
    let arguments: Vec<CString> =
        program.arguments.iter().map(|argument| text(argument)).collect::<io::Result<_>>()?;
    let mut environment = Vec::new();
    for (name, value) in std::env::vars_os() {
        let mut pair = name;
        pair.push("=");
        pair.push(value);
        environment.push(text(&pair)?);
    }
    if std::env::var_os("PYTHONHASHSEED").is_none() {
        // Otherwise the order of Python's sets would differ from run to run.
        environment.push(text(OsStr::new("PYTHONHASHSEED=0"))?);
    }
    let launched =
        sys::launch(&text(program.path.as_os_str())?, &arguments, &environment, &filter::program());
    launched.map_err(|error| {
        let why = match error.raw_os_error() {
            Some(libc::EINVAL | libc::ENOSYS) => "this kernel lacks what that needs: Linux 6.6 or newer, with seccomp's user notifications",
            Some(libc::EBUSY) => "something else supervises this process already: isocat virtual within isocat virtual, or a container's runtime",
            Some(libc::EPERM | libc::EACCES) => "this container does not allow it",
            _ => "the machine refuses it",
        };
        io::Error::new(error.kind(), format!("programs can't be supervised here, and nothing was started: {why} ({error})"))
    })
}
