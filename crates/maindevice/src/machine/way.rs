//! Bring-up and shutdown: the piece that runs, and the next one.

use alloc::boxed::Box;
use core::future::Future;
use core::pin::Pin;
use core::task::Poll;

use isocat_wire::time::{Host, Time};

use super::MainDevice;
use super::background::Ends;
use super::procedures::poll;
use crate::bring_up::{self, End, Work};
use crate::clock;
use crate::cycle::CyclicExchange;
use crate::delay_watch::DelayWatch;
use crate::error::{Cause, Error};
use crate::event::{Event, Stage};
use crate::quality::Monitor;
use crate::readmit::Keeper;
use crate::ring;
use crate::survey;
use crate::times;

/// What the machine is doing.
pub(super) enum Activity {
    /// A piece of bring-up or shutdown runs.
    Task(Piece, Pin<Box<dyn Future<Output = End> + Send>>),
    /// The host locks onto the reference clock.
    Locking { since: Time<Host> },
    /// All SubDevices are in OP.
    Operating,
    /// A survey is complete; SubDevices are in PREOP.
    Surveyed,
    /// Nothing more is sent.
    Over,
}

/// The pieces of bring-up and shutdown, see [`bring_up`].
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Piece {
    Prepare,
    Synchronize,
    Operate,
    MeasureTimes,
    PlanAnew,
    Survey,
    LeaveOperation,
    Stop,
    OpenRing,
}

impl Activity {
    /// A piece at its start.
    pub(super) fn of(piece: Piece, work: Work) -> Self {
        let task: Pin<Box<dyn Future<Output = End> + Send>> = match piece {
            Piece::Prepare => Box::pin(bring_up::prepare(work)),
            Piece::Survey => Box::pin(survey::survey(work)),
            Piece::Synchronize => Box::pin(bring_up::synchronize(work)),
            Piece::Operate => Box::pin(bring_up::operate(work)),
            Piece::MeasureTimes => Box::pin(times::measure(work)),
            Piece::PlanAnew => Box::pin(times::plan_anew(work)),
            Piece::LeaveOperation => Box::pin(bring_up::leave_operation(work)),
            Piece::Stop => Box::pin(bring_up::stop(work)),
            Piece::OpenRing => Box::pin(bring_up::open_ring(work)),
        };
        Self::Task(piece, task)
    }
}

/// Bring-up and shutdown.
impl MainDevice {
    pub(super) fn work_on_way(&mut self) {
        loop {
            if self.stopping && self.begin_stop() {
                continue;
            }
            match &mut self.activity {
                Activity::Task(piece, task) => {
                    let piece = *piece;
                    let end = poll(task);
                    self.grant_wishes();
                    let Poll::Ready((work, result)) = end else { return };
                    if self.failure.is_none() {
                        // The segment as it was at the failure is the evidence, so it is kept.
                        self.stage = work.stage;
                        self.segment = work.segment;
                    }
                    self.mailboxes = work.mailboxes;
                    self.after(piece, result);
                }
                Activity::Locking { since } => {
                    let since = *since;
                    let Some(cycle) = &self.cycle else { return };
                    if cycle.is_locked() && cycle.number() > 0 {
                        self.begin_piece(Piece::Synchronize);
                        continue;
                    }
                    let after = self.link.now() - since;
                    if after < cycle.lock_patience(self.config.timeouts.phase) {
                        return;
                    }
                    let error = cycle.servo().last_error();
                    self.fail(Error { stage: Stage::Phase, cause: Cause::Phase { error, after } });
                }
                Activity::Operating | Activity::Surveyed | Activity::Over => return,
            }
        }
    }

    /// Continues after a piece.
    fn after(&mut self, piece: Piece, result: Result<(), Error>) {
        // The shutdown continues to its end even after errors.
        match (piece, result) {
            (Piece::LeaveOperation, _) => {
                if let Some(cycle) = &mut self.cycle {
                    cycle.exchange_process_data(false);
                }
                self.begin_piece(Piece::Stop);
            }
            (Piece::Stop, _) if self.failure.is_some() => self.tell_failure(),
            (Piece::Stop, Ok(())) => {
                self.link.report(Event::Stopped);
                self.end();
            }
            (Piece::OpenRing, _) => self.tell_failure(),
            (_, Err(error)) => self.fail(error),
            (Piece::Prepare, Ok(())) => self.begin_cycle(),
            (Piece::Synchronize, Ok(())) => {
                if let Some(cycle) = &mut self.cycle {
                    cycle.exchange_process_data(true);
                }
                self.begin_piece(Piece::Operate);
            }
            (Piece::Operate, Ok(())) if times::is_wanted(&self.segment, &self.config) => {
                self.begin_piece(Piece::MeasureTimes);
            }
            (Piece::Operate, Ok(())) => self.begin_operation(),
            (Piece::MeasureTimes, Ok(())) => {
                if let Some(cycle) = &mut self.cycle {
                    cycle.exchange_process_data(false);
                }
                self.begin_piece(Piece::PlanAnew);
            }
            (Piece::PlanAnew, Ok(())) => self.begin_piece(Piece::Synchronize),
            (Piece::Survey, Ok(())) => {
                self.activity = Activity::Surveyed;
                self.link.report(Event::Surveyed);
            }
        }
    }

