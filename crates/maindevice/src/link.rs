//! Datagrams that procedures await: the queue, the frames in flight, the waiting.
//!
//! A [`Link`] is the procedures' side of the machine: cheap to clone, shared by all of them. A
//! datagram is queued when its [`Exchange`] is made, packed with as many others as fit into the
//! next frame, and finished when the frame comes back or is given up. So a procedure that needs
//! several answers at once makes its exchanges first and awaits them afterwards; procedures of many
//! devices that run joined share frames without knowing of each other.
//!
//! What both sides work on has one owner at a time: the machine holds it by itself and lays it on the desk that is in
//! the link only while procedures run. So frames of the cycle go in and out without a lock, and the lock of the
//! desk, which makes the machine `Send`, is never waited for.
//!
//! No waker is used: the machine polls its procedures after every input, which is the only time at
//! which something can have changed.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll};

use isocat_wire::command::Command;
use isocat_wire::datagram::{self, Address, Layouts};
use isocat_wire::frame::{
    ETHERCAT_HEADER_LEN, ETHERNET_HEADER_LEN, FrameWriter, LOCALLY_ADMINISTERED, MAX_LEN,
    payload_offset,
};
use isocat_wire::register::{Register, Value};
use isocat_wire::time::{Dc, Host, Nanos, Time};
use isocat_wire::{AutoIncrementAddress, StationAddress};
use spin::Mutex;

use crate::error::{AccessError, AccessProblem};
use crate::event::Event;
use crate::ring;
use crate::statistics::Statistics;

/// Waits end on this grid of host time, so that polls of many devices meet in one frame.
pub(crate) const GRAIN: Nanos = Nanos(50_000);
/// Datagram indices of the link's frames are below this one; those of the cycle are not.
pub(crate) const CYCLIC_INDEX: u8 = 0x80;
/// Bytes of a frame before its first datagram.
const HEADERS: usize = ETHERNET_HEADER_LEN + ETHERCAT_HEADER_LEN;
/// Most frames of the link in flight. More than a long line needs to be filled, and few enough that
/// an index comes again only long after its frame was given up.
const MOST_FLIGHTS: usize = 24;
/// A repetition waits for at most two to this power times as long as the first frame.
const MOST_DOUBLINGS: u8 = 4;
/// Events kept until somebody takes them; more are counted and dropped, so that memory is bounded.
const MOST_EVENTS: usize = 1024;

/// The procedures' handle of the machine.
#[derive(Clone)]
pub(crate) struct Link(Arc<Mutex<Desk>>);

/// Where the machine lays what it works on while its procedures run.
struct Desk {
    /// `None`: the machine has it in hand, and no procedure runs.
    inner: Option<Box<Inner>>,
    /// Slots of exchanges that were dropped meanwhile.
    released: Vec<usize>,
}

/// What the machine itself works on.
pub(crate) struct Inner {
    pub now: Time<Host>,
    pub statistics: Statistics,
    pub source: [u8; 6],
    /// Cycles in a row whose process data all counted right; kept by the machine.
    pub complete_cycles: u64,
    /// Working counter expected and found where process data were last incomplete.
    pub incomplete: (u16, u16),
    /// Cycles begun; kept by the machine.
    pub cycle: u64,
    /// Last reference time that the cycle brought back, and when its frame was sent.
    pub reference_time: (Time<Host>, Time<Dc>),
    /// Whether the cycle's drift datagram leads the clocks, and does not only read; kept by the machine.
    pub leading: bool,
    /// When a drift frame was last sent beside those of the cycle.
    pub hastened: Time<Host>,
    /// What the ring is, if there is to be one.
    pub ring: Option<ring::Shared>,
    /// What a procedure wants of the cycle; taken by the machine.
    pub wishes: VecDeque<Wish>,
    frame_timeout: Nanos,
    retries: u8,
    slots: Vec<Slot>,
    free: Vec<usize>,
    queue: VecDeque<usize>,
    flights: Vec<Flight>,
    next_index: u8,
    /// Earliest end of a wait, collected anew in each round of polling.
    wake: Time<Host>,
    events: VecDeque<Event>,
    dropped: u64,
}

/// What a procedure wants of the cyclic exchange.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Wish {
    /// The clocks are left to themselves.
    HoldClocks,
    /// This position leads the clocks from now on.
    Lead(usize),
}

struct Slot {
    state: SlotState,
    command: Command,
    address: Address,
    data: Vec<u8>,
    wkc: u16,
    sent: Time<Host>,
    retries: u8,
    /// Losses so far.
    losses: u8,
    alone: bool,
    /// Nobody waits any more.
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
    slots: Vec<usize>,
}

