//! Network namespaces, and a veth pair in its own namespace for tests on one machine.

use std::fs::File;
use std::os::fd::AsFd;
use std::process::{Command, Stdio};

use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};

use super::LinkError;

/// Runs a function inside a network namespace, on a thread of its own, so that the caller's
/// namespace does not change. Sockets opened there belong to the namespace wherever they are used.
pub(super) fn inside<T: Send>(
    namespace: &str,
    work: impl FnOnce() -> T + Send,
) -> Result<T, LinkError> {
    let failed = |error| LinkError::entering(namespace, error);
    let file = File::open(path(namespace)).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => LinkError::UnknownNamespace(namespace.to_owned()),
        _ => failed(error),
    })?;
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            move_into_link_name_space(file.as_fd(), Some(LinkNameSpaceType::Network))
                .map_err(|error| failed(error.into()))?;
            Ok(work())
        });
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// As `inside`, or in the present namespace if none is named.
pub(super) fn inside_or_here<T: Send>(
    namespace: Option<&str>,
    work: impl FnOnce() -> T + Send,
) -> Result<T, LinkError> {
    match namespace {
        Some(namespace) => inside(namespace, work),
        None => Ok(work()),
    }
}

/// A veth pair in its own network namespace, removed when dropped; two pairs for a ring.
///
/// The namespace has the name of the pair. Both ends are in it, so the machine's own network does
/// not change: `NAME` is for a MainDevice, `NAME-seg` for the segment. The second pair is `NAME-2`
/// and `NAME-sg2`.
#[derive(Debug)]
pub struct Veth {
    name: String,
}

impl Veth {
    /// Makes the pair. Needs `CAP_NET_ADMIN` and `CAP_SYS_ADMIN` (in practice: root) and the
    /// command `ip`. A pair of this name that an earlier process left behind is reused.
    pub fn create(name: &str) -> Result<Self, LinkError> {
        Self::with(name, &[pair_of(name)])
    }

    /// Makes the pair and a second one, for a MainDevice with two ports.
    pub fn create_ring(name: &str) -> Result<Self, LinkError> {
        Self::with(name, &[pair_of(name), second_pair_of(name)])
    }

    fn with(name: &str, pairs: &[[String; 2]]) -> Result<Self, LinkError> {
        let fits = (1..=MOST_NAME).contains(&name.len())
            && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_".contains(&b))
            && !name.starts_with('-');
        if !fits {
            return Err(LinkError::Name(name.to_owned()));
        }
        let veth = Self { name: name.to_owned() };
        if path(name).exists() {
            let is_there = |end: &String| ip(&["-n", name, "link", "show", end]).is_ok();
            if pairs.iter().all(|[_, segment]| is_there(segment)) {
                return Ok(veth);
            }
            std::mem::forget(veth);
            return Err(LinkError::Namespace(name.to_owned()));
        }
        // From here on a drop removes the namespace.
        ip(&["netns", "add", name]).map_err(|error| match error {
            LinkError::Ip { message, .. }
                if message.contains("ermission") || message.contains("not permitted") =>
            {
                LinkError::Permission {
                    what: "making a network namespace".to_owned(),
                    capability: "cap_net_admin,cap_sys_admin",
                }
            }
            error => error,
        })?;
        for [main, segment] in pairs {
            ip(&["-n", name, "link", "add", main, "type", "veth", "peer", "name", segment])?;
        }
        for end in pairs.iter().flatten() {
            // Only EtherCAT must be on this wire.
            let _ = ip(&[
                "netns",
                "exec",
                name,
                "sysctl",
                "-qw",
                &format!("net.ipv6.conf.{end}.disable_ipv6=1"),
            ]);
            ip(&["-n", name, "link", "set", end, "up"])?;
        }
        Ok(veth)
    }

    /// Name of the namespace.
    pub fn namespace(&self) -> &str {
        &self.name
    }

    /// The interface for a MainDevice.
    pub fn main_end(&self) -> String {
        self.name.clone()
    }

    /// The interface for the second port of a MainDevice, in a ring.
    pub fn second_main_end(&self) -> String {
        let [main, _] = second_pair_of(&self.name);
        main
    }

    /// The interface for the segment of a pair of this name.
    pub fn segment_end_of(name: &str) -> String {
        let [_, segment] = pair_of(name);
        segment
    }

    /// The interface for the other end of the segment, in a ring.
    pub fn second_segment_end_of(name: &str) -> String {
        let [_, segment] = second_pair_of(name);
        segment
    }

    /// The interface for the segment.
    pub fn segment_end(&self) -> String {
        Self::segment_end_of(&self.name)
    }
}

impl Drop for Veth {
    fn drop(&mut self) {
        // The pair is removed with its namespace. An error here cannot be handled sensibly.
        let _ = ip(&["netns", "del", &self.name]);
    }
}

/// The ends of the pair: the MainDevice's, then the segment's.
fn pair_of(name: &str) -> [String; 2] {
    [name.to_owned(), format!("{name}-seg")]
}

fn second_pair_of(name: &str) -> [String; 2] {
    [format!("{name}-2"), format!("{name}-sg2")]
}

/// Linux allows 15 characters, and the segment's end has four more than the pair.
const MOST_NAME: usize = 11;

fn path(namespace: &str) -> std::path::PathBuf {
    std::path::Path::new("/run/netns").join(namespace)
}

fn ip(arguments: &[&str]) -> Result<(), LinkError> {
    let error = |message: String| {
        let command = format!("ip {}", arguments.join(" "));
        LinkError::Ip { command, message }
    };
    let output = Command::new("ip")
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .map_err(|cause| error(format!("{cause}; the package iproute2 has it")))?;
    if output.status.success() {
        return Ok(());
    }
    Err(error(String::from_utf8_lossy(&output.stderr).trim().to_owned()))
}
