//! A server for one page.
//!
//! Each client has a thread during its request, for at most two seconds, whatever it sends. Clients
//! beyond the limit are refused.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use isocat_descriptions::limits;
use isocat_engine::status::Status;

/// Answers Prometheus as long as the program runs.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    page: Page,
}

/// The status on the page.
#[derive(Clone, Debug, Default)]
pub struct Page(Arc<Mutex<Option<Status>>>);

/// Time limit of a request and its answer.
const PATIENCE: Duration = Duration::from_secs(2);

impl Page {
    /// Shows this status from now on.
    pub fn show(&self, status: &Status) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(status.clone());
    }

    pub(super) fn text(&self) -> Option<String> {
        let status = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        status.as_ref().map(super::text)
    }
}

impl Server {
    /// Listens at this address.
    pub fn listen(address: SocketAddr) -> io::Result<Self> {
        Self::listen_with(address, Page::default(), |page| page.text())
    }

    /// Listens at this address, and calls `text` for each request.
    pub fn listen_with(
        address: SocketAddr,
        page: Page,
        text: impl Fn(&Page) -> Option<String> + Send + Sync + 'static,
    ) -> io::Result<Self> {
        Self::listen_for(address, page, PATIENCE, text)
    }

    /// As [`Self::listen_with`], with another time limit than [`PATIENCE`] for a request.
    pub(super) fn listen_for(
        address: SocketAddr,
        page: Page,
        patience: Duration,
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
                    // The process may be out of descriptors, for example, so it does not retry at
                    // once.
                    std::thread::sleep(PAUSE);
                    continue;
                };
                if clients.fetch_add(1, Ordering::Relaxed) >= limits::HTTP_CLIENTS {
                    clients.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let (shown, text, served) = (shown.clone(), text.clone(), clients.clone());
                let spawned = std::thread::Builder::new().name("scrape".into()).spawn(move || {
                    // An error of the client does not concern the server.
                    let _ = attend(client, is_local, patience, || text(&shown));
                    served.fetch_sub(1, Ordering::Relaxed);
                });
                if spawned.is_err() {
                    clients.fetch_sub(1, Ordering::Relaxed);
                }
            }
        })?;
        Ok(Self { address, page })
    }

    /// Its address; if port 0 was requested, with the port that was found.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its page.
    pub fn page(&self) -> Page {
        self.page.clone()
    }
}

/// Pause after a failed accept.
const PAUSE: Duration = Duration::from_millis(100);

fn attend(
    mut client: TcpStream,
    is_local: bool,
    patience: Duration,
    text: impl Fn() -> Option<String>,
) -> io::Result<()> {
    let until = Instant::now() + patience;
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
    send(&mut client, &answer.bytes(), until + patience)
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// Sends all bytes, unless the client reads them too slowly.
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

/// The answer to a request.
struct Answer {
    code: u16,
    reason: &'static str,
    kind: &'static str,
    body: String,
    /// Whether only the head is sent, for a HEAD request.
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

/// The answer to a request; `None` while the request is not complete.
fn answer(request: &[u8], is_local: bool, text: impl Fn() -> Option<String>) -> Option<Answer> {
    let mut fields = [httparse::EMPTY_HEADER; limits::HTTP_FIELDS];
    let mut parsed = httparse::Request::new(&mut fields);
    match parsed.parse(request) {
        Ok(httparse::Status::Partial) => return None,
        Ok(httparse::Status::Complete(_)) => {}
        Err(_) => return Some(Answer::words(400, "Bad Request", "that is no HTTP request\n")),
    }
    // A foreign page may resolve its own host name to this machine, so that its browser sends
    // requests here with that name. If only this machine can connect, only its own names are
    // answered.
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

/// Whether a `Host` field has a loopback name of this machine, with any port or none.
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
            // An address that the network reaches may have any name.
            assert_eq!(code(false), 200, "{host}");
        }
        let twice = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n";
        assert_eq!(answer(twice, true, || None).expect("complete").code, 421);
    }
}
