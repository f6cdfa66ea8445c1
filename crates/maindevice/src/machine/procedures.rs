//! The procedures in addition to the cycle, all in one set.

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll, Waker};

use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::delay::Times;
use crate::delay_watch::Change;
use crate::error::{AccessError, SdoResult};
use crate::event::RequestId;
use crate::health::Look;
use crate::mailbox::Mailbox;
use crate::readmit::Recovered;

use super::background::{Ends, Kind};

/// The result of a procedure.
pub(super) enum Ended {
    /// A requested object access; it returns the mailbox.
    Request { request: RequestId, position: usize, is_download: bool, answer: Answer },
    /// A read of memory.
    Read(RequestId, Result<Vec<u8>, AccessError>),
    /// An entry read in the background; `before` is what its mailbox had spent before.
    Entry { position: usize, object: ObjectAddress, before: Nanos, answer: Answer },
    /// The states of all SubDevices.
    Look(Look),
    /// Corrected delays, by position.
    Shift(Vec<(usize, Nanos)>),
    /// All SubDevices that were being re-admitted have come to their end.
    Readmit,
    /// The recovery of a SubDevice that left OP.
    Recover(usize, Box<Recovered>),
    /// A write of 0x0928; whether it was accepted.
    Rewrite(Change, bool),
    /// A latch of the receive times; `None`: it did not come back complete.
    Latch(Option<Times>),
}

/// A mailbox and the answer that came through it.
pub(super) type Answer = (Mailbox, SdoResult);

/// The subject of a procedure.
#[derive(Clone, Copy, Default)]
pub(super) struct About {
    /// The SubDevice, if there is only one.
    pub(super) position: Option<usize>,
    /// The object access that waits for the answer, and whether it is a download.
    pub(super) request: Option<(RequestId, bool)>,
}

/// All procedures in addition to the cycle, by kind.
#[derive(Default)]
pub(super) struct Procedures {
    all: [Vec<Procedure>; Kind::ALL.len()],
    count: usize,
}

struct Procedure {
    about: About,
    task: Pin<Box<dyn Future<Output = Ended> + Send>>,
    /// The result, if the procedure ended at once.
    ended: Option<Ended>,
}

impl Procedures {
    /// Starts a procedure: its first datagrams are queued.
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

    /// Polls the procedures of a kind from number `from` on until one ends; `from` is then where to
    /// continue.
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

    /// Drops the procedures that end with this level, and returns their subjects.
    pub fn end(&mut self, with: Ends) -> Vec<About> {
        let mut ended = Vec::new();
        for kind in Kind::ALL.into_iter().filter(|kind| kind.ends() <= with) {
            let all = core::mem::take(&mut self.all[kind as usize]);
            self.count -= all.len();
            ended.extend(all.into_iter().map(|procedure| procedure.about));
        }
        ended
    }

    /// Drops the procedures of a kind at a position, and returns their subjects.
    pub fn end_at(&mut self, kind: Kind, position: usize) -> Vec<About> {
        let all = &mut self.all[kind as usize];
        let is_meant = |procedure: &mut Procedure| procedure.about.position == Some(position);
        let ended: Vec<About> = all.extract_if(.., is_meant).map(|ended| ended.about).collect();
        self.count -= ended.len();
        ended
    }

    /// Whether a procedure of this kind runs.
    pub fn has(&self, kind: Kind) -> bool {
        !self.all[kind as usize].is_empty()
    }

    /// Whether a procedure of this kind runs at a position.
    pub fn has_at(&self, kind: Kind, position: usize) -> bool {
        self.all[kind as usize].iter().any(|procedure| procedure.about.position == Some(position))
    }

    /// Whether no procedure runs.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

impl About {
    /// About one SubDevice.
    pub fn position(position: usize) -> Self {
        Self { position: Some(position), request: None }
    }
}

/// Polls a procedure. Nothing wakes it, since the machine polls it after each input.
pub(super) fn poll<T: ?Sized + Future>(future: &mut Pin<Box<T>>) -> Poll<T::Output> {
    future.as_mut().poll(&mut Context::from_waker(Waker::noop()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken_up() -> impl Future<Output = Ended> + Send {
        core::future::ready(Ended::Readmit)
    }

    /// Each level ends what the levels before it end, and nothing else; requests that wait for an
    /// answer are returned.
    #[test]
    fn what_ends_is_told_by_its_kind() {
        for (with, left) in [(Ends::Way, 7), (Ends::Operation, 1), (Ends::Run, 0)] {
            let mut procedures = Procedures::default();
            assert!(procedures.is_empty());
            for kind in Kind::ALL {
                let request = (kind == Kind::Request).then_some((RequestId(7), true));
                procedures.start(kind, About { position: Some(3), request }, taken_up());
            }
            let ended = procedures.end(with);
            assert_eq!(ended.len(), Kind::ALL.len() - left);
            let asked: Vec<_> = ended.iter().filter_map(|about| about.request).collect();
            let expected: &[_] =
                if with >= Ends::Operation { &[(RequestId(7), true)] } else { &[] };
            assert_eq!(asked, expected);
            assert_eq!(Kind::ALL.into_iter().filter(|kind| procedures.has(*kind)).count(), left);
            assert_eq!(procedures.is_empty(), left == 0);
        }
    }

    /// A procedure that ends at once is not lost, and procedures of one SubDevice end separately.
    #[test]
    fn each_ends_once() {
        let mut procedures = Procedures::default();
        for position in 0..3 {
            procedures.start(Kind::Recover, About::position(position), taken_up());
        }
        procedures.start(Kind::Recover, About::position(9), core::future::pending());
        procedures.end_at(Kind::Recover, 1);
        assert!(procedures.has_at(Kind::Recover, 0) && !procedures.has_at(Kind::Recover, 1));
        let (mut from, mut ended) = (0, 0);
        while procedures.go_on(Kind::Recover, &mut from).is_some() {
            ended += 1;
        }
        assert_eq!(ended, 2);
        assert!(!procedures.is_empty() && procedures.has_at(Kind::Recover, 9));
        assert!(procedures.go_on(Kind::Look, &mut 0).is_none());
        procedures.end_at(Kind::Recover, 9);
        assert!(procedures.is_empty());
    }
}
