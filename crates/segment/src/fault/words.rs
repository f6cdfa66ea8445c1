//! The words for faults, with their arguments and meaning.

use isocat_sim::fault::{ClockChange, Fault, Foreign, FrameFault, Harm, Whose};
use isocat_subdevice::Misbehaviour;
use isocat_wire::time::Nanos;

use super::arguments::Arguments;
use super::{Order, Wrong};

/// A word for a fault.
pub struct Word {
    /// The first word of a line.
    pub name: &'static str,
    /// Its arguments, with `[…]` for optional ones.
    pub form: &'static str,
    /// An example line, for a segment with at least two SubDevices.
    pub example: &'static str,
    /// Its effect, as a sentence.
    pub means: &'static str,
    pub(super) read: fn(&mut Arguments<'_>) -> Result<Order, Wrong>,
}

/// All words: frames, cables, power and parts of SubDevices, clocks, the host, behaviour of
/// SubDevices, other devices on the wire.
pub static WORDS: [Word; 27] = [
    Word {
        name: "drop",
        form: "N|(SHARE% [burst N]) [out|back] [at CABLE]",
        example: "drop 3",
        means: "The next N frames are lost, or a share of all by chance: at the MainDevice's port, or on a cable.",
        read: |a| frames(a, Harm::Lost),
    },
    Word {
        name: "loss",
        form: "SHARE% [burst N] [out|back] [at CABLE]",
        example: "loss 0.5% burst 3",
        means: "A share of all frames is lost by chance; 0% ends it.",
        read: |a| frames(a, Harm::Lost),
    },
    Word {
        name: "damage",
        form: "N|(SHARE% [burst N]) [out|back] [at CABLE]",
        example: "damage 1% at 1",
        means: "A bit of frames tips over: ESCs behind count it (0x0300), and the program never sees the frame.",
        read: |a| frames(a, Harm::Damaged),
    },
    Word {
        name: "delay",
        form: "LEAST [MOST] [N|SHARE%] [out|back] [at CABLE]",
        example: "delay 100us 300us",
        means: "Frames come later, on their way back unless said otherwise: all of them, the next N, or a share; 0 ends it.",
        read: |a| {
            let (harm, which) = a.delay()?;
            let (way, cable) = a.place()?;
            let way = way.or(cable.is_none().then_some(isocat_sim::Direction::Back));
            Ok(Fault::Frames(FrameFault { harm, which, way, cable }).into())
        },
    },
    Word {
        name: "double",
        form: "N|(SHARE% [burst N]) [out|back]",
        example: "double 5",
        means: "Frames travel twice: before the segment, so that devices see them twice, or behind it.",
        read: |a| frames(a, Harm::Doubled),
    },
    Word {
        name: "pull",
        form: "CABLE",
        example: "pull 1 for 500ms",
        means: "A cable is pulled: the one that leads to a device, or the one that closes a ring.",
        read: |a| Ok(Fault::Pull { cable: a.cable()? }.into()),
    },
    Word {
        name: "plug",
        form: "CABLE",
        example: "plug 1",
        means: "It is plugged in again, and whatever of it was broken is mended.",
        read: |a| Ok(Fault::Plug { cable: a.cable()? }.into()),
    },
    Word {
        name: "break",
        form: "CABLE out|back",
        example: "break 1 back for 1s",
        means: "One way of that cable is broken: whose listener loses its link, while the other end sends into nothing.",
        read: |a| Ok(Fault::BreakWay { cable: a.cable()?, way: a.way()? }.into()),
    },
    Word {
        name: "flap",
        form: "CABLE OFF ON",
        example: "flap 1 20ms 400ms for 3s",
        means: "The link over a cable comes and goes: so long without it, so long with it.",
        read: |a| Ok(Fault::Flap { cable: a.cable()?, off: a.pause()?, on: a.pause()? }.into()),
    },
    Word {
        name: "recable",
        form: "CABLE LENGTH [TIME]",
        example: "recable 1 80m 2s",
        means: "A cable is taken out, and after a time (1 s) one of another length is there; below 15 us no link is lost.",
        read: |a| {
            let (cable, millimetres) = (a.cable()?, a.length()?);
            let takes = a.some_time()?.unwrap_or(REPLACED);
            Ok(Fault::Recable { cable, millimetres, takes }.into())
        },
    },
    Word {
        name: "power-off",
        form: "DEVICE",
        example: "power-off 1 for 2s",
        means: "A device loses its power; all its cables are as if pulled.",
        read: |a| Ok(Fault::PowerOff { device: a.device()? }.into()),
    },
    Word {
        name: "power-on",
        form: "DEVICE",
        example: "power-on 1",
        means: "It has its power again and starts anew, in INIT.",
        read: |a| Ok(Fault::PowerOn { device: a.device()? }.into()),
    },
    Word {
        name: "power-cycle",
        form: "DEVICE [OFF]",
        example: "power-cycle 1 500ms",
        means: "A device is off for a time, 500 ms unless said otherwise.",
        read: |a| {
            let fault = Fault::PowerOff { device: a.device()? };
            Ok(Order { lasts: Some(a.some_time()?.unwrap_or(OFF)), ..fault.into() })
        },
    },
    Word {
        name: "replace",
        form: "DEVICE BUILT-IN [TIME]",
        example: "replace 1 simple_io16 1s",
        means: "A device is taken out, and after a time (1 s) a built-in one is there in its place.",
        read: |a| {
            let device = a.device()?;
            let spare = Some(a.profile()?);
            let takes = a.some_time()?.unwrap_or(REPLACED).max(Nanos::millis(1));
            let fault = Fault::Replace { device, spare: 0, takes };
            Ok(Order { spare, ..fault.into() })
        },
    },
    Word {
        name: "dead-eeprom",
        form: "DEVICE",
        example: "dead-eeprom 1 for 2s",
        means: "The EEPROM of a device acknowledges nothing (0x0502 bit 13); at power-on nothing is loaded from it.",
        read: |a| Ok(Fault::DeadEeprom { device: a.device()? }.into()),
    },
    Word {
        name: "clock",
        form: "DEVICE|host RATE [over TIME]",
        example: "clock 1 +20ppm over 2s",
        means: "A clock runs faster by so much, at once or within a time.",
        read: |a| {
            let (whose, by_ppb) = (whose(a)?, a.rate()?);
            let change = match a.take("over") {
                true => ClockChange::Ramp { by_ppb, over: a.pause()? },
                false => ClockChange::Step { by_ppb },
            };
            Ok(Fault::Clock { whose, change }.into())
        },
    },
    Word {
        name: "clock-walk",
        form: "DEVICE|host STEP every TIME within BOUND",
        example: "clock-walk 1 100ppb every 50ms within 5ppm",
        means: "A clock wanders: by up to a step each time, never farther than a bound.",
        read: |a| {
            let (whose, step_ppb) = (whose(a)?, a.rate()?.abs());
            let every = match a.take("every") {
                true => a.pause()?,
                false => return Err(Wrong("\"every\" is missing".into())),
            };
            let bound_ppb = match a.take("within") {
                true => a.rate()?.abs(),
                false => return Err(Wrong("\"within\" is missing".into())),
            };
            let change = ClockChange::Walk { step_ppb, every, bound_ppb };
            Ok(Fault::Clock { whose, change }.into())
        },
    },
    Word {
        name: "clock-jump",
        form: "TIME",
        example: "clock-jump 2ms",
        means: "The host's clock jumps ahead by so much.",
        read: |a| Ok(Fault::ClockJump { by: a.pause()? }.into()),
    },
    Word {
        name: "stall",
        form: "TIME",
        example: "stall 20ms",
        means: "No program runs on the host: frames that come wait, timers come when it is over.",
        read: |a| {
            let lasts = a.some_time()?;
            Ok(Order { lasts, ..Fault::Stall.into() })
        },
    },
    Word {
        name: "late-wake-ups",
        form: "LEAST [MOST] [SHARE%]",
        example: "late-wake-ups 50us 400us 10% for 1s",
        means: "Other programs keep the host: timers wake it so much later, always or now and then.",
        read: |a| Ok(Fault::LateWakeUps(a.late()?).into()),
    },
    Word {
        name: "slow-send",
        form: "LEAST [MOST] [SHARE%]",
        example: "slow-send 20us 80us for 1s",
        means: "Frames leave the host so much later than the program's time stamp says.",
        read: |a| Ok(Fault::SlowSends(a.late()?).into()),
    },
    Word {
        name: "misbehave",
        form: "DEVICE WORD…",
        example: "misbehave 1 missed-copy 7 for 1s",
        means: "A device does something wrong: a word of `isocat conform --faults`.",
        read: |a| Ok(Fault::Misbehave { device: a.device()?, how: a.misbehaviour()? }.into()),
    },
    Word {
        name: "stuck-mailbox",
        form: "DEVICE",
        example: "stuck-mailbox 1 for 5s",
        means: "A device does not look into its mailbox any more.",
        read: |a| Ok(Fault::Misbehave { device: a.device()?, how: STUCK }.into()),
    },
    Word {
        name: "sync-off",
        form: "DEVICE",
        example: "sync-off 1 for 100ms",
        means: "The SYNC unit of a device is switched off (0 to register 0x0981); what stood there is written again at the end.",
        read: |a| Ok(Fault::SyncOff { device: a.device()? }.into()),
    },
    Word {
        name: "al-error",
        form: "DEVICE CODE",
        example: "al-error 1 0x0050",
        means: "The application of a device can't go on: it leaves OP for SAFEOP with this AL status code.",
        read: |a| Ok(Fault::AlError { device: a.device()?, code: a.code()? }.into()),
    },
    Word {
        name: "second-master",
        form: "count|init [EVERY]",
        example: "second-master count 10ms for 1s",
        means: "Another MainDevice sends at the same end: a count of all devices, or INIT for all, every 100 ms unless said otherwise.",
        read: |a| {
            let sends = match a.next() {
                Some("count") => Foreign::Count,
                Some("init") => Foreign::Init,
                found => {
                    let found = found.unwrap_or("nothing");
                    return Err(Wrong(format!("\"{found}\" is neither count nor init")));
                }
            };
            let every = a.some_time()?.unwrap_or(FOREIGN).max(Nanos::micros(10));
            Ok(Fault::SecondMaster { sends, every }.into())
        },
    },
    Word {
        name: "heal",
        form: "",
        example: "heal",
        means: "All faults in force end.",
        read: |_| Ok(Fault::Heal.into()),
    },
];

fn frames(a: &mut Arguments<'_>, harm: Harm) -> Result<Order, Wrong> {
    let which = a.which()?;
    let (way, cable) = a.place()?;
    if harm == Harm::Doubled && cable.is_some() {
        return Err(Wrong("frames are doubled at the MainDevice's port only".into()));
    }
    Ok(Fault::Frames(FrameFault { harm, which, way, cable }).into())
}

fn whose(a: &mut Arguments<'_>) -> Result<Whose, Wrong> {
    match a.take("host") {
        true => Ok(Whose::Host),
        false => a.device().map(Whose::Device),
    }
}

/// Default duration of a power cycle.
const OFF: Nanos = Nanos::millis(500);
const REPLACED: Nanos = Nanos::millis(1_000);
const FOREIGN: Nanos = Nanos::millis(100);
/// A mailbox that answers after an hour.
const STUCK: Misbehaviour = Misbehaviour::SlowMailbox(Nanos::millis(3_600_000));
