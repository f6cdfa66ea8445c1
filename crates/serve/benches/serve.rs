//! How long an answer of a served segment takes, and its parts: the frame of one cycle (FRMW, LRW,
//! BRD) through N SubDevices in OP. The work of SubDevices between two frames is done before the
//! next frame, as the service does it in the pause, and is counted separately.

#[cfg(target_os = "linux")]
mod linux {
    use std::time::{Duration, Instant};

    use criterion::{BenchmarkId, Criterion};
    use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
    use isocat_segment::{Scenario, SegmentFile};
    use isocat_serve::{Answer, Server, Setup};
    use isocat_wire::time::{Host, Nanos, Time};

    const CYCLE: Nanos = Nanos::millis(1);

    /// A server in OP, the present time, and the frames of a cycle.
    fn in_operation(devices: usize) -> (Server, Time<Host>, Vec<Vec<u8>>) {
        let text = format!(
            "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = {devices}\n"
        );
        let file = SegmentFile::parse("bench", &text).expect("a segment file");
        let mut now = Time::new(1_000_000_000);
        let mut server =
            Server::new(Setup::from(&Scenario::from(file)).without_process_data(), now);
        let mut main = MainDevice::new(Config::new(CYCLE), now);
        let mut buffer = [0; FRAME_LEN];
        let mut frames = Vec::new();
        loop {
            let mut cyclic = Vec::new();
            let mut back = Vec::new();
            while let Some(len) = main.poll_transmit(now, &mut buffer) {
                let mut bytes = buffer[..len].to_vec();
                // Frames with these indices are cyclic.
                if bytes[17] >= 0x80 {
                    cyclic.push(bytes.clone());
                }
                server.frame(now, &mut bytes);
                server.after(&bytes);
                now += Nanos::micros(30);
                back.push(bytes);
            }
            let idle = back.is_empty();
            for bytes in back {
                main.handle_frame(now, &bytes);
            }
            frames = if cyclic.is_empty() { frames } else { cyclic };
            while let Some(event) = main.poll_event() {
                match event {
                    Event::InOperation { .. } => return (server, now + CYCLE, frames),
                    Event::Failed(error) => panic!("{error}"),
                    _ => {}
                }
            }
            if !idle {
                continue;
            }
            now = now.max(main.next_timeout().expect("it goes on"));
            main.handle_timeout(now);
        }
    }

    /// This function is for callgrind: `--toggle-collect='*steady*'`.
    #[inline(never)]
    fn steady(server: &mut Server, now: Time<Host>, bytes: &mut [u8]) -> Answer {
        server.frame(now, bytes)
    }

    /// The work in the pause between two frames, as a function for callgrind.
    #[inline(never)]
    fn pause(server: &mut Server, to: Time<Host>) {
        server.catch_up(to);
    }

    pub fn answers(criterion: &mut Criterion) {
        for devices in [10, 100] {
            let (mut server, mut now, frames) = in_operation(devices);
            // One unmeasured round: the allocations of the first cycle in operation depend on the
            // heap after start-up.
            for frame in &frames {
                let mut bytes = frame.clone();
                server.frame(now, &mut bytes);
                server.after(&bytes);
                now += Nanos::micros(130);
            }
            server.catch_up(now + Nanos::micros(600));
            now += CYCLE;
            let mut group = criterion.benchmark_group("serve");
            for part in ["answer", "after", "pause"] {
                group.bench_function(BenchmarkId::new(part, devices), |bencher| {
                    bencher.iter_custom(|count| {
                        let mut spent = Duration::ZERO;
                        let mut timed = |which: &str, work: &mut dyn FnMut()| {
                            let begin = Instant::now();
                            work();
                            if which == part {
                                spent += begin.elapsed();
                            }
                        };
                        for _ in 0..count {
                            for frame in &frames {
                                let mut bytes = frame.clone();
                                timed("answer", &mut || {
                                    let answer = steady(&mut server, now, &mut bytes);
                                    assert!(matches!(answer, Answer::Back { hold: None, .. }));
                                });
                                timed("after", &mut || server.after(&bytes));
                                now += Nanos::micros(130);
                            }
                            timed("pause", &mut || pause(&mut server, now + Nanos::micros(600)));
                            while server.poll_event().is_some() {}
                            now += CYCLE;
                        }
                        spent
                    });
                });
            }
            group.finish();
        }
    }
}

#[cfg(target_os = "linux")]
criterion::criterion_group!(benches, linux::answers);
#[cfg(target_os = "linux")]
criterion::criterion_main!(benches);
#[cfg(not(target_os = "linux"))]
fn main() {}
