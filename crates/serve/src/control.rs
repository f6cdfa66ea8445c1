//! Requests to a running service: a socket in the file system, one line in each direction.
//!
//! Each client has a thread for the time of its request, at most two seconds, whether or not it
//! sends anything. If there are too many, the oldest client is disconnected. A thread hands its
//! request to the service and wakes it. A silent client therefore blocks neither a frame nor
//! another client's request.
//!
//! The socket is in a folder to which no other user can write. A client asks only a service of its
//! own user or of root, since another user's socket may answer anything, without end, or never.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use isocat_descriptions::limits;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};

use super::service::PATIENCE;

/// Requests that wait for the service, and signals to the service.
pub struct Requests {
    receiver: Receiver<(String, Sender<String>)>,
    signalled: Arc<AtomicBool>,
    path: PathBuf,
}

/// How long both ends wait for each other. Tests set it: no test may depend on how fast or how
/// punctual the machine is.
#[derive(Clone, Copy, Debug)]
struct Waits {
    /// A client's time to send its request, and to receive the answer.
    client: Duration,
    /// The service's time for the answer to a request.
    answer: Duration,
}

impl Waits {
    /// A client's time for a service in total.
    fn service(self) -> Duration {
        self.answer.saturating_add(self.client)
    }
}

/// The waits of a real service and of its clients.
const WAITS: Waits = Waits { client: Duration::from_secs(2), answer: PATIENCE };
/// How soon a client notices that it must stop.
const SLICE: Duration = Duration::from_millis(50);

/// The socket of the service of an interface: in `XDG_RUNTIME_DIR` if that is this user's own, else
/// in `/run` for root, else in `isocat-UID` in the folder for temporary files.
pub fn path_of(interface: &str) -> PathBuf {
    let user = rustix::process::geteuid();
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    // `sudo` may keep the variable, and the folder then belongs to another user.
    let own = |folder: &PathBuf| {
        std::fs::metadata(folder).is_ok_and(|found| found.is_dir() && found.uid() == user.as_raw())
    };
    let folder = match runtime.filter(own) {
        Some(folder) => folder,
        None if user.is_root() => PathBuf::from("/run"),
        None => std::env::temp_dir().join(format!("isocat-{}", user.as_raw())),
    };
    folder.join(file_of(interface))
}

/// The socket of the service that runs on an interface: [`path_of`] for this user, or root's.
pub fn find(interface: &str) -> PathBuf {
    let own = path_of(interface);
    let root = Path::new("/run").join(file_of(interface));
    if !own.exists() && root.exists() { root } else { own }
}

/// As [`find`] for an interface, or for the name that `--setup-veth` was given.
pub fn find_served(name: &str) -> PathBuf {
    let path = find(name);
    let veth = find(&isocat_host::Veth::segment_end_of(name));
    if !path.exists() && veth.exists() { veth } else { path }
}

/// Whether a service answers at this socket.
pub fn is_served(path: &Path) -> bool {
    connect(path, Instant::now() + WAITS.client, &AtomicBool::new(false)).is_ok()
}

fn file_of(interface: &str) -> String {
    format!("isocat-{interface}.sock")
}

/// Checks that no other user can replace the socket in its folder: the owner must be this user or
/// root, and others must not be able to write, or not to remove files of others.
fn check_folder(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    // A link could lead to any place that its owner chooses.
    let found = std::fs::symlink_metadata(folder)?;
    let (owner, me) = (found.uid(), rustix::process::geteuid().as_raw());
    let mode = found.mode();
    let shared = mode & 0o022 != 0 && mode & 0o1000 == 0;
    if !found.is_dir() || !is_trusted(owner, me) || shared {
        let folder = folder.display();
        return Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            format!(
                "the folder {folder} is not safe: expected one of user {me} or root that others can't write to, found \
                 one of user {owner} with mode {:o}",
                mode & 0o7777
            ),
        ));
    }
    Ok(())
}

/// Whether this is the user `me` or root.
fn is_trusted(user: u32, me: u32) -> bool {
    user == 0 || user == me
}

