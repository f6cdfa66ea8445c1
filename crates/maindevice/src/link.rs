//! Datagrams that procedures await: the queue, the frames in flight, the waiting.
//!
//! A [`Link`] is the procedures' side of the machine: cheap to clone, shared by all of them. A
//! datagram is queued when its [`Exchange`] is made, packed into the next frame with as many others
//! as fit, and finished when the frame comes back or is given up. So a procedure that needs several
//! answers at once makes its exchanges first and awaits them afterwards. Joined procedures of many
//! devices thus share frames without any coordination.
//!
//! Both sides work on the [`Port`], with all datagrams in flight and queued, and the [`Board`],
//! with the state of the run. These have one owner at a time: the machine, which puts them on the
//! desk in the link only while procedures run. So the frames of the cycle need no lock. The lock of
//! the desk makes the machine `Send` and never blocks.
//!
//! No waker is used: the machine polls its procedures after every input, since only an input can
//! change their state.

use alloc::boxed::Box;
use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll};

use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::frame::MAX_LEN;
use isocat_wire::register::{Register, Value};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AutoIncrementAddress, StationAddress};
use spin::Mutex;

use crate::board::Board;
use crate::error::{AccessError, AccessProblem};
use crate::event::Event;

mod origin;
mod port;

pub(crate) use origin::{Origin, is_touched};
pub(crate) use port::Port;

/// Waits end on this grid of host time, so that the polls of many devices share one frame.
pub(crate) const GRAIN: Nanos = Nanos(50_000);
/// Datagram indices of the link's frames are below this one; those of the cycle are not below.
pub(crate) const CYCLIC_INDEX: u8 = 0x80;

/// The procedures' handle of the machine.
#[derive(Clone)]
pub(crate) struct Link {
    desk: Arc<Mutex<Desk>>,
    /// Whether its datagrams go ahead of those of other handles.
    ahead: bool,
}

/// The place of the shared data while procedures run.
struct Desk {
    /// `None`: the machine owns it, and no procedure runs.
    shared: Option<Box<Shared>>,
    /// Slots of exchanges that were dropped meanwhile.
    released: Vec<usize>,
}

/// What procedures and machine work on.
pub(crate) struct Shared {
    pub port: Port,
    pub board: Board,
}

/// A datagram that came back.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Reply {
    pub data: Vec<u8>,
    pub wkc: u16,
    /// Number of ESCs that it passed, by the increments of its position. 0 for commands without a
    /// position.
    pub passed: u16,
    /// Time stamp of the frame that carried it.
    pub sent: Time<Host>,
}

/// A datagram that is queued or in flight.
pub(crate) struct Exchange {
    link: Link,
    slot: usize,
    command: Command,
    address: Address,
}

/// How a datagram travels.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Travel {
    /// In a separate frame.
    pub alone: bool,
    /// Whether a loss is reported at once, because the receiver could not tell a repetition from a
    /// new request.
    pub once: bool,
    /// Whether it leaves only when every other frame is back, including those of the cycle. If that
    /// does not happen within 100 ms, it is lost.
    pub quiet: bool,
    /// Whether it is in one frame with the datagram that is queued next: both arrive, or neither.
    pub with_next: bool,
    /// Whether it leaves before everything that is queued, even if as much is in flight as fits on
    /// the way.
    pub ahead: bool,
}

impl Link {
    pub fn new(now: Time<Host>, source: [u8; 6], frame_timeout: Nanos, retries: u8) -> Self {
        let port = Port::new(now, source, frame_timeout, retries);
        let shared = Box::new(Shared { port, board: Board::new() });
        let desk = Desk { shared: Some(shared), released: Vec::new() };
        Self { desk: Arc::new(Mutex::new(desk)), ahead: false }
    }

    /// A handle whose datagrams go ahead of those of other handles.
    pub fn ahead(&self) -> Self {
        Self { desk: self.desk.clone(), ahead: true }
    }

    /// Takes the shared data for the machine; no procedure may run until it is put back.
    pub fn take(&self) -> Box<Shared> {
        self.desk(|desk| desk.shared.take()).expect("it is taken once, before it is laid back")
    }

    /// Puts the shared data back.
    pub fn lay_back(&self, mut shared: Box<Shared>) {
        self.desk(|desk| {
            for slot in desk.released.drain(..) {
                shared.port.release(slot);
            }
            desk.shared = Some(shared);
        });
    }

    /// Accesses the shared data.
    pub fn with<R>(&self, f: impl FnOnce(&mut Shared) -> R) -> R {
        self.desk(|desk| f(desk.shared.as_mut().expect("procedures run while it is on the desk")))
    }

    /// Accesses the desk. The machine and all of its procedures run in one thread at a time, so
    /// this never blocks.
    fn desk<R>(&self, f: impl FnOnce(&mut Desk) -> R) -> R {
        f(&mut self.desk.try_lock().expect("one thread has the machine, and asks once at a time"))
    }

