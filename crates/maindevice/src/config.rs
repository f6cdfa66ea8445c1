//! The user's intent: the cycle, the devices, and the timeouts.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use isocat_sync::budget::{Limits, SyncLimits};
use isocat_sync::phase::Direction;
use isocat_sync::{SyncMode, SyncSignal};
use isocat_wire::address::ObjectAddress;
use isocat_wire::dc::AssignActivate;
use isocat_wire::soe::Idn;
use isocat_wire::time::Nanos;

use crate::segment::SubDevice;

/// Intent for one segment. [`Config::new`] gives every setting but the cycle a default; the field's
/// doc has its reason.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Config {
    /// Time from one exchange of process data to the next; above zero.
    pub cycle: Nanos,
    /// The devices that are expected, by position. Empty: any devices, each in the best mode it
    /// has. Otherwise number and identities must agree with the devices found.
    pub devices: Vec<DeviceConfig>,
    /// How late a frame may be sent after the instant that [`next_timeout`] returned, at worst. The
    /// plan keeps this distance to SYNC0. Default 20 µs: a tuned real-time kernel on a PC.
    ///
    /// [`next_timeout`]: crate::MainDevice::next_timeout
    pub host_jitter: Nanos,
    /// How much too early the time stamps given to [`poll_transmit`] usually are: the mean time
    /// from stamp to wire, less its constant part; at most a twentieth of the cycle. Single stamps
    /// may be early by any time. The clock servo adapts its limit for outliers, its limit for a
    /// lock and its averaging time to it. Default 0: stamps are exact, as in virtual time or with
    /// stamps of the network controller. Use some 10 µs for a socket of an ordinary Linux machine.
    ///
    /// [`poll_transmit`]: crate::MainDevice::poll_transmit
    pub stamp_noise: Nanos,
    /// Phase of SYNC0 in the cycle, counted from the instant at which the frame is sent, in
    /// `0..cycle`. `None`: the plan takes the phase at which all devices have most slack.
    pub shift: Option<Nanos>,
    /// Which clock the segment follows. Default: the reference clock, which the host follows too.
    /// Other directions write to the reference clock in every cycle, with all errors of this host's
    /// stamps; they need a cycle of at most 4 ms.
    pub direction: Direction,
    /// Whether the reference clock's time is distributed, at start and in every cycle. Switched off
    /// for tests only: clocks then run apart by their ppm.
    pub drift_compensation: bool,
    /// Filter depths of the clocks' drift loops.
    pub drift_filters: DriftFilters,
    /// Runs although a line of the plan does not fit. For tests of devices. Default no.
    pub force: bool,
    /// Source address of all frames. The first ESC sets bit 1 of the first octet; if that bit is
    /// clear here, returned frames without it are our own echo and are ignored.
    pub source: [u8; 6],
    /// Whether the delay of a hop varies from frame to frame, since each port transfers frames into
    /// the clock of its ESC: up to 40 ns for MII, 10 ns for EBUS. It counts in the error of delays,
    /// in the limits of 0x092C and in the plan's clock error. Default yes; no only for wires
    /// without it, such as a simulated one.
    pub hop_jitter: bool,
    /// Wanted standard error (1 sigma) of the delays, ns. With [`Config::hop_jitter`], latches are
    /// repeated until all delays reach it, up to eight times [`Config::delay_latches`]. Default 5
    /// ns: half a tick.
    pub delay_error: Nanos,
    /// Least number of latches of the port receive times for the delay measurement. Each latch has
    /// an error of a 10 ns tick at every port, and the jitter of the hops. 16 latches bring the
    /// mean near 1 ns in short segments, at a cost of well under 1 ms for each device. With
    /// [`Config::hop_jitter`] they are 1 to 5 ms apart, so that clocks slip in between. A latch
    /// whose frame is lost, or that not all SubDevices take, is counted and repeated; if more
    /// latches are lost than wanted, bring-up fails. 0 counts as 1.
    pub delay_latches: usize,
    /// Whether delays are also measured while the segment runs. Default no: each latch takes a
    /// frame and a read of 16 bytes from every SubDevice, out of the acyclic share.
    pub delay_watch: Option<DelayWatch>,
    /// Whether clocks, error counters and distances are read in the background while the segment
    /// runs. [`MainDevice::snapshot`](crate::MainDevice::snapshot) returns the readings, and
    /// [`Event::Alarm`](crate::Event::Alarm) reports values beyond their limits. Default no.
    pub quality: Option<QualityWatch>,
    /// Clocks count as converged when 0x092C is below this at every device. With
    /// [`Config::hop_jitter`], four standard deviations of the frames' jitter are added. Default
    /// 100 ns: well above the tick and too small to matter in a sync budget.
    pub drift_threshold: Nanos,
    /// How much two clocks of the segment may differ, for the plan: by drift, by the error of the
    /// measured delays, by the tick of 10 ns. `None`: twice [`Config::drift_threshold`], one on
    /// either side of the reference, or what the drift loop leaves in cycles of this length if that
    /// is more ([`clock_error`](isocat_sync::budget::clock_error())). With [`Config::hop_jitter`]
    /// the part of the longest way's jitter that passes through a loop is added.
    pub clock_error: Option<Nanos>,
    /// The limits within which a SubDevice counts as synchronized; a plan with larger errors does
    /// not fit. Default 1 us for the error of SYNC0 and 1 us for the spread of outputs after their
    /// pulse.
    pub limits: Limits,
    /// Watchdog of the process data (register 0x0420) of SubDevices with outputs, in whole 100 µs
    /// up to 6.5535 s. `None`: the default of the chips, 100 ms. It is a safety function and is
    /// only made longer on request: the plan rejects cycles that are too long for it.
    pub watchdog: Option<Nanos>,
    /// Largest share of the cycle that acyclic frames may take on the wire in operation, percent,
    /// 1..=90. Default 40. Before operation it is 90.
    pub acyclic_share: u8,
    /// Surveys the segment instead of bringing it into operation: it goes up to PREOP with clocks,
    /// then reports [`Event::Surveyed`](crate::Event::Surveyed). It writes no objects. A fault of
    /// one SubDevice does not end the survey but goes into
    /// [`Segment::problems`](crate::Segment::problems). Default no.
    pub survey: Option<Survey>,
    /// Whether devices that announce dynamic times (0x1C32:04 or 0x1C33:04, bit 14) and state 0 for
    /// one of them measure their times (sub-index 08). For that the segment goes to OP with outputs
    /// of 0, back to PREOP, and up again by a plan with the measured times. The application is not
    /// called before that. Default no: a machine goes to OP twice only on request.
    pub measure_times: Option<MeasureTimes>,
    /// How SubDevices that lost power or link while the segment runs are re-admitted. `None`: they
    /// are not. Default: they are re-admitted when they are back.
    pub readmission: Option<Readmission>,
    /// What is done with SubDevices that leave OP by themselves. Default [`Recovery::Never`]: the
    /// user, who knows the machine, must judge why a device left OP.
    pub recovery: Recovery,
    /// A second port behind the last SubDevice, so that a single broken cable stops no SubDevice.
    /// Default no. It cannot be combined with [`Config::survey`], with [`Config::delay_watch`]
    /// (frames do not come back the way they went, so delays cannot be measured), with
    /// [`DeviceConfig::hot_connect`], and with a [`Config::direction`] other than following the
    /// reference clock.
    pub ring: Option<Ring>,
    /// Whether any SubDevice may fail during bring-up. It is left out, in INIT, and the others run
    /// ([`SubDevice::left_out`], [`Event::LeftOut`](crate::Event::LeftOut)). Default no: a machine
    /// without one of its axes is not the machine that was planned. SubDevices that may be absent
    /// ([`DeviceConfig::hot_connect`]) are left out in any case.
    pub tolerate: bool,
    /// Whether SubDevices whose SIIs begin alike (configuration, identity and checksum, but not
    /// alias and serial number) share the content of the first two, if these two agree to the end.
    /// Default yes: reading SIIs takes most of the bring-up time of a long line. Switch it off if
    /// EEPROMs of one identity differ in their categories, as may be so for modular devices that
    /// store their modules there.
    pub share_sii: bool,
    /// Whether devices of one vendor, product and revision share the descriptions of 0x1C32 and
    /// 0x1C33, if they support complete access. The first two and then one in sixteen are asked for
    /// each description and each entry; the others upload each object as a whole. Values always
    /// come from the device itself. Default yes: objects take most of the bring-up time of a long
    /// line. Switch it off if devices of one revision have different dictionaries.
    pub share_objects: bool,
    /// Timeouts.
    pub timeouts: Timeouts,
}

