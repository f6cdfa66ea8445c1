//! Writes the series of a run as a table for statistics: one row for each SubDevice and cycle, as
//! CSV or Parquet.
//!
//! A cycle of the table ends when the MainDevice has its inputs. The row of a SubDevice holds what
//! happened there since its previous row. Rows begin and end with the judged time, so their figures
//! agree with the report. They are written during the run; some cycles are held back, because
//! events of SubDevices are reported late. If no frame came back for some cycles, their rows divide
//! that time evenly. If no frame reached a SubDevice for some cycles, its events are in the row in
//! which a frame reached it again.

pub mod csv;
pub mod parquet;

use std::collections::VecDeque;
use std::io;

use isocat_maindevice::{MainDevice, segment};
use isocat_sim::bench::{Intent, Measured};
use isocat_sim::device::Device;
use isocat_sim::{Segment, ServedCycle, Tap};
use isocat_wire::register;
use isocat_wire::time::{Nanos, Picos, Time, True};

/// A column of the table.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Column {
    /// Its name, which ends with the unit.
    pub name: &'static str,
    /// The type of its values.
    pub kind: Kind,
    /// What it means.
    pub meaning: &'static str,
}

/// The type of a column's values.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// A 64-bit integer with its sign, in every row.
    Integer,
    /// A 64-bit integer with its sign, or no value.
    Optional,
    /// A text, in every row.
    Text,
}

/// A value of a row.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Value<'a> {
    /// No value, in a column that is [`Kind::Optional`].
    Null,
    /// A number.
    Integer(i64),
    /// A text.
    Text(&'a str),
}

/// All columns, in their order.
pub const COLUMNS: [Column; 14] = {
    const fn column(name: &'static str, kind: Kind, meaning: &'static str) -> Column {
        Column { name, kind, meaning }
    }
    use Kind::{Integer, Optional, Text};
    [
        column(
            "true_time_ns",
            Integer,
            "end of the cycle: its inputs are in the MainDevice's hands",
        ),
        column("cycle", Integer, "number of the cycle, as the MainDevice counts"),
        column("position", Integer, "place of the SubDevice in processing order, from 0"),
        column("name", Text, "its name in the segment file"),
        column("sync0_pulses", Integer, "SYNC0 edges since the row before"),
        column(
            "sync0_error_ps",
            Optional,
            "SYNC0 edge against the reference clock's ideal grid; of several the furthest off",
        ),
        column(
            "margin_ns",
            Optional,
            "from ready outputs to the pulse at which they act; of several the least",
        ),
        column("system_time_difference_ns", Optional, "register 0x092C; null without clock"),
        column("al_state", Text, "INIT, PREOP, SAFEOP, OP or BOOT"),
        column("al_status_code", Integer, "0 if nothing is wrong"),
        column(
            "sm_event_missed",
            Optional,
            "counter 0x1C32:0B (0x1C33:0B without outputs); null without these objects",
        ),
        column(
            "host_phase_error_ns",
            Optional,
            "phase error of the MainDevice's servo; null where no frame gave one",
        ),
        column(
            "frames_lost",
            Integer,
            "frames that the MainDevice lost so far, from the beginning of the run",
        ),
        column(
            "working_counter_errors",
            Optional,
            "wrong working counters so far, from the beginning of the run; null of a foreign MainDevice, which knows them alone",
        ),
    ]
};

