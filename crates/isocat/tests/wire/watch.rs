//! What the live view shows, held against itself and against a run: nothing between two statuses is
//! missed, and filling one takes no memory. Then the command at both ends of a wire, where
//! namespaces can be had.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use isocat::status::{Board, Kind, Scribe, Status};
use isocat::watch::Source;
use isocat::watch::source::Speed;
use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::World;
use isocat_wire::time::{Picos, Time};

fn scenario() -> Scenario {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.operation.quality.get_or_insert_default();
    scenario
}

/// Statuses up to a time of the segment.
fn statuses(scenario: Scenario, until_ns: i64, look_at: Option<usize>) -> Vec<Status> {
    let source = Source::simulated(scenario, Speed::Max, Arc::new(AtomicBool::new(false)));
    source.look_at(look_at);
    let (mut all, began) = (Vec::new(), Instant::now());
    loop {
        match source.take() {
            Some(status) => all.push(status),
            None => std::thread::sleep(Duration::from_millis(1)),
        }
        let last: Option<&Status> = all.last();
        if last.is_some_and(|status| status.at_ns >= until_ns || status.has_ended()) {
            source.end();
            return all;
        }
        assert!(began.elapsed() < Duration::from_secs(120), "no status comes: {last:?}");
    }
}

/// The largest of late, taken together, is the largest in operation: no edge falls between two
/// statuses. The judges of a run of that length find the same.
#[test]
fn no_edge_is_missed() {
    let all = statuses(scenario(), 4_000_000_000, None);
    for pair in all.windows(2) {
        assert_eq!(pair[1].since_ns, pair[0].at_ns.max(pair[1].since_ns), "a hole");
        assert_eq!(pair[1].at_ns - pair[0].at_ns, 100_000_000);
    }
    let last = all.last().expect("some");
    assert!(last.in_operation() && last.verdict().good, "{:?}", last.verdict());
    for device in last.devices.iter().filter(|device| device.has_sync) {
        let errors = all.iter().filter_map(|status| status.devices[device.position].error);
        let recent = errors.clone().filter_map(|error| error.recent_ns).fold(0.0, f64::max);
        let error = device.error.expect("it has SYNC");
        assert_eq!(recent, error.worst_ns, "{}", device.name);
        assert!(error.worst_ns > 0.0 && error.count > 3_000, "{error:?}");
        assert!(errors.clone().all(|error| error.now_ns.abs() <= error.worst_ns));
        let margins = all.iter().filter_map(|status| status.devices[device.position].margin);
        let least = margins.map(|margin| margin.now_ns).fold(f64::INFINITY, f64::min);
        let margin = device.margin.expect("it has SYNC");
        assert!(least >= margin.least_ns && margin.least_ns > 400_000.0, "{least} {margin:?}");
    }
    let mut same = scenario();
    same.duration = isocat::Nanos(last.operation_ns.expect("in operation"));
    let report = isocat::run(&same);
    for (device, reported) in last.devices.iter().zip(&report.devices) {
        let reported = reported.true_time.sync0_error.as_ref();
        let figures = device.error.map(|error| (error.worst_ns, error.count));
        assert_eq!(figures, reported.map(|error| (error.worst_ns, error.count)), "{}", device.name);
    }
    // The run reads its counters once more when it is over.
    let frames = report.segment.main_device.frames_sent - last.host.frames_sent;
    assert!(frames < 100, "{frames} frames more");
}

/// What is seen of a cycle lies within what was planned for it.
#[test]
fn a_cycle_that_is_looked_at_is_seen_where_it_was_planned() {
    let all = statuses(scenario(), 3_000_000_000, Some(1));
    let last = all.last().expect("some");
    assert!(last.devices[0].moments.iter().all(|moment| moment.seen_ns.is_none()), "not looked at");
    let moments = &last.devices[1].moments;
    let seen: Vec<_> =
        moments.iter().filter_map(|moment| Some((moment, moment.seen_ns?))).collect();
    assert!(seen.len() >= 5, "{moments:?}");
    for (moment, (from, to)) in seen {
        let planned = moment.earliest_ns as f64..=moment.latest_ns as f64;
        assert!(planned.contains(&from) && planned.contains(&to), "{moment:?}");
    }
}

/// What is told on the way up comes as it happens, and a way up that fails says why.
#[test]
fn the_way_up_is_told() {
    let all = statuses(scenario(), 2_000_000_000, None);
    let told: Vec<&str> =
        all.iter().flat_map(|status| &status.events).map(|event| &*event.what).collect();
    for what in ["stage scan", "PREOP", "stage SYNC", "SAFEOP", "OP", "all in OP: in operation"] {
        assert!(told.contains(&what), "{what} is not among {told:?}");
    }
    let short = "cycle = \"125us\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";
    let file = SegmentFile::parse("short.toml", short).expect("a segment");
    let all = statuses(Scenario::from(file), 60_000_000_000, None);
    let last = all.last().expect("some");
    assert!(last.has_ended() && !last.verdict().good);
    assert!(last.failure.as_ref().is_some_and(|why| why.contains("0x1C32:05")), "{last:?}");
}

