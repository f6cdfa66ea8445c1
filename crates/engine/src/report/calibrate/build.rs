//! Builds the document from the measurements.

use isocat_esc::DriftLaw;
use isocat_wire::dc::DifferencePolarity;

use super::{
    CalibrationReport, ClockKind, Device, FORMAT, Figure, Fit, Hop, Jitter, Law, LawVerdict,
    Spread, StateChange,
};
use crate::calibrate::{self, Calibration, Judgement, PortKind, Times, Verdict};

impl CalibrationReport {
    /// The report of a calibration; `place` is the segment file or interface.
    pub fn new(place: &str, found: &Calibration) -> Self {
        let devices: Vec<Device> =
            found.devices.iter().map(|one| device(one, found.reference)).collect();
        let followers = devices.iter().filter(|device| device.clock == ClockKind::Follower);
        let clocks = followers.clone().count();
        let told = followers
            .filter(|device| device.difference_polarity.is_some())
            .filter(|device| device.law.as_ref().is_some_and(|law| law.name.is_some()))
            .count();
        let mut left_changed: Vec<String> = found
            .left_changed
            .iter()
            .map(|(position, why)| format!("clock of position {position}: {why}"))
            .collect();
        left_changed.extend(found.devices.iter().filter_map(|device| {
            let state = device.response.state_left?;
            Some(format!("state of position {}: {state}", device.position))
        }));
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            place: place.to_owned(),
            complete: told == clocks && left_changed.is_empty(),
            verdict: format!(
                "calibrated: law and sign of {told} of {clocks} clocks beside the reference were told"
            ),
            reference: found.reference,
            courses: found.courses,
            drift_frames: found.drift_frames.0,
            drift_frames_lost: found.drift_frames.1,
            paced: [found.paced.0.0, found.paced.1.0],
            frames_sent: found.frames.0,
            frames_lost: found.frames.1,
            left_changed,
            devices,
        }
    }
}

fn device(device: &calibrate::Device, reference: usize) -> Device {
    let clock = device.clock.as_ref();
    let figure = |(value, error): (f64, f64), from| Figure {
        value: thousandth(value),
        error: thousandth(error),
        from,
    };
    let state = |change: &Option<calibrate::StateChange>| change.as_ref().map(state_change);
    Device {
        position: device.position,
        esc_type: device.kind,
        clock: match () {
            () if device.position == reference => ClockKind::Reference,
            () if device.has_clock => ClockKind::Follower,
            () if device.has_times => ClockKind::ReceiveTimes,
            () => ClockKind::None,
        },
        crystal_ppb: clock.map(|clock| figure(clock.crystal_ppb, CRYSTAL)),
        crystal_change_ppb: clock.map(|clock| figure(clock.crystal_change_ppb, CRYSTAL_AGAIN)),
        difference_polarity: clock.and_then(|clock| clock.polarity).map(
            |polarity| match polarity {
                DifferencePolarity::PositiveAhead => "positive-ahead",
                DifferencePolarity::NegativeAhead => "negative-ahead",
            },
        ),
        law: clock.map(|clock| law(&clock.law)),
        latch_deviation: clock.map(|clock| thousandth(clock.latch_deviation)),
        jitter: clock.map(|clock| jitter(&clock.jitter)),
        hop: device.hop.as_ref().map(|hop| Hop {
            above: hop.above.map(|(above, _)| above),
            port: hop.above.map(|(_, port)| port.index()),
            round_trip: spread(&hop.round_trip, hop.latches, ROUND_TRIP),
            one_way: hop.one_way.as_ref().map(|one| spread(one, hop.latches, ONE_WAY)),
            t_diff: hop.t_diff.map(|t_diff| figure(t_diff, T_DIFF)),
        }),
        eeprom_read: device.response.eeprom.as_ref().map(|times| timed(times, EEPROM)),
        to_preop: state(&device.response.to_preop),
        to_init: state(&device.response.to_init),
    }
}

