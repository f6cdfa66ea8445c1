//! The clocks of a segment, compared by latches of their local times, and the reference's time as a
//! time line.

use isocat_wire::Command;
use isocat_wire::datagram::Address;
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};

use super::bus::{Ask, Bus, Trouble, at, number, read, write};
use super::found::{ClockRegisters, Found};

/// The clocks under calibration and the access to them.
pub(super) struct Clocks<'b, 'w> {
    pub bus: &'b mut Bus<'w>,
    /// Position of the reference clock: the first clock of the segment.
    pub reference: usize,
    reference_registers: ClockRegisters,
    /// Positions of the other clocks, and their original registers.
    pub followers: Vec<(usize, ClockRegisters)>,
    /// Number of devices that process a write to 0x0900.
    timed: u16,
    /// The last known pair of host time and reference time.
    pair: Option<(Time<Host>, i64)>,
}

/// Readings of the clocks at one instant: several latches, and a line through them.
#[derive(Clone, Debug)]
pub(super) struct Fix {
    /// Local time of the reference, ns, unwrapped: the mean of the latches.
    pub at: f64,
    /// Each follower's local time less the reference's.
    pub spots: Vec<Spot>,
    /// The latches: local time of the reference, and each follower's less that.
    pub latches: Vec<(i64, Vec<i32>)>,
}

impl Fix {
    /// Time from the first latch to the last, ns.
    pub fn span(&self) -> f64 {
        let ends = self.latches.first().zip(self.latches.last());
        ends.map_or(0.0, |((first, _), (last, _))| (last - first) as f64)
    }

    /// A follower's local time less the reference's at a latch, ns; 0 for the reference itself.
    pub fn apart(&self, latch: usize, follower: Option<usize>) -> f64 {
        let Some(follower) = follower else { return 0.0 };
        let first = self.latches[0].1[follower];
        // Counters may wrap in between.
        let since = self.latches[latch].1[follower].wrapping_sub(first);
        f64::from(first) + f64::from(since)
    }

    /// The instants of the latches, by the reference's local time.
    pub fn instants(&self) -> Vec<i64> {
        self.latches.iter().map(|(at, _)| *at).collect()
    }
}

/// The reading of one clock.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(super) struct Spot {
    /// Local time less the reference's local time, ns, modulo 2^32 around its first value.
    pub apart: f64,
    /// Standard deviation of a single latch about the line, ns.
    pub deviation: f64,
    /// Standard error of `apart`, ns, without the jitter that all latches have alike.
    pub error: f64,
}

impl<'b, 'w> Clocks<'b, 'w> {
    /// The clocks among these devices.
    pub fn new(bus: &'b mut Bus<'w>, devices: &[Found]) -> Result<Self, Trouble> {
        let clocks: Vec<_> =
            devices.iter().filter_map(|d| d.clock.map(|clock| (d.position, clock))).collect();
        let Some(((reference, registers), followers)) =
            clocks.split_first().filter(|(_, others)| !others.is_empty())
        else {
            return Err(Trouble::NoClocks { found: clocks.len() });
        };
        Ok(Self {
            bus,
            reference: *reference,
            reference_registers: *registers,
            followers: followers.to_vec(),
            timed: devices.iter().filter(|device| device.has_times).count() as u16,
            pair: None,
        })
    }

    /// Writes the filter depths of all clocks, and 0x0930, which clears their loops. Returns the
    /// reference's local time at that moment.
    pub fn reset(&mut self, depths: [u8; 2], start: u16) -> Result<i64, Trouble> {
        self.write_all(register::TIME_FILTER_DEPTH.address, &depths)?;
        let mut asks: Vec<Ask> = vec![read(self.reference, register::SYSTEM_TIME.address, 4)];
        let address = Address::Broadcast(register::SPEED_COUNTER_START.address);
        asks.push((Command::Bwr, address, start.to_bytes().to_vec()));
        let before = self.bus.now();
        let answers = self.bus.ask(&asks)?;
        self.check_all(register::SPEED_COUNTER_START.address, answers[1].wkc)?;
        let low = number(&answers[0].data) as u32;
        Ok(self.unwrap(self.local_of(low, 0), before))
    }

