//! What the user wants: the cycle, the devices, and how patient to be.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use isocat_sync::budget::Limits;
use isocat_sync::phase::Direction;
use isocat_sync::{SyncMode, SyncSignal};
use isocat_wire::address::ObjectAddress;
use isocat_wire::dc::AssignActivate;
use isocat_wire::soe::Idn;
use isocat_wire::time::Nanos;

use crate::segment::SubDevice;

/// Intent for one segment. [`Config::new`] gives every setting but the cycle a default whose reason
/// stands at the field.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Config {
    /// Time from one exchange of process data to the next; above zero.
    pub cycle: Nanos,
    /// The devices that are expected, by position. Empty: take what is there, every device in the
    /// best mode it has. Otherwise number and identities must agree with what is found.
    pub devices: Vec<DeviceConfig>,
    /// How late a frame may be sent after the instant that [`next_timeout`] named, at worst. The
    /// plan keeps this distance to SYNC0. Default 20 µs: a tuned real-time kernel on a PC.
    ///
    /// [`next_timeout`]: crate::MainDevice::next_timeout
    pub host_jitter: Nanos,
    /// How much too early the time stamps given to [`poll_transmit`] are as a rule: the mean time from
    /// stamp to wire, less what of it is constant; at most a twentieth of the cycle. Single stamps may
    /// be early by any time. The clock servo follows: what it takes for an outlier, what for a lock, how
    /// long it averages. Default 0: stamps are exact, as in virtual time or with stamps of the network
    /// controller. Some 10 µs for a socket of an ordinary Linux machine.
    ///
    /// [`poll_transmit`]: crate::MainDevice::poll_transmit
    pub stamp_noise: Nanos,
    /// Phase of SYNC0 in the cycle, counted from the instant at which the frame is sent, in
    /// `0..cycle`. `None`: the plan takes the phase at which all devices have most slack.
    pub shift: Option<Nanos>,
    /// Which clock leads the segment. Default: the reference clock, and the host follows. Anything else writes
    /// into the reference clock in every cycle, and what is imperfect about this host's stamps with it; for cycles of 4 ms
    /// at most.
    pub direction: Direction,
    /// Whether the reference clock's time is distributed, at start and in every cycle. Switched off
    /// for tests only: clocks then run apart by their ppm.
    pub drift_compensation: bool,
    /// Filter depths of the clocks' drift loops.
    pub drift_filters: DriftFilters,
    /// Run although a line of the plan does not fit. For tests of devices; default no.
    pub force: bool,
    /// Source address of all frames. The first ESC sets bit 1 of the first octet; if that bit is
    /// clear here, frames that come back without it are our own echo and are ignored.
    pub source: [u8; 6],
    /// Whether the delay of a hop is taken to vary from frame to frame, as ports take frames into
    /// the clock of their ESC: up to 40 ns for MII, 10 ns for EBUS. It is in the error of delays,
    /// in what 0x092C may show and in the plan's clock error. Default yes; no only for wires
    /// without it, as a simulated one may be.
    pub hop_jitter: bool,
    /// How well delays are to be known, as standard error (1 sigma), ns. With
    /// [`Config::hop_jitter`], latches go on until all are, up to eight times
    /// [`Config::delay_latches`]. Default 5 ns: half a tick.
    pub delay_error: Nanos,
    /// How often the port receive times are latched for the delay measurement, at least. Each latch
    /// has an error of a 10 ns tick at every port, and the jitter of the hops; 16 of them bring the
    /// mean near 1 ns in short segments at a cost of well under 1 ms a device. With
    /// [`Config::hop_jitter`] they are 1 to 5 ms apart, so that clocks slip in between. Latches
    /// whose frame is lost, or that not all SubDevices take, are counted and made again; more of
    /// them than wanted ones end the way up. 0 counts as 1.
    pub delay_latches: usize,
    /// Whether delays are measured on while the segment runs. Default no: each latch takes a frame and a read of
    /// 16 bytes from every SubDevice, out of the acyclic share.
    pub delay_watch: Option<DelayWatch>,
    /// Whether clocks, error counters and distances are read in the background while the segment runs: what they say is
    /// [`MainDevice::snapshot`](crate::MainDevice::snapshot), what leaves its limits [`Event::Alarm`](crate::Event::Alarm).
    /// Default no.
    pub quality: Option<QualityWatch>,
    /// Clocks count as converged when 0x092C is below this at every device; with
    /// [`Config::hop_jitter`], four standard deviations of what frames jitter on their way are
    /// added. Default 100 ns: well above the tick and below what any sync budget notices.
    pub drift_threshold: Nanos,
    /// How much two clocks of the segment may differ, for the plan: by drift, by the error of the
    /// measured delays, by the tick of 10 ns. `None`: twice [`Config::drift_threshold`], one on
    /// either side of the reference, or what the drift loop leaves in cycles of this length if that
    /// is more ([`clock_error`](isocat_sync::budget::clock_error())); with [`Config::hop_jitter`]
    /// what a loop hands on of the longest way's jitter besides.
    pub clock_error: Option<Nanos>,
    /// With what a SubDevice counts as synchronized: a plan that promises less does not fit.
    /// Default 1 us for the error of SYNC0 and 1 us for the spread of outputs behind their pulse.
    pub limits: Limits,
    /// Watchdog of the process data (register 0x0420) of SubDevices with outputs, in whole 100 µs up to 6.5535 s.
    /// `None`: as the chips have it, 100 ms. It is a safety function and never made longer unasked: the plan
    /// refuses cycles that it can't see.
    pub watchdog: Option<Nanos>,
    /// How much of the cycle acyclic frames may take on the wire, percent, 1..=90. Default 40.
    pub acyclic_share: u8,
    /// Instead of bringing the segment into operation, look what is there: up to PREOP with clocks, then
    /// [`Event::Surveyed`](crate::Event::Surveyed). Nothing is written to objects, and what one SubDevice lacks
    /// ends nothing: it goes into [`Segment::problems`](crate::Segment::problems). Default no.
    pub survey: Option<Survey>,
    /// Whether devices that announce dynamic times (0x1C32:04 or 0x1C33:04, bit 14) and state 0 for one measure
    /// them (sub-index 08). For that the segment goes to OP with outputs of 0, back to PREOP, and up again
    /// by a plan with what was measured. The application is not called before that. Default no: a machine goes to
    /// OP twice only if it is asked to.
    pub measure_times: Option<MeasureTimes>,
    /// What becomes of SubDevices that are lost while the segment runs, by power or by cable. `None`: nothing is
    /// done, and nothing expected otherwise. Default: they are admitted again when they are back.
    pub readmission: Option<Readmission>,
    /// What becomes of SubDevices that leave OP by themselves. Default [`Recovery::Never`]: why a device fell is
    /// for whoever knows its machine to judge.
    pub recovery: Recovery,
    /// A second port behind the last SubDevice, so that one broken cable stops nobody. Default no. Not together with
    /// [`Config::survey`], [`Config::delay_watch`] (frames don't come back the way they went, so nothing can be measured),
    /// [`DeviceConfig::hot_connect`], and a [`Config::direction`] but following the reference clock.
    pub ring: Option<Ring>,
    /// Whether any SubDevice may fail on the way up: it is left out, in INIT, and the others run
    /// ([`SubDevice::left_out`], [`Event::LeftOut`](crate::Event::LeftOut)). Default no: a machine with an axis
    /// missing is not the machine that was planned. Those that may be absent ([`DeviceConfig::hot_connect`]) are left out
    /// in any case.
    pub tolerate: bool,
    /// Whether SubDevices whose SII begins alike (configuration, identity and checksum, but for alias and serial number)
    /// share what the first two of them have, if these two agree to the end. Default yes: reading SIIs is most of the
    /// way up of a long line. Switch it off where EEPROMs of one identity differ in their categories, as those of
    /// modular devices may that store their modules there.
    pub share_sii: bool,
    /// How long to wait for what.
    pub timeouts: Timeouts,
}