/// Refuses the socket at `path` of the user `owner`, unless that is the user `me` or root.
fn check_owner(path: &Path, owner: u32, me: u32) -> io::Result<()> {
    if is_trusted(owner, me) {
        return Ok(());
    }
    Err(io::Error::new(
        io::ErrorKind::PermissionDenied,
        format!(
            "{} belongs to user {owner}; expected user {me} or root (another user's socket is not asked)",
            path.display()
        ),
    ))
}

impl Requests {
    /// Listens, and lets signals (SIGINT, SIGTERM, SIGHUP) end the service. Returns the socket that
    /// wakes it.
    pub fn listen(path: &Path) -> io::Result<(Self, UnixStream)> {
        Self::listen_with(path, WAITS)
    }

    fn listen_with(path: &Path, waits: Waits) -> io::Result<(Self, UnixStream)> {
        let own = path.parent().filter(|folder| folder.parent() == Some(&*std::env::temp_dir()));
        if let Some(folder) = own.filter(|folder| !folder.exists()) {
            std::fs::DirBuilder::new().mode(0o700).create(folder)?;
        }
        check_folder(path)?;
        if is_served(path) {
            let message = "another isocat serves there already";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, message));
        }
        // The socket is left over from a process that could not clean up; no service answers there.
        let _ = std::fs::remove_file(path);
        let listener = UnixListener::bind(path)?;
        let (wake, waker) = UnixStream::pair()?;
        // A full pipe wakes the service as well as another byte would.
        waker.set_nonblocking(true)?;
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in signal_hook::consts::TERM_SIGNALS {
            if *signal == signal_hook::consts::SIGQUIT {
                continue;
            }
            signal_hook::flag::register(*signal, signalled.clone())?;
            signal_hook::low_level::pipe::register(*signal, waker.try_clone()?)?;
        }
        let (sender, receiver) = channel();
        std::thread::Builder::new()
            .name("control".into())
            .spawn(move || attend_all(&listener, &sender, &waker, waits))?;
        Ok((Self { receiver, signalled, path: path.to_owned() }, wake))
    }

    /// Whether a signal has asked the service to end.
    pub(crate) fn signalled(&self) -> bool {
        self.signalled.load(Ordering::Relaxed)
    }

    /// Answers all waiting requests.
    pub fn answer(&self, mut how: impl FnMut(&str) -> String) {
        while let Ok((request, reply)) = self.receiver.try_recv() {
            let answer = how(&request);
            // The client may have disconnected and needs no answer.
            let _ = reply.send(answer);
        }
    }
}

