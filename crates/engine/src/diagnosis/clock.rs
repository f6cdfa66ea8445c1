//! A clock with an error: what leads it, and what keeps it off the grid.

use isocat_descriptions::quantity::time;
use isocat_maindevice::Segment;
use isocat_wire::datagram::Address;
use isocat_wire::{Command, register};

use super::{Case, place};
use crate::recording::series::{Series, SpanOfTime};

/// Whether the host leads the reference clock: a frame of its cycle writes the system time.
pub(super) fn host_leads(segment: &Segment) -> bool {
    let frames = segment.timing.iter().flat_map(|timing| &timing.frames);
    frames.flat_map(|frame| &frame.datagrams).any(|datagram| {
        let is_time = |at: u16| at == register::SYSTEM_TIME.address;
        matches!(datagram.address, Address::Station(_, at) if is_time(at))
            && matches!(datagram.command, Command::Fpwr)
    })
}

impl Case<'_> {
    /// Looks for a clock with an error.
    pub(super) fn clock(&mut self) {
        let series = &self.seen.sync0;
        let Some((least, largest)) = series.range() else { return };
        if least.abs().max(largest.abs()) <= self.limit.0 || self.leads {
            return;
        }
        let slope = slope_ppm(series);
        // 0x092C changes with each drift frame that reaches the clock.
        let led = self.seen.difference.range().is_some_and(|(least, most)| least != most);
        if led && self.late_host_leads() {
            return;
        }
        if slope.abs() >= 0.05 && led {
            self.causes.push(format!(
                "Its SYNC0 runs away by {slope:+.2} us each second ({slope:+.2} ppm) although drift frames reach it: the rate of its \
                 clock, or of the reference's, changes faster than its drift loop follows."
            ));
            self.remedies.push(
                "Find what changes the clock: 0x092C over time shows since when. [host] difference_filter and speed_filter set how fast \
                 drift loops follow (isocat explain speed_filter)."
                    .into(),
            );
        } else if slope.abs() >= 0.05 {
            self.causes.push(format!(
                "Its SYNC0 runs away by {slope:+.2} us each second ({slope:+.2} ppm): its clock is not led by the reference clock."
            ));
            self.remedies.push(format!(
                "Send a drift frame each cycle (FRMW of 0x0910 at the reference clock): {}, which is the default; without \
                 --no-drift-compensation.",
                place::host(self.report, "drift_compensation = true")
            ));
        } else {
            self.off_the_grid(series.mean().unwrap_or_default() / 1e3);
        }
    }

    /// Where the host leads the clocks, each frame that leaves late moves the reference clock.
    /// Whether that is the cause.
    fn late_host_leads(&mut self) -> bool {
        let Some(timing) = self.timing.filter(|_| self.host_leads) else { return false };
        let planned = timing.cycle.jitter;
        let seen = self.report.segment.main_device.host_phase_error;
        let Some(latest) = seen.map(|seen| seen.max_ns).filter(|ns| *ns > planned.0 as f64) else {
            return false;
        };
        self.causes.push(format!(
            "The host leads the clocks (direction = \"drive-reference\"), and its frames came up to {} late, planned with {planned} ([host] \
             jitter): each late frame moves the reference clock, which the other clocks follow later.",
            time(latest)
        ));
        self.remedies.push(format!(
            "Let the reference clock lead, so that a late host moves no clock: {}, which is the default.",
            place::head(self.report, "direction = \"follow-reference\"")
        ));
        self.remedies.push(
            "Or make the host punctual: isocat run --preflight tells what on it harms punctuality."
                .into(),
        );
        true
    }

    /// States why SYNC0 is off the grid and stays there, by `off` ns on average.
    fn off_the_grid(&mut self, off: f64) {
        let compare = "isocat scan measures delays with their errors; compare 0x0928 with what this report says of it.";
        let registers = &self.report.devices[self.position].registers;
        let by_register = self.seen.difference.mean().map(|ps| ps / 1e3);
        // The clock is where its registers want it: what is wrong is what the ports measured.
        let is_measured = registers.delay_error_ns.is_some_and(|error| off.abs() > error as f64);
        let follows = by_register.filter(|by_register| by_register.abs() < off.abs() / 4.0);
        let Some(by_register) = follows.filter(|_| is_measured) else {
            self.causes.push(format!(
                "Its SYNC0 lies off the grid by {} on average, and stays there: its offset (0x0920), its delay (0x0928) or its start \
                 time (0x0990) is wrong.",
                time(off)
            ));
            return self.remedies.push(compare.into());
        };
        self.causes.push(format!(
            "Its SYNC0 lies off the grid by {} on average, and stays there, although its own clock sees no error (0x092C: {} on average) \
             and its delay (0x0928) is what the ports measured. Ports measure the way out and back as one: where out and back differ in a \
             cable, a media converter or a chip, half of the difference stays as an error that no register shows. Else its start time \
             (0x0990) is wrong.",
            time(off),
            time(by_register)
        ));
        self.remedies.extend([
            "Look for what differs out and back on the way to it: both fibres or pairs of a cable must be equally long, and media \
             converters of one make."
                .to_owned(),
            compare.to_owned(),
        ]);
    }
}

/// Slope of a series in ps, in us per second, which is ppm: from its first to its last tenth.
fn slope_ppm(series: &Series) -> f64 {
    let spans = series.spans();
    let tenth = (spans.len() / 10).max(1);
    let mean = |spans: &[SpanOfTime]| {
        let count = spans.len().max(1) as f64;
        let at = spans.iter().map(|span| (span.begin.0 + span.end.0) as f64 / 2.0).sum::<f64>();
        let value = spans.iter().map(|span| span.mean()).sum::<f64>();
        (at / count, value / count)
    };
    if spans.len() < 2 {
        return 0.0;
    }
    let (begin, end) = (mean(&spans[..tenth]), mean(&spans[spans.len() - tenth..]));
    if end.0 > begin.0 { (end.1 - begin.1) / (end.0 - begin.0) * 1e6 } else { 0.0 }
}
