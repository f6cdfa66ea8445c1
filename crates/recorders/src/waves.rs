//! Writes the events at the SubDevices of a run as waveforms: a VCD file for GTKWave and similar
//! tools.
//!
//! One scope for each SubDevice. Events of the ESC (`sync0`, `sync1`, `sm2`, `sm3`) and missed ones
//! (`sm_missed`) are of the type `event`; the steps of its program (`copy_outputs`, `application`,
//! `outputs_valid`, `latch_inputs`, `copy_inputs`) are 1 while they last; `state` is the AL state,
//! with bit 4 for an error. A SubDevice that oversamples has two more for each quantity, counted
//! from 0: `in0_sample` is the number in its set of the sample that was just taken, `in0_value` is
//! what was taken; `out0_sample` and `out0_value` are the sample that acts. Each is written at its
//! instant, also where it stays the same. Time is true time in picoseconds from the beginning of
//! the run.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use isocat_sim::observation::{Observation, Observed};
use isocat_sim::sampling::Sample;
use isocat_sim::{Segment, Tap};
use isocat_subdevice::Step;
use isocat_wire::time::{Time, True};
use vcd::{IdCode, TimescaleUnit, Value, VarType};

/// Collects events and writes them at the end, sorted by time: they arrive in the order of time
/// only for each SubDevice. Takes 32 bytes for each event.
pub struct Waves<W: Write = BufWriter<File>> {
    output: W,
    names: Vec<String>,
    seen: Vec<(Time<True>, usize, Observed)>,
}

impl Waves {
    /// Creates the file. `names`: those of the SubDevices, by position.
    pub fn create(path: &Path, names: Vec<String>) -> io::Result<Self> {
        Ok(Self::new(BufWriter::new(File::create(path)?), names))
    }
}

/// The variables of one SubDevice.
struct Variables {
    events: [IdCode; EVENTS.len()],
    steps: [IdCode; STEPS.len()],
    state: IdCode,
    samples: Samples,
}

/// The number and the value of what is sampled: whether it is an output, and its channel.
type Samples = BTreeMap<(bool, u16), [IdCode; 2]>;

const EVENTS: [&str; 5] = ["sync0", "sync1", "sm2", "sm3", "sm_missed"];
const STEPS: [(Step, &str); 5] = [
    (Step::MapOutputs, "copy_outputs"),
    (Step::Application, "application"),
    (Step::OutputsValid, "outputs_valid"),
    (Step::LatchInputs, "latch_inputs"),
    (Step::MapInputs, "copy_inputs"),
];
/// Width of `state`.
const STATE_BITS: u32 = 5;
/// Bits of the number and of the value of a sample.
const SAMPLE_BITS: [u32; 2] = [16, 32];

impl<W: Write> Waves<W> {
    /// Begins waveforms, written to `output` at the end.
    pub fn new(output: W, names: Vec<String>) -> Self {
        Self { output, names, seen: Vec::new() }
    }

    /// By position: what is sampled there.
    fn sampled(&self) -> BTreeMap<usize, Samples> {
        let mut sampled: BTreeMap<usize, Samples> = BTreeMap::new();
        for (_, device, event) in &self.seen {
            if let Observed::Sampled(Sample { is_output, channel, .. }) = event {
                let samples = sampled.entry(*device).or_default();
                samples.insert((*is_output, *channel), [IdCode::FIRST; 2]);
            }
        }
        sampled
    }

    /// Writes the file.
    pub fn finish(mut self) -> io::Result<()> {
        // The sort is stable: events at the same instant keep their order.
        self.seen.sort_by_key(|(at, ..)| *at);
        let mut sampled = self.sampled();
        let mut writer = vcd::Writer::new(&mut self.output);
        writer.version(concat!("isocat ", env!("CARGO_PKG_VERSION")))?;
        writer.comment("true time; see the documentation of isocat for the signals")?;
        writer.timescale(1, TimescaleUnit::PS)?;
        writer.add_module("segment")?;
        let mut variables = Vec::with_capacity(self.names.len());
        for (position, name) in self.names.iter().enumerate() {
            let samples = sampled.remove(&position).unwrap_or_default();
            variables.push(declare(&mut writer, &scope(position, name), samples)?);
        }
        writer.upscope()?;
        writer.enddefinitions()?;
        writer.timestamp(0)?;
        writer.begin(vcd::SimulationCommand::Dumpvars)?;
        for variables in &variables {
            for step in variables.steps {
                writer.change_scalar(step, Value::V0)?;
            }
            change_number(&mut writer, variables.state, STATE_BITS, 1)?;
        }
        writer.end()?;
        let mut now = Time::ZERO;
        for (at, device, event) in self.seen {
            let Some(variables) = variables.get(device) else { continue };
            if at != now {
                writer.timestamp(at.count())?;
                now = at;
            }
            change(&mut writer, variables, event)?;
        }
        self.output.flush()
    }
}