/// Filter depths of the drift loop, each 0 to 15: a mean over about 2^depth values. `None`: chosen
/// by the cycle, see [`DriftFilters::depths`].
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct DriftFilters {
    /// Depth for the time difference (register 0x0934).
    pub difference: Option<u8>,
    /// Depth for the speed (register 0x0935).
    pub speed: Option<u8>,
}

impl DriftFilters {
    /// Depths of the filters of the difference and of the speed, if a system time comes each
    /// `interval`.
    ///
    /// The exact behaviour of the filters is not published; docs/dc.md lists the possible laws. By
    /// default, differences are averaged over 16 ms (depth 6 at most) and speeds over 64 ms (depth
    /// 6 to 9), which suits every possible law: clocks lock in some 4 000 drift frames, follow a
    /// step of temperature within some ten ns at 1 ms, and average the jitter of hops. With 0 and
    /// 12, as many MainDevices set them, a clock behind many hops may wander by some 100 ns, and a
    /// crystal that changes by 1 ppm moves its clock by up to 0.7 us at a cycle of 1 ms.
    pub fn depths(&self, interval: Nanos) -> (u8, u8) {
        let mean_over =
            |span: Nanos| (span.0 / interval.0.max(1)).checked_ilog2().unwrap_or(0) as u8;
        let difference = self.difference.unwrap_or(mean_over(DIFFERENCE_SPAN).min(6));
        let speed = self.speed.unwrap_or(mean_over(SPEED_SPAN).clamp(6, 9));
        (difference.min(15), speed.min(15))
    }
}

