//! The connection between a stack and the segment.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use isocat_serve::bus::Arrival;
use isocat_sim::MainPort;

use crate::Bus;

/// A packet socket at the segment, for a stack that builds its own frames.
///
/// Like packet sockets of a kernel, each socket receives every frame that comes back at its port.
/// In a ring, that is not the port that the frame left.
pub struct Socket {
    bus: Bus,
    port: MainPort,
    pub(crate) queue: Rc<RefCell<Queue>>,
}

/// Frames that were not received yet.
pub(crate) struct Queue {
    port: MainPort,
    frames: VecDeque<Vec<u8>>,
    waits: Option<Waker>,
}

/// Frames that can wait; further ones are lost, as in the buffer of a kernel's socket.
pub const MOST_WAITING: usize = 1_024;

impl Socket {
    pub(crate) fn new(bus: Bus, port: MainPort) -> Self {
        let queue = Queue { port, frames: VecDeque::new(), waits: None };
        Self { bus, port, queue: Rc::new(RefCell::new(queue)) }
    }

    /// Sends a frame of 14 to 1514 bytes, from the destination address on, without check sequence.
    /// Its first bit leaves now, or when the previous frame has left.
    ///
    /// # Panics
    ///
    /// If no frame has this length.
    #[track_caller]
    pub fn send(&self, frame: &[u8]) {
        if let Err(error) = self.bus.0.send(self.port, frame) {
            panic!("a frame was not sent: {error}");
        }
    }

    /// Waits for the next frame.
    pub async fn receive(&self) -> Vec<u8> {
        std::future::poll_fn(|context| self.poll_receive(context)).await
    }

    /// Waits for the next frame; `None` if none has come within `time`. The host wakes late, as
    /// from [`Bus::host_sleep`].
    pub async fn receive_for(&self, time: Duration) -> Option<Vec<u8>> {
        let mut end = self.bus.host_sleep(time);
        std::future::poll_fn(|context| match self.poll_receive(context) {
            Poll::Ready(frame) => Poll::Ready(Some(frame)),
            Poll::Pending => std::pin::Pin::new(&mut end).poll(context).map(|()| None),
        })
        .await
    }

    /// The next frame, if one has already come.
    pub fn try_receive(&self) -> Option<Vec<u8>> {
        self.queue.borrow_mut().frames.pop_front()
    }

    /// For futures written by hand: returns the next frame, or wakes the task when one comes. Only
    /// one task can wait at a time.
    pub fn poll_receive(&self, context: &mut Context<'_>) -> Poll<Vec<u8>> {
        let mut queue = self.queue.borrow_mut();
        match queue.frames.pop_front() {
            Some(frame) => Poll::Ready(frame),
            None => {
                queue.waits = Some(context.waker().clone());
                Poll::Pending
            }
        }
    }
}

impl Queue {
    /// Adds a frame that has come back.
    pub fn put(&mut self, arrival: &Arrival) {
        if arrival.port != self.port || self.frames.len() >= MOST_WAITING {
            return;
        }
        self.frames.push_back(arrival.frame.clone());
        if let Some(waker) = self.waits.take() {
            waker.wake();
        }
    }
}