    fn write_all(&mut self, address: u16, data: &[u8]) -> Result<(), Trouble> {
        let answers =
            self.bus.ask(&[(Command::Bwr, Address::Broadcast(address), data.to_vec())])?;
        self.check_all(address, answers[0].wkc)
    }

    fn check_all(&self, address: u16, found: u16) -> Result<(), Trouble> {
        let expected = self.followers.len() as u16 + 1;
        match found == expected {
            true => Ok(()),
            false => Err(Trouble::Count { position: None, address, expected, found }),
        }
    }

    /// Writes the delay of all followers, register 0x0928.
    pub fn set_delays(&mut self, delay: u32) -> Result<(), Trouble> {
        let bytes = delay.to_le_bytes().to_vec();
        let writes: Vec<_> = self.followers.iter().map(|(at, _)| (*at, bytes.clone())).collect();
        self.bus.write_each(&writes, register::SYSTEM_TIME_DELAY.address)
    }

    /// Writes offsets that set each follower's system time `ahead` ns ahead of the reference's at a
    /// fix. Returns the exact lead of each, since an offset has whole ns.
    pub fn set_ahead(&mut self, fix: &Fix, ahead: i64) -> Result<Vec<f64>, Trouble> {
        let mut left = Vec::with_capacity(fix.spots.len());
        let mut writes = Vec::with_capacity(fix.spots.len());
        for (spot, (position, registers)) in fix.spots.iter().zip(&self.followers) {
            let more = ahead - spot.apart.round() as i64;
            let offset = self.reference_registers.offset.wrapping_add_signed(more);
            writes.push((*position, registers.offset_bytes(offset)));
            left.push(spot.apart + more as f64);
        }
        self.bus.write_each(&writes, register::SYSTEM_TIME_OFFSET.address)?;
        Ok(left)
    }

    /// Sends one drift frame. Returns the reference's local time when it passed, or `None` if it
    /// did not come back. `lead` is the movement of the reference's system time in this frame,
    /// `then` the one from this frame's end on.
    pub fn drift_frame(&mut self, lead: i64, then: i64) -> Result<Option<i64>, Trouble> {
        let armw = at(self.reference, register::SYSTEM_TIME.address);
        let mut asks = vec![(Command::Armw, armw, vec![0; 4])];
        if then != lead {
            asks.push(self.lead(then));
        }
        let before = self.bus.now();
        let Some(answers) = self.bus.once(&asks)? else { return Ok(None) };
        self.check_all(register::SYSTEM_TIME.address, answers[0].wkc)?;
        let low = number(&answers[0].data) as u32;
        Ok(Some(self.unwrap(self.local_of(low, lead), before)))
    }

    /// A write of the reference's original offset, moved by `lead`.
    fn lead(&self, lead: i64) -> Ask {
        let offset = self.reference_registers.offset.wrapping_add_signed(lead);
        let bytes = self.reference_registers.offset_bytes(offset);
        write(self.reference, register::SYSTEM_TIME_OFFSET.address, bytes)
    }

    /// Restores the reference's original offset.
    pub fn end_lead(&mut self) -> Result<(), Trouble> {
        let ask = self.lead(0);
        self.bus.ask(&[ask]).map(drop)
    }

    /// Reads register 0x092C or 0x0932 of all followers, `len` bytes of each.
    pub fn shown(&mut self, address: u16, len: usize) -> Result<Vec<Vec<u8>>, Trouble> {
        let positions: Vec<usize> = self.followers.iter().map(|(at, _)| *at).collect();
        self.bus.read_each(&positions, address, len)
    }

    /// Takes several latches, `pace` apart on average.
    pub fn fix(&mut self, latches: usize, pace: Nanos) -> Result<Fix, Trouble> {
        let mut times = Vec::with_capacity(latches);
        let mut lost = 0;
        while times.len() < latches {
            match self.latch()? {
                Some(latch) => times.push(latch),
                None if lost < latches => lost += 1,
                None => return Err(Trouble::Lost { address: register::RECEIVE_TIME_0.address }),
            }
            // The pace is no multiple of ticks, of the dividers' periods or of the teeth of jitter,
            // so that latches meet them at different places.
            let uneven = (times.len() as i64 * 617) % 997 - 498;
            self.bus.wait(Nanos(pace.0 + pace.0 * uneven / 997))?;
        }
        let at = times.iter().map(|(at, _)| *at as f64).sum::<f64>() / latches as f64;
        let spots = (0..self.followers.len()).map(|follower| spot(&times, at, follower)).collect();
        Ok(Fix { at, spots, latches: times })
    }

