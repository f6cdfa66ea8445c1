//! Frames of procedures: datagrams that are queued, in flight and back, and the end of each wait.

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::task::Poll;

use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN, Header, WKC_LEN};
use isocat_wire::frame::{ETHERCAT_HEADER_LEN, ETHERNET_HEADER_LEN, FrameWriter};
use isocat_wire::time::{Host, Nanos, Time};

use super::{CYCLIC_INDEX, Reply, Travel, is_touched};
use crate::error::AccessProblem;
use crate::statistics::Statistics;

/// Bytes of a frame before its first datagram.
const HEADERS: usize = ETHERNET_HEADER_LEN + ETHERCAT_HEADER_LEN;
/// Most frames of the link in flight. They are more than a long line needs, and few enough that an
/// index is reused only long after its frame was given up.
const MOST_FLIGHTS: usize = 24;
/// Frames in flight beyond these of datagrams that go ahead.
const MOST_AHEAD: usize = 40;
/// Time of an octet on the wire, ns.
const NS_PER_OCTET: i64 = 80;
/// Octets around a frame: preamble, check sequence, gap.
const AROUND_FRAME: usize = 24;
/// Octets in flight beyond those that fill the way: the wire is then busy while a host needs up to
/// 240 us for its next frame.
const IN_RESERVE: i64 = 3_000;
/// Number of SubDevices that [`Timeouts::frame`](crate::config::Timeouts::frame) already includes.
const USUAL_COUNT: u16 = 1000;
/// Way through a SubDevice and back, with cables of 100 m: 0.5 us for each, in both directions.
const WAY_PER_SUBDEVICE: Nanos = Nanos(2_000);
/// A repetition waits at most 2 to this power times as long as the first frame.
const MOST_DOUBLINGS: u8 = 4;

/// Longest wait of a datagram for an instant without any frame in flight. Other datagrams wait
/// behind it.
const QUIET_PATIENCE: Nanos = Nanos(100_000_000);

/// Most bytes of memory that a free slot keeps for the next datagram: those of registers.
const MOST_KEPT: usize = 16;

/// The queue, the frames in flight and the waits.
pub(crate) struct Port {
    /// Host time of the last input.
    pub now: Time<Host>,
    source: [u8; 6],
    frame_timeout: Nanos,
    /// Time that a long line adds to `frame_timeout`.
    longer_way: Nanos,
    retries: u8,
    slots: Vec<Slot>,
    free: Vec<usize>,
    /// Datagrams that wait to be sent; those that go ahead are first.
    queue: VecDeque<usize>,
    /// Number of datagrams in the queue that go ahead.
    ahead: usize,
    flights: Vec<Flight>,
    /// Empty lists of earlier flights, reused so that a frame does not allocate.
    spare: Vec<Vec<usize>>,
    /// The shortest time that a frame took to come back.
    shortest_way: Option<Nanos>,
    next_index: u8,
    /// Since when the first datagram in the queue waits until every frame is back.
    quiet_since: Option<Time<Host>>,
    /// Indices of frames that were given up, one bit each, until the index is used again.
    given_up: u128,
    /// Whether the segment returns the source address unchanged. An answer that no SubDevice
    /// processed then looks like the sent frame.
    unmarked: bool,
    /// Earliest end of a wait, computed again in each round of polling.
    wake: Time<Host>,
}

