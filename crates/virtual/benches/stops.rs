//! The cost of supervision: a program that does nothing, a call that stops its thread, a frame out
//! and back, and readings of the clock, which do not stop a thread. Where possible the same loops
//! also run without supervision, so that each run gives the ratio.
//!
//! The program is this bench itself: `stops --subject NAME COUNT`.
#![cfg_attr(not(all(target_os = "linux", target_arch = "x86_64")), allow(unused))]

#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match &arguments[..] {
        [_, flag, name, count] if flag == "--subject" => {
            subject::run(name, count.parse().expect("a number"));
        }
        _ => {
            let mut criterion = criterion::Criterion::default().configure_from_args();
            supervised::measure(&mut criterion);
            criterion.final_summary();
        }
    }
}

#[cfg(not(all(target_os = "linux", target_arch = "x86_64")))]
fn main() {}

#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod subject {
    use std::fs::File;
    use std::hint::black_box;
    use std::io::Write;
    use std::time::Instant;

    use isocat_host::RawSocket;

    pub fn run(name: &str, count: u32) {
        match name {
            "nothing" => {}
            "calls" => write_nothing(count),
            "clock" => (0..count).for_each(|_| {
                black_box(Instant::now());
            }),
            "frames" => exchange(count),
            other => panic!("there is no subject {other:?}"),
        }
    }

    /// A call that does almost nothing and stops its thread.
    fn write_nothing(count: u32) {
        let mut nowhere = File::create("/dev/null").expect("there is always room");
        for _ in 0..count {
            let written = nowhere.write(&[]).expect("nothing can be written");
            assert_eq!(written, 0);
        }
    }

    fn exchange(count: u32) {
        let mut socket = RawSocket::open("vt0", None).expect("a packet socket");
        let mut frame = [0xFF; 60];
        frame[12..14].copy_from_slice(&[0x88, 0xA4]);
        let mut buffer = [0; 1514];
        for _ in 0..count {
            socket.send(&frame).expect("it is sent");
            while socket.receive(&mut buffer).expect("the link is up").is_none() {}
        }
    }
}

#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod supervised {
    use std::ffi::OsString;
    use std::process::Command;
    use std::sync::Arc;

    use criterion::{Criterion, Throughput};
    use isocat_virtual::kernel::{Costs, Luck, MachineFault};
    use isocat_virtual::supervisor::{self, Options, Program};
    use isocat_virtual::{Wire, WireAnswer};
    use isocat_wire::time::{Host, Nanos, Time};

    /// Number of repetitions of each subject.
    const COUNT: u32 = 20_000;

    /// Each frame comes back unchanged after 7 us.
    struct Echo;

    impl Wire for Echo {
        fn send(
            &mut self,
            interface: usize,
            at: Time<Host>,
            frame: &[u8],
            answers: &mut Vec<WireAnswer>,
        ) {
            answers.push(WireAnswer { at: at + Nanos(7_000), interface, bytes: frame.to_vec() });
        }
        fn advance(&mut self, _: Time<Host>) {}
        fn next_timeout(&self, _: Time<Host>) -> Option<Time<Host>> {
            None
        }
        fn take_machine_faults(&mut self) -> Vec<MachineFault> {
            Vec::new()
        }
    }

    pub fn measure(criterion: &mut Criterion) {
        let test = std::env::current_exe().expect("a bench has a binary");
        let words = |name: &str, count: u32| ["--subject".into(), name.into(), count.to_string()];
        let run = |name: &str, count: u32| {
            let arguments = words(name, count).map(OsString::from);
            let program =
                Program::find(test.as_os_str(), &arguments).expect("this binary runs here");
            let options = Options {
                interfaces: vec!["vt0".into()],
                costs: Costs::default(),
                luck: Luck::default(),
                limit: None,
                stop: Arc::default(),
            };
            supervisor::run(&program, &options, &mut Echo)
        };
        if let Err(error) = run("nothing", 0) {
            println!("skipped: {error}");
            return;
        }
        let alone = |name: &str, count: u32| {
            let status = Command::new(&test).args(words(name, count)).status();
            assert!(status.expect("it runs").success());
        };
        let mut group = criterion.benchmark_group("supervision");
        group.sample_size(10);
        group.bench_function("start and end, supervised", |b| b.iter(|| run("nothing", 0)));
        group.bench_function("start and end, alone", |b| b.iter(|| alone("nothing", 0)));
        group.throughput(Throughput::Elements(COUNT.into()));
        for name in ["calls", "clock", "frames"] {
            group.bench_function(format!("{name}, supervised"), |b| b.iter(|| run(name, COUNT)));
            // Without supervision there is no interface to send to.
            if name != "frames" {
                group.bench_function(format!("{name}, alone"), |b| b.iter(|| alone(name, COUNT)));
            }
        }
        group.finish();
    }
}