fn declare(
    writer: &mut vcd::Writer<impl Write>,
    scope: &str,
    mut samples: Samples,
) -> io::Result<Variables> {
    writer.add_module(scope)?;
    let mut add = |kind, width, name: &str| writer.add_var(kind, width, name, None);
    let mut events = [IdCode::FIRST; EVENTS.len()];
    for (event, name) in events.iter_mut().zip(EVENTS) {
        *event = add(VarType::Event, 1, name)?;
    }
    let mut steps = [IdCode::FIRST; STEPS.len()];
    for (step, (_, name)) in steps.iter_mut().zip(STEPS) {
        *step = add(VarType::Wire, 1, name)?;
    }
    let state = add(VarType::Reg, STATE_BITS, "state")?;
    for ((is_output, channel), ids) in &mut samples {
        let direction = if *is_output { "out" } else { "in" };
        for ((id, bits), what) in ids.iter_mut().zip(SAMPLE_BITS).zip(["sample", "value"]) {
            *id = add(VarType::Reg, bits, &format!("{direction}{channel}_{what}"))?;
        }
    }
    writer.upscope()?;
    Ok(Variables { events, steps, state, samples })
}

fn change(
    writer: &mut vcd::Writer<impl Write>,
    variables: &Variables,
    event: Observed,
) -> io::Result<()> {
    let step = |wanted: Step| {
        let at = STEPS.iter().position(|(step, _)| *step == wanted);
        at.map(|at| variables.steps[at])
    };
    let number = match event {
        Observed::Sync0 => 0,
        Observed::Sync1 => 1,
        Observed::Sm2 => 2,
        Observed::Sm3 => 3,
        Observed::SmEventMissed(_) => 4,
        // These events are no edges.
        Observed::StillActive(_) | Observed::Acknowledged(_) | Observed::OutputsSafe => {
            return Ok(());
        }
        Observed::Began(began) => {
            return step(began).map_or(Ok(()), |id| writer.change_scalar(id, Value::V1));
        }
        Observed::Finished(ended) => {
            return step(ended).map_or(Ok(()), |id| writer.change_scalar(id, Value::V0));
        }
        Observed::State(state, code) => {
            let error = u8::from(code.0 != 0) << 4;
            return change_number(
                writer,
                variables.state,
                STATE_BITS,
                (state as u8 | error).into(),
            );
        }
        Observed::Sampled(Sample { is_output, channel, number, value }) => {
            let Some(ids) = variables.samples.get(&(is_output, channel)) else { return Ok(()) };
            for ((id, bits), number) in ids.iter().zip(SAMPLE_BITS).zip([number.into(), value]) {
                change_number(writer, *id, bits, number)?;
            }
            return Ok(());
        }
    };
    writer.change_scalar(variables.events[number], Value::V1)
}

fn change_number(
    writer: &mut vcd::Writer<impl Write>,
    id: IdCode,
    bits: u32,
    number: u32,
) -> io::Result<()> {
    let bit = |bit: u32| if number >> bit & 1 == 1 { Value::V1 } else { Value::V0 };
    writer.change_vector(id, (0..bits).rev().map(bit))
}

/// The name of a scope. Names in VCD have no blanks: position and name, where each character other
/// than a letter or digit is an underscore.
fn scope(position: usize, name: &str) -> String {
    let clean = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    format!("d{position}_{}", name.chars().map(clean).collect::<String>())
}

impl<W: Write> Tap for Waves<W> {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}

    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        self.seen.push((at, observation.device, observation.event));
    }
}