/// The loop of a real wire fills the board in its cycles: that takes no memory, whether somebody
/// looks or not.
#[test]
fn filling_the_board_allocates_nothing() {
    let setup = Scenario::from(SegmentFile::built_in()).run().setup;
    let board = Board::new(Status::new("x".into(), Kind::Wire, 1_000_000, 1_000));
    let mut scribe = Scribe::new(board.clone(), &setup.config);
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    let at = |world: &World<Motion, NoTap>| world.now().as_nanos() as i64;
    let limit = Time::new(20_000_000_000_000);
    'up: loop {
        assert!(world.step(limit), "the segment does not come up");
        while let Some(event) = world.poll_event() {
            scribe.event(at(&world), &event);
            if matches!(event, Event::InOperation { .. }) {
                break 'up;
            }
        }
    }
    let mut run = |looks: bool| {
        let end = world.now() + Picos(50_000_000_000);
        while world.step(end) {
            while let Some(event) = world.poll_event() {
                scribe.event(at(&world), &event);
            }
            scribe.cycle(world.main());
            assert!(scribe.publish(at(&world), world.main(), |_, _| {}));
        }
        looks.then(|| board.take())
    };
    // Buffers find their size.
    run(true);
    run(true);
    let before = run(true).flatten().expect("filled").host.cycles;
    let unseen = allocation_counter::measure(|| drop(run(false)));
    assert_eq!(unseen.count_total, 0, "{unseen:?}");
    // The counter works: every reader takes a copy.
    let looked = allocation_counter::measure(|| drop(run(true)));
    assert!(looked.count_total > 0);
    let after = run(true).flatten().expect("filled").host.cycles;
    assert!(after >= before + 140, "{before} {after}");
}

#[cfg(target_os = "linux")]
mod wire {
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::process::{Child, Command, Output, Stdio};

    use super::*;

    fn isocat() -> Command {
        Command::new(env!("CARGO_BIN_EXE_isocat"))
    }

    /// Ended, and its namespace with it, when dropped.
    struct Running(Child);

    impl Drop for Running {
        fn drop(&mut self) {
            if let Some(pid) = rustix::process::Pid::from_raw(self.0.id() as i32) {
                // It may have ended by itself.
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
            }
            let _ = self.0.wait();
        }
    }

    fn text(bytes: &[u8]) -> String {
        String::from_utf8_lossy(bytes).into_owned()
    }

    fn gate(arguments: &[&str]) -> Output {
        let gate = ["--plain", "--until", "1us", "--for", "2s", "--within", "30s"];
        isocat().arg("watch").args(arguments).args(gate).output().expect("it starts")
    }

    fn metrics(port: u16) -> String {
        let mut client = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
        client.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").expect("it reads");
        let mut answer = String::new();
        client.read_to_string(&mut answer).expect("it answers");
        answer
    }

    /// A segment is served on one end of a wire and run by `watch --interface` on the other: both
    /// say that it is in sync, one by registers, the other in true time.
    #[test]
    fn both_ends_of_a_wire_are_watched() {
        let _alone = crate::alone::alone();
        let name = "ic-watch";
        let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
        let file = folder.join("watch.toml");
        let devices = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 2\n";
        std::fs::write(&file, format!("cycle = \"10ms\"\n{devices}")).expect("a scratch file");
        let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr());
        let port = port.expect("a free port").port();
        let mut served = isocat()
            .args(["serve", "--setup-veth", name, "--metrics", &port.to_string()])
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map(Running)
            .expect("it starts");
        std::thread::sleep(Duration::from_millis(1500));
        if served.0.try_wait().expect("it is ours").is_some() {
            eprintln!("skipped: it needs root and the command ip");
            return;
        }
        let file = file.to_str().expect("UTF-8");
        let interface = ["--interface", name, "--netns", name, file];
        let mut why = String::new();
        for _ in 0..4 {
            let alone = gate(&interface);
            why = text(&alone.stderr);
            if alone.status.code() != Some(0) {
                eprintln!("the machine stalls: {why}");
                continue;
            }
            assert!(
                why.contains("2 SubDevices with SYNC within 1 us for 2 s") && why.contains("[r]"),
                "{why}"
            );
            let mut run = isocat();
            run.arg("watch").args(interface).arg("--plain").stdout(Stdio::null());
            let main = Running(run.stderr(Stdio::null()).spawn().expect("it starts"));
            let beside = gate(&["--serve", name]);
            why = text(&beside.stderr);
            if beside.status.code() != Some(0) {
                eprintln!("the machine stalls: {why}");
                continue;
            }
            assert!(
                why.contains("2 SubDevices with SYNC within 1 us for 2 s") && why.contains("[t]"),
                "{why}"
            );
            let lines = text(&beside.stdout);
            assert!(lines.contains(" in sync  2 of 2 in OP  error at most "), "{lines}");
            let metrics = metrics(port);
            assert!(metrics.starts_with("HTTP/1.1 200 OK"), "{metrics}");
            for sample in [
                "isocat_in_operation 1",
                "isocat_sync0_error_seconds{position=\"1\"",
                "kind=\"served\"",
            ] {
                assert!(metrics.contains(sample), "no {sample} in\n{metrics}");
            }
            drop(main);
            return;
        }
        eprintln!("skipped: this machine stalls all the time: {why}");
    }
}
