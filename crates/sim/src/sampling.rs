//! Oversampling: a device takes or gives several samples in a cycle, one at each SYNC0 pulse.
//!
//! Inputs: each SYNC0 takes a sample of a signal, and Input Latch hands over the last N samples,
//! the oldest first. Where the cycle is whole, they are those that were taken since the SYNC1
//! before; the last one comes with SYNC1.
//!
//! Outputs: SYNC1 takes over the set that was mapped, and lets its first sample act. Each SYNC0
//! behind it lets the next one act. A device with one sample in a cycle takes the set over at
//! SYNC0.
//!
//! The signal is a sawtooth of 100 Hz, from zero to the largest number of a sample. It begins at
//! zero with the run, and it is a function of true time alone, so each sample tells when it was
//! taken.

use isocat_maindevice::written::Bits;
use isocat_subdevice::Event;
use isocat_wire::time::{Time, True};

/// Where the samples of a device lie in its process data.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Sampling {
    /// Samples of a set, one at each SYNC0: 1 to 65535.
    pub samples: u16,
    /// What inputs sample.
    pub inputs: Vec<Channel>,
    /// What outputs give.
    pub outputs: Vec<Channel>,
}

/// One quantity that is sampled.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Channel {
    /// Its first sample in the process image of its direction.
    pub first: Bits,
    /// From one sample to the next, bits.
    pub step: u32,
}

impl Channel {
    /// Where the sample with this number lies, from 0 on.
    pub fn sample(&self, number: u16) -> Bits {
        Bits { at: self.first.at + self.step * u32::from(number), ..self.first }
    }

    /// What the signal shows at an instant, in the bits of a sample.
    pub fn signal(&self, at: Time<True>) -> u32 {
        let phase = u128::from(at.count() % SIGNAL_PERIOD_PS);
        ((phase << self.first.len) / u128::from(SIGNAL_PERIOD_PS)) as u32
    }
}

/// Period of the signal, ps: 10 ms.
const SIGNAL_PERIOD_PS: u64 = 10_000_000_000;

/// A sample at its instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Sample {
    /// An output sample begins to act; else an input sample is taken.
    pub is_output: bool,
    /// Number of the channel in its direction.
    pub channel: u16,
    /// Number of the sample in its set, from 0 on. One of the inputs that is not below
    /// [`Sampling::samples`] was not handed over in time.
    pub number: u16,
    /// The bits of the sample.
    pub value: u32,
}

/// The converters of a device.
#[derive(Clone, Debug)]
pub(crate) struct Sampler {
    sampling: Sampling,
    now: Time<True>,
    /// The last samples of each input channel: a ring, whose oldest one is at `next`.
    taken: Vec<Vec<u32>>,
    next: usize,
    /// Samples since Input Latch.
    number: u16,
    /// By input channel: the set that Input Latch handed over.
    latched: Vec<Vec<u32>>,
    /// By output channel: the set that came last.
    mapped: Vec<Vec<u32>>,
    /// By output channel: the set that acts.
    acting: Vec<Vec<u32>>,
    has_outputs: bool,
    /// Number of the sample that acts.
    acts: Option<u16>,
    /// What happened at the last event.
    seen: Vec<Sample>,
}

impl Sampler {
    pub fn new(sampling: Sampling) -> Self {
        let sets = |channels: &[Channel]| vec![vec![0; sampling.samples.into()]; channels.len()];
        let (inputs, outputs) = (sets(&sampling.inputs), sets(&sampling.outputs));
        let most = inputs.len() + outputs.len();
        Self {
            now: Time::ZERO,
            taken: inputs.clone(),
            next: 0,
            number: 0,
            latched: inputs,
            mapped: outputs.clone(),
            acting: outputs,
            has_outputs: false,
            acts: None,
            seen: Vec::with_capacity(most),
            sampling,
        }
    }