/// Time over which differences are averaged.
const DIFFERENCE_SPAN: Nanos = Nanos::millis(16);
/// Time over which speeds are averaged.
const SPEED_SPAN: Nanos = Nanos::millis(64);

impl Config {
    /// A configuration with defaults for a cycle.
    pub fn new(cycle: Nanos) -> Self {
        Self {
            cycle,
            devices: Vec::new(),
            host_jitter: Nanos::micros(20),
            stamp_noise: Nanos::ZERO,
            shift: None,
            direction: Direction::FollowReference,
            drift_compensation: true,
            drift_filters: DriftFilters::default(),
            force: false,
            source: [0x10; 6],
            hop_jitter: true,
            delay_error: Nanos(5),
            delay_latches: 16,
            delay_watch: None,
            quality: None,
            drift_threshold: Nanos(100),
            clock_error: None,
            limits: Limits::default(),
            watchdog: None,
            acyclic_share: 40,
            survey: None,
            measure_times: None,
            readmission: Some(Readmission::default()),
            recovery: Recovery::Never,
            ring: None,
            tolerate: false,
            share_sii: true,
            share_objects: true,
            timeouts: Timeouts::default(),
        }
    }
}

/// How delays are measured while the segment runs.
///
/// Only receive times are latched (a write to 0x0900), which disturbs neither SYNC nor the drift
/// loop. Filters (0x0930) are never reset. A delay that differs from the one in force by more than
/// the error is reported as [`Event::DelayChanged`](crate::Event::DelayChanged).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DelayWatch {
    /// Time from one latch to the next; at least one cycle. Default 1 s.
    pub every: Nanos,
    /// Number of latches for one estimate; at least 2. Default 16.
    pub latches: usize,
    /// Whether a changed delay is written to 0x0928. The clock then moves to its new time as the
    /// drift loop allows, and its pulses move with it. Default no.
    pub rewrite: bool,
}

