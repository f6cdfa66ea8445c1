//! The test bench of the device: the software ESC, the stack, and the device's own time.

use isocat_esc::{Esc, EscEvent};
use isocat_subdevice::{Event, Io, Step, SubDevice};
use isocat_wire::register::al_event;
use isocat_wire::time::{Device, Time};
use isocat_wire::{Nanos, frame};

use crate::{device, machine};

/// The stack with the application of this device.
pub type Stack = SubDevice<Io, [u8; device::STORE]>;

/// ESC, stack and time.
pub struct Bench {
    esc: &'static mut Esc<&'static mut [u8]>,
    stack: &'static mut Stack,
    now: Time<Device>,
    /// When the main loop runs next.
    polling: Option<Time<Device>>,
    /// Steps that were started with a delay, each with the instant at which it is due.
    waiting: [Option<(Time<Device>, Step)>; WAITING],
    frames: u32,
    call_stack: CallStack,
}

/// The largest call stack of the stack, bytes, including access to the software ESC.
#[derive(Clone, Copy, Default)]
pub struct CallStack {
    /// One turn of the main loop.
    pub main_loop: usize,
    /// One event of a cycle, with all its steps.
    pub interrupt: usize,
}

impl Bench {
    /// The device, switched on at time 0.
    pub fn new(esc: &'static mut Esc<&'static mut [u8]>, stack: &'static mut Stack) -> Self {
        Self {
            esc,
            stack,
            now: Time::ZERO,
            polling: None,
            waiting: [None; WAITING],
            frames: 0,
            call_stack: CallStack::default(),
        }
    }

    /// Passes a frame that arrives now; returns when it has passed.
    pub fn pass(&mut self, frame: &mut [u8]) {
        let end = self.now + Nanos(frame::duration_ns(frame.len()) as i64);
        self.until(self.now);
        self.esc.process(frame, self.now, end, true);
        self.frames += 1;
        self.until(end);
    }

    /// Processes all events until `end`, each at its instant.
    pub fn until(&mut self, end: Time<Device>) {
        loop {
            let due = self.next_due();
            if due > end {
                break;
            }
            self.now = self.now.max(due);
            if let Some((_, event)) = self.esc.step(self.now) {
                self.interrupt(event);
            } else if let Some(step) = self.take_waiting() {
                self.perform(step);
            } else {
                self.main_loop();
            }
        }
        self.now = end;
    }

    /// The device's time.
    pub fn now(&self) -> Time<Device> {
        self.now
    }

    /// Number of frames that passed.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// The largest call stack so far.
    pub fn call_stack(&self) -> CallStack {
        self.call_stack
    }

    /// The stack, for reading.
    pub fn stack(&self) -> &Stack {
        self.stack
    }

    fn next_due(&self) -> Time<Device> {
        let waiting = self.waiting.iter().flatten().map(|(due, _)| *due);
        let own = [self.polling, self.stack.next_timeout()];
        own.into_iter().flatten().chain(waiting).fold(self.esc.next_event(), Time::min)
    }

    fn main_loop(&mut self) {
        self.polling = self.polling.filter(|due| *due > self.now);
        self.handle(Event::Timer);
        let used = machine::call_stack_of(|| {
            self.stack.poll(self.now, &mut self.esc.pdi(self.now));
        });
        self.call_stack.main_loop = self.call_stack.main_loop.max(used);
    }

    /// Does what the interrupt lines from the ESC to the CPU do on a board.
    fn interrupt(&mut self, event: EscEvent) {
        let mut look = true;
        match event {
            EscEvent::FrameEnd { al_events } => {
                let (sm2, sm3) = (al_event::sync_manager(2), al_event::sync_manager(3));
                if al_events & sm2 != 0 {
                    self.handle(Event::Sm2);
                }
                if al_events & sm3 != 0 {
                    self.handle(Event::Sm3);
                }
                look = al_events & !(sm2 | sm3) != 0;
            }
            EscEvent::Sync0 => self.handle(Event::Sync0),
            EscEvent::Sync1 => self.handle(Event::Sync1),
            _ => {}
        }
        if look {
            self.polling.get_or_insert(self.now + MAIN_LOOP);
        }
    }

    fn handle(&mut self, event: Event) {
        let used = machine::call_stack_of(|| self.start(event));
        self.call_stack.interrupt = self.call_stack.interrupt.max(used);
    }

    fn start(&mut self, event: Event) {
        let steps = self.stack.handle_event(self.now, event, &mut self.esc.pdi(self.now));
        for (step, delay) in steps {
            if delay == Nanos::ZERO {
                self.perform(step);
            } else {
                let free = self.waiting.iter_mut().find(|place| place.is_none());
                *free.expect("no step starts again before it ended") =
                    Some((self.now + delay, step));
            }
        }
    }

    /// Takes a step that is due.
    fn take_waiting(&mut self) -> Option<Step> {
        let now = self.now;
        let due =
            |place: &&mut Option<(Time<Device>, Step)>| place.is_some_and(|(at, _)| at <= now);
        Some(self.waiting.iter_mut().find(due)?.take()?.1)
    }

    /// Performs a step, which takes no time here: the speed of a real CPU is not part of this test.
    fn perform(&mut self, step: Step) {
        self.stack.begin(self.now, step, &mut self.esc.pdi(self.now));
        self.stack.finish(self.now, step, &mut self.esc.pdi(self.now));
    }
}

/// Time from an event until the main loop runs.
const MAIN_LOOP: Nanos = Nanos::micros(20);
/// Steps that can wait at the same time: one of each kind.
const WAITING: usize = isocat_subdevice::MAX_STEPS;