fn law(judged: &Judgement) -> Law {
    let (verdict, admissible) = match &judged.verdict {
        Verdict::Told(fit) => (LawVerdict::Told, vec![*fit]),
        Verdict::NotToldApart(fits) => (LawVerdict::NotToldApart, fits.clone()),
        Verdict::NoneFits => (LawVerdict::NoneFits, Vec::new()),
    };
    let told = admissible.first().filter(|_| verdict == LawVerdict::Told);
    let fits = judged.fits.iter().map(|fit| {
        let (name, parameter) = parts(fit.law);
        Fit {
            name,
            parameter,
            admissible: admissible.contains(fit),
            misfit: thousandth(fit.misfit),
            measured: fit.parameter.map(|(value, error)| Figure {
                value: thousandth(value),
                error: thousandth(error),
                from: PARAMETER,
            }),
        }
    });
    Law {
        verdict,
        name: told.map(|fit| parts(fit.law).0),
        phase: told.and_then(|fit| match fit.law {
            DriftLaw::Hold { phase } | DriftLaw::Block { phase } => Some(phase),
            DriftLaw::Proportional { .. } => None,
        }),
        gain: told.and_then(|fit| match fit.law {
            DriftLaw::Proportional { gain, .. } => Some(gain),
            DriftLaw::Hold { .. } | DriftLaw::Block { .. } => None,
        }),
        fits: fits.collect(),
        numbers: judged.numbers,
    }
}

fn jitter(jitter: &calibrate::Jitter) -> Jitter {
    Jitter {
        above: jitter.above,
        port: match jitter.port {
            PortKind::Mii => "mii",
            PortKind::Ebus => "ebus",
            PortKind::Other => "other",
        },
        deviation: jitter.deviation.map(|(value, error)| Figure {
            value: thousandth(value),
            error: thousandth(error),
            from: JITTER,
        }),
        latches: jitter.latches,
    }
}

fn parts(law: DriftLaw) -> (&'static str, u16) {
    match law {
        DriftLaw::Hold { phase } => ("hold", u16::from(phase)),
        DriftLaw::Block { phase } => ("block", u16::from(phase)),
        DriftLaw::Proportional { gain, .. } => ("proportional", gain),
    }
}

fn spread(spread: &calibrate::Spread, count: usize, from: &'static str) -> Spread {
    let count_or_one = count.max(1) as f64;
    // Readings in ticks of 10 ns may all be alike: the next one might still be another tick.
    let error = (spread.deviation / count_or_one.sqrt()).hypot(10.0 / count_or_one);
    Spread {
        mean: thousandth(spread.mean),
        error: thousandth(error),
        deviation: thousandth(spread.deviation),
        least: spread.least,
        most: spread.most,
        count,
        from,
    }
}

/// Times by polling: they may be too long by the time between two polls.
fn timed(times: &Times, from: &'static str) -> Spread {
    let of = spread(&times.spread, times.count, from);
    Spread { error: thousandth(of.error.hypot(times.grain)), ..of }
}

fn state_change(change: &calibrate::StateChange) -> StateChange {
    match change {
        calibrate::StateChange::After(times) => {
            StateChange { took: Some(timed(times, STATE)), refused: None }
        }
        calibrate::StateChange::Refused(_, code) => {
            StateChange { took: None, refused: Some(*code) }
        }
        calibrate::StateChange::TooLate(_) => StateChange { took: None, refused: None },
    }
}

fn thousandth(value: f64) -> f64 {
    (value * 1_000.0).round() / 1_000.0
}

const CRYSTAL: &str = "growth of 0x0918 against the reference's over 10 s without drift frames";
const CRYSTAL_AGAIN: &str = "the same over 5 s at the end, less the first";
const PARAMETER: &str = "0x0932, 0x0918 behind courses of drift frames, against the software ESC";
const JITTER: &str =
    "0x0918 against that of the clock above, about straight lines of half a second";
const ROUND_TRIP: &str = "receive times of the ports, 0x0900 to 0x090F";
const ONE_WAY: &str = "half the branch's time above less the round trip here, 0x0900 to 0x090F";
const T_DIFF: &str =
    "0x0900 to 0x090F of the device above, with the ports behind this one closed and open";
const EEPROM: &str = "host's clock: command to 0x0502 until it is not busy";
const STATE: &str = "host's clock: request to 0x0120 until 0x0130 shows it";
