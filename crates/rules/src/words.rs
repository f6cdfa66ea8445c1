//! Sentences of breaches: what is otherwise than it was meant, with its figures.

use alloc::format;
use alloc::string::String;
use core::fmt;

use isocat_sync::SyncMode;
use isocat_wire::dc::SyncActivation;
use isocat_wire::time::Picos;

use crate::breach::Breach;

/// What was found, as the rest of a sentence that begins with the name of the SubDevice, or as a
/// sentence about the segment.
impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&said(self))
    }
}

impl Breach {
    /// What to do, likeliest first.
    pub fn remedies(&self) -> &'static [&'static str] {
        match self {
            Self::NotOperated { .. } => &[
                "read 0x0134 (AL status code) of the SubDevice, and ask for OP again when its cause is gone",
            ],
            Self::OtherMode { wanted, .. } if wanted.uses_dc() => &[
                "write SYNC0 (0x0990, 0x09A0, then 0x0980 and 0x0981) in PREOP, before SAFEOP is asked for",
                "write 0x1C32:01 and 0x1C33:01 as the mode needs",
            ],
            Self::OtherMode { .. } => {
                &["leave SYNC0 off (0x0981), and write 0x1C32:01 and 0x1C33:01 as the mode needs"]
            }
            Self::StartPassed { .. } => &[
                "read the reference's system time just before, and take a start time 100 ms later",
            ],
            Self::OtherSync0Cycle { .. } => &["write the cycle to 0x09A0, in ns, before 0x0981"],
            Self::OtherShift { .. } => &[
                "take a start time (0x0990) of a whole cycle plus the shift, by the reference clock",
                "send frames at whole cycles of the reference clock",
            ],
            Self::Sync0Apart { .. } => {
                &["give all SubDevices start times (0x0990) that lie whole cycles apart"]
            }
            Self::OtherCycle { .. } => &["let the MainDevice's timer have the cycle of the file"],
            Self::NoProcessData => {
                &["assign PDOs in 0x1C12 and 0x1C13, and set the SyncManagers to their lengths"]
            }
            Self::NotCarried { .. } => {
                &["let an FMMU (0x0600) map the SyncManager to logical bytes that a datagram has"]
            }
            Self::CarriedSeldom { .. } => &[
                "send its process data in each of its cycles",
                "let the file say how often they are to be exchanged (cycle of the SubDevice)",
            ],
            Self::OtherInterpolation { .. } => &[
                "write the cycle to 0x60C2 in PREOP: units in :01, power of ten of a second in :02",
            ],
            Self::SharedAddress { .. } => &["give each FMMU logical bytes of its own"],
            Self::WatchdogOff => &[
                "leave 0x0400 and 0x0420 as they are after power-on, or write a time of some cycles",
                "write the SyncManager's control byte as the EEPROM has it",
            ],
            Self::OtherWatchdog { .. } => {
                &["write the time to 0x0420, in steps of what 0x0400 says (100 us after power-on)"]
            }
            Self::ClockSet { .. } => {
                &["leave offset and delay alone while SYNC0 runs: drift frames keep the clock"]
            }
            Self::TimeNotDistributed { .. } => &["send FRMW of 0x0910 in each cycle"],
            Self::FramesSlide { .. } => {
                &["correct the MainDevice's timer by the time that FRMW brings"]
            }
            Self::AnswersUntaken { .. } => &[
                "wait longer for answers: raise the time-out of the receive call, to some milliseconds or most of the cycle",
                "where the answers come late themselves: coalescing of the network card, its driver",
            ],
            Self::SeveralTalkers { .. } => {
                &["one MainDevice alone may talk on a segment: find the other one"]
            }
        }
    }
}

