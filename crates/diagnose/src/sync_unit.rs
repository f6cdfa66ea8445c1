//! The SYNC unit of a device as a MainDevice set it up, with one entry for each time it was
//! switched on or off.

use std::time::Duration;

use isocat_wire::dc::{AssignActivate, SyncActivation};
use isocat_wire::register;

use crate::access::{Access, part};
use crate::clock::nearest;
use crate::known::{Image, Known, Log};
use crate::phase::Grid;

/// One write to 0x0981, with the settings written before it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Switched {
    pub frame: usize,
    pub at: Duration,
    /// 0x0980 and 0x0981 as a word.
    pub word: AssignActivate,
    /// SYNC0 cycle, ns.
    pub sync0_cycle: Option<Known<u32>>,
    /// SYNC1 cycle, ns.
    pub sync1_cycle: Option<Known<u32>>,
    /// Start time as it was written, ns of system time.
    pub start: Option<Known<Start>>,
    /// System time of the reference clock as it was last seen before the write.
    pub now: Option<Known<u64>>,
    /// Time between that reading and this write, by the stamps of the capture.
    pub since: Duration,
    /// The device's own system time then, as it was read shortly before.
    pub own: Option<u64>,
}

impl Switched {
    /// The start time with all its bits.
    pub fn full_start(&self) -> Option<u64> {
        let start = self.start?.value;
        match start.bytes {
            8 => Some(start.ns),
            _ => Some(nearest(start.ns as u32, self.now?.value)),
        }
    }

    /// Whether it makes SYNC0 pulses from then on.
    pub fn makes_sync0(&self) -> bool {
        self.word.activates() && self.word.makes_sync0()
    }
}

/// A start time, of which 64 bits or only the lower 32 were written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Start {
    pub ns: u64,
    /// 4 or 8 bytes were written.
    pub bytes: u8,
}

/// What was done with one SYNC unit.
#[derive(Clone, Debug)]
pub(crate) struct SyncUnit {
    pub switched: Log<Switched>,
    /// The last entry, even if the log is full.
    pub last: Option<Switched>,
    /// The last entry at the end of the last stretch of operation, until the next one begins.
    operated: Option<Switched>,
    /// How often 0x0984 or 0x0990 was read after SYNC had been switched on, and the first of these
    /// frames.
    pub looked: Option<Known<u64>>,
    /// A reading of 0x0990 while SYNC was on: time of the next pulse.
    pub next_pulse: Option<Known<u64>>,
    /// Number of bytes of the start time in the last write to it.
    start_bytes: u8,
    start_frame: usize,
}

impl SyncUnit {
    pub fn new() -> Self {
        Self {
            switched: Log::new(64),
            last: None,
            operated: None,
            looked: None,
            next_pulse: None,
            start_bytes: 0,
            start_frame: 0,
        }
    }

    /// Takes a write or a reading at this device's registers, which `image` already contains.
    pub fn access(
        &mut self,
        access: &Access<'_>,
        at: Duration,
        image: &Image,
        now: Option<(Known<u64>, Duration)>,
        own: Option<(u64, Duration)>,
    ) {
        let start = register::SYNC_START_TIME.address;
        if access.written().is_some() && access.taken() != Some(false) && access.covers(start, 4) {
            self.start_bytes = if access.covers(start, 8) { 8 } else { 4 };
            self.start_frame = access.frame;
        }
        let activation = register::SYNC_ACTIVATION.address;
        let written = access.written().filter(|_| access.taken() != Some(false));
        if let Some([byte]) = written.and_then(|data| part(access.ado(), data, activation)) {
            self.switch(access.frame, at, SyncActivation(byte), image, now, own);
        }
        if access.read().is_some() && self.is_on() {
            self.look(access, start);
        }
    }

    fn switch(
        &mut self,
        frame: usize,
        at: Duration,
        activation: SyncActivation,
        image: &Image,
        now: Option<(Known<u64>, Duration)>,
        own: Option<(u64, Duration)>,
    ) {
        let control = image.latest(register::CYCLIC_UNIT_CONTROL).map_or(0, |known| known.value);
        let switched = Switched {
            frame,
            at,
            word: AssignActivate(u16::from_le_bytes([control, activation.0])),
            sync0_cycle: image.written(register::SYNC0_CYCLE),
            sync1_cycle: image.written(register::SYNC1_CYCLE),
            start: self.start(image),
            now: now.map(|(now, _)| now),
            own: own.and_then(|(own, then)| {
                let since = at.checked_sub(then).filter(|since| *since <= SHORTLY)?;
                Some(own.wrapping_add(since.as_nanos() as u64))
            }),
            since: now.map_or(Duration::ZERO, |(_, then)| at.saturating_sub(then)),
        };
        self.switched.push(switched);
        self.last = Some(switched);
        self.looked = None;
        self.next_pulse = None;
    }

    fn start(&self, image: &Image) -> Option<Known<Start>> {
        let bytes = self.start_bytes;
        let known = match bytes {
            8 => image.written(register::SYNC_START_TIME)?,
            4 => {
                let low = image.written_bytes::<4>(register::SYNC_START_TIME.address)?;
                low.map(|bytes| u32::from_le_bytes(bytes).into())
            }
            _ => return None,
        };
        Some(Known { value: Start { ns: known.value, bytes }, frame: self.start_frame })
    }

    fn look(&mut self, access: &Access<'_>, start: u16) {
        let status = register::ACTIVATION_STATUS.address;
        if !access.covers(status, 1) && !access.covers(start, 4) {
            return;
        }
        let looked = self.looked.get_or_insert(Known { value: 0, frame: access.frame });
        looked.value += 1;
        let data = access.read().unwrap_or(&[]);
        if let Some(bytes) = part::<8>(access.ado(), data, start) {
            self.next_pulse = Some(Known { value: u64::from_le_bytes(bytes), frame: access.frame });
        }
    }

    /// The instants of its SYNC0 pulses, if SYNC0 is on, or was at the end of operation, and start
    /// and cycle are known. A start time of 32 bits is the one nearest to the time at which it was
    /// written.
    pub fn grid(&self) -> Option<Grid> {
        let on = self.operating()?;
        Grid::new(on.sync0_cycle?.value, on.full_start()?)
    }

    /// Whether SYNC0 is on, or was at the end of operation.
    pub fn operates(&self) -> bool {
        self.operating().is_some()
    }

    fn operating(&self) -> Option<Switched> {
        [self.last, self.operated].into_iter().flatten().find(Switched::makes_sync0)
    }

    /// Notes that operation ended: the way down may switch SYNC off.
    pub fn left_operation(&mut self) {
        self.operated = self.last;
    }

    /// Notes that operation began.
    pub fn entered_operation(&mut self) {
        self.operated = None;
    }

    /// Whether SYNC0 is on by the last switch.
    pub fn is_on(&self) -> bool {
        self.last.is_some_and(|last| last.makes_sync0())
    }
}

/// Time for which stamps continue a clock's reading.
const SHORTLY: Duration = Duration::from_secs(1);