    /// Accesses the board.
    pub fn board<R>(&self, f: impl FnOnce(&mut Board) -> R) -> R {
        self.with(|shared| f(&mut shared.board))
    }

    pub fn now(&self) -> Time<Host> {
        self.with(|shared| shared.port.now)
    }

    pub fn report(&self, event: Event) {
        self.board(|board| board.report(event));
    }

    /// Queues a datagram.
    pub fn exchange(
        &self,
        command: Command,
        address: Address,
        data: Vec<u8>,
        travel: Travel,
    ) -> Exchange {
        let travel = Travel { ahead: travel.ahead || self.ahead, ..travel };
        let slot = self.with(|shared| shared.port.enqueue(command, address, data, travel));
        Exchange { link: self.clone(), slot, command, address }
    }

    /// Reads `len` bytes of one SubDevice.
    pub fn fprd(&self, station: StationAddress, ado: u16, len: usize) -> Exchange {
        let (command, address) = (Command::Fprd, Address::Station(station, ado));
        let travel = Travel { ahead: self.ahead, ..Travel::default() };
        let slot = self.with(|shared| shared.port.enqueue_read(command, address, len, travel));
        Exchange { link: self.clone(), slot, command, address }
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

    /// Reads bytes of all SubDevices, combined by OR.
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
        core::future::poll_fn(|_| match self.with(|shared| shared.port.waits_until(due)) {
            true => Poll::Pending,
            false => Poll::Ready(()),
        })
        .await;
    }

    /// Waits until the condition holds; it is checked after every input. Returns `false` if it does
    /// not hold by `due`.
    pub async fn wait_for(&self, due: Time<Host>, holds: impl Fn(&Board) -> bool) -> bool {
        core::future::poll_fn(|_| {
            self.with(|shared| {
                if holds(&shared.board) {
                    return Poll::Ready(true);
                }
                match shared.port.waits_until(due) {
                    true => Poll::Pending,
                    false => Poll::Ready(false),
                }
            })
        })
        .await
    }
}

/// The value in a reply. Its length is that of the register, since the machine checks lengths.
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
        counts(command, address, &reply, expected)?;
        Ok(reply)
    }

    /// The first bytes of the reply, if its working counter is `expected`. It allocates nothing.
    pub async fn bytes<const LEN: usize>(self, expected: u16) -> Result<[u8; LEN], AccessError> {
        let (command, address) = (self.command, self.address);
        let answer = core::future::poll_fn(|_| {
            self.link.with(|shared| shared.port.answer_with(self.slot, expected))
        });
        answer.await.map_err(|problem| AccessError { command, address, problem })
    }

    /// Whether the working counter of its reply is `expected`.
    pub fn counts(&self, reply: &Reply, expected: u16) -> Result<(), AccessError> {
        counts(self.command, self.address, reply, expected)
    }
}

fn counts(
    command: Command,
    address: Address,
    reply: &Reply,
    expected: u16,
) -> Result<(), AccessError> {
    if reply.wkc == expected {
        return Ok(());
    }
    let problem = AccessProblem::WorkingCounter { expected, found: reply.wkc };
    Err(AccessError { command, address, problem })
}

impl Future for Exchange {
    /// `None`: lost.
    type Output = Option<Reply>;

    fn poll(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Self::Output> {
        self.link.with(|shared| shared.port.answer(self.slot))
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        self.link.desk(|desk| match &mut desk.shared {
            Some(shared) => shared.port.release(self.slot),
            None => desk.released.push(self.slot),
        });
    }
}

impl Shared {
    /// See [`Port::transmit`].
    pub fn transmit(&mut self, now: Time<Host>, buffer: &mut [u8], most: usize) -> Option<usize> {
        self.port.transmit(now, buffer, most, &mut self.board.statistics)
    }

    /// See [`Port::receive`].
    pub fn receive(&mut self, payload: &[u8]) -> bool {
        self.port.receive(payload, &mut self.board.statistics)
    }

    /// Sets the time to `now`: see [`Port::handle_timeout`].
    #[inline]
    pub fn handle_timeout(&mut self, now: Time<Host>) {
        self.port.now = now;
        self.port.handle_timeout(&mut self.board.statistics);
    }
}

/// A procedure that may borrow from its caller.
pub(crate) type Procedure<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Runs procedures concurrently; ends with the first error, or with all results in order.
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

/// Waits for `main` and drives `other` meanwhile. Its result is put into `done` if it ends first.
pub(crate) async fn drive_beside<A, B>(
    main: impl Future<Output = A>,
    mut other: Pin<&mut impl Future<Output = B>>,
    done: &mut Option<B>,
) -> A {
    let mut main = core::pin::pin!(main);
    core::future::poll_fn(move |context| {
        let result = main.as_mut().poll(context);
        if result.is_pending()
            && done.is_none()
            && let Poll::Ready(value) = other.as_mut().poll(context)
        {
            *done = Some(value);
        }
        result
    })
    .await
}

/// Longest frame that the machine makes; a buffer of this length is always enough.
pub const FRAME_LEN: usize = MAX_LEN;