    pub fn sampling(&self) -> &Sampling {
        &self.sampling
    }

    /// What the device does next, it does at this instant.
    pub fn tell_time(&mut self, now: Time<True>) {
        self.now = now;
    }

    /// What happened at the last event.
    pub fn seen(&self) -> &[Sample] {
        &self.seen
    }

    /// An event in SAFEOP or OP.
    pub fn event(&mut self, event: Event) {
        let is_alone = self.sampling.samples == 1;
        match event {
            Event::Sync0 => {
                self.take();
                if is_alone {
                    self.begin_outputs();
                } else if let Some(number) = self.acts.and_then(|acts| acts.checked_add(1)) {
                    // What comes behind the last sample is that of the next SYNC1.
                    self.act(number);
                }
            }
            Event::Sync1 if !is_alone => self.begin_outputs(),
            _ => {}
        }
    }

    /// Forgets what happened at the last event.
    pub fn clear_seen(&mut self) {
        self.seen.clear();
    }

    /// Input Latch: the set is handed over.
    pub fn latch(&mut self) {
        for (taken, latched) in self.taken.iter().zip(&mut self.latched) {
            let (newer, older) = taken.split_at(self.next);
            latched[..older.len()].copy_from_slice(older);
            latched[older.len()..].copy_from_slice(newer);
        }
        self.number = 0;
    }

    /// Puts the set into the process image.
    pub fn show(&self, inputs: &mut [u8]) {
        for (channel, set) in self.sampling.inputs.iter().zip(&self.latched) {
            for (number, value) in (0..).zip(set) {
                channel.sample(number).write(inputs, i64::from(*value));
            }
        }
    }

    /// Outputs have come.
    pub fn map(&mut self, outputs: &[u8]) {
        for (channel, set) in self.sampling.outputs.iter().zip(&mut self.mapped) {
            for (number, value) in (0..).zip(set) {
                *value = channel.sample(number).read(outputs).unwrap_or(0) as u32;
            }
        }
        self.has_outputs = true;
    }

    /// Outputs are in their safe state: no sample acts.
    pub fn release(&mut self) {
        self.has_outputs = false;
        self.acts = None;
    }

    /// The device is switched off.
    pub fn power_off(&mut self) {
        self.release();
        let sets = self.taken.iter_mut().chain(&mut self.latched);
        sets.for_each(|set| set.fill(0));
        (self.next, self.number) = (0, 0);
    }

    fn take(&mut self) {
        if self.sampling.inputs.is_empty() {
            return;
        }
        let all = (0..).zip(self.sampling.inputs.iter().zip(&mut self.taken));
        for (channel, (input, taken)) in all {
            let value = input.signal(self.now);
            taken[self.next] = value;
            self.seen.push(Sample { is_output: false, channel, number: self.number, value });
        }
        self.next = (self.next + 1) % usize::from(self.sampling.samples);
        self.number = self.number.saturating_add(1);
    }

    fn begin_outputs(&mut self) {
        if !self.has_outputs {
            return;
        }
        for (mapped, acting) in self.mapped.iter().zip(&mut self.acting) {
            acting.copy_from_slice(mapped);
        }
        self.act(0);
    }

