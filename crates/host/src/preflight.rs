//! Reports what harms a real-time loop on this machine: settings, each with the file that shows it,
//! and a short measurement of wake-ups.
//!
//! Nothing is changed here. A file that cannot be read gives no finding.

use std::path::Path;

use isocat_wire::time::Nanos;

use super::clock;
use super::namespace::inside_or_here;
use super::{Histogram, LinkError, RawSocket, Wish};

/// A setting or measurement that harms the loop.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Finding {
    /// The problem, with its figures.
    pub what: String,
    /// The file from which it was read.
    pub source: String,
    /// Advice.
    pub advice: String,
}

/// The subject of the check.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// The interface; `None`: only the machine.
    pub interface: Option<&'a str>,
    /// Its network namespace.
    pub namespace: Option<&'a str>,
    /// The settings with which the loop will run.
    pub wish: Wish,
    /// Whether processors are kept out of deep sleep while the loop runs.
    pub keeps_awake: bool,
}

/// Reads the settings of this machine.
pub fn look(subject: Subject<'_>, socket: Option<&RawSocket>) -> Result<Vec<Finding>, LinkError> {
    let mut findings = inside_or_here(subject.namespace, || look_at(Path::new("/"), &subject))?;
    let gathered = socket.and_then(|socket| Some((socket.interface(), socket.coalescing()?)));
    if let Some((interface, gathered)) = gathered.filter(|(_, g)| g.adaptive || g.usecs > 0) {
        let how = match gathered.adaptive {
            true => "as long as its driver likes".to_owned(),
            false => format!("up to {} us", gathered.usecs),
        };
        findings.push(Finding {
            what: format!("{interface} waits {how} before it tells of a frame"),
            source: "ethtool -c (ioctl SIOCETHTOOL)".to_owned(),
            advice: format!("ethtool -C {interface} adaptive-rx off rx-usecs 0 tx-usecs 0"),
        });
    }
    Ok(findings)
}

/// Checks the files below `root`, which tests create.
fn look_at(root: &Path, subject: &Subject<'_>) -> Vec<Finding> {
    let files = Files { root };
    let mut findings = Vec::new();
    let mut harm = |what: String, source: &str, advice: &str| {
        let source = format!("/{source}");
        findings.push(Finding { what, source, advice: advice.to_owned() });
    };
    let online = cpus(&files.read(ONLINE).unwrap_or_default());
    let ours: Vec<usize> = subject.wish.cpu.map_or_else(|| online.clone(), |cpu| vec![cpu]);

    let preemption = files.read("proc/sys/kernel/version").unwrap_or_default();
    let real_time = files.read("sys/kernel/realtime").is_some_and(|text| text == "1")
        || preemption.contains("PREEMPT_RT");
    if !real_time && !preemption.is_empty() {
        harm(
            "the kernel is not built with PREEMPT_RT: it may delay a wake-up by milliseconds"
                .into(),
            "proc/sys/kernel/version",
            "install a real-time kernel (Debian: linux-image-rt-amd64)",
        );
    }
    let flags = files.read("proc/cpuinfo").unwrap_or_default();
    let mut flags = flags.lines().filter(|line| line.starts_with("flags"));
    if flags.any(|line| line.split_whitespace().any(|flag| flag == "hypervisor")) {
        harm(
            "this is a virtual machine: its host takes the processor away when it likes".into(),
            "proc/cpuinfo",
            "run on the machine itself, or pin and reserve the processors on the host",
        );
    }
    let governor = |cpu: &usize| {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
        files.read(&path).filter(|name| name != "performance").map(|name| (path, name))
    };
    if let Some((path, name)) = ours.iter().find_map(governor) {
        harm(
            format!("the processor's clock follows its load (governor {name})"),
            &path,
            "cpupower frequency-set -g performance",
        );
    }
    let deep = ours.iter().find_map(|cpu| files.deep_sleep(*cpu));
    if let Some((path, name, latency)) = deep.filter(|_| !subject.keeps_awake) {
        harm(
            format!("the processor may sleep so deeply that it wakes {latency} us later ({name})"),
            &path,
            "let isocat hold /dev/cpu_dma_latency (run as root), or cpupower idle-set -D 2",
        );
    }
    let isolated = files.read("sys/devices/system/cpu/isolated");
    if let Some(isolated) = isolated {
        let set = cpus(&isolated);
        match subject.wish.cpu {
            Some(cpu) if !set.contains(&cpu) => harm(
                format!("CPU {cpu} is not isolated: other programs and interrupts run there too"),
                "sys/devices/system/cpu/isolated",
                &format!("boot with isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu}"),
            ),
            None if set.is_empty() => harm(
                "no CPU is isolated, so other programs and interrupts share the loop's".into(),
                "sys/devices/system/cpu/isolated",
                "boot with isolcpus=N and run with --cpu N",
            ),
            None => harm(
                format!("CPU {isolated} is isolated but the loop does not run there"),
                "sys/devices/system/cpu/isolated",
                &format!("run with --cpu {}", set[0]),
            ),
            Some(_) => {}
        }
    }
    if subject.wish.busy {
        let share = files.read("proc/sys/kernel/sched_rt_runtime_us");
        if let Some(share) = share.filter(|share| share != "-1") {
            harm(
                format!(
                    "the kernel stops a loop that never sleeps after {share} us of each period"
                ),
                "proc/sys/kernel/sched_rt_runtime_us",
                "sysctl kernel.sched_rt_runtime_us=-1, or run without --busy",
            );
        }
        if (1..=FEW_CPUS).contains(&online.len()) {
            harm(
                format!("--busy takes one CPU for itself, and there are only {}", online.len()),
                ONLINE,
                "run without --busy",
            );
        }
    }
    if let Some(interface) = subject.interface {
        let path = format!("proc/sys/net/ipv6/conf/{interface}/disable_ipv6");
        if files.read(&path).is_some_and(|text| text == "0") {
            harm(
                format!("IPv6 is on at {interface} and sends frames of its own onto the segment"),
                &path,
                &format!("sysctl net.ipv6.conf.{interface}.disable_ipv6=1"),
            );
        }
    }
    findings
}

