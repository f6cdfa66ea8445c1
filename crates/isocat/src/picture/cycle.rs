//! The events in the cycle of one SubDevice, as planned and as observed.
//!
//! The lanes follow the data from top to bottom: the frame, the SM events, the pulses, outputs
//! until they are valid, the application, inputs until they are in the buffer, and the slack before
//! each deadline. Dashed outlines are the plan's earliest and latest instants. Filled bars are the
//! observed mean, and the pale bands around them least and largest. Times count from the begin of
//! the bus cycle by the reference clock; in Free Run from the SubDevice's own first step.

use isocat_descriptions::quantity::time;
use isocat_engine::recording::cycle::{CycleSeen, Origin};
use isocat_engine::timeline::{Moment, Timeline};
use isocat_maindevice::segment::Timing;
use isocat_sim::Statistics;
use isocat_sync::SyncMode;
use isocat_sync::budget::{Device, Moments, Span};
use isocat_wire::time::Nanos;

use super::Picture;
use super::frame::{Align, Frame};
use super::margin::{Margin, margins};

/// The data of the drawing.
#[derive(Clone, Copy, Debug)]
pub struct Cycle<'a> {
    /// An id that is unique on the page.
    pub id: &'a str,
    /// The SubDevice, in words.
    pub name: &'a str,
    /// The plan.
    pub timing: &'a Timing,
    /// Position of the SubDevice.
    pub position: usize,
    /// The observed cycle; `None` for the plan alone.
    pub seen: Option<&'a CycleSeen>,
}

impl Cycle<'_> {
    /// The drawing; `None` if the plan does not include the SubDevice.
    pub fn draw(&self) -> Option<Picture> {
        let device = &self.timing.devices.get(self.position)?.0;
        let own = self.seen.is_some_and(|seen| seen.origin == Origin::OwnCycle);
        let moments = match own {
            // Its own cycle has no fixed place in the bus cycle.
            true => Moments::default(),
            false => self.timing.moments(self.position).unwrap_or_default(),
        };
        let title = format!("The cycle of SubDevice {} ({})", self.position, self.name);
        let (from, to) = self.range(device, &moments, own);
        let mut drawing = Drawing {
            frame: Frame::new(self.id, &title, from, to),
            timing: self.timing,
            device,
            position: self.position,
            moments,
            seen: self.seen,
        };
        if !own {
            drawing.wire();
            drawing.events();
            drawing.pulses();
        }
        drawing.outputs();
        drawing.application();
        drawing.inputs();
        if !own {
            drawing.margins();
        }
        Some(drawing.frame.finish())
    }

    /// The range of the axis: at least the cycle and the frame of the next one.
    fn range(&self, device: &Device, moments: &Moments, own: bool) -> (f64, f64) {
        let send = self.timing.cycle.send;
        let cycle = device.exchange(&self.timing.cycle);
        let frames = self.timing.frames.last().map_or(Nanos::ZERO, |frame| frame.end);
        let (mut from, mut to) = match own {
            true => (0.0, 0.0),
            false => {
                let end = send + cycle + frames + self.timing.cycle.jitter;
                (send.0.min(0) as f64, end.0 as f64)
            }
        };
        let planned = Moment::PLANNED.into_iter().filter_map(|moment| moments.of(moment));
        for span in planned {
            from = from.min(span.earliest.0 as f64);
            to = to.max(span.latest.0 as f64);
        }
        for (_, seen) in self.seen.iter().flat_map(|seen| &seen.moments) {
            from = from.min(seen.least() as f64 / 1e3);
            to = to.max(seen.largest() as f64 / 1e3);
        }
        // From SYNC0 to the next one, so that the cycle time has both ends.
        let sync0 = self.seen.and_then(|seen| seen.of(Moment::Sync0)).map(|seen| seen.mean() / 1e3);
        if let Some(sync0) = sync0.or_else(|| moments.sync0.map(middle)).filter(|_| !own) {
            to = to.max(sync0 + device.pulses.sync0_cycle.0 as f64);
        }
        let margin = (to - from) * 0.015;
        (from - margin, to + margin)
    }
}

struct Drawing<'a> {
    frame: Frame,
    timing: &'a Timing,
    device: &'a Device,
    position: usize,
    moments: Moments,
    seen: Option<&'a CycleSeen>,
}

/// Heights in a lane.
const BAR: f64 = 13.0;
const LANE: f64 = 40.0;
/// Frames that are drawn at most.
const MOST_FRAMES: i64 = 64;

