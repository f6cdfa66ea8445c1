use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use isocat_descriptions::limits;
use isocat_engine::status::{Error, Host, Kind, Margin};

use super::*;

/// A segment of two devices, with figures that are easy to find.
fn status() -> Status {
    let mut status = Status::new("a \"b\"\\c.toml".into(), Kind::Simulated, 1_000_000, 1_000);
    status.stage = isocat_engine::status::Stage::InOperation;
    (status.at_ns, status.operation_ns) = (2_500_000_000, Some(2_000_000_000));
    status.host = Host {
        phase_error_ns: Some(-1_500.0),
        servo: Some(isocat_sync::phase::State::Locked),
        rate_ppm: Some(-47.0),
        frames_sent: 1234,
        frames_lost: 5,
        ..Host::default()
    };
    for (position, name) in ["axis", "io"].into_iter().enumerate() {
        let mut device = Device::new(position, name.to_owned());
        device.mode = if position == 0 { "dc-sync0" } else { "free-run" }.into();
        device.has_sync = position == 0;
        device.al_state = Some(isocat_wire::AlState::Op);
        status.devices.push(device);
    }
    let axis = &mut status.devices[0];
    axis.error = Some(Error { now_ns: -12.0, recent_ns: None, worst_ns: 34.0, count: 7 });
    axis.margin = Some(Margin { now_ns: 438_000.0, least_ns: 437_000.0 });
    axis.clock_ppm = Some(50.0);
    axis.outputs[0].value = Some(3);
    axis.outputs[0].risen = 6;
    axis.alarms.push("clock off".into());
    status
}

fn says(text: &str, line: &str) {
    assert!(text.lines().any(|l| l == line), "no line {line:?} in\n{text}");
}

#[test]
fn figures_in_base_units_with_labels() {
    let text = text(&status());
    let version = env!("CARGO_PKG_VERSION");
    says(
        &text,
        &format!(
            "isocat_info{{version=\"{version}\",segment=\"a \\\"b\\\"\\\\c.toml\",kind=\"simulated\"}} 1"
        ),
    );
    says(&text, "# TYPE isocat_frames_lost_total counter");
    says(&text, "isocat_frames_lost_total 5");
    says(&text, "isocat_host_phase_error_seconds -0.0000015");
    says(&text, "isocat_servo_state{state=\"locked\"} 1");
    says(&text, "isocat_servo_state{state=\"holdover\"} 0");
    let axis = "position=\"0\",device=\"axis\",mode=\"dc-sync0\"";
    says(&text, "# TYPE isocat_sync0_error_seconds gauge");
    says(&text, &format!("isocat_sync0_error_seconds{{{axis},source=\"true time\"}} -0.000000012"));
    says(&text, &format!("isocat_sync0_margin_seconds{{{axis},source=\"true time\"}} 0.000438"));
    says(&text, &format!("isocat_clock_deviation_ratio{{{axis}}} 0.00005"));
    says(&text, &format!("isocat_sync_entry{{{axis},object=\"0x1C32:0B\"}} 3"));
    says(&text, &format!("isocat_sync_entry_risen_total{{{axis},object=\"0x1C32:0B\"}} 6"));
    says(&text, &format!("isocat_alarm{{{axis},alarm=\"clock off\"}} 1"));
    says(&text, "isocat_in_sync 0");
    says(&text, "isocat_al_state{position=\"1\",device=\"io\",mode=\"free-run\"} 8");
    // An unknown figure has no sample, and a family without samples is omitted.
    assert!(!text.contains("isocat_sync0_error_recent_seconds"));
    assert!(!text.contains("isocat_sync0_error_seconds{position=\"1\""));
    // Each family has its two lines, and each name occurs once.
    let types: Vec<_> = text.lines().filter(|line| line.starts_with("# TYPE")).collect();
    let helps = text.lines().filter(|line| line.starts_with("# HELP")).count();
    let mut names = types.clone();
    names.sort_unstable();
    names.dedup();
    assert_eq!((helps, names.len()), (types.len(), types.len()));
    assert!(types.iter().all(|line| line.contains("_total ") == line.ends_with(" counter")));
}

#[test]
fn addresses() {
    assert_eq!(address("9464"), Ok("127.0.0.1:9464".parse().expect("an address")));
    assert_eq!(address("[::1]:80"), Ok("[::1]:80".parse().expect("an address")));
    for wrong in ["", "localhost", "65536", "1.2.3.4", ":80", "-1"] {
        assert!(address(wrong).is_err_and(|why| why.contains("expected a port")), "{wrong}");
    }
}

/// A patience that never ends within a test. A client that waits for another one makes its test
/// hang, which is seen, and no machine is so slow that a request is given up.
const FOR_EVER: Duration = Duration::from_secs(3_600);

