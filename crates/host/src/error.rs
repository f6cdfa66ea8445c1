//! Errors of an interface, in words that say what to do.

use std::fmt;
use std::io;

/// An interface cannot be used.
#[derive(Debug)]
pub enum LinkError {
    /// The process lacks a permission.
    Permission {
        /// What the process tried.
        what: String,
        /// The capability that it lacks, as `setcap` names it.
        capability: &'static str,
    },
    /// There is no interface with that name.
    Unknown {
        /// The name.
        name: String,
        /// The interfaces that exist.
        known: Vec<String>,
    },
    /// The interface is down, or does not exist any more.
    Down(String),
    /// No pair of interfaces can have this name.
    Name(String),
    /// A namespace with that name exists and was not made by this program.
    Namespace(String),
    /// There is no network namespace with that name.
    UnknownNamespace(String),
    /// The command `ip` failed.
    Ip {
        /// The command with its arguments.
        command: String,
        /// Its error output, or why it could not be started.
        message: String,
    },
    /// Any other error of the system.
    Os {
        /// What was being done.
        what: &'static str,
        /// The interface.
        name: String,
        /// The system's error.
        error: io::Error,
    },
}

impl LinkError {
    /// The error of an operation on an interface.
    pub(super) fn os(what: &'static str, name: &str, error: io::Error) -> Self {
        Self::needing("cap_net_raw", what, name, error)
    }

    /// The error of entering a network namespace.
    pub(super) fn entering(namespace: &str, error: io::Error) -> Self {
        let capabilities = "cap_net_raw,cap_sys_admin";
        Self::needing(capabilities, "entering the network namespace", namespace, error)
    }

    fn needing(capability: &'static str, what: &'static str, name: &str, error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::PermissionDenied => {
                Self::Permission { what: format!("{what} {name}"), capability }
            }
            _ => Self::Os { what, name: name.to_owned(), error },
        }
    }

    pub(super) fn unknown_interface(name: &str) -> Self {
        // The table must be that of this thread's namespace; /sys may show another one.
        let text = std::fs::read_to_string("/proc/thread-self/net/dev").unwrap_or_default();
        let known = text.lines().skip(2).filter_map(|line| line.split_once(':'));
        Self::Unknown {
            name: name.to_owned(),
            known: known.map(|(name, _)| name.trim().to_owned()).collect(),
        }
    }
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Permission { what, capability } => {
                let program = std::env::current_exe().unwrap_or_else(|_| "isocat".into());
                let program = program.display();
                writeln!(f, "{what} is not permitted to this user")?;
                write!(f, "run it as root, or grant it once: sudo setcap {capability}+ep {program}")
            }
            Self::Unknown { name, known } => {
                write!(f, "there is no network interface \"{name}\"")?;
                match known.is_empty() {
                    true => write!(f, "; there is none at all"),
                    false => write!(f, "; there are {}", known.join(", ")),
                }
            }
            Self::Down(name) => {
                writeln!(f, "the interface {name} is down or gone")?;
                write!(f, "bring it up: ip link set {name} up")
            }
            Self::Name(name) => write!(
                f,
                "\"{name}\" can't name a veth pair; expected 1 to 11 letters, digits, '-' or '_'"
            ),
            Self::Namespace(name) => {
                write!(
                    f,
                    "there is a network namespace \"{name}\" already that is not of this program; "
                )?;
                write!(f, "expected a free name")
            }
            Self::UnknownNamespace(name) => write!(
                f,
                "there is no network namespace \"{name}\"; \"ip netns\" lists those there are"
            ),
            Self::Ip { command, message } => write!(f, "\"{command}\" failed: {message}"),
            Self::Os { what, name, error } => write!(f, "{what} {name} failed: {error}"),
        }
    }
}

impl std::error::Error for LinkError {}