impl Drawing<'_> {
    fn seen(&self, moment: Moment) -> Option<&Statistics> {
        self.seen?.of(moment)
    }

    /// The earliest and the latest instant of an event: observed, or else planned.
    fn ends(&self, moment: Moment) -> Option<(f64, f64)> {
        let seen = self.seen(moment).map(|s| (s.least() as f64 / 1e3, s.largest() as f64 / 1e3));
        let span = || self.moments.of(moment).map(|s| (s.earliest.0 as f64, s.latest.0 as f64));
        seen.or_else(span)
    }

    /// The average instant of an event: observed, or else the middle of the plan.
    fn middle(&self, moment: Moment) -> Option<f64> {
        let seen = self.seen(moment).map(|seen| seen.mean() / 1e3);
        seen.or_else(|| self.moments.of(moment).map(middle))
    }

    /// A tip such as `SYNC0 (planned 524 us; seen 9984 times: mean …)`.
    fn tip(&self, words: &str, moment: Moment) -> String {
        let mut tip = words.to_owned();
        if let Some(Span { earliest, latest }) = self.moments.of(moment) {
            tip += &match earliest == latest {
                true => format!("\nplanned at {}", exact(earliest.0 as f64)),
                false => {
                    let (earliest, latest) = (exact(earliest.0 as f64), exact(latest.0 as f64));
                    format!("\nplanned from {earliest} to {latest}")
                }
            };
        }
        if let Some(seen) = self.seen(moment) {
            tip += &format!(
                "\nseen {} times in true time: mean {}, from {} to {}",
                seen.count(),
                exact(seen.mean() / 1e3),
                exact(seen.least() as f64 / 1e3),
                exact(seen.largest() as f64 / 1e3),
            );
        }
        tip
    }

    /// Draws an event: its planned span, the observed band, and its mean.
    fn event(&mut self, class: &str, moment: Moment, words: &str, label: &str, y: f64) {
        let tip = self.tip(words, moment);
        if let Some(span) = self.moments.of(moment) {
            let span = (span.earliest.0 as f64, span.latest.0 as f64);
            self.frame.bar("plan", span, y - 2.0, BAR + 4.0, &tip);
        }
        if self.seen(moment).is_some()
            && let Some(ends) = self.ends(moment)
        {
            self.frame.bar(&format!("{class} band"), ends, y, BAR, &tip);
        }
        if let Some(at) = self.middle(moment) {
            self.frame.mark(&format!("m {class}"), at, y - 4.0, BAR + 8.0, &tip);
            self.frame.label("", at, y - 6.0, Align::Start, label);
        }
    }

    /// Draws work from one event to another, with the band of its end.
    fn work(
        &mut self,
        class: &str,
        (begin, end): (Moment, Moment),
        words: &str,
        label: &str,
        y: f64,
    ) {
        let (Some(from), Some(to)) = (self.middle(begin), self.middle(end)) else { return };
        let mut tip = self.tip(words, end);
        if self.seen(begin).is_some() && self.seen(end).is_some() {
            tip += &format!("\ntakes {} on average", time(to - from));
        }
        if self.seen(end).is_some() {
            let (first, last) = (self.ends(begin), self.ends(end));
            if let (Some((first, _)), Some((_, last))) = (first, last) {
                self.frame.bar(&format!("{class} band"), (first, last), y, BAR, &tip);
            }
        }
        self.frame.bar(class, (from, to), y, BAR, &tip);
        if let Some(span) = self.moments.of(end) {
            let latest = (span.earliest.0 as f64, span.latest.0 as f64);
            self.frame.bar("plan", latest, y - 2.0, BAR + 4.0, &tip);
        }
        // Below its bar: above it are the names of events.
        self.frame.label("", from, y + BAR + 12.0, Align::Start, label);
    }

    fn wire(&mut self) {
        let y = self.frame.lane("frames", 30.0) + 11.0;
        let cycle = self.timing.cycle;
        let last = self.frame.last();
        // As many as there is room for; a slow SubDevice on a fast bus sees many.
        for turn in 0..MOST_FRAMES {
            let begin = cycle.send + Nanos(cycle.cycle.0 * turn);
            if begin.0 as f64 > last {
                break;
            }
            let in_cycle = |every: u32| turn % i64::from(every.max(1)) == 0;
            for frame in self.timing.frames.iter().filter(|frame| in_cycle(frame.every)) {
                let (from, to) = ((begin + frame.begin).0 as f64, (begin + frame.end).0 as f64);
                let tip = format!(
                    "frame with {} bytes, {} datagrams\nplanned from {} to {} at the reference clock, up to {} later",
                    frame.length,
                    frame.datagrams.len(),
                    exact(from),
                    exact(to),
                    cycle.jitter,
                );
                let late = cycle.jitter.0 as f64;
                self.frame.bar("jitter", (from, to + late), y, BAR, &tip);
                self.frame.bar("wire", (from, to), y, BAR, &tip);
            }
        }
    }

    fn events(&mut self) {
        if self.ends(Moment::Sm2).is_none() && self.ends(Moment::Sm3).is_none() {
            return;
        }
        let y = self.frame.lane("SM events", LANE) + 19.0;
        if self.ends(Moment::Sm2).is_some() {
            self.event("outputs", Moment::Sm2, "SM2 event: outputs stored", "SM2", y);
        }
        if self.seen(Moment::Sm3).is_some() {
            self.fetched(y);
        }
    }

    /// Draws the frame that fetches inputs: the plan has its begin, the SubDevice observes its end.
    fn fetched(&mut self, y: f64) {
        let Some(seen) = self.seen(Moment::Sm3) else { return };
        let (mean, ends) =
            (seen.mean() / 1e3, (seen.least() as f64 / 1e3, seen.largest() as f64 / 1e3));
        let tip = format!(
            "SM3 event: inputs fetched by the next frame\nseen {} times in true time: mean {}, from {} to {}",
            seen.count(),
            exact(mean),
            exact(ends.0),
            exact(ends.1)
        );
        self.frame.bar("inputs band", ends, y, BAR, &tip);
        self.frame.mark("m inputs", mean, y - 4.0, BAR + 8.0, &tip);
        self.frame.label("", mean, y - 6.0, Align::End, "SM3");
    }

    fn pulses(&mut self) {
        let Some(sync0) = self.middle(Moment::Sync0) else { return };
        let y = self.frame.lane("SYNC", LANE + 18.0) + 39.0;
        self.event("pulse", Moment::Sync0, "SYNC0", "SYNC0", y);
        if self.middle(Moment::Sync1).is_some() {
            self.event("pulse", Moment::Sync1, "SYNC1", "SYNC1", y);
        }
        let cycle = self.device.pulses.sync0_cycle;
        let next = sync0 + cycle.0 as f64;
        let last = (self.timing.cycle.send + self.device.exchange(&self.timing.cycle)).0 as f64;
        let mut at = next;
        while at <= last.max(next) && cycle > Nanos::ZERO {
            self.frame.mark("m pulse band", at, y - 4.0, BAR + 8.0, "the next SYNC0");
            at += cycle.0 as f64;
        }
        let words = format!("cycle time 1C32:02 {cycle}");
        self.frame.distance("", (sync0, next), y - 21.0, &words, &words);
    }

    fn outputs(&mut self) {
        if self.middle(Moment::OutputsReady).is_none()
            && self.middle(Moment::OutputsValid).is_none()
        {
            return;
        }
        let y = self.frame.lane("outputs", LANE + 30.0) + 39.0;
        let begin = match self.seen(Moment::OutputsFetched) {
            Some(_) => Moment::OutputsFetched,
            None if self.device.mode == SyncMode::DcSync1 => Moment::Sync0,
            None => Moment::Sm2,
        };
        let stated = self.device.output_calc_and_copy;
        let took = self.seen.map(|seen| seen.outputs_took);
        self.work(
            "outputs",
            (begin, Moment::OutputsReady),
            &format!("calc and copy of outputs\n1C32:06 states {stated}"),
            &calc_and_copy("1C32:06", stated, took),
            y,
        );
        let Some(valid) = self.middle(Moment::OutputsValid) else { return };
        self.event("outputs", Moment::OutputsValid, "Outputs Valid", "outputs valid", y);
        if let Some(pulse) = self.acting() {
            let pulse = self.middle(pulse).unwrap_or(valid);
            let after = self.device.outputs_act_after();
            let shift = self.device.timed_output_shift().filter(|shift| *shift > Nanos::ZERO);
            let words = match shift {
                Some(shift) => format!("shift 1C32:03 {shift}, delay 1C32:09 {}", after - shift),
                None => format!("delay 1C32:09 {after}"),
            };
            let seen = format!("{words}\nfrom the pulse to Outputs Valid {}", time(valid - pulse));
            self.frame.distance("", (pulse, valid), y - 21.0, &words, &seen);
        }
    }

    fn application(&mut self) {
        let ends = (Moment::ApplicationBegins, Moment::ApplicationEnds);
        if self.seen(ends.0).is_none() || self.seen(ends.1).is_none() {
            return;
        }
        let y = self.frame.lane("application", LANE - 4.0) + 7.0;
        self.work("application", ends, "application", "application", y);
    }

    fn inputs(&mut self) {
        let Some(latch) = self.middle(Moment::InputLatch) else { return };
        let y = self.frame.lane("inputs", LANE + 30.0) + 39.0;
        let begin = match self.seen(Moment::InputsBegin) {
            Some(_) => Moment::InputsBegin,
            None => Moment::InputLatch,
        };
        let stated = self.device.input_calc_and_copy;
        let took = self.seen.map(|seen| seen.inputs_took);
        self.work(
            "inputs",
            (begin, Moment::InputsAvailable),
            &format!(
                "calc and copy of inputs, until they stand in the buffer\n1C33:06 states {stated}"
            ),
            &calc_and_copy("1C33:06", stated, took),
            y,
        );
        self.event("inputs", Moment::InputLatch, "Input Latch", "input latch", y);
        self.latch_start(latch, y);
    }

    /// Draws Start Input Latch, and the distances from the pulse and from there to Input Latch.
    fn latch_start(&mut self, latch: f64, y: f64) {
        let delay = self.device.input_latch_delay();
        let words = delay.map(|delay| format!("delay 1C33:09 {delay}"));
        if let Some((delay, words)) = delay.zip(words.as_ref()) {
            let start = latch - delay.0 as f64;
            let tip =
                format!("Start Input Latch\n{words} before Input Latch, as the device states");
            self.frame.mark("m inputs band", start, y - 4.0, BAR + 8.0, &tip);
            self.frame.label("", start, y - 6.0, Align::End, "start input latch");
        }
        let by_timer = self.device.shifts_inputs();
        let shift = by_timer.then(|| format!("shift 1C33:03 {}", self.device.input_shift));
        let words: Vec<_> = shift.into_iter().chain(words).collect();
        let pulse = match by_timer {
            true => self.acting(),
            false => Some(Moment::Sync1),
        };
        let pulse = pulse.and_then(|pulse| self.middle(pulse));
        if let Some(pulse) = pulse.filter(|_| !words.is_empty()) {
            let words = words.join(", ");
            let tip = format!("{words}\nfrom the pulse to Input Latch {}", time(latch - pulse));
            self.frame.distance("", (pulse.min(latch), latch), y - 21.0, &words, &tip);
        }
    }

    /// Draws the least slack before each deadline.
    fn margins(&mut self) {
        let margins = margins(self.timing, self.position, self.seen);
        if margins.is_empty() {
            return;
        }
        let from = if self.seen.is_some() { "seen" } else { "planned" };
        let y = self.frame.lane("margins", LANE) + 25.0;
        for margin in margins {
            let Margin { what, until, done, deadline, left } = margin;
            let words = match left < 0.0 {
                true => format!("{what} too late by {}", time(-left)),
                false => format!("{what} {}", ns(left)),
            };
            let tip = format!(
                "{what}: what is left until {until} at worst, {from}: {}\nfrom {} at the latest to {} at the earliest",
                ns(left),
                exact(done),
                exact(deadline)
            );
            let class = margin.class(self.timing.cycle.jitter);
            self.frame.distance(class, (done.min(deadline), done.max(deadline)), y, &words, &tip);
        }
    }

    /// The pulse at which outputs act.
    fn acting(&self) -> Option<Moment> {
        isocat_engine::recording::cycle::acting(self.device)
    }
}