struct Slot {
    state: SlotState,
    command: Command,
    address: Address,
    data: Vec<u8>,
    /// Number of datagrams that `data` holds whole, of a batch of reads; 0 if it is the data of
    /// one.
    batch: u16,
    wkc: u16,
    passed: u16,
    sent: Time<Host>,
    retries: u8,
    /// Number of losses so far.
    losses: u8,
    alone: bool,
    quiet: bool,
    with_next: bool,
    ahead: bool,
    /// No procedure waits for it any more.
    abandoned: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum SlotState {
    Queued,
    InFlight,
    Done,
    Lost,
    Free,
}

struct Flight {
    index: u8,
    deadline: Time<Host>,
    sent: Time<Host>,
    /// Its length on the wire.
    octets: usize,
    slots: Vec<usize>,
}

impl Port {
    pub fn new(now: Time<Host>, source: [u8; 6], frame_timeout: Nanos, retries: u8) -> Self {
        Self {
            now,
            source,
            frame_timeout,
            longer_way: Nanos::ZERO,
            retries,
            slots: Vec::new(),
            free: Vec::new(),
            queue: VecDeque::new(),
            ahead: 0,
            flights: Vec::new(),
            spare: Vec::new(),
            shortest_way: None,
            next_index: 0,
            quiet_since: None,
            given_up: 0,
            unmarked: false,
            wake: Time::NEVER,
        }
    }

    /// Sets the number of SubDevices. Frames through more than [`USUAL_COUNT`] get a longer
    /// timeout.
    pub fn expect_way(&mut self, count: u16) {
        let more = i64::from(count.saturating_sub(USUAL_COUNT));
        self.longer_way = Nanos(more * WAY_PER_SUBDEVICE.0);
    }

    /// Queues a datagram; returns its slot.
    pub fn enqueue(
        &mut self,
        command: Command,
        address: Address,
        data: Vec<u8>,
        travel: Travel,
    ) -> usize {
        let at = self.free.pop();
        self.enqueue_in(at, command, address, data, travel)
    }

    /// Queues a datagram that reads `len` bytes; it reuses the memory of an earlier one.
    pub fn enqueue_read(
        &mut self,
        command: Command,
        address: Address,
        len: usize,
        travel: Travel,
    ) -> usize {
        let at = self.free.pop();
        let mut data = at.map_or(Vec::new(), |at| core::mem::take(&mut self.slots[at].data));
        data.resize(len, 0);
        self.enqueue_in(at, command, address, data, travel)
    }

    /// Queues a batch of `count` datagrams (FPRD) that are whole already: headers, data and working
    /// counters, one behind the other, each with the flag that another one follows. They travel in
    /// one frame. [`Self::take_batch`] returns the memory.
    pub fn enqueue_batch(&mut self, datagrams: Vec<u8>, count: u16) -> usize {
        let at = self.free.pop();
        let nobody = Address::Broadcast(0);
        let at = self.enqueue_in(at, Command::Nop, nobody, datagrams, Travel::default());
        self.slots[at].batch = count;
        at
    }

    /// Whether a batch is back or lost.
    pub fn has_batch(&self, slot: usize) -> bool {
        matches!(self.slots[slot].state, SlotState::Done | SlotState::Lost)
    }

    /// The datagrams of a batch that is back or lost, and when their frame was sent; `None` instead
    /// of the time: it is lost. The slot is free then.
    pub fn take_batch(&mut self, at: usize) -> (Option<Time<Host>>, Vec<u8>) {
        let slot = &mut self.slots[at];
        let sent = (slot.state == SlotState::Done).then_some(slot.sent);
        let datagrams = core::mem::take(&mut slot.data);
        self.release(at);
        (sent, datagrams)
    }

    /// Queues a datagram in this free slot, or in a new one.
    fn enqueue_in(
        &mut self,
        at: Option<usize>,
        command: Command,
        address: Address,
        data: Vec<u8>,
        travel: Travel,
    ) -> usize {
        let slot = Slot {
            state: SlotState::Queued,
            command,
            address,
            data,
            batch: 0,
            wkc: 0,
            passed: 0,
            sent: Time::ZERO,
            retries: if travel.once { 0 } else { self.retries },
            losses: 0,
            alone: travel.alone,
            quiet: travel.quiet,
            with_next: travel.with_next,
            ahead: travel.ahead,
            abandoned: false,
        };
        let at = match at {
            Some(at) => {
                self.slots[at] = slot;
                at
            }
            None => {
                self.slots.push(slot);
                self.slots.len() - 1
            }
        };
        self.push(at);
        at
    }