/// Where a frame that came in is from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Origin {
    /// From us, through a SubDevice or by a source address that can't show it.
    Ours {
        /// Where its datagrams begin.
        payload: usize,
    },
    /// From us, untouched.
    Echo,
    /// From another MainDevice.
    Foreign([u8; 6]),
    /// Not EtherCAT.
    Other,
}

impl Origin {
    /// The first ESC that a frame passes sets bit 1 of its source address.
    #[inline]
    pub fn of(frame: &[u8], source: [u8; 6]) -> Self {
        let Ok(payload) = payload_offset(frame) else { return Origin::Other };
        let Some(found) = frame[6..].first_chunk::<6>() else { return Origin::Other };
        if *found == source && source[0] & LOCALLY_ADMINISTERED == 0 {
            return Origin::Echo;
        }
        let passed = |mut address: [u8; 6]| {
            address[0] |= LOCALLY_ADMINISTERED;
            address
        };
        if passed(*found) == passed(source) {
            Origin::Ours { payload }
        } else {
            Origin::Foreign(*found)
        }
    }
}

/// A datagram that came back.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Reply {
    pub data: Vec<u8>,
    pub wkc: u16,
    /// Time stamp of the frame that carried it.
    pub sent: Time<Host>,
}

/// A datagram on its way.
pub(crate) struct Exchange {
    link: Link,
    slot: usize,
    command: Command,
    address: Address,
}

/// How a datagram travels.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Travel {
    /// In a frame of its own.
    pub alone: bool,
    /// A loss is reported at once: the receiver could not tell a repetition from a new request.
    pub once: bool,
}

impl Link {
    pub fn new(now: Time<Host>, source: [u8; 6], frame_timeout: Nanos, retries: u8) -> Self {
        let inner = Inner {
            now,
            statistics: Statistics::default(),
            source,
            complete_cycles: 0,
            incomplete: (0, 0),
            cycle: 0,
            reference_time: (Time::ZERO, Time::ZERO),
            leading: false,
            hastened: Time::ZERO,
            ring: None,
            wishes: VecDeque::new(),
            frame_timeout,
            retries,
            slots: Vec::new(),
            free: Vec::new(),
            queue: VecDeque::new(),
            flights: Vec::new(),
            next_index: 0,
            wake: Time::NEVER,
            events: VecDeque::with_capacity(MOST_EVENTS),
            dropped: 0,
        };
        Self(Arc::new(Mutex::new(Desk { inner: Some(Box::new(inner)), released: Vec::new() })))
    }

    /// The machine takes what is shared into its own hands: until it is laid back no procedure may run.
    pub fn take(&self) -> Box<Inner> {
        self.desk(|desk| desk.inner.take()).expect("it is taken once, before it is laid back")
    }

    /// The machine lays back what it took.
    pub fn lay_back(&self, mut inner: Box<Inner>) {
        self.desk(|desk| {
            for slot in desk.released.drain(..) {
                inner.release(slot);
            }
            desk.inner = Some(inner);
        });
    }

    /// Looks at or changes what is shared.
    pub fn with<R>(&self, f: impl FnOnce(&mut Inner) -> R) -> R {
        self.desk(|desk| f(desk.inner.as_mut().expect("procedures run while it is on the desk")))
    }

    /// The machine and all of its procedures run in one thread at a time: nothing ever waits here.
    fn desk<R>(&self, f: impl FnOnce(&mut Desk) -> R) -> R {
        f(&mut self.0.try_lock().expect("one thread has the machine, and asks once at a time"))
    }

    pub fn now(&self) -> Time<Host> {
        self.with(|inner| inner.now)
    }

    pub fn report(&self, event: Event) {
        self.with(|inner| inner.report(event));
    }

    /// Queues a datagram.
    pub fn exchange(
        &self,
        command: Command,
        address: Address,
        data: Vec<u8>,
        travel: Travel,
    ) -> Exchange {
        let slot = self.with(|inner| {
            let slot = Slot {
                state: SlotState::Queued,
                command,
                address,
                data,
                wkc: 0,
                sent: Time::ZERO,
                retries: if travel.once { 0 } else { inner.retries },
                losses: 0,
                alone: travel.alone,
                abandoned: false,
            };
            let at = match inner.free.pop() {
                Some(at) => {
                    inner.slots[at] = slot;
                    at
                }
                None => {
                    inner.slots.push(slot);
                    inner.slots.len() - 1
                }
            };
            inner.queue.push_back(at);
            at
        });
        Exchange { link: self.clone(), slot, command, address }
    }