/// Filter depths of the drift loop, each 0 to 15: a mean over about 2 to the power of it. `None`:
/// by the cycle, see [`DriftFilters::depths`].
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
pub struct DriftFilters {
    /// Register 0x0934: of the time difference.
    pub difference: Option<u8>,
    /// Register 0x0935: of the speed.
    pub speed: Option<u8>,
}

impl DriftFilters {
    /// Depths of the filters of the difference and of the speed, where a system time comes each
    /// `interval`.
    ///
    /// What they do is not published; docs/dc.md tells what it may be. Unless others are asked for,
    /// differences are averaged over 16 ms (6 at most) and speeds over 64 ms (6 to 9), which suits
    /// every law that the public record admits: clocks lock in some 4 000 drift frames, follow a
    /// step of temperature within some ten ns at 1 ms, and average the jitter of hops away. With 0
    /// and 12, as many MainDevices set them, a clock behind many hops may wander by some 100 ns,
    /// and a crystal that changes by 1 ppm moves its clock by up to 0.7 us at a cycle of 1 ms.
    pub fn depths(&self, interval: Nanos) -> (u8, u8) {
        let mean_over =
            |span: Nanos| (span.0 / interval.0.max(1)).checked_ilog2().unwrap_or(0) as u8;
        let difference = self.difference.unwrap_or(mean_over(DIFFERENCE_SPAN).min(6));
        let speed = self.speed.unwrap_or(mean_over(SPEED_SPAN).clamp(6, 9));
        (difference.min(15), speed.min(15))
    }
}

