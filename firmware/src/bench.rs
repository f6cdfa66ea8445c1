//! The device on its bench: the software ESC, the stack, and the device's own time.

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
    /// When the main loop looks next.
    polling: Option<Time<Device>>,
    /// Steps that were started with a delay, and the instant at which each is due.
    waiting: [Option<(Time<Device>, Step)>; WAITING],
    frames: u32,
    call_stack: CallStack,
}

/// The most call stack that the stack took, bytes, the software ESC's door included.
#[derive(Clone, Copy, Default)]
pub struct CallStack {
    /// One turn of the main loop.
    pub main_loop: usize,
    /// One event of a cycle, with all its steps.
    pub interrupt: usize,
}

impl Bench {
    /// The device, powered on at time 0.
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

    /// A frame of `len` bytes arrives now; returns when it has passed.
    pub fn pass(&mut self, frame: &mut [u8]) {
        let end = self.now + Nanos(frame::duration_ns(frame.len()) as i64);
        self.until(self.now);
        self.esc.process(frame, self.now, end, true);
        self.frames += 1;
        self.until(end);
    }

    /// All that happens until `end`, each at its instant.
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

    /// Frames that passed.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// The most call stack so far.
    pub fn call_stack(&self) -> CallStack {
        self.call_stack
    }

    /// The stack, to look at.
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

    /// What wires from the ESC to the CPU do on a board.
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

    /// The step that is due.
    fn take_waiting(&mut self) -> Option<Step> {
        let now = self.now;
        let due =
            |place: &&mut Option<(Time<Device>, Step)>| place.is_some_and(|(at, _)| at <= now);
        Some(self.waiting.iter_mut().find(due)?.take()?.1)
    }

    /// In the device's time a step takes none: how fast a real CPU is is not what is shown here.
    fn perform(&mut self, step: Step) {
        self.stack.begin(self.now, step, &mut self.esc.pdi(self.now));
        self.stack.finish(self.now, step, &mut self.esc.pdi(self.now));
    }
}

/// From an event until the main loop looks.
const MAIN_LOOP: Nanos = Nanos::micros(20);
/// Steps that can wait at once: one of each kind.
const WAITING: usize = isocat_subdevice::MAX_STEPS;