    /// Puts a datagram at the end of the queue, or behind those that go ahead if it does so too.
    fn push(&mut self, at: usize) {
        if self.slots[at].ahead {
            self.queue.insert(self.ahead, at);
            self.ahead += 1;
        } else {
            self.queue.push_back(at);
        }
    }

    /// Takes the first datagram out of the queue.
    fn pop(&mut self) -> Option<usize> {
        let at = self.queue.pop_front()?;
        self.ahead -= usize::from(self.slots[at].ahead);
        Some(at)
    }

    /// The answer to a datagram, once; inner `None`: it is lost.
    pub fn answer(&mut self, slot: usize) -> Poll<Option<Reply>> {
        let slot = &mut self.slots[slot];
        match slot.state {
            SlotState::Done => Poll::Ready(Some(Reply {
                data: core::mem::take(&mut slot.data),
                wkc: slot.wkc,
                passed: slot.passed,
                sent: slot.sent,
            })),
            SlotState::Lost => Poll::Ready(None),
            _ => Poll::Pending,
        }
    }

    /// The same without the data's memory, for the first bytes of an answer with this working
    /// counter.
    pub fn answer_with<const LEN: usize>(
        &self,
        slot: usize,
        expected: u16,
    ) -> Poll<Result<[u8; LEN], AccessProblem>> {
        let slot = &self.slots[slot];
        match slot.state {
            SlotState::Done if slot.wkc == expected => {
                Poll::Ready(slot.data.first_chunk().copied().ok_or(AccessProblem::Lost))
            }
            SlotState::Done => {
                Poll::Ready(Err(AccessProblem::WorkingCounter { expected, found: slot.wkc }))
            }
            SlotState::Lost => Poll::Ready(Err(AccessProblem::Lost)),
            _ => Poll::Pending,
        }
    }

    /// Whether a wait until `due` is not over; the machine then wakes by `due`.
    pub fn waits_until(&mut self, due: Time<Host>) -> bool {
        if self.now < due {
            self.wake = self.wake.min(due);
        }
        self.now < due
    }

    /// Builds the next frame of queued datagrams, of at most `most` bytes unless a single datagram
    /// is longer; `None` if nothing is queued or too much is in flight.
    pub fn transmit(
        &mut self,
        now: Time<Host>,
        buffer: &mut [u8],
        most: usize,
        statistics: &mut Statistics,
    ) -> Option<usize> {
        if self.waits_for_quiet(now, 0) || self.queue.is_empty() || self.has_enough_in_flight() {
            return None;
        }
        let mut frame = FrameWriter::new(buffer, self.source);
        let index = self.free_index();
        let mut slots = self.spare.pop().unwrap_or_default();
        let mut len = HEADERS;
        let (mut losses, mut datagrams) = (0, 0);
        // Whether the last datagram must be in one frame with the next one.
        let mut bound = false;
        while let Some(&at) = self.queue.front() {
            let room = self.front_len();
            let slot = &mut self.slots[at];
            let more = slot.octets();
            let first = slots.is_empty();
            if !first && !bound && (slot.alone || slot.quiet || len + room > most) {
                break;
            }
            let pushed = match slot.batch {
                0 => frame.push(slot.command, index, slot.address, &slot.data).map(|_| ()),
                _ => frame.push_whole(index, &slot.data),
            };
            if pushed.is_err() {
                break;
            }
            datagrams += u64::from(slot.batch.max(1));
            let alone = slot.alone;
            bound = slot.with_next;
            slot.state = SlotState::InFlight;
            slot.sent = now;
            slots.push(at);
            losses = losses.max(slot.losses);
            len += more;
            self.next_queued();
            if alone {
                break;
            }
        }
        if slots.is_empty() {
            // It is longer than the caller's buffer, so it can never be sent.
            self.spare.push(slots);
            if let Some(at) = self.next_queued() {
                self.lose(at);
            }
            return None;
        }
        self.next_index = (index + 1) % CYCLIC_INDEX;
        self.given_up &= !(1 << index);
        statistics.frames_sent += 1;
        statistics.datagrams += datagrams;
        // Each repetition waits twice as long, so that a host that slept gets time to wake.
        let patience = Nanos(self.frame_timeout.0 << losses.min(MOST_DOUBLINGS)) + self.longer_way;
        let octets = len + AROUND_FRAME;
        self.flights.push(Flight { index, deadline: now + patience, sent: now, octets, slots });
        Some(frame.finish())
    }