/// Whether the CPU with this number is online; true if the system does not tell.
pub fn is_online(cpu: usize) -> bool {
    match (Files { root: Path::new("/") }).read(ONLINE) {
        Some(text) => cpus(&text).contains(&cpu),
        None => true,
    }
}

/// Sleeps until the start of some cycles, and records how late the calling thread woke.
pub fn wake_ups(cycle: Nanos) -> Histogram {
    let mut late = Histogram::default();
    let cycle = cycle.min(MOST_TIME);
    let count = (MOST_TIME.0 / cycle.0.max(1)).min(MOST_WAKE_UPS);
    let begin = clock::now();
    for number in 1..=count {
        let due = begin + Nanos(cycle.0 * number);
        while clock::now() < due {
            clock::sleep_until(due);
        }
        late.add(clock::now() - due);
        if clock::now() - begin > MOST_TIME {
            break;
        }
    }
    late
}

struct Files<'a> {
    root: &'a Path,
}

impl Files<'_> {
    /// The content of a file, without the end of line; `None` if it cannot be read.
    fn read(&self, path: &str) -> Option<String> {
        std::fs::read_to_string(self.root.join(path)).ok().map(|text| text.trim().to_owned())
    }

    /// The deepest idle state that a CPU may enter, if it is deeper than C1: file, name, and
    /// wake-up time in microseconds.
    fn deep_sleep(&self, cpu: usize) -> Option<(String, String, u32)> {
        let folder = format!("sys/devices/system/cpu/cpu{cpu}/cpuidle");
        let states = std::fs::read_dir(self.root.join(&folder)).ok()?;
        states
            .filter_map(|state| state.ok()?.file_name().into_string().ok())
            .filter_map(|state| {
                let entry = |name: &str| self.read(&format!("{folder}/{state}/{name}"));
                let latency: u32 = entry("latency")?.parse().ok()?;
                let allowed = entry("disable").is_none_or(|text| text == "0");
                let deep = allowed && latency > C1_LATENCY_US;
                let path = format!("{folder}/{state}/latency");
                deep.then(|| (path, entry("name").unwrap_or_default(), latency))
            })
            .max_by_key(|(_, _, latency)| *latency)
    }
}

/// The CPUs of a list such as `0-3,8`.
fn cpus(list: &str) -> Vec<usize> {
    let number = |text: &str| text.trim().parse::<usize>().ok();
    list.split(',')
        .filter_map(|range| match range.split_once('-') {
            Some((first, last)) => Some(number(first)?..=number(last)?),
            None => number(range).map(|only| only..=only),
        })
        .flatten()
        .collect()
}

const ONLINE: &str = "sys/devices/system/cpu/online";
/// On a machine with no more CPUs than this, a loop that never sleeps leaves too little for the
/// rest.
const FEW_CPUS: usize = 2;
/// C1 wakes in 1 to 2 us, C1E within 10; deeper states take tens to hundreds of microseconds.
const C1_LATENCY_US: u32 = 10;
const MOST_WAKE_UPS: i64 = 200;
const MOST_TIME: Nanos = Nanos::millis(500);