    fn act(&mut self, number: u16) {
        if number >= self.sampling.samples {
            self.acts = None;
            return;
        }
        self.acts = Some(number);
        for (channel, set) in (0..).zip(&self.acting) {
            let value = set[usize::from(number)];
            self.seen.push(Sample { is_output: true, channel, number, value });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampler(samples: u16) -> Sampler {
        let channel = Channel { first: Bits { at: 8, len: 8, signed: false }, step: 8 };
        Sampler::new(Sampling { samples, inputs: vec![channel], outputs: vec![channel] })
    }

    /// An event at an instant; what was seen at it: whether of outputs, number, value.
    fn at(sampler: &mut Sampler, ps: u64, event: Event) -> Vec<(bool, u16, u32)> {
        sampler.clear_seen();
        sampler.tell_time(Time::new(ps));
        sampler.event(event);
        sampler.seen().iter().map(|seen| (seen.is_output, seen.number, seen.value)).collect()
    }

    /// A 256th of the signal's period.
    const STEP: u64 = SIGNAL_PERIOD_PS / 256;

    #[test]
    fn the_signal_is_a_sawtooth_of_true_time() {
        let of = |len: u8, ps: u64| {
            let first = Bits { at: 0, len, signed: false };
            Channel { first, step: len.into() }.signal(Time::new(ps))
        };
        assert_eq!(
            [0, STEP - 1, STEP, STEP * 256 - 1, STEP * 256].map(|t| of(8, t)),
            [0, 0, 1, 255, 0]
        );
        let half = SIGNAL_PERIOD_PS / 2;
        assert_eq!([0, half - 1, half, 2 * half].map(|t| of(1, t)), [0, 0, 1, 0]);
        assert_eq!(of(32, SIGNAL_PERIOD_PS - 1), u32::MAX);
    }

    #[test]
    fn a_set_of_inputs_is_in_the_order_of_its_instants() {
        let mut sampler = sampler(3);
        for number in 0..3 {
            let seen = at(&mut sampler, STEP * u64::from(number), Event::Sync0);
            assert_eq!(seen, [(false, number as u16, number)]);
        }
        sampler.latch();
        // What is taken before the set is mapped is of the next one.
        assert_eq!(at(&mut sampler, STEP * 9, Event::Sync0), [(false, 0, 9)]);
        let mut image = [0xEE; 5];
        sampler.show(&mut image);
        assert_eq!(image, [0xEE, 0, 1, 2, 0xEE]);
    }

    #[test]
    fn a_set_that_is_not_whole_begins_with_old_samples() {
        let mut sampler = sampler(3);
        (0..3).for_each(|n| drop(at(&mut sampler, STEP * (10 + n), Event::Sync0)));
        sampler.latch();
        assert_eq!(at(&mut sampler, STEP * 20, Event::Sync0), [(false, 0, 20)]);
        sampler.latch();
        let mut image = [0; 4];
        sampler.show(&mut image);
        assert_eq!(image, [0, 11, 12, 20]);
    }

    #[test]
    fn outputs_begin_at_sync1_and_go_on_with_each_sync0() {
        let mut sampler = sampler(2);
        let outputs = |sampler: &mut Sampler, event| {
            at(sampler, 0, event).into_iter().filter(|seen| seen.0).collect::<Vec<_>>()
        };
        assert_eq!(outputs(&mut sampler, Event::Sync1), [], "nothing came");
        sampler.map(&[0, 7, 8]);
        assert_eq!(outputs(&mut sampler, Event::Sync0), [], "the set begins at SYNC1");
        assert_eq!(outputs(&mut sampler, Event::Sync1), [(true, 0, 7)]);
        sampler.map(&[0, 3, 4]);
        assert_eq!(
            outputs(&mut sampler, Event::Sync0),
            [(true, 1, 8)],
            "still of the set that acts"
        );
        assert_eq!(outputs(&mut sampler, Event::Sync0), [], "that of the next SYNC1");
        assert_eq!(outputs(&mut sampler, Event::Sync1), [(true, 0, 3)]);
        sampler.release();
        assert_eq!(outputs(&mut sampler, Event::Sync0), []);
        assert_eq!(outputs(&mut sampler, Event::Sync1), []);
    }

    #[test]
    fn one_sample_in_a_cycle_needs_no_sync1() {
        let mut sampler = sampler(1);
        sampler.map(&[0, 7]);
        assert_eq!(at(&mut sampler, STEP * 5, Event::Sync0), [(false, 0, 5), (true, 0, 7)]);
        assert_eq!(at(&mut sampler, STEP * 5, Event::Sync1), []);
    }
}
