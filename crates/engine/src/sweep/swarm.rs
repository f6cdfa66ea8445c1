//! Faults that a run draws for itself: their kinds, number, times and sizes.

use isocat_descriptions::quantity::parse_duration;
use isocat_segment::profile::built_in;
use isocat_sim::random::Stream;
use toml::{Table, Value};

/// Adds 1 to 4 faults to a file. Each run has only a few kinds of faults, since faults that always
/// come together hide each other's effects. All begin in the first two thirds of the run, and all
/// that can end do so.
pub(super) fn draw(table: &mut Table, seed: u64) {
    let mut draw = Draw::new(table, seed);
    let count = 1 + draw.below(4);
    let faults: Vec<Value> = (0..count).map(|_| Value::Table(draw.fault())).collect();
    match table.entry("fault").or_insert_with(|| Value::Array(Vec::new())) {
        Value::Array(known) => known.extend(faults),
        other => *other = Value::Array(faults),
    }
}

/// The random stream, and the facts of the file that it needs.
struct Draw {
    chance: Stream,
    /// Device types by position.
    devices: Vec<String>,
    /// Whether a last cable closes a ring.
    is_ring: bool,
    /// Duration of the run, ns.
    duration: i64,
    /// Bus cycle, ns.
    cycle: i64,
}

impl Draw {
    fn new(table: &Table, seed: u64) -> Self {
        let time = |key: &str, otherwise: i64| {
            let text = table.get(key).and_then(Value::as_str);
            text.and_then(|text| parse_duration(text).ok()).map_or(otherwise, |time| time.0)
        };
        Self {
            chance: Stream::new(seed, "swarm", 0),
            devices: devices(table),
            is_ring: table.get("ring").is_some_and(|ring| ring.as_bool() != Some(false)),
            duration: time("for", 10_000_000_000),
            cycle: time("cycle", 1_000_000),
        }
    }

    fn fault(&mut self) -> Table {
        let at = self.duration / 1_000 * (50 + self.below(600)) as i64;
        let mut fault = Table::new();
        fault.insert("at".into(), Value::String(format!("in-operation + {at}ns")));
        fault.insert("what".into(), Value::String(self.line()));
        fault
    }

    fn line(&mut self) -> String {
        match self.below(4) {
            0 => self.of_frames(),
            1 => self.of_the_wire(),
            2 => self.of_time(),
            _ => self.of_a_device(),
        }
    }

    fn of_frames(&mut self) -> String {
        let (count, cable) = (1 + self.below(5), self.cable());
        match self.below(6) {
            0 => format!("drop {count}"),
            1 => format!("drop {count} at {cable}"),
            2 => {
                let (share, burst) = (1 + self.below(30), 1 + self.below(4));
                format!("loss {share}% burst {burst} for {}", self.share(5, 200))
            }
            3 => format!("damage {count} at {cable}"),
            4 => format!("delay 0 {} for {}", self.cycles(10, 1_500), self.share(5, 200)),
            _ => format!("double {count}"),
        }
    }

    fn of_the_wire(&mut self) -> String {
        let cable = self.cable();
        match self.below(7) {
            0 => format!("pull {cable} for {}", self.share(1, 200)),
            // This is too short for the ends of the cable to notice.
            1 => format!("pull {cable} for {}ns", 10_000 + self.below(5_000)),
            2 => {
                let way = if self.below(2) == 0 { "out" } else { "back" };
                format!("break {cable} {way} for {}", self.share(1, 200))
            }
            3 => {
                let (off, on) = (self.share(1, 50), self.share(1, 200));
                format!("flap {cable} {off} {on} for {}", self.share(50, 300))
            }
            4 => format!("power-cycle {} {}", self.device(), self.share(1, 200)),
            5 => {
                let takes = match self.below(2) {
                    0 => "0".to_owned(),
                    _ => self.share(1, 200),
                };
                format!("recable {cable} {}m {takes}", 1 + self.below(100))
            }
            _ => {
                // A device of the same type, with other counters and another clock.
                let (device, takes) = (self.device(), self.share(1, 200));
                match self.devices.get(device as usize) {
                    Some(kind) if built_in(kind).is_some() => {
                        format!("replace {device} {kind} {takes}")
                    }
                    _ => format!("power-cycle {device} {takes}"),
                }
            }
        }
    }