#[cfg(test)]
mod tests {
    use super::*;

    /// A tree of files like `/sys` and `/proc`.
    struct Tree(std::path::PathBuf);

    impl Tree {
        fn new(name: &str) -> Self {
            let name = format!("isocat-{}-{name}", std::process::id());
            let tree = Self(std::env::temp_dir().join(name));
            for (path, text) in GOOD {
                tree.write(path, text);
            }
            tree
        }

        fn write(&self, path: &str, text: &str) {
            let path = self.0.join(path);
            std::fs::create_dir_all(path.parent().expect("a folder")).expect("a writable folder");
            std::fs::write(path, format!("{text}\n")).expect("a writable file");
        }

        fn findings(&self, subject: Subject<'_>) -> Vec<Finding> {
            look_at(&self.0, &subject)
        }
    }

    impl Drop for Tree {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn subject(cpu: Option<usize>, busy: bool) -> Subject<'static> {
        Subject {
            interface: Some("eth0"),
            namespace: None,
            wish: Wish { cpu, busy },
            keeps_awake: false,
        }
    }

    const GOOD: [(&str, &str); 9] = [
        ("proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian 6.12"),
        ("proc/cpuinfo", "processor : 0\nflags : fpu vme sse2"),
        ("proc/sys/kernel/sched_rt_runtime_us", "-1"),
        ("proc/sys/net/ipv6/conf/eth0/disable_ipv6", "1"),
        (ONLINE, "0-3"),
        ("sys/devices/system/cpu/isolated", "2-3"),
        ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "performance"),
        ("sys/devices/system/cpu/cpu3/cpuidle/state1/latency", "2"),
        ("sys/devices/system/cpu/cpu3/cpuidle/state1/disable", "0"),
    ];

    #[test]
    fn a_tuned_machine_has_no_findings() {
        assert_eq!(Tree::new("good").findings(subject(Some(3), true)), []);
    }

    #[test]
    fn every_fault_is_named_with_its_file() {
        let faults = [
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC", "PREEMPT_RT"),
            ("proc/cpuinfo", "flags : fpu hypervisor sse2", "virtual machine"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000", "950000 us"),
            ("proc/sys/net/ipv6/conf/eth0/disable_ipv6", "0", "IPv6"),
            (ONLINE, "0-1", "only 2"),
            ("sys/devices/system/cpu/isolated", "2", "CPU 3 is not isolated"),
            ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "powersave", "powersave"),
            ("sys/devices/system/cpu/cpu3/cpuidle/state1/latency", "133", "133 us"),
        ];
        for (path, text, word) in faults {
            let tree = Tree::new("fault");
            tree.write(path, text);
            let findings = tree.findings(subject(Some(3), true));
            assert_eq!(findings.len(), 1, "{findings:?}");
            assert!(findings[0].what.contains(word), "{findings:?}");
            assert_eq!(findings[0].source, format!("/{path}"));
            assert!(!findings[0].advice.is_empty());
        }
    }

    #[test]
    fn deep_sleep_harms_only_if_allowed_and_not_held_off() {
        let tree = Tree::new("deep");
        tree.write("sys/devices/system/cpu/cpu3/cpuidle/state1/latency", "133");
        assert_eq!(tree.findings(subject(Some(3), false)).len(), 1);
        assert_eq!(tree.findings(Subject { keeps_awake: true, ..subject(Some(3), false) }), []);
        tree.write("sys/devices/system/cpu/cpu3/cpuidle/state1/disable", "1");
        assert_eq!(tree.findings(subject(Some(3), false)), []);
    }

    #[test]
    fn isolated_cpus_want_to_be_used() {
        let findings = Tree::new("unused").findings(subject(None, false));
        assert_eq!(findings.len(), 1, "{findings:?}");
        assert!(findings[0].advice.contains("--cpu 2"), "{findings:?}");
    }

    #[test]
    fn an_empty_machine_has_no_findings() {
        assert_eq!(look_at(Path::new("/no/such/root"), &subject(None, true)), []);
    }

    #[test]
    fn lists_of_cpus() {
        assert_eq!(cpus("0-3,8"), [0, 1, 2, 3, 8]);
        assert_eq!(cpus(""), [0_usize; 0]);
    }

    #[test]
    fn wake_ups_are_counted_and_never_early() {
        let late = wake_ups(Nanos::millis(1));
        assert!((1..=200).contains(&late.count()), "{late:?}");
        assert!(late.least() >= Nanos::ZERO);
        // A cycle longer than the measurement is measured once.
        assert_eq!(wake_ups(Nanos::millis(600)).count(), 1);
    }
}