/// Differences are averaged over this time.
const DIFFERENCE_SPAN: Nanos = Nanos::millis(16);
/// Speeds are averaged over this time.
const SPEED_SPAN: Nanos = Nanos::millis(64);

impl Config {
    /// Defaults around a cycle.
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
            timeouts: Timeouts::default(),
        }
    }
}

/// How delays are measured on while the segment runs.
///
/// Only receive times are latched (a write to 0x0900), which disturbs neither SYNC nor the drift loop. Filters
/// (0x0930) are never reset. A delay that lies beyond the error from the one in force is
/// [`Event::DelayChanged`](crate::Event::DelayChanged).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DelayWatch {
    /// From one latch to the next; at least one cycle. Default 1 s.
    pub every: Nanos,
    /// Latches that make one estimate; at least 2. Default 16.
    pub latches: usize,
    /// Whether 0x0928 is written with a delay that has changed. The clock then moves to its new time as the
    /// drift loop allows, and its pulses with it. Default no.
    pub rewrite: bool,
}

/// Reading in the background how well the segment runs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct QualityWatch {
    /// Share of the wire's time that the reads may take, permille, 1..=200: clocks half of it and objects the other, or
    /// one of them all if the other is not there. It is kept over time, to one reading. Default 10.
    pub share_permille: u16,
    /// Readings kept of each clock, and moments kept of the segment, 16 or more. Default 256.
    pub history: usize,
    /// Cycles without a drift frame that all clocks took, after which [`Event::ClocksUnled`](crate::Event::ClocksUnled)
    /// tells so: what 0x092C shows is old then. 1 or more; default 100.
    pub unled_cycles: u64,
    /// 0x092C beyond this raises an alarm; half of it lets it go. With [`Config::hop_jitter`], four
    /// standard deviations of what frames jitter on their way are added. Default 200 ns: twice what
    /// clocks count as converged with.
    pub difference_limit: Nanos,
    /// Less than this before SYNC0, by [`Margin`](crate::quality::Margin), raises an alarm; a quarter of what is planned
    /// above it lets it go. `None`: margins are kept and raise nothing. Default 0: less would be too late for a
    /// SubDevice that needs all the time it states.
    pub margin_limit: Option<Nanos>,
    /// Whether 0x1C32 and 0x1C33 are read as well: error counters (:0B to :0E, :20) and distances (0x1C32:0F to :12),
    /// as far as a SubDevice has them. Requests of the application go first. Default yes.
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

