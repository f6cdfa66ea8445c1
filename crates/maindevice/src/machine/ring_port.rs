//! The second port of a ring, and the effect of its state on the clocks.

use alloc::boxed::Box;

use isocat_wire::time::{Host, Time};

use super::way::Activity;
use super::{MainDevice, in_hand, take};
use crate::board::{RingState, View};
use crate::config::Config;
use crate::event::Event;
use crate::link::Link;
use crate::ring::{Copies, Port, Taken};

/// The ring of the machine.
pub(super) struct Ring {
    copies: Copies,
    /// The view last handled, and the number of SubDevices that took part.
    known: (View, u16),
    told: Told,
    /// The position last reported as reference of the clocks behind the cut.
    split: Option<usize>,
}

/// The last event of the ring.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Told {
    Whole,
    Cut((Option<usize>, Option<usize>)),
}

impl Ring {
    pub fn new(config: &Config, link: &Link, now: Time<Host>) -> Option<Box<Self>> {
        let ring = config.ring?;
        link.board(|board| board.ring = Some(RingState::default()));
        Some(Box::new(Self {
            copies: Copies::new(config, ring, now),
            known: (View::Unknown, 0),
            told: Told::Whole,
            split: None,
        }))
    }

    #[cold]
    pub fn next_timeout(&self) -> Time<Host> {
        self.copies.next_timeout()
    }
}

/// The second port.
impl MainDevice {
    /// As [`Self::handle_frame`], with the port that received the frame. Without [`Config::ring`]
    /// the ports make no difference.
    #[inline(never)]
    pub fn handle_frame_at(&mut self, port: Port, now: Time<Host>, frame: &[u8]) {
        let Self { ring, shared, cycle, config, .. } = self;
        let Some(ring) = ring else { return self.handle_frame(now, frame) };
        let copies = &mut ring.copies;
        let shared = in_hand(shared);
        shared.port.now = now;
        let taken = shared.board.ring.as_mut().map(|shared| copies.take(port, now, frame, shared));
        let taken = match taken {
            Some(Taken::Kept) => {
                self.close_cycle(now);
                return self.look_at_ring();
            }
            Some(Taken::Merged) => take(shared, cycle, config, now, copies.merged()),
            Some(Taken::AsItIs) | None => take(shared, cycle, config, now, frame),
        };
        self.look_at_ring();
        self.close_cycle(now);
        if taken {
            self.work();
        }
    }

    /// Writes the next frame for the secondary port of a ring into `buffer` and returns its length;
    /// `None` if there is nothing to send. Call this directly after each frame of
    /// [`Self::poll_transmit`] until it returns `None`: the frame is the copy of that frame.
    /// Without [`Config::ring`] it always returns `None`.
    ///
    /// ```
    /// # use isocat_maindevice::config::Ring;
    /// # use isocat_maindevice::{Config, FRAME_LEN, MainDevice, Port};
    /// # use isocat_wire::time::{Host, Nanos, Time};
    /// # let clock = || Time::<Host>::ZERO;
    /// # let (send_primary, send_secondary) = (|_: &[u8]| {}, |_: &[u8]| {});
    /// # let (mut buffer, frame) = ([0; FRAME_LEN], [0; 60]);
    /// # let mut config = Config::new(Nanos::millis(1));
    /// config.ring = Some(Ring::default());
    /// // ...
    /// # let mut main = MainDevice::new(config, clock());
    /// while let Some(len) = main.poll_transmit(clock(), &mut buffer) {
    ///     send_primary(&buffer[..len]);
    ///     while let Some(len) = main.poll_secondary(&mut buffer) {
    ///         send_secondary(&buffer[..len]);
    ///     }
    /// }
    /// main.handle_frame_at(Port::Secondary, clock(), &frame);
    /// ```
    pub fn poll_secondary(&mut self, buffer: &mut [u8]) -> Option<usize> {
        self.ring.as_mut()?.copies.transmit(buffer)
    }

    /// Copies a frame that leaves the primary port.
    #[cold]
    pub(super) fn copy(&mut self, now: Time<Host>, frame: &[u8]) {
        let Self { ring: Some(ring), shared, .. } = self else { return };
        if in_hand(shared).board.ring.is_some_and(|shared| !shared.line) {
            ring.copies.sent(now, frame);
        }
    }

    /// Handles copies whose wait is over.
    #[cold]
    pub(super) fn expire_copies(&mut self, now: Time<Host>) {
        let Self { ring: Some(ring), shared, cycle, config, .. } = self else { return };
        let (shared, copies) = (in_hand(shared), &mut ring.copies);
        loop {
            let expired = shared.board.ring.as_mut().and_then(|ring| copies.expire(now, ring));
            match expired {
                None => break,
                Some(Taken::Merged) => {
                    take(shared, cycle, config, now, copies.merged());
                }
                Some(Taken::Kept | Taken::AsItIs) => {}
            }
        }
        self.look_at_ring();
    }

    /// Whether a ring is configured but not whole.
    pub(super) fn is_ring_cut(&self) -> bool {
        self.ring.as_ref().is_some_and(|ring| !matches!(ring.known.0, View::Whole))
    }

    /// Reports that the ring is cut or whole, and chooses the reference of the clocks behind the
    /// cut.
    fn look_at_ring(&mut self) {
        let Self { ring: Some(ring), shared, cycle: Some(cycle), segment, activity, .. } = self
        else {
            return;
        };
        let shared = in_hand(shared);
        shared.board.statistics.copies_lost = ring.copies.lost;
        let Some(RingState { line: false, view, .. }) = shared.board.ring else { return };
        let known = (view, cycle.present());
        if !matches!(activity, Activity::Operating) || known == ring.known {
            return;
        }
        ring.known = known;
        let number = cycle.number();
        let mut leads = None;
        let told = match view {
            View::Unknown => return,
            View::Whole | View::Reverse => {
                (ring.copies.leader, ring.split) = (None, None);
                Some(Told::Whole)
            }
            View::Cut { near, far } => {
                let (near, far) = (usize::from(near), usize::from(far));
                // SubDevices that are back but not admitted yet answer too.
                let everybody = near + far == segment.devices.len();
                let there = segment.devices.iter().filter(|device| everybody || device.admitted);
                let count = there.clone().count();
                let position = |at: usize| there.clone().nth(at).map(|device| device.position);
                // If it is not known which SubDevices answer, no clock is chosen.
                let behind = there.clone().skip(count.saturating_sub(far));
                let clock = |device: &&crate::SubDevice| device.admitted && device.dc.has_clock();
                let leader = behind.filter(|_| near + far == count).find(clock);
                ring.copies.leader = leader.map(|device| device.station);
                let split = leader.map(|device| device.position);
                let split = split.filter(|position| segment.reference != Some(*position));
                if split != ring.split {
                    (ring.split, leads) = (split, split);
                }
                let before = near.checked_sub(1).and_then(position);
                (near + far <= count).then(|| Told::Cut((before, position(count - far))))
            }
        };
        // The cut is reported before its consequences.
        if let Some(told) = told.filter(|told| *told != ring.told) {
            ring.told = told;
            shared.board.report(match told {
                Told::Cut(between) => Event::RingCut { cycle: number, between },
                _ => Event::RingHealed { cycle: number },
            });
        }
        if let Some(position) = leads {
            shared.board.report(Event::ClocksSplit { position, cycle: number });
        }
    }
}