    /// Whether the first datagram in the queue waits until every frame is back; `cyclic` frames are
    /// in flight in addition to the link's own. A datagram that waited too long is lost.
    pub fn waits_for_quiet(&mut self, now: Time<Host>, cyclic: usize) -> bool {
        let Some(&at) = self.queue.front() else { return false };
        if !self.slots[at].quiet || cyclic + self.flights.len() == 0 {
            self.quiet_since = None;
            return false;
        }
        let since = *self.quiet_since.get_or_insert(now);
        if now - since >= QUIET_PATIENCE {
            self.quiet_since = None;
            self.next_queued();
            self.lose(at);
        }
        true
    }

    /// Whether the first datagram in the queue waits until a frame comes back. More frames than
    /// keep the way full would only queue in front of the wire, and a datagram that goes ahead
    /// would wait behind them.
    fn has_enough_in_flight(&self) -> bool {
        if self.queue.front().is_some_and(|at| self.slots[*at].ahead) {
            return self.flights.len() >= MOST_FLIGHTS + MOST_AHEAD;
        }
        if self.flights.len() >= MOST_FLIGHTS {
            return true;
        }
        let on_the_way: usize = self.flights.iter().map(|flight| flight.octets).sum();
        let way = self.shortest_way.unwrap_or(self.frame_timeout).0 / NS_PER_OCTET;
        on_the_way as i64 >= way.saturating_add(IN_RESERVE)
    }

    /// The next index that is not in flight.
    fn free_index(&self) -> u8 {
        let mut index = self.next_index;
        while self.flights.iter().any(|flight| flight.index == index) {
            index = (index + 1) % CYCLIC_INDEX;
        }
        index
    }

    /// Bytes on the wire of the first datagram in the queue, in a separate frame; `None` if nothing
    /// is queued.
    #[inline]
    pub fn first_len(&self) -> Option<usize> {
        self.queue.front().map(|_| self.front_len() + HEADERS)
    }

    /// Bytes of the first datagram in the queue and of those that must be in one frame with it.
    fn front_len(&self) -> usize {
        let mut len = 0;
        for &at in &self.queue {
            let slot = &self.slots[at];
            len += slot.octets();
            if !slot.with_next {
                break;
            }
        }
        len
    }

    /// Takes the datagrams of a returned frame; `false` if the frame is not ours.
    pub fn receive(&mut self, payload: &[u8], statistics: &mut Statistics) -> bool {
        let Some(&index) = payload.get(1) else { return false };
        let Some(at) = self.flights.iter().position(|flight| flight.index == index) else {
            return false;
        };
        if !self.belongs(&self.flights[at].slots, payload) {
            return false;
        }
        let mut flight = self.flights.swap_remove(at);
        let way = self.now - flight.sent;
        self.shortest_way = Some(self.shortest_way.map_or(way, |known| known.min(way)));
        // It belongs to them, so their datagrams follow each other with these lengths.
        let mut rest = payload;
        for at in flight.slots.drain(..) {
            let slot = &mut self.slots[at];
            if slot.batch > 0 {
                let Some((datagrams, more)) = rest.split_at_checked(slot.data.len()) else { break };
                rest = more;
                slot.data.copy_from_slice(datagrams);
                slot.state = SlotState::Done;
                if slot.abandoned {
                    self.put_back(at);
                }
                continue;
            }
            let (Some((header, more)), len) = (rest.split_at_checked(HEADER_LEN), slot.data.len())
            else {
                break;
            };
            let Some((data, more)) = more.split_at_checked(len) else { break };
            let Some((wkc, more)) = more.split_first_chunk() else { break };
            rest = more;
            slot.data.copy_from_slice(data);
            slot.wkc = u16::from_le_bytes(*wkc);
            if slot.command.increments_position() {
                let adp = u16::from_le_bytes([header[2], header[3]]);
                slot.passed = adp.wrapping_sub(slot.address.raw() as u16);
            }
            slot.state = SlotState::Done;
            if slot.abandoned {
                self.put_back(at);
            }
        }
        self.spare.push(flight.slots);
        statistics.frames_received += 1;
        true
    }