/// How long devices measure their times. The values are longest ones, so they only grow.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct MeasureTimes {
    /// They count as stable when none has changed for this long; above zero. Default 1 s.
    pub settled: Nanos,
    /// After this long the last values are taken; [`OwnTimes::settled`](crate::OwnTimes) then says so. Default
    /// 10 s.
    pub longest: Nanos,
}

impl Default for MeasureTimes {
    fn default() -> Self {
        Self { settled: Nanos::millis(1_000), longest: Nanos::millis(10_000) }
    }
}

/// What a survey looks at.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Survey {
    /// Whether objects are read by SDO; without them the SII alone says what process data there are. Default yes.
    pub objects: bool,
}

impl Default for Survey {
    fn default() -> Self {
        Self { objects: true }
    }
}

/// How SubDevices that were lost are taken up again.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Readmission {
    /// From an attempt that failed to the next one. Default 1 s.
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
    /// How long one copy of a frame is waited for when the other has come back from a cut. More than the ways to
    /// either side differ, and the two ports are apart in giving frames to the program; short enough that what there is
    /// comes within the cycle. `None`: a quarter of the cycle.
    pub patience: Option<Nanos>,
    /// How much longer a frame takes from the secondary port to the last SubDevice than from the primary one to the first.
    /// The plan counts with it behind a cut. Default 0, cables of one length; nobody measures it.
    pub longer: Nanos,
}

/// When a SubDevice that left OP by itself, its AL status showing an error as a rule, is acknowledged and brought
/// back.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Recovery {
    /// Never.
    #[default]
    Never,
    /// One attempt for each SubDevice in the whole run.
    Once,
    /// Again and again, each pause after a failure twice as long as the one before. Being well for as long as
    /// the longest pause makes it short again.
    BackOff {
        /// From the fall to the first attempt.
        first: Nanos,
        /// Longest pause.
        longest: Nanos,
    },
}