impl Drop for Requests {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

fn attend_all(
    listener: &UnixListener,
    sender: &Sender<(String, Sender<String>)>,
    waker: &UnixStream,
    waits: Waits,
) {
    let mut clients: VecDeque<Weak<UnixStream>> = VecDeque::new();
    for client in listener.incoming() {
        let Ok(client) = client else {
            // For example, there are no free descriptors: wait before the next try.
            std::thread::sleep(SLICE);
            continue;
        };
        // The thread of a finished client has closed its socket.
        clients.retain(|client| client.strong_count() > 0);
        if clients.len() >= limits::CONTROL_CLIENTS
            && let Some(oldest) = clients.pop_front().and_then(|oldest| oldest.upgrade())
        {
            // The client's thread then reads an end of file.
            let _ = oldest.shutdown(std::net::Shutdown::Both);
        }
        let client = Arc::new(client);
        let Ok(waker) = waker.try_clone() else { continue };
        clients.push_back(Arc::downgrade(&client));
        let sender = sender.clone();
        // If no thread can be started, the client is closed at once.
        let _ = std::thread::Builder::new().name("client".into()).spawn(move || {
            // Errors of a client do not concern the service.
            let _ = attend(&client, &sender, &waker, waits);
        });
    }
}

fn attend(
    client: &UnixStream,
    sender: &Sender<(String, Sender<String>)>,
    mut waker: &UnixStream,
    waits: Waits,
) -> io::Result<()> {
    let never = AtomicBool::new(false);
    let until = Instant::now() + waits.client;
    let request = read(client, limits::CONTROL_REQUEST, true, until, &never)?;
    let (reply, answer) = channel();
    let gone = || io::Error::other("the service is gone");
    sender.send((request.trim().to_owned(), reply)).map_err(|_| gone())?;
    match waker.write_all(b"r") {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
        written => written?,
    }
    let answer = answer.recv_timeout(waits.answer).map_err(|_| gone())? + "\n";
    write(client, answer.as_bytes(), Instant::now() + waits.client, &never)
}

/// Sends a request to a service and returns its answer, at most 64 MiB and within seven seconds.
pub fn request(path: &Path, request: &str) -> io::Result<String> {
    self::request_until(path, request, &AtomicBool::new(false))
}

/// As [`request`], but ends at once when `stop` is set.
pub fn request_until(path: &Path, request: &str, stop: &AtomicBool) -> io::Result<String> {
    request_with(path, request, stop, WAITS)
}

fn request_with(path: &Path, request: &str, stop: &AtomicBool, waits: Waits) -> io::Result<String> {
    let until = Instant::now() + waits.service();
    let stream = connect(path, until, stop)?;
    write(&stream, format!("{request}\n").as_bytes(), until, stop)?;
    read(&stream, limits::CONTROL_ANSWER, false, until, stop)
}

/// Connects to a service of this user or of root.
fn connect(path: &Path, until: Instant, stop: &AtomicBool) -> io::Result<UnixStream> {
    let me = rustix::process::geteuid().as_raw();
    check_owner(path, std::fs::symlink_metadata(path)?.uid(), me)?;
    check_folder(path)?;
    let address = SocketAddrUnix::new(path)?;
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    loop {
        match rustix::net::connect(&socket, &address) {
            Ok(()) => break,
            // The queue of the service is full: it may be busy, or may never accept a client.
            Err(rustix::io::Errno::AGAIN) => wait(until, stop)?,
            Err(error) => return Err(error.into()),
        }
    }
    // The owner of the listening process, which may differ from that of the file.
    check_owner(path, rustix::net::sockopt::socket_peercred(&socket)?.uid.as_raw(), me)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}

/// Waits a little, unless the time is over.
fn wait(until: Instant, stop: &AtomicBool) -> io::Result<()> {
    std::thread::sleep(left(until, stop)?);
    Ok(())
}

/// The length of one wait.
fn left(until: Instant, stop: &AtomicBool) -> io::Result<Duration> {
    if stop.load(Ordering::Relaxed) {
        return Err(io::Error::new(io::ErrorKind::Interrupted, "interrupted"));
    }
    let left = until.saturating_duration_since(Instant::now());
    match left.is_zero() {
        true => Err(io::Error::new(io::ErrorKind::TimedOut, "the other end is too slow")),
        false => Ok(left.min(SLICE)),
    }
}

fn is_timeout(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}

/// Reads a line, or everything, of limited length within a limited time, even if it arrives byte by
/// byte.
fn read(
    mut stream: &UnixStream,
    most: usize,
    line: bool,
    until: Instant,
    stop: &AtomicBool,
) -> io::Result<String> {
    let mut read = Vec::new();
    let mut bytes = [0; 16 * 1024];
    loop {
        stream.set_read_timeout(Some(left(until, stop)?))?;
        let count = match stream.read(&mut bytes) {
            Ok(0) if line => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(0) => break,
            Ok(count) => count,
            Err(error) if is_timeout(&error) => continue,
            Err(error) => return Err(error),
        };
        read.extend_from_slice(&bytes[..count]);
        if line && let Some(end) = read.iter().position(|byte| *byte == b'\n') {
            read.truncate(end);
            break;
        }
        if read.len() > most {
            let message = format!("more than {most} bytes were received; expected {most} or fewer");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
    }
    String::from_utf8(read).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// Writes everything within a limited time.
fn write(
    mut stream: &UnixStream,
    mut bytes: &[u8],
    until: Instant,
    stop: &AtomicBool,
) -> io::Result<()> {
    while !bytes.is_empty() {
        stream.set_write_timeout(Some(left(until, stop)?))?;
        match stream.write(bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => bytes = &bytes[count..],
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