    /// Whether a frame holds exactly these datagrams.
    fn belongs(&self, slots: &[usize], payload: &[u8]) -> bool {
        let mut rest = payload;
        for (number, &at) in slots.iter().enumerate() {
            let is_last = number + 1 == slots.len();
            let Some(more) = self.slots[at].behind(rest, is_last) else { return false };
            rest = more;
        }
        true
    }

    /// Gives up frames whose timeout is over.
    #[inline]
    pub fn handle_timeout(&mut self, statistics: &mut Statistics) {
        if !self.flights.is_empty() {
            self.expire(statistics);
        }
    }

    fn expire(&mut self, statistics: &mut Statistics) {
        let now = self.now;
        while let Some(at) = self.flights.iter().position(|flight| flight.deadline <= now) {
            let mut flight = self.flights.swap_remove(at);
            statistics.frames_lost += 1;
            self.given_up |= 1 << flight.index;
            for at in flight.slots.drain(..) {
                let slot = &mut self.slots[at];
                if slot.abandoned {
                    self.put_back(at);
                } else if slot.retries > 0 {
                    slot.retries -= 1;
                    slot.losses = slot.losses.saturating_add(1);
                    slot.state = SlotState::Queued;
                    self.push(at);
                } else {
                    self.lose(at);
                }
            }
            self.spare.push(flight.slots);
        }
    }

    /// When a frame will be given up or a wait ends.
    #[inline]
    pub fn next_timeout(&self) -> Time<Host> {
        let flights = self.flights.iter().map(|flight| flight.deadline);
        flights.fold(self.wake, Time::min)
    }

    /// Number of frames in flight.
    #[inline]
    pub fn in_flight(&self) -> usize {
        self.flights.len()
    }

    /// Called before each round of polling.
    #[inline]
    pub fn forget_waits(&mut self) {
        self.wake = Time::NEVER;
    }

    /// Whether a frame with our own source address, unmarked by an ESC, is an answer; `payload` is
    /// its datagrams. It is one if an ESC has processed it. An unprocessed frame is one only if the
    /// segment is known not to mark frames and the interface does not show the frames it sends.
    #[cold]
    pub fn is_answer(&mut self, payload: &[u8], statistics: &Statistics) -> bool {
        let index = payload.get(1).copied().unwrap_or_default();
        let flight = self.flights.iter().find(|flight| flight.index == index);
        let sent = |number: usize| match (index < CYCLIC_INDEX, flight) {
            // The only position in the cycle is that of its broadcast read.
            (false, _) => Some(0),
            (true, flight) => {
                let slots = flight.map_or(&[][..], |flight| &flight.slots).iter();
                let of = |slot: &usize| &self.slots[*slot];
                let datagrams =
                    slots.map(of).flat_map(|slot| (0..slot.batch.max(1)).map(move |_| slot));
                datagrams.into_iter().nth(number).map(|slot| slot.address.raw() as u16)
            }
        };
        if is_touched(payload, sent) {
            self.unmarked = true;
            return true;
        }
        self.unmarked && statistics.frames_echoed == 0
    }

    /// From now on the first ESC is expected to mark frames, until a frame shows that it does not.
    pub fn expect_marks(&mut self) {
        self.unmarked = false;
    }

    /// Whether a frame with this index was given up and is not back yet; it counts as back from now
    /// on.
    pub fn take_given_up(&mut self, index: u8) -> bool {
        let bit = 1 << (index % CYCLIC_INDEX);
        let was = self.given_up & bit != 0;
        self.given_up &= !bit;
        was
    }