/// Patience, all in host time.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Timeouts {
    /// From sending a frame to giving it up. Default 5 ms: a full frame through a thousand devices
    /// takes 2 ms, and a busy host adds its own. Each SubDevice beyond the thousandth adds 2 us by itself. Each repetition of a datagram waits twice as long as the
    /// one before.
    pub frame: Nanos,
    /// How often a datagram that may be repeated is sent again after a loss. Default 3: with 5 ms for the
    /// first frame, 75 ms without any answer end the way up, a sleep of 40 ms at either end does not.
    pub retries: u8,
    /// For one read of the SII EEPROM. Default 100 ms; real ones take about 1 ms.
    pub eeprom: Nanos,
    /// For the answer to one mailbox service. Default 2 s: drives store parameters in flash before
    /// they answer.
    pub mailbox: Nanos,
    /// From the request of INIT to INIT. ETG timeouts: 5 s back to INIT.
    pub init: Nanos,
    /// INIT to PREOP: 3 s.
    pub preop: Nanos,
    /// PREOP to SAFEOP: 10 s.
    pub safeop: Nanos,
    /// SAFEOP to OP: 12 s, more than the 9 s (less ten percent) after which stacks answer with the
    /// reason themselves.
    pub op: Nanos,
    /// For the drift loop to converge: 30 s. A loop pulls out some hundred ns a second.
    pub drift: Nanos,
    /// For the host's phase to lock onto the reference clock: 20 s, or four times as many cycles as
    /// locking takes where that is longer.
    pub phase: Nanos,
    /// From programming SYNC0 until the first pulse; the lead of the start time. Default 100 ms:
    /// time to program all devices, as masters have it.
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
    /// What messages call it. Empty: the name in its SII.
    pub name: String,
    /// Vendor id and product code that must stand in its SII. `None`: any.
    pub identity: Option<(u32, u32)>,
    /// Synchronization mode. `None`: the best that the device and the cycle allow.
    pub mode: Option<SyncMode>,
    /// Its own cycle, a whole multiple of the bus cycle, up to 2.147 s: SYNC0 comes so often, and its process data
    /// travel in that bus cycle only. For all modes but subordinated cycles, which are the other way round. `None`:
    /// the bus cycle.
    pub cycle: Option<Nanos>,
    /// From SYNC0 to SYNC1; with subordinated cycles from the SYNC0 that SYNC1 belongs to, less than a
    /// cycle of SYNC0. `None`: for "DC SYNC1" the time the device needs (0x1C32:06) in whole
    /// microseconds, for "DC shift SYNC1" a quarter of the cycle, for subordinated cycles 0.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0 with subordinated cycles. `None`: as the device has it in 0x1C32:0A.
    pub sync0_cycle: Option<Nanos>,
    /// Word for registers 0x0980 (who owns the SYNC unit and the latch units) and 0x0981 (what the
    /// SYNC unit does), as AssignActivate of a description has it. A mode with DC adds the pulses that
    /// it needs, and takes the SYNC unit; a mode without makes no pulses. `None`: the pulses of the
    /// mode; owners stay as they are, but for a SYNC unit that the mode needs.
    pub unit: Option<AssignActivate>,
    /// PDOs to assign to 0x1C12. `None`: as the device has them.
    pub outputs: Option<Vec<u16>>,
    /// PDOs to assign to 0x1C13. `None`: as the device has them.
    pub inputs: Option<Vec<u16>>,
    /// Shift of Outputs Valid, object 0x1C32:03, for devices that shift by a local timer.
    pub shift_outputs: Option<Nanos>,
    /// Shift of Input Latch, object 0x1C33:03, for devices that shift by a local timer.
    pub shift_inputs: Option<Nanos>,
    /// Times that the device measured once, for the plan where it states 0 or nothing; they go before
    /// assumed ones. A device with any of them here does not measure again.
    pub measured: MeasuredTimes,
    /// Times for the plan where the device states 0 or nothing.
    pub assumed: AssumedTimes,
    /// How its oscillator runs against true time, as far as that is known. `None`: within 100 ppm
    /// of the others.
    pub clock: Option<ClockRange>,
    /// It may be absent, and come while the segment runs (hot connect): what is known of it, so that the cycle is
    /// planned as if it were there. Identity, ESC, clock, SII, PDOs and sync objects are used, and where it hangs: a
    /// port that has nothing else behind it. [`Segment::devices`](crate::Segment::devices) of a run with it is such a
    /// description, and so is what [`plan`](crate::plan()) is given. Not for the first SubDevice. `None`: it must be there.
    pub hot_connect: Option<Box<SubDevice>>,
    /// SDO downloads in PREOP, in this order, before mode and mapping are read.
    pub startup: Vec<StartupDownload>,
    /// Parameters of its drives that SoE writes in PREOP, in this order, behind the SDO downloads. A device without SoE
    /// is not brought up if there are some.
    pub parameters: Vec<StartupParameter>,
}

impl DeviceConfig {
    /// Whether it need not be there.
    pub fn may_be_absent(&self) -> bool {
        self.hot_connect.is_some()
    }
}

/// Times to plan with where a device states 0 or nothing. `None`: 0 is taken as stated.
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
    /// From the shortest to the longest time from the pulse to outputs that act as soon as they are
    /// calculated, without delay and shift. No object states it. `None`: as `pulse_jitter`.
    pub outputs_spread: Option<Nanos>,
    /// How its SYNC signals fall again. No object states it.
    pub sync_signal: SyncSignal,
}

/// Times that a device measured itself, on command of 0x1C32:08 and 0x1C33:08. `None`: not measured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct MeasuredTimes {
    /// 0x1C32:05 and 0x1C33:05, the longer one.
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

/// Between what an oscillator runs, ppb; positive is fast.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ClockRange {
    /// At its slowest.
    pub least_ppb: i64,
    /// At its fastest.
    pub most_ppb: i64,
}

impl ClockRange {
    /// By how much two oscillators may come apart, ppb.
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
    /// The bytes, little-endian; a list with its lengths in front.
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
