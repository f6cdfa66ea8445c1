//! The questions to each SubDevice at the beginning and at the end of the time in operation.

use isocat_maindevice::{Event, MainDevice, RequestId};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::{AlStatus, AlStatusCode, ObjectAddress};

use super::Readings;

/// Requests to all SubDevices and their answers. Process data go on meanwhile: the caller runs the
/// MainDevice and passes each event to [`Questions::event`] until [all are
/// answered](Questions::are_answered).
pub struct Questions {
    before: bool,
    asked: Vec<(RequestId, usize, Question)>,
    answers: Vec<(RequestId, Option<Vec<u8>>)>,
}

/// A question to a SubDevice.
#[derive(Clone, Copy)]
enum Question {
    Counter(ObjectAddress),
    Status,
    Difference(DifferencePolarity),
}

impl Questions {
    /// Asks for the counters of 0x1C32 and 0x1C33; at the end (not `before`) also for states and
    /// clocks.
    pub fn ask(main: &mut MainDevice, before: bool) -> Self {
        let mut asked = Vec::new();
        for position in 0..main.segment().devices.len() {
            for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
                for object in counters_of(main, position, index) {
                    let request = main.upload(position, object);
                    asked.push((request, position, Question::Counter(object)));
                }
            }
            if before {
                continue;
            }
            let request = main.read_memory(position, register::AL_STATUS.address, STATUS_LEN);
            asked.push((request, position, Question::Status));
            let device = &main.segment().devices[position];
            if device.dc.has_clock() {
                let polarity = device.difference_polarity;
                let address = register::SYSTEM_TIME_DIFFERENCE.address;
                let len = Register::<SystemTimeDifference>::LEN;
                let request = main.read_memory(position, address, len);
                asked.push((request, position, Question::Difference(polarity)));
            }
        }
        Self { before, asked, answers: Vec::new() }
    }

    /// Takes an event, if it is an answer.
    pub fn event(&mut self, event: &Event) {
        let (request, answer) = match event {
            Event::Uploaded { request, result } => (*request, result.clone().ok()),
            Event::Read { request, result } => (*request, result.clone().ok()),
            _ => return,
        };
        if self.asked.iter().any(|(asked, ..)| *asked == request) {
            self.answers.push((request, answer));
        }
    }

    /// Whether all questions are answered.
    pub fn are_answered(&self) -> bool {
        self.answers.len() >= self.asked.len()
    }

    /// Writes the answers into the readings, by position.
    pub fn fill(&self, readings: &mut [Readings]) {
        for (request, position, question) in &self.asked {
            let answer = self.answers.iter().find(|(id, _)| id == request);
            let Some((_, Some(bytes))) = answer else { continue };
            if let Some(readings) = readings.get_mut(*position) {
                take(readings, *question, bytes, self.before);
            }
        }
    }
}

/// The counters that a SubDevice has in 0x1C32 or 0x1C33.
fn counters_of(main: &MainDevice, position: usize, index: u16) -> Vec<ObjectAddress> {
    let device = &main.segment().devices[position];
    let object = match index {
        OUTPUT_PARAMETER => &device.output_sync,
        _ => &device.input_sync,
    };
    let present = |sub: &u8| object.as_ref().is_some_and(|o| o.entry(*sub).is_some());
    COUNTERS.into_iter().filter(present).map(|sub| ObjectAddress::new(index, sub)).collect()
}

/// Writes one answer into the readings.
fn take(readings: &mut Readings, question: Question, bytes: &[u8], before: bool) {
    match question {
        Question::Counter(object) => {
            let number = bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte));
            let counters = match (object.index, before) {
                (OUTPUT_PARAMETER, true) => &mut readings.outputs_before,
                (OUTPUT_PARAMETER, false) => &mut readings.outputs,
                (_, true) => &mut readings.inputs_before,
                (_, false) => &mut readings.inputs,
            };
            let counter = match object.sub {
                sub::SM_EVENT_MISSED => &mut counters.sm_event_missed,
                sub::CYCLE_TIME_TOO_SMALL => &mut counters.cycle_time_too_small,
                sub::SHIFT_TIME_TOO_SHORT => &mut counters.shift_time_too_short,
                _ => &mut counters.sync_error,
            };
            *counter = Some(number);
        }
        Question::Status => {
            let word = |at: usize| {
                bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().map(u16::from_le_bytes)
            };
            readings.status = word(0).zip(word(4)).map(|(s, c)| (AlStatus(s), AlStatusCode(c)));
        }
        Question::Difference(polarity) => {
            let bytes = bytes.first_chunk().copied();
            readings.difference =
                bytes.map(|bytes| SystemTimeDifference::from_bytes(bytes).nanos(polarity));
        }
    }
}

/// Bytes of AL status, a gap, and AL status code.
const STATUS_LEN: usize = 6;
const COUNTERS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];