    /// Takes the first datagram out of the queue. The next one in the queue still has a waiting
    /// procedure.
    fn next_queued(&mut self) -> Option<usize> {
        let at = self.pop();
        self.drop_abandoned();
        at
    }

    /// Removes datagrams from the front of the queue for which no procedure waits.
    fn drop_abandoned(&mut self) {
        while let Some(&at) = self.queue.front()
            && self.slots[at].abandoned
        {
            self.pop();
            self.put_back(at);
        }
    }

    fn lose(&mut self, at: usize) {
        self.slots[at].state = SlotState::Lost;
        if self.slots[at].abandoned {
            self.put_back(at);
        }
    }

    /// The procedure no longer waits for this slot.
    pub fn release(&mut self, at: usize) {
        match self.slots[at].state {
            SlotState::InFlight => self.slots[at].abandoned = true,
            SlotState::Queued => {
                // It stays in the queue and is skipped at its turn: a search for it would take the
                // time of the whole queue for each datagram of a dropped procedure.
                self.slots[at].abandoned = true;
                if self.queue.front() == Some(&at) {
                    self.quiet_since = None;
                    self.drop_abandoned();
                }
            }
            SlotState::Done | SlotState::Lost => self.put_back(at),
            SlotState::Free => {}
        }
    }

    fn put_back(&mut self, at: usize) {
        let slot = &mut self.slots[at];
        slot.state = SlotState::Free;
        if slot.data.capacity() <= MOST_KEPT {
            slot.data.clear();
        } else {
            slot.data = Vec::new();
        }
        self.free.push(at);
    }
}

impl Slot {
    /// Bytes in the frame.
    fn octets(&self) -> usize {
        self.data.len() + if self.batch == 0 { HEADER_LEN + WKC_LEN } else { 0 }
    }

    /// What follows the datagrams of this slot in a received frame; `None` if others are there.
    /// `is_last`: none may follow.
    fn behind<'b>(&self, bytes: &'b [u8], is_last: bool) -> Option<&'b [u8]> {
        if self.batch > 0 {
            return self.behind_batch(bytes, is_last);
        }
        let (header, rest) = bytes.split_first_chunk()?;
        let header = Header::parse(header);
        // ESCs increment the position; the other half of the address does not change.
        let same_place = if self.command.increments_position() {
            header.ado() == (self.address.raw() >> 16) as u16
        } else {
            header.address == self.address.raw()
        };
        let same_length = usize::from(header.len) == self.data.len();
        let same = header.command == self.command as u8 && same_length && same_place;
        let rest = rest.get(self.data.len() + WKC_LEN..)?;
        (same && header.more != is_last).then_some(rest)
    }

    fn behind_batch<'b>(&self, bytes: &'b [u8], is_last: bool) -> Option<&'b [u8]> {
        let (found, rest) = bytes.split_at_checked(self.data.len())?;
        // All datagrams are looked at, and what differs is gathered: nearly always it is nothing.
        // Ours all say that another one follows, and the last one may be right not to.
        let (mut differs, mut last) = (0, 0);
        let mut at = 0;
        while let (Some(ours), Some(theirs)) = (start_at(&self.data, at), start_at(found, at)) {
            differs |= last;
            last = ours ^ theirs;
            at += HEADER_LEN + (ours >> 48 & 0x07FF) as usize + WKC_LEN;
        }
        let same = differs & (UNCHANGED | MORE) == 0 && last & UNCHANGED == 0;
        let ends = last & MORE != 0;
        (same && ends == is_last).then_some(rest)
    }
}

/// The first eight bytes of a header at this place: command, index, address, length and flags.
#[inline(always)]
fn start_at(datagrams: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(*datagrams.get(at..)?.first_chunk()?))
}

/// The flag that another datagram follows.
const MORE: u64 = 1 << 63;

/// The bits of these that come back as they were sent, of commands that increment no position:
/// neither the index, which the flight has, nor the flags.
const UNCHANGED: u64 = 0x07FF_FFFF_FFFF_00FF;