    /// Reads `len` bytes of one SubDevice.
    pub fn fprd(&self, station: StationAddress, ado: u16, len: usize) -> Exchange {
        let address = Address::Station(station, ado);
        self.exchange(Command::Fprd, address, vec![0; len], Travel::default())
    }

    /// Writes bytes to one SubDevice.
    pub fn fpwr(&self, station: StationAddress, ado: u16, data: &[u8]) -> Exchange {
        let address = Address::Station(station, ado);
        self.exchange(Command::Fpwr, address, data.to_vec(), Travel::default())
    }

    /// Reads `len` bytes of the SubDevice at a position.
    pub fn aprd(&self, position: usize, ado: u16, len: usize) -> Exchange {
        let adp = AutoIncrementAddress::of_position(position as u16);
        let address = Address::Position(adp, ado);
        self.exchange(Command::Aprd, address, vec![0; len], Travel::default())
    }

    /// Writes bytes to the SubDevice at a position.
    pub fn apwr(&self, position: usize, ado: u16, data: &[u8]) -> Exchange {
        let adp = AutoIncrementAddress::of_position(position as u16);
        let address = Address::Position(adp, ado);
        self.exchange(Command::Apwr, address, data.to_vec(), Travel::default())
    }

    /// Reads bytes of all SubDevices, OR-ed.
    pub fn brd(&self, ado: u16, len: usize) -> Exchange {
        self.exchange(Command::Brd, Address::Broadcast(ado), vec![0; len], Travel::default())
    }

    /// Writes bytes to all SubDevices.
    pub fn bwr(&self, ado: u16, data: &[u8]) -> Exchange {
        self.exchange(Command::Bwr, Address::Broadcast(ado), data.to_vec(), Travel::default())
    }

    /// Reads a register; the working counter must be 1.
    pub async fn read<T: Value>(
        &self,
        station: StationAddress,
        register: Register<T>,
    ) -> Result<T, AccessError> {
        let reply = self.fprd(station, register.address, T::LEN).expect(1).await?;
        Ok(decode(register, &reply.data))
    }

    /// Reads a register that may not exist: `None` if the working counter stays 0.
    pub async fn try_read<T: Value>(
        &self,
        station: StationAddress,
        register: Register<T>,
    ) -> Result<Option<T>, AccessError> {
        let reply = self.fprd(station, register.address, T::LEN).reply().await?;
        Ok((reply.wkc > 0).then(|| decode(register, &reply.data)))
    }

    /// Writes a register; the working counter must be 1.
    pub async fn write<T: Value>(
        &self,
        station: StationAddress,
        register: Register<T>,
        value: T,
    ) -> Result<(), AccessError> {
        self.fpwr(station, register.address, value.to_bytes().as_ref()).expect(1).await?;
        Ok(())
    }

    /// Waits at least this long.
    pub async fn sleep(&self, span: Nanos) {
        let due = (self.now() + span).count().next_multiple_of(GRAIN.0 as u64);
        self.until(Time::new(due)).await;
    }

    /// Waits until a point of host time.
    pub async fn until(&self, due: Time<Host>) {
        core::future::poll_fn(|_| {
            self.with(|inner| {
                if inner.now >= due {
                    return Poll::Ready(());
                }
                inner.wake = inner.wake.min(due);
                Poll::Pending
            })
        })
        .await;
    }

    /// Waits until the condition holds; it is looked at after every input. Gives `false` if it does
    /// not hold by `due`.
    pub async fn wait_for(&self, due: Time<Host>, holds: impl Fn(&Inner) -> bool) -> bool {
        core::future::poll_fn(|_| {
            self.with(|inner| {
                if holds(inner) {
                    return Poll::Ready(true);
                }
                if inner.now >= due {
                    return Poll::Ready(false);
                }
                inner.wake = inner.wake.min(due);
                Poll::Pending
            })
        })
        .await
    }
}

/// The value in a reply, which has the register's length since the machine keeps lengths.
fn decode<T: Value>(register: Register<T>, data: &[u8]) -> T {
    let mut bytes = T::Bytes::default();
    bytes.as_mut().copy_from_slice(data);
    register.decode(&bytes)
}

impl Exchange {
    /// The reply, whatever its working counter.
    pub async fn reply(self) -> Result<Reply, AccessError> {
        let (command, address) = (self.command, self.address);
        self.await.ok_or(AccessError { command, address, problem: AccessProblem::Lost })
    }

