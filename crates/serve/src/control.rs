//! Requests to a service that runs: a socket in the file system, a line each way.
//!
//! The thread that listens hands each request to the service and wakes it; so nobody who connects and says
//! nothing can hold up a frame.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use super::service::PATIENCE;

/// Requests that wait for the service, and signals to it.
pub struct Requests {
    receiver: Receiver<(String, Sender<String>)>,
    signalled: Arc<AtomicBool>,
    path: PathBuf,
}

/// Longest request, bytes.
const LONGEST: u64 = 4096;
/// How long a client may take to say what it wants.
const CLIENT: Duration = Duration::from_secs(2);

/// Where the requests to the service of an interface go: below `XDG_RUNTIME_DIR`, else `/run` for root, else
/// the folder for temporary files.
pub fn path_of(interface: &str) -> PathBuf {
    let folder = match std::env::var_os("XDG_RUNTIME_DIR") {
        Some(folder) => PathBuf::from(folder),
        None if rustix::process::geteuid().is_root() => PathBuf::from("/run"),
        None => std::env::temp_dir(),
    };
    folder.join(file_of(interface))
}

/// Where somebody serves on an interface, whoever that is: [`path_of`] for this user, or for another.
pub fn find(interface: &str) -> PathBuf {
    let others = ["/run", "/tmp"].map(|folder| Path::new(folder).join(file_of(interface)));
    let mut all = std::iter::once(path_of(interface)).chain(others);
    all.find(|path| path.exists()).unwrap_or_else(|| path_of(interface))
}

/// As [`find`] for an interface, or for the name that `--setup-veth` was given.
pub fn find_served(name: &str) -> PathBuf {
    let path = find(name);
    let veth = find(&isocat_host::Veth::segment_end_of(name));
    if !path.exists() && veth.exists() { veth } else { path }
}

/// Whether somebody answers there.
pub fn is_served(path: &Path) -> bool {
    UnixStream::connect(path).is_ok()
}

fn file_of(interface: &str) -> String {
    format!("isocat-{interface}.sock")
}

impl Requests {
    /// Listens, and has signals (SIGINT, SIGTERM, SIGHUP) end the service. Gives what wakes it.
    pub fn listen(path: &Path) -> io::Result<(Self, UnixStream)> {
        if is_served(path) {
            let message = "another isocat serves there already";
            return Err(io::Error::new(io::ErrorKind::AddrInUse, message));
        }
        // Of a process that could not clean up; nobody answers there.
        let _ = std::fs::remove_file(path);
        let listener = UnixListener::bind(path)?;
        let (wake, waker) = UnixStream::pair()?;
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in signal_hook::consts::TERM_SIGNALS {
            if *signal == signal_hook::consts::SIGQUIT {
                continue;
            }
            signal_hook::flag::register(*signal, signalled.clone())?;
            signal_hook::low_level::pipe::register(*signal, waker.try_clone()?)?;
        }
        let (sender, receiver) = channel();
        std::thread::Builder::new().name("control".into()).spawn(move || {
            for client in listener.incoming() {
                // One that hangs up or misbehaves is its own trouble.
                let Ok(client) = client else { continue };
                let _ = attend(&client, &sender, &waker);
            }
        })?;
        Ok((Self { receiver, signalled, path: path.to_owned() }, wake))
    }

    /// Whether a signal has asked for the end.
    pub(crate) fn signalled(&self) -> bool {
        self.signalled.load(Ordering::Relaxed)
    }

    /// Answers all requests that wait.
    pub fn answer(&self, mut how: impl FnMut(&str) -> String) {
        while let Ok((request, reply)) = self.receiver.try_recv() {
            let answer = how(&request);
            // A client that went away does not want to know.
            let _ = reply.send(answer);
        }
    }
}

impl Drop for Requests {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

fn attend(
    client: &UnixStream,
    sender: &Sender<(String, Sender<String>)>,
    mut waker: &UnixStream,
) -> io::Result<()> {
    client.set_read_timeout(Some(CLIENT))?;
    client.set_write_timeout(Some(CLIENT))?;
    let mut lines = BufReader::new(client.take(LONGEST));
    let mut request = String::new();
    lines.read_line(&mut request)?;
    let (reply, answer) = channel();
    let gone = || io::Error::other("the service is gone");
    sender.send((request.trim().to_owned(), reply)).map_err(|_| gone())?;
    waker.write_all(b"r")?;
    let answer = answer.recv_timeout(PATIENCE).map_err(|_| gone())?;
    let mut client = client;
    client.write_all(answer.as_bytes())?;
    client.write_all(b"\n")
}

/// Sends a request to a service and gives its answer.
pub fn request(path: &Path, request: &str) -> io::Result<String> {
    let mut stream = UnixStream::connect(path)?;
    stream.set_read_timeout(Some(PATIENCE + CLIENT))?;
    stream.write_all(request.as_bytes())?;
    stream.write_all(b"\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer)
}