/// Readings in the background that show how well the segment runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct QualityWatch {
    /// Share of the wire's time that the reads may take, permille, 1..=200. Clocks and objects get
    /// half of it each, or one of them all if the other is not read. The share is kept on average,
    /// to one reading. Default 10.
    pub share_permille: u16,
    /// Readings kept of each clock, and moments kept of the segment; at least 16. Default 256.
    pub history: usize,
    /// Number of cycles without a drift frame that all clocks took, after which
    /// [`Event::ClocksUnled`](crate::Event::ClocksUnled) is reported: 0x092C is then out of date.
    /// At least 1; default 100.
    pub unled_cycles: u64,
    /// 0x092C beyond this raises an alarm; half of it ends the alarm. With [`Config::hop_jitter`],
    /// four standard deviations of the frames' jitter are added. Default 200 ns: twice the limit
    /// within which clocks count as converged.
    pub difference_limit: Nanos,
    /// A [`Margin`](crate::quality::Margin) before SYNC0 below this raises an alarm, which ends at
    /// a quarter of the way from here to the planned margin. `None`: margins are recorded but raise
    /// no alarm. Default 0: below it a frame is too late for a SubDevice that needs all the time it
    /// states.
    pub margin_limit: Option<Nanos>,
    /// Whether 0x1C32 and 0x1C33 are read as well: error counters (:0B to :0E, :20) and distances
    /// (0x1C32:0F to :12), as far as a SubDevice has them. Requests of the application have
    /// priority. Default yes.
    pub objects: bool,
}

impl Default for QualityWatch {
    fn default() -> Self {
        Self {
            share_permille: 10,
            history: 256,
            unled_cycles: 100,
            difference_limit: Nanos(200),
            margin_limit: Some(Nanos::ZERO),
            objects: true,
        }
    }
}

impl Default for DelayWatch {
    fn default() -> Self {
        Self { every: Nanos::millis(1_000), latches: 16, rewrite: false }
    }
}

/// How long devices measure their times. A device reports the longest value so far, so values only
/// grow.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MeasureTimes {
    /// Time without a change after which the values count as stable; above zero. Default 1 s.
    pub settled: Nanos,
    /// Time after which the last values are taken even if they still change;
    /// [`OwnTimes::settled`](crate::OwnTimes) tells so. Default 10 s.
    pub longest: Nanos,
}

impl Default for MeasureTimes {
    fn default() -> Self {
        Self { settled: Nanos::millis(1_000), longest: Nanos::millis(10_000) }
    }
}

/// What a survey reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Survey {
    /// Whether objects are read by SDO; without them only the SII describes the process data.
    /// Default yes.
    pub objects: bool,
}

impl Default for Survey {
    fn default() -> Self {
        Self { objects: true }
    }
}

/// How lost SubDevices are re-admitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Readmission {
    /// Time from a failed attempt to the next one. Default 1 s.
    pub pause: Nanos,
}

impl Default for Readmission {
    fn default() -> Self {
        Self { pause: Nanos::millis(1_000) }
    }
}

/// How a ring is run.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Ring {
    /// How long to wait for one copy of a frame after the other has come back from a cut. It must
    /// be longer than the difference of the ways to either side plus the time by which the two
    /// ports differ in delivering frames to the program, and short enough that the copies come
    /// within the cycle. `None`: a quarter of the cycle.
    pub patience: Option<Nanos>,
    /// How much longer a frame takes from the secondary port to the last SubDevice than from the
    /// primary port to the first. The plan includes it behind a cut. Default 0, for cables of equal
    /// length; it is not measured.
    pub longer: Nanos,
}