    fn of_time(&mut self) -> String {
        let device = self.device();
        match self.below(9) {
            0 => format!("clock {device} {} over {}", self.ppm(100), self.share(5, 200)),
            1 => format!("clock {device} {}", self.ppm(200)),
            2 => format!("clock host {}", self.ppm(200)),
            3 => {
                let (step, every) = (1 + self.below(2_000), self.share(1, 20));
                format!("clock-walk {device} {step}ppb every {every} within 30ppm")
            }
            4 => format!("clock-jump {}", self.cycles(1, 20_000)),
            5 => format!("stall {}", self.cycles(500, 40_000)),
            6 => {
                let late = self.cycles(10, 1_500);
                format!("late-wake-ups 0 {late} 20% for {}", self.share(5, 200))
            }
            7 => {
                // By up to three cycles, since a frame that is late by most of a cycle looks like
                // an early one; alone, or now and then for a while.
                let late = self.cycles(1, 3_000);
                match self.below(3) {
                    0 => format!("slow-send {late} for {}ns", self.cycle),
                    1 => format!("slow-send 0 {late} 50% for {}", self.share(5, 200)),
                    _ => format!("slow-send 0 {late} 5% for {}", self.share(5, 200)),
                }
            }
            _ => format!("second-master count {} for {}", self.share(1, 50), self.share(5, 200)),
        }
    }

    fn of_a_device(&mut self) -> String {
        let device = self.device();
        match self.below(6) {
            0 => format!("sync-off {device} for {}", self.share(1, 50)),
            1 => format!("al-error {device} 0x8{:03X}", self.below(0x1000)),
            2 => format!("stuck-mailbox {device} for {}", self.share(5, 200)),
            3 => format!("dead-eeprom {device} for {}", self.share(5, 200)),
            _ => {
                let lasts = self.share(5, 200);
                format!("misbehave {device} {} for {lasts}", self.misbehaviour())
            }
        }
    }

    fn misbehaviour(&mut self) -> String {
        match self.below(6) {
            0 => format!("missed-copy {}", 2 + self.below(60)),
            1 => format!("late-copy {}", self.cycles(10, 500)),
            2 => format!("late-application {}", self.cycles(10, 500)),
            3 => "dead-sync0".to_owned(),
            4 => "ignores-shift".to_owned(),
            _ => format!("slow-mailbox {}", self.share(1, 100)),
        }
    }

    fn device(&mut self) -> u64 {
        self.below(self.devices.len() as u64)
    }

    /// The cable that leads to a SubDevice, or the one that closes a ring.
    fn cable(&mut self) -> String {
        let device = self.device();
        let cables = self.devices.len() as u64 + 1;
        match self.is_ring && self.below(cables) + 1 == cables {
            true => "ring".to_owned(),
            false => device.to_string(),
        }
    }

    fn below(&mut self, count: u64) -> u64 {
        self.chance.up_to(count.max(1) - 1)
    }

    /// A time in thousandths of the run, at least a millisecond.
    fn share(&mut self, from: u64, to: u64) -> String {
        let time = self.duration / 1_000 * (from + self.below(to - from)) as i64;
        format!("{}ns", time.max(1_000_000))
    }

    /// A time in thousandths of a cycle, at least 10 us.
    fn cycles(&mut self, from: u64, to: u64) -> String {
        let time = self.cycle / 1_000 * (from + self.below(to - from)) as i64;
        format!("{}ns", time.max(10_000))
    }

    fn ppm(&mut self, most: u64) -> String {
        let sign = if self.below(2) == 0 { '+' } else { '-' };
        format!("{sign}{}ppm", 1 + self.below(most))
    }
}

/// Device types of a file, by position.
fn devices(table: &Table) -> Vec<String> {
    let tables = table.get("subdevice").and_then(Value::as_array).into_iter().flatten();
    let each = tables.flat_map(|table| {
        let count = table.get("count").and_then(Value::as_integer).unwrap_or(1).max(1);
        let device = table.get("device").and_then(Value::as_str).unwrap_or_default();
        std::iter::repeat_n(device.to_owned(), count as usize)
    });
    each.collect()
}