    /// The reply, if its working counter is `expected`.
    pub async fn expect(self, expected: u16) -> Result<Reply, AccessError> {
        let (command, address) = (self.command, self.address);
        let reply = self.reply().await?;
        if reply.wkc != expected {
            let problem = AccessProblem::WorkingCounter { expected, found: reply.wkc };
            return Err(AccessError { command, address, problem });
        }
        Ok(reply)
    }
}

impl Future for Exchange {
    /// `None`: lost.
    type Output = Option<Reply>;

    fn poll(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Self::Output> {
        self.link.with(|inner| {
            let slot = &mut inner.slots[self.slot];
            match slot.state {
                SlotState::Done => Poll::Ready(Some(Reply {
                    data: core::mem::take(&mut slot.data),
                    wkc: slot.wkc,
                    sent: slot.sent,
                })),
                SlotState::Lost => Poll::Ready(None),
                _ => Poll::Pending,
            }
        })
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        self.link.desk(|desk| match &mut desk.inner {
            Some(inner) => inner.release(self.slot),
            None => desk.released.push(self.slot),
        });
    }
}

impl Inner {
    /// Builds the next frame of queued datagrams, of `most` bytes at most unless a single datagram
    /// is longer; `None` if nothing is queued or too much is in flight.
    pub fn transmit(&mut self, now: Time<Host>, buffer: &mut [u8], most: usize) -> Option<usize> {
        if self.queue.is_empty() || self.flights.len() >= MOST_FLIGHTS {
            return None;
        }
        let mut frame = FrameWriter::new(buffer, self.source);
        let index = self.free_index();
        let mut slots = Vec::new();
        let mut len = HEADERS;
        let mut losses = 0;
        while let Some(&at) = self.queue.front() {
            let slot = &mut self.slots[at];
            let more = slot.data.len() + datagram::HEADER_LEN + datagram::WKC_LEN;
            let first = slots.is_empty();
            if !first && (slot.alone || len + more > most) {
                break;
            }
            if frame.push(slot.command, index, slot.address, &slot.data).is_err() {
                break;
            }
            self.queue.pop_front();
            slot.state = SlotState::InFlight;
            slot.sent = now;
            slots.push(at);
            losses = losses.max(slot.losses);
            len += more;
            if slot.alone {
                break;
            }
        }
        if slots.is_empty() {
            // Longer than the caller's buffer: it will never go out.
            if let Some(at) = self.queue.pop_front() {
                self.lose(at);
            }
            return None;
        }
        self.next_index = (index + 1) % CYCLIC_INDEX;
        self.statistics.frames_sent += 1;
        self.statistics.datagrams += slots.len() as u64;
        // Each repetition waits twice as long: whoever was asleep on the way gets time to wake.
        let patience = Nanos(self.frame_timeout.0 << losses.min(MOST_DOUBLINGS));
        self.flights.push(Flight { index, deadline: now + patience, slots });
        Some(frame.finish())
    }

    /// The next index that no frame in flight has.
    fn free_index(&self) -> u8 {
        let mut index = self.next_index;
        while self.flights.iter().any(|flight| flight.index == index) {
            index = (index + 1) % CYCLIC_INDEX;
        }
        index
    }

    /// Bytes on the wire of the first datagram queued, as a frame of its own; `None` if nothing is
    /// queued.
    pub fn first_len(&self) -> Option<usize> {
        let &at = self.queue.front()?;
        let len = self.slots[at].data.len() + datagram::HEADER_LEN + datagram::WKC_LEN;
        Some(len + HEADERS)
    }

    /// Takes the datagrams of a frame that came back; `false` if it is none of ours.
    pub fn receive(&mut self, payload: &[u8]) -> bool {
        let Some(&index) = payload.get(1) else { return false };
        let Some(at) = self.flights.iter().position(|flight| flight.index == index) else {
            return false;
        };
        if !self.belongs(&self.flights[at].slots, payload) {
            return false;
        }
        let flight = self.flights.swap_remove(at);
        let mut layouts = Layouts::new();
        for at in flight.slots {
            let Some(Ok(layout)) = layouts.next(payload) else { break };
            let slot = &mut self.slots[at];
            slot.data.copy_from_slice(&payload[layout.data()..layout.wkc()]);
            slot.wkc = u16::from_le_bytes([payload[layout.wkc()], payload[layout.wkc() + 1]]);
            slot.state = SlotState::Done;
            if slot.abandoned {
                self.put_back(at);
            }
        }
        self.statistics.frames_received += 1;
        true
    }