/// When a SubDevice that left OP by itself is acknowledged and brought back. Its AL status usually
/// shows an error.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Recovery {
    /// Never.
    #[default]
    Never,
    /// Makes one attempt for each SubDevice in the whole run.
    Once,
    /// Repeats attempts, with each pause after a failure twice as long as the one before. A
    /// SubDevice that stays in OP for the longest pause starts again with the first pause.
    ///
    /// A SubDevice that keeps its error through three acknowledgements, of a second each, is led
    /// through INIT, which some devices need for clearing it.
    BackOff {
        /// Time from leaving OP to the first attempt.
        first: Nanos,
        /// Longest pause.
        longest: Nanos,
    },
}

/// Timeouts, all in host time.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Timeouts {
    /// Time from sending a frame to giving it up. Default 5 ms: a full frame through a thousand
    /// devices takes 2 ms, and a busy host adds its own time. Each SubDevice beyond the thousandth
    /// adds 2 us automatically. Each repetition of a datagram waits twice as long as the one
    /// before.
    pub frame: Nanos,
    /// How often a datagram that may be repeated is sent again after a loss. Default 3: with 5 ms
    /// for the first frame, 75 ms without any answer end the bring-up, but a sleep of 40 ms at
    /// either end does not.
    pub retries: u8,
    /// For one read of the SII EEPROM. Default 100 ms; real EEPROMs take about 1 ms.
    pub eeprom: Nanos,
    /// For the answer to one mailbox service. Default 2 s: drives store parameters in flash before
    /// they answer.
    pub mailbox: Nanos,
    /// From requesting INIT to reaching it. Default 5 s, the ETG timeout.
    pub init: Nanos,
    /// From requesting PREOP to reaching it. Default 3 s.
    pub preop: Nanos,
    /// From requesting SAFEOP to reaching it. Default 10 s.
    pub safeop: Nanos,
    /// From requesting OP to reaching it. Default 12 s, more than the 9 s (less ten percent) after
    /// which SubDevice stacks answer with the reason themselves.
    pub op: Nanos,
    /// For the drift loop to converge. Default 30 s: a loop corrects some hundred ns each second.
    pub drift: Nanos,
    /// For the host's phase to lock onto the reference clock. Default 20 s, or four times the
    /// cycles that locking takes if that is longer.
    pub phase: Nanos,
    /// The longest lead of the start time: from programming SYNC0 until the first pulse. Default
    /// 100 ms, as other MainDevices have it. On the way up a shorter one is tried first, which
    /// suffices unless the host stalls: 20 ms and 200 us for each SubDevice.
    pub sync_lead: Nanos,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            frame: Nanos::millis(5),
            retries: 3,
            eeprom: Nanos::millis(100),
            mailbox: Nanos::millis(2_000),
            init: Nanos::millis(5_000),
            preop: Nanos::millis(3_000),
            safeop: Nanos::millis(10_000),
            op: Nanos::millis(12_000),
            drift: Nanos::millis(30_000),
            phase: Nanos::millis(20_000),
            sync_lead: Nanos::millis(100),
        }
    }
}