fn said(breach: &Breach) -> String {
    match breach {
        Breach::NotOperated { state, code } => {
            format!("is in {state}, and is to be in OP: AL status code {code}")
        }
        Breach::OtherMode { wanted, found, activation } => {
            let why = why(*wanted, *found, *activation);
            format!("runs in {found}, and is to run in {wanted}{why}")
        }
        Breach::StartPassed { ago } => format!(
            "its SYNC0 never comes: the start time (0x0990) had passed, by now {ago} ago"
        ),
        Breach::OtherSync0Cycle { wanted, found } if found.0 == 0 => {
            format!("its SYNC0 comes a single time (0x09A0 is 0), and is to come each {wanted}")
        }
        Breach::OtherSync0Cycle { wanted, found } => {
            format!("its SYNC0 comes each {found} (0x09A0), and is to come each {wanted}")
        }
        Breach::OtherShift { wanted, found } => {
            let side = if found.0 < 0 { "before" } else { "after" };
            let found = time(found.abs());
            format!("SYNC0 comes {found} {side} frames leave, and is to come {wanted} after (shift)")
        }
        Breach::Sync0Apart { from, by, limit } => {
            let side = if by.0 > 0 { "after" } else { "before" };
            format!(
                "SYNC0 comes {} {side} that of SubDevice {from}, limit {limit}: start times (0x0990) or clocks (0x0920, 0x0928) do not fit",
                by.abs()
            )
        }
        Breach::OtherCycle { wanted, found } => {
            format!("frames come each {found}, and are to come each {wanted}")
        }
        Breach::NoProcessData => {
            "has no process data at all: nothing is assigned in 0x1C12 and 0x1C13".into()
        }
        Breach::NotCarried { outputs: true } => {
            "no frame brings outputs to it: look at its FMMU".into()
        }
        Breach::NotCarried { outputs: false } => {
            "no frame fetches its inputs: look at its FMMU".into()
        }
        Breach::CarriedSeldom { outputs, wanted, found } => {
            let what = if *outputs { "outputs come to it" } else { "its inputs are fetched" };
            format!("{what} each {} only, and are to each {wanted}", time((*found).into()))
        }
        Breach::OtherInterpolation { wanted, found } => {
            let what = if found > wanted { "is late at each" } else { "waits at each" };
            format!(
                "interpolates its set points over {found} (0x60C2), and one comes each {wanted}: it {what}"
            )
        }
        Breach::SharedAddress { with, outputs, logical } => {
            let what = if *outputs { "outputs" } else { "inputs" };
            format!("its {what} are those of SubDevice {with}: both map logical byte {logical:#010X}")
        }
        Breach::WatchdogOff => {
            "nothing guards its outputs: its process data watchdog is off (0x0420, or bit 6 of its SyncManager's control)"
                .into()
        }
        Breach::OtherWatchdog { wanted, found } => format!(
            "its process data watchdog has {found} (0x0400, 0x0420), and is to have {wanted} (watchdog)"
        ),
        Breach::ClockSet { by } => format!(
            "its clock was set anew in operation, by {by} (0x0920 or 0x0928), and SYNC0 jumped with it"
        ),
        Breach::TimeNotDistributed { gap, limit } => format!(
            "the reference time was not distributed for {}: after {} clocks may be too far apart",
            time((*gap).into()),
            time((*limit).into())
        ),
        Breach::FramesSlide { per_second, half_cycle_after } => {
            let way = if per_second.0 > 0 { "later" } else { "earlier" };
            format!(
                "frames come {} {way} each second, by half of a cycle in {}: the MainDevice does not follow the \
                 reference clock",
                time(per_second.abs().into()),
                time((*half_cycle_after).into())
            )
        }
        Breach::AnswersUntaken { frames, of } => format!(
            "the program sent {frames} of {of} frames without having taken the answer to the one before, and not the others: at times it \
             takes inputs of the cycle before for new ones; a longer time-out of its receive call lets it wait for them"
        ),
        Breach::SeveralTalkers { frames } => {
            format!("more than one MainDevice sends on this wire: {frames} frames are of another one")
        }
    }
}

/// Why a SubDevice runs in another mode, as far as its SYNC unit tells.
fn why(wanted: SyncMode, found: SyncMode, activation: Option<u8>) -> String {
    let Some(activation) = activation else { return String::new() };
    let (sync0, sync1) = (SyncActivation::SYNC0, SyncActivation::SYNC1);
    let active = activation & SyncActivation::ACTIVE != 0;
    if wanted.uses_dc() && !(active && activation & sync0 != 0) {
        format!(": SYNC0 is off (0x0981 = {activation:#04X})")
    } else if wanted.uses_sync1() && activation & sync1 == 0 {
        format!(": SYNC1 is off (0x0981 = {activation:#04X})")
    } else if wanted.uses_dc() && !found.uses_dc() {
        ": SYNC0 runs now, but it chose its mode on the way to SAFEOP, by the SYNC unit and 0x1C32:01 as they were then"
            .into()
    } else {
        String::new()
    }
}

/// A time with three digits behind the point.
fn time(span: Picos) -> String {
    let (per_unit, unit) = match span.0.unsigned_abs() {
        0..1_000_000_000 => (1e6, "us"),
        1_000_000_000..1_000_000_000_000 => (1e9, "ms"),
        _ => (1e12, "s"),
    };
    format!("{:.3} {unit}", span.0 as f64 / per_unit)
}