fn middle(span: Span) -> f64 {
    (span.earliest.0 + span.latest.0) as f64 / 2.0
}

/// The stated time, and the observed one if it is larger.
fn calc_and_copy(object: &str, stated: Nanos, took: Option<Statistics>) -> String {
    let longest =
        took.filter(|took| took.count() > 0).map_or(0.0, |took| took.largest() as f64 / 1e3);
    match longest > stated.0 as f64 + 100.0 {
        true => format!("calc and copy {}, {object} states {stated}", time(longest)),
        false => format!("calc and copy {object} {stated}"),
    }
}

/// A time with all digits, in ns.
fn exact(ns: f64) -> String {
    let whole = format!("{ns:.3}");
    format!("{} ns", whole.trim_end_matches('0').trim_end_matches('.'))
}

/// A margin in whole ns, with groups of three digits.
pub(crate) fn ns(value: f64) -> String {
    time(value.floor())
}

/// The events around a pulse that found no outputs ready, which is at 0: from the SM2 event before
/// it until outputs were finally ready.
pub fn events(id: &str, title: &str, timeline: &Timeline) -> Option<Picture> {
    let all = || timeline.entries.iter().map(|(at, moment)| (at.0 as f64 / 1e3, *moment));
    let begin = all().rfind(|(at, moment)| *at <= 0.0 && *moment == Moment::Sm2).map(|(at, _)| at);
    let ready =
        all().find(|(at, moment)| *at > 0.0 && *moment == Moment::OutputsReady).map(|(at, _)| at);
    let next = all().find(|(at, moment)| *at > 0.0 && *moment == Moment::Sm2).map(|(at, _)| at);
    // Outputs of the next frame are not part of it.
    let ready = ready.filter(|ready| next.is_none_or(|next| *ready < next));
    let (first, last) = (all().next()?.0, all().next_back()?.0);
    let (from, to) = (begin.unwrap_or(first), ready.unwrap_or(last).max(1.0));
    let room = (to - from) * 0.3;
    let mut frame = Frame::new(id, title, from - room, to + room);
    let lanes: [(&str, &str, &[Moment]); 4] = [
        ("SM events", "outputs", &[Moment::Sm2, Moment::Sm3]),
        ("SYNC", "pulse", &[Moment::Sync0, Moment::Sync1]),
        (
            "outputs",
            "outputs",
            &[Moment::OutputsFetched, Moment::OutputsReady, Moment::OutputsValid],
        ),
        ("inputs", "inputs", &[Moment::InputLatch, Moment::InputsBegin, Moment::InputsAvailable]),
    ];
    for (name, class, moments) in lanes {
        let mut of: Vec<_> = all().filter(|(_, moment)| moments.contains(moment)).collect();
        if of.is_empty() {
            continue;
        }
        // One frame causes both events; SM2 is shown.
        let outputs: Vec<f64> =
            of.iter().filter(|(_, moment)| *moment == Moment::Sm2).map(|(at, _)| *at).collect();
        of.retain(|(at, moment)| {
            *moment != Moment::Sm3 || outputs.iter().all(|sm2| (sm2 - at).abs() > 1.0)
        });
        let y = frame.lane(name, 34.0) + 16.0;
        let mut begun = None;
        for (at, moment) in of {
            let tip = format!("{}\nat {}", moment.words().trim(), exact(at));
            match moment {
                Moment::OutputsFetched | Moment::InputsBegin => begun = Some(at),
                Moment::OutputsReady | Moment::InputsAvailable => {
                    if let Some(begin) = begun.take() {
                        let took = format!("{tip}\ntook {}", time(at - begin));
                        frame.bar(class, (begin, at), y, BAR, &took);
                    }
                }
                _ => {
                    let old = moment == Moment::OutputsValid
                        && at >= 0.0
                        && next.is_none_or(|next| at < next);
                    let (class, label) = match old {
                        true => ("late", "valid: outputs of the cycle before"),
                        false => (class, short(moment)),
                    };
                    frame.mark(&format!("m {class}"), at, y - 4.0, BAR + 8.0, &tip);
                    frame.label("", at, y - 6.0, Align::Start, label);
                }
            }
        }
    }
    let y = frame.lane("", 34.0) + 22.0;
    match ready {
        Some(ready) => {
            let words = format!("outputs too late by {}", ns(ready));
            frame.distance("bad", (0.0, ready), y, &words, &words);
        }
        None => {
            frame.mark("m late", 0.0, y - 12.0, 18.0, "0: the pulse that found no outputs ready");
            frame.label("bad", 0.0, y, Align::Start, "no outputs");
        }
    }
    Some(frame.finish())
}

const fn short(moment: Moment) -> &'static str {
    match moment {
        Moment::Sm2 => "SM2",
        Moment::Sm3 => "SM3",
        Moment::Sync0 => "SYNC0",
        Moment::Sync1 => "SYNC1",
        Moment::OutputsValid => "valid",
        Moment::InputLatch => "latch",
        _ => "",
    }
}