/// Intent for one device.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct DeviceConfig {
    /// Its name in messages. Empty: the name in its SII.
    pub name: String,
    /// Vendor id and product code that its SII must have. `None`: any.
    pub identity: Option<(u32, u32)>,
    /// Synchronization mode. `None`: the best that the device and the cycle allow.
    pub mode: Option<SyncMode>,
    /// Its own cycle, a whole multiple of the bus cycle, up to 2.147 s. SYNC0 has this period, and
    /// its process data are exchanged only once in it. Not for subordinated cycles, whose SYNC0 is
    /// faster than the bus cycle. `None`: the bus cycle.
    pub cycle: Option<Nanos>,
    /// Time from SYNC0 to SYNC1. With subordinated cycles it counts from the SYNC0 that SYNC1
    /// belongs to, and is less than a cycle of SYNC0. `None`: for "DC SYNC1" the time the device
    /// needs (0x1C32:06) in whole microseconds, for "DC shift SYNC1" a quarter of the cycle, for
    /// subordinated cycles 0.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0 with subordinated cycles. `None`: the device's value in 0x1C32:0A.
    pub sync0_cycle: Option<Nanos>,
    /// Word for registers 0x0980 (which side owns the SYNC unit and the latch units) and 0x0981
    /// (what the SYNC unit does), in the form of AssignActivate in a description. A mode with DC
    /// adds the pulses that it needs and takes the SYNC unit; a mode without DC makes no pulses.
    /// `None`: the pulses of the mode; owners stay unchanged, except for a SYNC unit that the mode
    /// needs.
    pub unit: Option<AssignActivate>,
    /// PDOs to assign to 0x1C12. `None`: the assignment of the device.
    pub outputs: Option<Vec<u16>>,
    /// PDOs to assign to 0x1C13. `None`: the assignment of the device.
    pub inputs: Option<Vec<u16>>,
    /// Shift of Outputs Valid, object 0x1C32:03, for devices that shift by a local timer.
    pub shift_outputs: Option<Nanos>,
    /// Shift of Input Latch, object 0x1C33:03, for devices that shift by a local timer.
    pub shift_inputs: Option<Nanos>,
    /// Times that the device once measured, for the plan if it states 0 or nothing. They have
    /// priority over assumed times. A device with any of them does not measure again.
    pub measured: MeasuredTimes,
    /// Times for the plan if the device states 0 or nothing.
    pub assumed: AssumedTimes,
    /// Speed of its oscillator against true time, if known. `None`: within 100 ppm of the others.
    pub clock: Option<ClockRange>,
    /// The SubDevice may be absent and come while the segment runs (hot connect). This describes
    /// it, so that the cycle is planned as if it were present. Identity, ESC, clock, SII, PDOs and
    /// sync objects are used, and its place: a port with no other SubDevice behind it.
    /// [`Segment::devices`](crate::Segment::devices) of a run with it contains such a description,
    /// and so does the segment that [`plan`](crate::plan()) takes. Not for the first SubDevice.
    /// `None`: it must be present.
    pub hot_connect: Option<Box<SubDevice>>,
    /// Registers of its watchdogs, unless [`Config::watchdog`] sets that of all.
    pub watchdog: WatchdogRegisters,
    /// SDO downloads in PREOP, in this order, before mode and mapping are read.
    pub startup: Vec<StartupDownload>,
    /// Drive parameters that SoE writes in PREOP, in this order, after the SDO downloads. A device
    /// without SoE but with parameters here fails in bring-up.
    pub parameters: Vec<StartupParameter>,
}

/// What is written to the registers of the watchdogs; `None`: the chip keeps its own value.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct WatchdogRegisters {
    /// Register 0x0400, the unit of both times: 40 ns × (this + 2).
    pub divider: Option<u16>,
    /// Register 0x0410, the watchdog of the PDI, in these units.
    pub pdi: Option<u16>,
    /// Register 0x0420, the watchdog of the process data, in these units; 0: off. Written to a
    /// SubDevice with outputs.
    pub process_data: Option<u16>,
}

impl WatchdogRegisters {
    /// How long outputs stay valid without new ones; `None`: as long as it takes. What is not
    /// written is as after power-on.
    pub fn time(self) -> Option<Nanos> {
        let unit = 40 * (i64::from(self.divider.unwrap_or(DIVIDER)) + 2);
        let steps = i64::from(self.process_data.unwrap_or(STEPS));
        (steps > 0).then_some(Nanos(unit * steps))
    }
}