    /// One latch: the reference's local time, and each follower's less that; `None` if the frame
    /// was lost.
    fn latch(&mut self) -> Result<Option<(i64, Vec<i32>)>, Trouble> {
        let address = register::RECEIVE_TIME_0.address;
        let before = self.bus.now();
        let asks = [(Command::Bwr, Address::Broadcast(address), vec![0; 4])];
        let Some(answers) = self.bus.once(&asks)? else { return Ok(None) };
        if answers[0].wkc != self.timed {
            let (expected, found) = (self.timed, answers[0].wkc);
            return Err(Trouble::Count { position: None, address, expected, found });
        }
        let mut positions = vec![self.reference];
        positions.extend(self.followers.iter().map(|(at, _)| *at));
        let entries = self.bus.read_each(&positions, register::RECEIVE_TIME_EPU.address, 8)?;
        let low = |bytes: &Vec<u8>| number(bytes) as u32;
        let reference = low(&entries[0]);
        let apart =
            entries[1..].iter().map(|bytes| low(bytes).wrapping_sub(reference) as i32).collect();
        Ok(Some((self.unwrap(reference, before), apart)))
    }

    /// Local time of the reference that belongs to its system time.
    fn local_of(&self, system: u32, lead: i64) -> u32 {
        let offset = self.reference_registers.offset.wrapping_add_signed(lead);
        system.wrapping_sub(offset as u32)
    }

    /// The reference's local time without wrapping, by the host's clock.
    fn unwrap(&mut self, low: u32, host: Time<Host>) -> i64 {
        let local = match self.pair {
            None => i64::from(low),
            Some((then, local)) => {
                let about = local + (host - then).0;
                about + i64::from(low.wrapping_sub(about as u32) as i32)
            }
        };
        self.pair = Some((host, local));
        local
    }

    /// The reference's local time at a host time, to about a microsecond.
    pub fn local_at(&self, host: Time<Host>) -> i64 {
        self.pair.map_or(0, |(then, local)| local + (host - then).0)
    }
}

/// A line through the latches of one follower.
fn spot(times: &[(i64, Vec<i32>)], middle: f64, follower: usize) -> Spot {
    let Some((_, first)) = times.first() else { return Spot::default() };
    let first = first[follower];
    let points: Vec<(f64, f64)> = times
        .iter()
        .map(|(at, apart)| (*at as f64 - middle, f64::from(apart[follower].wrapping_sub(first))))
        .collect();
    let line = Line::through(&points);
    let rests = points.iter().map(|(at, apart)| apart - line.at(*at));
    let free = points.len().saturating_sub(2).max(1) as f64;
    let deviation = (rests.map(|rest| rest * rest).sum::<f64>() / free).sqrt();
    // The error of the clocks' ticks is not independent noise, so a few latches cannot average it
    // out.
    let error = (deviation / (points.len() as f64).sqrt()).max(LEAST_ERROR);
    Spot { apart: f64::from(first) + line.middle, deviation, error }
}

/// A straight line by least squares.
pub(super) struct Line {
    /// Means of abscissas and ordinates.
    mean: f64,
    middle: f64,
    slope: f64,
}

impl Line {
    pub fn through(points: &[(f64, f64)]) -> Self {
        let count = points.len().max(1) as f64;
        let mean = points.iter().map(|(x, _)| x).sum::<f64>() / count;
        let middle = points.iter().map(|(_, y)| y).sum::<f64>() / count;
        let square: f64 = points.iter().map(|(x, _)| (x - mean) * (x - mean)).sum();
        let product: f64 = points.iter().map(|(x, y)| (x - mean) * (y - middle)).sum();
        Self { mean, middle, slope: if square > 0.0 { product / square } else { 0.0 } }
    }

    pub fn at(&self, x: f64) -> f64 {
        self.middle + self.slope * (x - self.mean)
    }
}

/// Lower bound of a fix's error, however many latches it has: the grain of two dividers, ns.
const LEAST_ERROR: f64 = 1.5;
