//! What can go wrong with an interface, in words that say what to do.

use std::fmt;
use std::io;

/// An interface that can't be used.
#[derive(Debug)]
pub enum LinkError {
    /// The process may not do it.
    Permission {
        /// What it wanted.
        what: String,
        /// What it lacks, as `setcap` names it.
        capability: &'static str,
    },
    /// There is no interface of that name.
    Unknown {
        /// The name.
        name: String,
        /// Those that there are.
        known: Vec<String>,
    },
    /// The interface is down, or has gone.
    Down(String),
    /// A name that no pair of interfaces can have.
    Name(String),
    /// A namespace of that name is there and is not ours.
    Namespace(String),
    /// There is no network namespace of that name.
    UnknownNamespace(String),
    /// The command `ip` failed.
    Ip {
        /// As it was called.
        command: String,
        /// What it said.
        message: String,
    },
    /// Anything else that the system refuses.
    Os {
        /// What was being done.
        what: &'static str,
        /// To which interface.
        name: String,
        /// What the system says.
        error: io::Error,
    },
}

impl LinkError {
    /// Of something that was done to an interface.
    pub(super) fn os(what: &'static str, name: &str, error: io::Error) -> Self {
        Self::needing("cap_net_raw", what, name, error)
    }

    /// Of entering a network namespace.
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
        // Of this thread's namespace, which /sys need not be.
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