/// A server on the loopback; `None`, with a word, on a machine without one.
fn server() -> Option<Server> {
    server_with(FOR_EVER)
}

fn server_with(patience: Duration) -> Option<Server> {
    let address = "127.0.0.1:0".parse().expect("an address");
    let server =
        Server::listen_for(address, Page::default(), patience, |page| page.text()).expect("a port");
    match TcpStream::connect(server.address()) {
        Ok(_) => Some(server),
        Err(error) if error.kind() == std::io::ErrorKind::NetworkUnreachable => {
            println!("skipped: there is no loopback: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn ask(address: SocketAddr, request: &str) -> String {
    let mut client = TcpStream::connect(address).expect("it listens");
    client.write_all(request.as_bytes()).expect("it reads");
    let mut answer = String::new();
    // A server that has not read the whole request may reset the connection after its answer.
    let _ = client.read_to_string(&mut answer);
    answer
}

#[test]
fn one_page_and_nothing_else() {
    let Some(server) = server() else { return };
    let get = |path: &str| {
        ask(server.address(), &format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"))
    };
    assert!(get("/metrics").starts_with("HTTP/1.1 503 "), "nothing is known yet");
    server.page().show(&status());
    let answer = get("/metrics");
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    assert!(answer.contains("Content-Type: text/plain; version=0.0.4; charset=utf-8\r\n"));
    let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
    assert!(head.contains(&format!("Content-Length: {}\r\n", body.len())));
    assert_eq!(body, text(&status()));
    assert!(get("/metrics?x=1").starts_with("HTTP/1.1 200 "));
    for elsewhere in ["/", "/metrics/", "/metricsx", "/favicon.ico", "//metrics"] {
        assert!(get(elsewhere).starts_with("HTTP/1.1 404 "), "{elsewhere}");
    }
    let post = ask(server.address(), "POST /metrics HTTP/1.1\r\nContent-Length: 0\r\n\r\n");
    assert!(post.starts_with("HTTP/1.1 405 "), "{post}");
    let head = ask(server.address(), "HEAD /metrics HTTP/1.1\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200 ") && head.ends_with("\r\n\r\n"), "{head}");
}

#[test]
fn nonsense_is_answered_and_too_much_of_it_cut_off() {
    let Some(server) = server() else { return };
    assert!(ask(server.address(), "\u{1}\u{2}\r\n\r\n").starts_with("HTTP/1.1 400 "));
    assert!(ask(server.address(), "GET /metrics\r\n\r\n").starts_with("HTTP/1.1 400 "));
    let long = format!("GET /metrics HTTP/1.1\r\nX: {}", "x".repeat(20_000));
    assert!(ask(server.address(), &long).starts_with("HTTP/1.1 431 "));
}

/// Clients that send nothing may take an hour each. The next client is served nevertheless, and
/// those beyond the limit are refused until one of the first is gone.
#[test]
fn slow_clients_hold_up_nobody() {
    let Some(server) = server() else { return };
    server.page().show(&status());
    let request = "GET /metrics HTTP/1.1\r\n\r\n";
    let connect = || TcpStream::connect(server.address()).expect("it listens");
    let served = || ask(server.address(), request).starts_with("HTTP/1.1 200 ");
    // A client that is refused is disconnected; one with a place has all its time.
    let waits = |client: &mut TcpStream| {
        client.set_nonblocking(true).expect("a socket");
        let read = client.read(&mut [0; 1]).map_err(|error| error.kind());
        read == Err(std::io::ErrorKind::WouldBlock)
    };
    let mut silent: Vec<_> = (1..limits::HTTP_CLIENTS).map(|_| connect()).collect();
    // One place is left, as soon as the client that tried the loopback is gone.
    while !served() {}
    silent.push(loop {
        // The place of the client before is free a moment after its answer. Clients are looked at
        // in their order: behind the next one it is settled whether this one has the place.
        let mut last = connect();
        served();
        if waits(&mut last) {
            break last;
        }
    });
    for _ in 0..limits::HTTP_CLIENTS {
        assert_eq!(ask(server.address(), request), "", "there are more clients than the limit");
    }
    drop(silent.swap_remove(0));
    while !served() {}
    assert!(silent.iter_mut().all(waits), "a client with time is kept");
}

/// A client that sends nothing, or too little, is disconnected when its time is over.
#[test]
fn a_client_that_says_nothing_is_left() {
    let Some(server) = server_with(Duration::from_millis(1)) else { return };
    for sent in ["", "GET /metr"] {
        // Its time may be over for the answer as well, and what was not read yet resets the
        // connection.
        let answer = ask(server.address(), sent);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 408 "), "{answer}");
    }
}

#[test]
fn a_port_in_use_is_an_error() {
    let Some(first) = server() else { return };
    let second = Server::listen(first.address());
    assert!(second.is_err_and(|error| error.kind() == std::io::ErrorKind::AddrInUse));
}