    /// Counts a frame that is not an answer to us.
    #[cold]
    pub fn count_stranger(&mut self, origin: Origin) {
        match origin {
            Origin::Ours { .. } => {}
            Origin::Echo => self.statistics.frames_echoed += 1,
            Origin::Foreign(source) => {
                self.statistics.frames_foreign += 1;
                self.statistics.foreign_source = Some(source);
            }
            Origin::Other => self.statistics.frames_other += 1,
        }
    }

    /// Whether a frame holds just these datagrams.
    fn belongs(&self, slots: &[usize], payload: &[u8]) -> bool {
        let mut layouts = Layouts::new();
        for &at in slots {
            let slot = &self.slots[at];
            let Some(Ok(layout)) = layouts.next(payload) else { return false };
            let header = layout.header;
            // Positions are counted up on the way; the other half of the address stays.
            let same_place = if slot.command.increments_position() {
                header.ado() == (slot.address.raw() >> 16) as u16
            } else {
                header.address == slot.address.raw()
            };
            let same_length = usize::from(header.len) == slot.data.len();
            if header.command != slot.command as u8 || !same_length || !same_place {
                return false;
            }
        }
        layouts.next(payload).is_none()
    }

    /// Gives up frames whose time is over.
    #[inline]
    pub fn handle_timeout(&mut self) {
        let now = self.now;
        while let Some(at) = self.flights.iter().position(|flight| flight.deadline <= now) {
            let flight = self.flights.swap_remove(at);
            self.statistics.frames_lost += 1;
            for at in flight.slots {
                let slot = &mut self.slots[at];
                if slot.abandoned {
                    self.put_back(at);
                } else if slot.retries > 0 {
                    slot.retries -= 1;
                    slot.losses = slot.losses.saturating_add(1);
                    slot.state = SlotState::Queued;
                    self.queue.push_back(at);
                } else {
                    self.lose(at);
                }
            }
        }
    }

    /// When a frame will be given up or a wait ends.
    pub fn next_timeout(&self) -> Time<Host> {
        let flights = self.flights.iter().map(|flight| flight.deadline);
        flights.fold(self.wake, Time::min)
    }

    /// Frames that are under way.
    pub fn in_flight(&self) -> usize {
        self.flights.len()
    }

    /// Before each round of polling.
    pub fn forget_waits(&mut self) {
        self.wake = Time::NEVER;
    }

    pub fn report(&mut self, event: Event) {
        if self.events.len() >= MOST_EVENTS {
            self.dropped += 1;
        } else {
            self.events.push_back(event);
        }
    }

    pub fn poll_event(&mut self) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        let count = core::mem::take(&mut self.dropped);
        (count > 0).then_some(Event::Dropped { count })
    }

    fn lose(&mut self, at: usize) {
        self.slots[at].state = SlotState::Lost;
        if self.slots[at].abandoned {
            self.put_back(at);
        }
    }

    /// Nobody waits for a slot any more.
    fn release(&mut self, at: usize) {
        match self.slots[at].state {
            SlotState::InFlight => self.slots[at].abandoned = true,
            SlotState::Queued => {
                self.queue.retain(|queued| *queued != at);
                self.put_back(at);
            }
            SlotState::Done | SlotState::Lost => self.put_back(at),
            SlotState::Free => {}
        }
    }

    fn put_back(&mut self, at: usize) {
        self.slots[at].state = SlotState::Free;
        self.slots[at].data = Vec::new();
        self.free.push(at);
    }
}

/// A procedure that may borrow from its caller.
pub(crate) type Procedure<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Runs procedures side by side; ends with the first error, or with all results in order.
pub(crate) async fn join<T, E>(mut all: Vec<Procedure<'_, Result<T, E>>>) -> Result<Vec<T>, E> {
    let mut done: Vec<Option<T>> = all.iter().map(|_| None).collect();
    core::future::poll_fn(move |context| {
        let mut pending = false;
        for (procedure, done) in all.iter_mut().zip(&mut done) {
            if done.is_some() {
                continue;
            }
            match procedure.as_mut().poll(context) {
                Poll::Ready(Ok(value)) => *done = Some(value),
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => pending = true,
            }
        }
        if pending {
            return Poll::Pending;
        }
        Poll::Ready(Ok(done.iter_mut().filter_map(Option::take).collect()))
    })
    .await
}

/// Longest frame that the machine makes; a buffer of this length takes every one.
pub const FRAME_LEN: usize = MAX_LEN;