    fn begin_cycle(&mut self) {
        let now = self.link.now();
        self.link.board(|board| {
            if self.segment.reference.is_some() && self.config.drift_compensation {
                board.statistics.time_to_converged = Some(now - self.begin);
            }
        });
        self.cycle =
            Some(CyclicExchange::new(&self.config, &self.segment, now, self.config.source));
        self.stage = Stage::Phase;
        self.link.report(Event::Progress(Stage::Phase));
        self.activity = Activity::Locking { since: now };
    }

    fn begin_operation(&mut self) {
        let (now, begin) = (self.link.now(), self.begin);
        self.link.board(|board| {
            board.statistics.time_to_operation = Some(now - begin);
            board.statistics.bring_up_frames = board.statistics.frames_sent;
            let cycle = board.cycle;
            board.report(Event::InOperation { cycle, after: now - begin });
        });
        if let Some(cycle) = &mut self.cycle {
            cycle.measuring = true;
        }
        let jitters = self.config.hop_jitter;
        let watch = |config| DelayWatch::new(config, &self.segment, now, jitters);
        self.delay_watch = self.config.delay_watch.and_then(watch);
        let (number, counts) = self.link.board(|board| (board.cycle, board.statistics));
        let noise = clock::noise(&self.segment, &self.config);
        let monitor = |config| Monitor::new(config, &self.segment, now, number, &counts, &noise);
        self.quality = self.config.quality.map(monitor);
        self.keeper = Keeper::new(self.segment.devices.len());
        for device in &self.segment.devices {
            let (position, Some(error)) = (device.position, &device.left_out) else { continue };
            let Error { stage, cause } = (**error).clone();
            self.link.report(Event::LeftOut { position, stage, cause });
            self.keeper.leave_out(position);
        }
        self.activity = Activity::Operating;
    }

    fn begin_piece(&mut self, piece: Piece) {
        let work = Work {
            link: self.link.clone(),
            config: self.config.clone(),
            segment: self.segment.clone(),
            mailboxes: core::mem::take(&mut self.mailboxes),
            stage: self.stage,
        };
        self.activity = Activity::of(piece, work);
    }

    /// Starts the shutdown, if the machine is in bring-up or in operation.
    fn begin_stop(&mut self) -> bool {
        let turns = match &self.activity {
            Activity::Task(piece, _) => {
                !matches!(piece, Piece::LeaveOperation | Piece::Stop | Piece::OpenRing)
            }
            Activity::Locking { .. } | Activity::Operating | Activity::Surveyed => true,
            Activity::Over => false,
        };
        if turns {
            self.end_background(Ends::Operation);
            self.begin_piece(Piece::LeaveOperation);
        }
        turns
    }

    /// Ends the bring-up. SubDevices that were already written go back to INIT first, if they can.
    fn fail(&mut self, error: Error) {
        self.stage = error.stage;
        let on_the_way_up = (Stage::Sii..Stage::Stop).contains(&error.stage);
        let piece = match ring::is_closed(&self.link) {
            _ if on_the_way_up && self.failure.is_none() => Piece::LeaveOperation,
            true => Piece::OpenRing,
            false => {
                self.failure = Some(error);
                return self.tell_failure();
            }
        };
        self.failure = Some(error);
        self.begin_piece(piece);
    }

    /// Reports why the bring-up failed, and ends.
    fn tell_failure(&mut self) {
        if let Some(error) = self.failure.take() {
            self.link.report(Event::Failed(error));
        }
        self.end();
    }

    /// Ends the run: nothing more is sent.
    fn end(&mut self) {
        self.end_background(Ends::Run);
        self.cycle = None;
        self.activity = Activity::Over;
    }
}
