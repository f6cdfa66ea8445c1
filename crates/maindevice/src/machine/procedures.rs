//! The procedures that run beside the cycle, all in one set.

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll, Waker};

use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::delay::Times;
use crate::delay_watch::Change;
use crate::error::{AccessError, Cause, SdoResult};
use crate::event::RequestId;
use crate::health::Look;
use crate::mailbox::Mailbox;
use crate::quality::Registers;
use crate::segment::SubDevice;

use super::background::{Ends, Kind};

/// What a procedure gives at its end.
pub(super) enum Ended {
    /// An object access that was asked for; its mailbox comes back.
    Request { request: RequestId, position: usize, is_download: bool, answer: Answer },
    /// A read of memory.
    Read(RequestId, Result<Vec<u8>, AccessError>),
    /// An entry of the background; what its mailbox had spent before.
    Entry { position: usize, object: ObjectAddress, before: Nanos, answer: Answer },
    /// A look at the states of all.
    Look(Look),
    /// Delays that were set right, by position.
    Shift(Vec<(usize, Nanos)>),
    /// All that were being taken up have come to their end.
    Readmit,
    /// A SubDevice that left OP.
    Recover(usize, Result<SubDevice, Cause>),
    /// A write of 0x0928; whether it was taken.
    Rewrite(Change, bool),
    /// A latch of the receive times; `None`: it did not come back whole.
    Latch(Option<Times>),
    /// Registers of clocks.
    Clocks(Vec<(usize, Option<Registers>)>),
}

/// A mailbox and what came through it.
pub(super) type Answer = (Mailbox, SdoResult);

/// Whom a procedure is about.
#[derive(Clone, Copy, Default)]
pub(super) struct About {
    /// The SubDevice, if it is one.
    pub(super) position: Option<usize>,
    /// The object access that waits for the answer; whether it is a download.
    pub(super) request: Option<(RequestId, bool)>,
}

/// All procedures beside the cycle, by kind.
#[derive(Default)]
pub(super) struct Procedures {
    all: [Vec<Procedure>; Kind::ALL.len()],
    count: usize,
}

struct Procedure {
    about: About,
    task: Pin<Box<dyn Future<Output = Ended> + Send>>,
    /// It was through at once.
    ended: Option<Ended>,
}

impl Procedures {
    /// Starts one: its first datagrams are queued.
    pub fn start(
        &mut self,
        kind: Kind,
        about: About,
        task: impl Future<Output = Ended> + Send + 'static,
    ) {
        let mut task: Pin<Box<dyn Future<Output = Ended> + Send>> = Box::pin(task);
        let ended = match poll(&mut task) {
            Poll::Ready(ended) => Some(ended),
            Poll::Pending => None,
        };
        self.all[kind as usize].push(Procedure { about, task, ended });
        self.count += 1;
    }

    /// Goes on with those of a kind from number `from` on, until one ends; `from` is where to go on then.
    pub fn go_on(&mut self, kind: Kind, from: &mut usize) -> Option<Ended> {
        let all = &mut self.all[kind as usize];
        while let Some(procedure) = all.get_mut(*from) {
            let ended = match procedure.ended.take() {
                Some(ended) => Poll::Ready(ended),
                None => poll(&mut procedure.task),
            };
            if let Poll::Ready(ended) = ended {
                drop(all.swap_remove(*from));
                self.count -= 1;
                return Some(ended);
            }
            *from += 1;
        }
        None
    }

    /// Drops those that end with this, and gives whom they were about.
    pub fn end(&mut self, with: Ends) -> Vec<About> {
        let mut ended = Vec::new();
        for kind in Kind::ALL.into_iter().filter(|kind| kind.ends() <= with) {
            let all = core::mem::take(&mut self.all[kind as usize]);
            self.count -= all.len();
            ended.extend(all.into_iter().map(|procedure| procedure.about));
        }
        ended
    }

    /// Drops those of a kind that are about a position.
    pub fn end_at(&mut self, kind: Kind, position: usize) {
        let all = &mut self.all[kind as usize];
        self.count -= all.len();
        all.retain(|procedure| procedure.about.position != Some(position));
        self.count += all.len();
    }

    /// Whether one of a kind is under way.
    pub fn has(&self, kind: Kind) -> bool {
        !self.all[kind as usize].is_empty()
    }

    /// Whether one of a kind is under way that is about a position.
    pub fn has_at(&self, kind: Kind, position: usize) -> bool {
        self.all[kind as usize].iter().any(|procedure| procedure.about.position == Some(position))
    }

    /// Whether none is under way.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

impl About {
    /// Of one SubDevice.
    pub fn position(position: usize) -> Self {
        Self { position: Some(position), request: None }
    }
}

/// Lets a procedure go on; nothing wakes it, as the machine asks it behind each input.
pub(super) fn poll<T: ?Sized + Future>(future: &mut Pin<Box<T>>) -> Poll<T::Output> {
    future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
}