/// The output of a table.
pub trait Table: Send {
    /// Writes one row, with values in the order of [`COLUMNS`].
    fn row(&mut self, values: &[Value<'_>; COLUMNS.len()]) -> io::Result<()>;

    /// Ends the table.
    fn finish(&mut self) -> io::Result<()>;
}

/// Collects events, and writes them row by row.
pub struct Series {
    table: Box<dyn Table>,
    failed: Option<io::Error>,
    names: Vec<String>,
    /// Whether the present time is judged.
    judging: bool,
    /// When the last cycle ended.
    end: Time<True>,
    number: Option<u64>,
    phase_errors: u64,
    /// Cycles whose rows are not written yet.
    held: VecDeque<Cycle>,
    /// Values that were measured after the end of the last cycle.
    open: Vec<(Time<True>, usize, Measured)>,
}

/// One cycle.
struct Cycle {
    end: Time<True>,
    number: u64,
    host_phase_error: Option<Nanos>,
    frames_lost: u64,
    working_counter_errors: Option<u64>,
    cells: Vec<Cell>,
}

/// Figures of the MainDevice in a cycle.
#[derive(Clone, Copy)]
struct Counts {
    host_phase_error: Option<Nanos>,
    frames_lost: u64,
    working_counter_errors: Option<u64>,
}

/// One SubDevice in one cycle.
#[derive(Clone)]
struct Cell {
    pulses: i64,
    error: Option<Picos>,
    margin: Option<Nanos>,
    difference: Option<Nanos>,
    state: &'static str,
    code: u16,
    missed: Option<u16>,
}

/// Cycles that are held back: events of a SubDevice are reported when the next frame that concerns
/// it passes.
const HELD: usize = 16;

impl Series {
    /// Writes to `table`. `names`: those of the SubDevices, by position.
    pub fn new(table: Box<dyn Table>, names: Vec<String>) -> Self {
        Self {
            table,
            failed: None,
            names,
            judging: false,
            end: Time::ZERO,
            number: None,
            phase_errors: 0,
            held: VecDeque::new(),
            open: Vec::new(),
        }
    }

    /// Ends the table; returns the first error.
    pub fn finish(mut self) -> io::Result<()> {
        self.release(0);
        match self.failed {
            Some(error) => Err(error),
            None => self.table.finish(),
        }
    }

    /// Ends the cycles up to `number`, of which the last one ended at `end`.
    fn close(&mut self, end: Time<True>, number: u64, counts: Counts, cells: &[Cell]) {
        let first = self.number.map_or(number, |last| last + 1).min(number);
        let (began, cycles) = (self.end, (number - first + 1) as i64);
        for each in first..=number {
            let part = i128::from((end - began).0) * i128::from(each - first + 1);
            let passed = Picos((part / i128::from(cycles)) as i64);
            self.held.push_back(Cycle {
                end: began + passed,
                number: each,
                host_phase_error: counts.host_phase_error.filter(|_| each == number),
                frames_lost: counts.frames_lost,
                working_counter_errors: counts.working_counter_errors,
                cells: cells.to_vec(),
            });
            let open = std::mem::take(&mut self.open);
            for (at, device, measured) in open {
                self.take(at, device, measured);
            }
            self.release(HELD);
        }
        (self.number, self.end) = (Some(number), end);
    }

    /// Ends cycles of a MainDevice of isocat.
    fn close_own(&mut self, end: Time<True>, number: u64, main: &MainDevice, segment: &Segment) {
        let statistics = main.statistics();
        let is_new = statistics.phase_error.count != self.phase_errors;
        self.phase_errors = statistics.phase_error.count;
        let counts = Counts {
            host_phase_error: is_new.then_some(statistics.phase_error.last),
            frames_lost: statistics.frames_missed(),
            working_counter_errors: Some(statistics.working_counter_errors),
        };
        self.close(end, number, counts, &cells(main, segment));
    }

    /// Adds a measured value to its row.
    fn take(&mut self, at: Time<True>, device: usize, measured: Measured) {
        let Some(cycle) = self.held.iter_mut().find(|cycle| at <= cycle.end) else {
            self.open.push((at, device, measured));
            return;
        };
        let Some(cell) = cycle.cells.get_mut(device) else { return };
        if let Some(error) = measured.sync0_error {
            cell.pulses += 1;
            let worse = cell.error.is_none_or(|known| error.abs() > known.abs());
            cell.error = if worse { Some(error) } else { cell.error };
        }
        let margins = [cell.margin, measured.margin];
        cell.margin = margins.into_iter().flatten().min();
    }

    /// Writes the oldest cycles until at most `most` are held.
    fn release(&mut self, most: usize) {
        while self.held.len() > most {
            let Some(cycle) = self.held.pop_front() else { return };
            for (position, (cell, name)) in cycle.cells.iter().zip(&self.names).enumerate() {
                if self.failed.is_none() {
                    self.failed = self.table.row(&values(&cycle, position, cell, name)).err();
                }
            }
        }
    }
}

fn values<'a>(
    cycle: &Cycle,
    position: usize,
    cell: &Cell,
    name: &'a str,
) -> [Value<'a>; COLUMNS.len()] {
    let optional = |value: Option<i64>| value.map_or(Value::Null, Value::Integer);
    [
        Value::Integer(cycle.end.as_nanos() as i64),
        Value::Integer(cycle.number as i64),
        Value::Integer(position as i64),
        Value::Text(name),
        Value::Integer(cell.pulses),
        optional(cell.error.map(|error| error.0)),
        optional(cell.margin.map(|margin| margin.0)),
        optional(cell.difference.map(|difference| difference.0)),
        Value::Text(cell.state),
        Value::Integer(cell.code.into()),
        optional(cell.missed.map(i64::from)),
        optional(cycle.host_phase_error.map(|error| error.0)),
        Value::Integer(cycle.frames_lost as i64),
        optional(cycle.working_counter_errors.map(|count| count as i64)),
    ]
}

/// Bit 2 of the ESC's features: it has distributed clocks.
const HAS_CLOCK: u16 = 1 << 2;

/// The state of the SubDevices. What they have is known from isocat's MainDevice.
fn cells(main: &MainDevice, segment: &Segment) -> Vec<Cell> {
    let found = main.segment().devices.iter().map(Some).chain(std::iter::repeat(None));
    let of = |(device, found): (_, Option<&segment::SubDevice>)| {
        let has_clock = found.is_some_and(|found| found.dc.has_clock());
        let counts = |f: &segment::SubDevice| f.output_sync.is_some() || f.input_sync.is_some();
        cell(device, has_clock, found.is_some_and(counts))
    };
    segment.devices().iter().zip(found).map(of).collect()
}

/// The state of the SubDevices without isocat's MainDevice: what they have is known from
/// themselves.
fn served_cells(segment: &Segment) -> Vec<Cell> {
    let of = |device: &Device| {
        let has_clock = device.esc.register(register::FEATURES) & HAS_CLOCK != 0;
        // The counters are objects, which are read by mailbox.
        cell(device, has_clock, device.stack.description().mailbox.is_some())
    };
    segment.devices().iter().map(of).collect()
}

fn cell(device: &Device, has_clock: bool, counts: bool) -> Cell {
    Cell {
        pulses: 0,
        error: None,
        margin: None,
        difference: has_clock.then(|| device.esc.system_time_difference()),
        state: device.stack.state().name(),
        code: device.stack.status_code().0,
        missed: counts.then(|| device.stack.sync().sm_event_missed()),
    }
}

impl Tap for Series {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}