/// Registers 0x0400 and 0x0420 after power-on: 1000 steps of 100 us.
const DIVIDER: u16 = 2498;
const STEPS: u16 = 1_000;

impl Config {
    /// The watchdog registers of the SubDevice at a position.
    pub(crate) fn watchdog_of(&self, position: usize) -> WatchdogRegisters {
        let asked = self.watchdog.map(|time| WatchdogRegisters {
            process_data: Some((time.0 / WATCHDOG_TICK.0) as u16),
            ..WatchdogRegisters::default()
        });
        let own = || self.devices.get(position).map(|device| device.watchdog);
        asked.or_else(own).unwrap_or_default()
    }
}

/// Unit of register 0x0420 by the reset value of register 0x0400.
pub(crate) const WATCHDOG_TICK: Nanos = Nanos::micros(100);

impl DeviceConfig {
    /// Whether it may be absent.
    pub fn may_be_absent(&self) -> bool {
        self.hot_connect.is_some()
    }
}

/// Times for the plan if a device states 0 or nothing. `None`: 0 is taken as stated.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct AssumedTimes {
    /// For 0x1C32:05.
    pub minimum_cycle: Option<Nanos>,
    /// For 0x1C32:06.
    pub outputs_calc_and_copy: Option<Nanos>,
    /// For 0x1C32:09.
    pub outputs_delay: Option<Nanos>,
    /// For 0x1C33:06.
    pub inputs_calc_and_copy: Option<Nanos>,
    /// For 0x1C33:09.
    pub inputs_delay: Option<Nanos>,
    /// How much later than its pulse the device's steps may begin. No object states it.
    pub pulse_jitter: Option<Nanos>,
    /// Difference of the longest and the shortest time from the pulse to outputs that act as soon
    /// as they are calculated, without delay and shift. No object states it. `None`: same as
    /// `pulse_jitter`.
    pub outputs_spread: Option<Nanos>,
    /// What ends the pulses of its SYNC signals. No object states it.
    pub sync_signal: SyncSignal,
    /// Limits of its SYNC unit's cycles beside 0x1C32:05. No object states them.
    pub sync_limits: SyncLimits,
}

/// Times that a device measured itself, on command of 0x1C32:08 and 0x1C33:08. `None`: not
/// measured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct MeasuredTimes {
    /// The longer of 0x1C32:05 and 0x1C33:05.
    pub minimum_cycle: Option<Nanos>,
    /// 0x1C32:06.
    pub outputs_calc_and_copy: Option<Nanos>,
    /// 0x1C32:09.
    pub outputs_delay: Option<Nanos>,
    /// 0x1C33:06.
    pub inputs_calc_and_copy: Option<Nanos>,
    /// 0x1C33:09.
    pub inputs_delay: Option<Nanos>,
}

/// The range of an oscillator's speed, ppb; positive is fast.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ClockRange {
    /// At its slowest.
    pub least_ppb: i64,
    /// At its fastest.
    pub most_ppb: i64,
}

impl ClockRange {
    /// Largest difference in speed of two oscillators, ppb.
    pub fn apart(self, other: Self) -> i64 {
        (self.most_ppb - other.least_ppb).max(other.most_ppb - self.least_ppb)
    }
}

/// One parameter of a drive that is written at start.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct StartupParameter {
    /// Which drive of the SubDevice, 0 to 7.
    pub drive: u8,
    /// The parameter.
    pub idn: Idn,
    /// The bytes, little-endian; a list begins with its two lengths.
    pub data: Vec<u8>,
}

/// One SDO download at start.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct StartupDownload {
    /// The entry; with complete access its sub-index is 0 or 1.
    pub object: ObjectAddress,
    /// The bytes, little-endian.
    pub data: Vec<u8>,
    /// Complete access.
    pub complete: bool,
}
