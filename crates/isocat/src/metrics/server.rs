//! A server for one page.
//!
//! Each client has a thread for as long as its request takes, two seconds at most, whatever it sends or does not send. With too
//! many of them at a time the next ones are sent away.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use isocat_descriptions::limits;
use isocat_engine::status::Status;

/// Answers for Prometheus as long as the program runs.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    page: Page,
}

/// The status that is shown.
#[derive(Clone, Debug, Default)]
pub struct Page(Arc<Mutex<Option<Status>>>);

/// For a request and its answer.
const PATIENCE: Duration = Duration::from_secs(2);

impl Page {
    /// Shows this from now on.
    pub fn show(&self, status: &Status) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(status.clone());
    }

    fn text(&self) -> Option<String> {
        let status = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        status.as_ref().map(super::text)
    }
}

impl Server {
    /// Listens there.
    pub fn listen(address: SocketAddr) -> io::Result<Self> {
        Self::listen_with(address, Page::default(), |page| page.text())
    }

    /// Listens there, and asks for the text of the page each time.
    pub fn listen_with(
        address: SocketAddr,
        page: Page,
        text: impl Fn(&Page) -> Option<String> + Send + Sync + 'static,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let is_local = address.ip().is_loopback();
        let shown = page.clone();
        let clients = Arc::new(AtomicUsize::new(0));
        let text = Arc::new(text);
        std::thread::Builder::new().name("metrics".into()).spawn(move || {
            for client in listener.incoming() {
                let Ok(client) = client else {
                    // Out of descriptors, say: not at once again.
                    std::thread::sleep(PAUSE);
                    continue;
                };
                if clients.fetch_add(1, Ordering::Relaxed) >= limits::HTTP_CLIENTS {
                    clients.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (shown, text, served) = (shown.clone(), text.clone(), clients.clone());
                let spawned = std::thread::Builder::new().name("scrape".into()).spawn(move || {
                    // Who hangs up or says nothing is its own trouble.
                    let _ = attend(client, is_local, || text(&shown));
                    served.fetch_sub(1, Ordering::Relaxed);
                });
                if spawned.is_err() {
                    clients.fetch_sub(1, Ordering::Relaxed);
                }
            }
        })?;
        Ok(Self { address, page })
    }

    /// Where it listens; with port 0 the one that was found.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What it shows.
    pub fn page(&self) -> Page {
        self.page.clone()
    }
}

/// After a client could not be taken.
const PAUSE: Duration = Duration::from_millis(100);

fn attend(
    mut client: TcpStream,
    is_local: bool,
    text: impl Fn() -> Option<String>,
) -> io::Result<()> {
    let until = Instant::now() + PATIENCE;
    let mut request = Vec::with_capacity(1024);
    let answer = loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break Answer::words(408, "Request Timeout", "too slow\n");
        }
        client.set_read_timeout(Some(left))?;
        let mut bytes = [0; 1024];
        let count = match client.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) if is_timeout(&error) => continue,
            Err(error) => return Err(error),
        };
        request.extend_from_slice(&bytes[..count]);
        match answer(&request, is_local, &text) {
            None if request.len() > limits::HTTP_REQUEST => {
                break Answer::words(431, "Request Header Fields Too Large", "too long\n");
            }
            None => {}
            Some(answer) => break answer,
        }
    };
    client.set_write_timeout(Some(PATIENCE))?;
    send(&mut client, &answer.bytes(), until + PATIENCE)
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// Sends it all, unless the client takes it too slowly.
fn send(client: &mut TcpStream, mut bytes: &[u8], until: Instant) -> io::Result<()> {
    while !bytes.is_empty() {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        client.set_write_timeout(Some(left))?;
        match client.write(bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// What goes back.
struct Answer {
    code: u16,
    reason: &'static str,
    kind: &'static str,
    body: String,
    /// Of a HEAD request only the head goes back.
    head_only: bool,
}

impl Answer {
    fn words(code: u16, reason: &'static str, body: &str) -> Self {
        let kind = "text/plain; charset=utf-8";
        Self { code, reason, kind, body: body.to_owned(), head_only: false }
    }

    fn bytes(&self) -> Vec<u8> {
        let Self { code, reason, kind, body, .. } = self;
        let length = body.len();
        let head = format!(
            "HTTP/1.1 {code} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
        );
        let body = if self.head_only { "" } else { body };
        [head.as_bytes(), body.as_bytes()].concat()
    }
}

/// The answer to a request; `None` while it is not complete.
fn answer(request: &[u8], is_local: bool, text: impl Fn() -> Option<String>) -> Option<Answer> {
    let mut fields = [httparse::EMPTY_HEADER; limits::HTTP_FIELDS];
    let mut parsed = httparse::Request::new(&mut fields);
    match parsed.parse(request) {
        Ok(httparse::Status::Partial) => return None,
        Ok(httparse::Status::Complete(_)) => {}
        Err(_) => return Some(Answer::words(400, "Bad Request", "that is no HTTP request\n")),
    }
    // A page of a foreign site may make its own name stand for this machine: then its browser asks here, with
    // that name. Where only this machine can ask, only its own names are answered.
    let hosts = parsed.headers.iter().filter(|field| field.name.eq_ignore_ascii_case("host"));
    if is_local && !hosts.into_iter().all(|field| is_loopback(field.value)) {
        let words = "expected localhost or a loopback address as Host\n";
        return Some(Answer::words(421, "Misdirected Request", words));
    }
    let path = parsed.path.unwrap_or_default().split('?').next().unwrap_or_default();
    let method = parsed.method.unwrap_or_default();
    Some(match (method, path) {
        ("GET" | "HEAD", "/metrics") => match text() {
            Some(body) => Answer {
                code: 200,
                reason: "OK",
                kind: "text/plain; version=0.0.4; charset=utf-8",
                body,
                head_only: method == "HEAD",
            },
            None => Answer::words(503, "Service Unavailable", "nothing is known yet\n"),
        },
        (_, "/metrics") => Answer::words(405, "Method Not Allowed", "GET only\n"),
        _ => Answer::words(404, "Not Found", "only /metrics is here\n"),
    })
}

/// Whether a `Host` field names this machine as only its own programs do, with any port or none.
fn is_loopback(host: &[u8]) -> bool {
    let Ok(host) = std::str::from_utf8(host) else { return false };
    let host = host.trim();
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((name, port)) if port.is_empty() || port.starts_with(':') => name,
        Some(_) => return false,
        None => host.split_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_are_answered() {
        for (host, expected) in [
            ("localhost", true),
            ("LocalHost:9464", true),
            ("127.0.0.1:9464", true),
            ("127.8.9.1", true),
            ("[::1]:9464", true),
            ("[::1]", true),
            ("128.0.0.1", false),
            ("[::2]:9464", false),
            ("[::1]evil.example", false),
            ("localhost.evil.example", false),
            ("evil.example:9464", false),
            ("127.0.0.1.evil.example", false),
            ("", false),
        ] {
            assert_eq!(is_loopback(host.as_bytes()), expected, "{host}");
            let request = format!("GET /metrics HTTP/1.1\r\nHost: {host}\r\n\r\n");
            let code = |is_local| {
                answer(request.as_bytes(), is_local, || Some(String::new())).expect("complete").code
            };
            assert_eq!(code(true), if expected { 200 } else { 421 }, "{host}");
            // An address that the network reaches has names that nobody here knows.
            assert_eq!(code(false), 200, "{host}");
        }
        let twice = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n";
        assert_eq!(answer(twice, true, || None).expect("complete").code, 421);
    }
}