    fn judging_begins(&mut self, at: Time<True>, _: &Intent) {
        (self.judging, self.end) = (true, at);
    }

    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        if self.judging {
            self.take(at, device, *measured);
        }
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        if self.judging {
            self.close_own(at, main.statistics().cycles, main, segment);
        } else {
            // Skips the phase errors of earlier cycles: a row has that of its own cycle.
            self.phase_errors = main.statistics().phase_error.count;
        }
    }

    fn judging_ends(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        // The remaining events belong to a cycle that has begun, or to cycles since the last frame
        // came back.
        let begun = main.statistics().cycles;
        let next = self.number.map_or(begun, |last| last + 1);
        if self.judging && (begun > next || !self.open.is_empty()) {
            self.close_own(at, begun.max(next), main, segment);
        }
        self.judging = false;
        self.release(0);
    }

    fn served_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>, segment: &Segment) {
        let Some(cycle) = cycle else {
            self.judging = false;
            return self.release(0);
        };
        if !std::mem::replace(&mut self.judging, true) {
            // The judged time begins with this frame; the first row is that of the next cycle.
            (self.end, self.number) = (at, Some(cycle.number));
            return self.open.clear();
        }
        let counts = Counts {
            host_phase_error: None,
            frames_lost: cycle.frames_lost,
            working_counter_errors: None,
        };
        self.close(at, cycle.number, counts, &served_cells(segment));
    }
}
