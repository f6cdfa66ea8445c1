//! Back into a running segment: SubDevices that were lost, by power or by cable, and such as left OP.
//!
//! What a look at the segment found (`health`) is held against the tree of the scan: [`places`] tells who stands
//! where. [`readmit`] takes up those that are back, all of them together, and each on its own where it can: address,
//! identity, PREOP, objects and mapping as planned, delay and offset from the running reference clock, drift by the
//! cyclic datagram, SYNC on the grid that the others have, SAFEOP, OP. [`recover`] is for a SubDevice that still is
//! where it was and only left its state.
//!
//! Nothing here disturbs those that run. All writes go to the SubDevice that is concerned; the one broadcast is the
//! latch of receive times (0x0900), which neither SYNC nor the drift loop uses.

use alloc::boxed::Box;
use alloc::rc::Rc;
use alloc::vec;
use alloc::vec::Vec;
use core::cell::RefCell;
use core::convert::Infallible;
use core::future::Future;
use core::pin::Pin;

use isocat_wire::al::AlState;
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{PortNumber, StationAddress};

use crate::bring_up;
use crate::clock::{self, Joining};
use crate::config::{Config, DeviceConfig, Readmission, Recovery};
use crate::error::{Cause, MappingProblem};
use crate::health::Found;
use crate::link::{Link, Procedure, Travel, join};
use crate::mailbox::Mailbox;
use crate::segment::{Segment, SubDevice};
use crate::{esm, mapping, mode, objects, scan, sii, sync};

/// How one SubDevice came out of it.
pub(crate) type Outcome = Result<Box<(SubDevice, Option<Mailbox>)>, Cause>;

/// A re-admission of several under way.
pub(crate) type Readmitting = dyn Future<Output = ()>;

/// Outcomes by position, as they come.
pub(crate) type Outcomes = Rc<RefCell<Vec<(usize, Outcome)>>>;

/// A recovery under way.
pub(crate) type Recovering = dyn Future<Output = Result<SubDevice, Cause>>;

/// Delays being set right; gives the new ones by position.
pub(crate) type Shifting = dyn Future<Output = Vec<(usize, Nanos)>>;

/// What is known of those that are lost or out of OP, and what is being done.
#[derive(Default)]
pub(crate) struct Keeper {
    /// By position.
    absences: Vec<Absence>,
    pub readmitting: Option<Pin<Box<Readmitting>>>,
    pub outcomes: Outcomes,
    /// Delays being set right.
    pub shifting: Option<Pin<Box<Shifting>>>,
    pub recovering: Vec<(usize, Pin<Box<Recovering>>)>,
}

/// One SubDevice's troubles.
#[derive(Clone, Copy, Default)]
struct Absence {
    /// A procedure has it in hand since.
    busy: Option<Time<Host>>,
    /// Not again before.
    not_before: Time<Host>,
    /// Another device stands in its place.
    taken: bool,
    /// Attempts to bring it back to OP since it was last well.
    attempts: u32,
}

impl Keeper {
    /// For so many SubDevices.
    pub fn new(count: usize) -> Self {
        Self { absences: vec![Absence::default(); count], ..Self::default() }
    }

    /// Whether nothing is under way.
    pub fn is_idle(&self) -> bool {
        self.readmitting.is_none() && self.recovering.is_empty() && self.shifting.is_none()
    }

    /// Who of those found is to be taken up now.
    pub fn wanted(
        &self,
        places: &[Option<usize>],
        segment: &Segment,
        now: Time<Host>,
    ) -> Vec<usize> {
        let wanted = |position: &usize| {
            let absence = &self.absences[*position];
            places[*position].is_some()
                && !segment.devices[*position].admitted
                && !absence.taken
                && absence.busy.is_none()
                && now >= absence.not_before
        };
        (0..places.len().min(self.absences.len())).filter(wanted).collect()
    }

    /// A procedure has it in hand.
    pub fn begin(&mut self, position: usize, now: Time<Host>) {
        self.absences[position].busy = Some(now);
    }

    /// It is admitted; how long it took.
    pub fn admitted(&mut self, position: usize, now: Time<Host>) -> Nanos {
        let busy = self.absences[position].busy;
        self.absences[position] = Absence::default();
        now - busy.unwrap_or(now)
    }

    /// It was not admitted; when it is tried again.
    pub fn failed(
        &mut self,
        position: usize,
        cause: &Cause,
        policy: Readmission,
        now: Time<Host>,
    ) -> Option<Nanos> {
        let absence = &mut self.absences[position];
        absence.busy = None;
        absence.taken = matches!(cause, Cause::Identity { .. });
        absence.not_before = now + policy.pause;
        (!absence.taken).then_some(policy.pause)
    }

    /// Whether another device stands in its place.
    pub fn is_out(&self, position: usize) -> bool {
        self.absences.get(position).is_some_and(|absence| absence.taken)
    }

    /// Nobody stands in its place any more.
    pub fn is_absent(&mut self, position: usize) {
        self.absences[position].taken = false;
    }

    /// Whether a SubDevice that left OP is to be brought back now; which attempt it is.
    pub fn attempt(&mut self, position: usize, policy: Recovery, now: Time<Host>) -> Option<u32> {
        let absence = self.absences.get_mut(position)?;
        if absence.busy.is_some() {
            return None;
        }
        match policy {
            Recovery::Never => return None,
            Recovery::Once if absence.attempts > 0 => return None,
            Recovery::Once => {}
            Recovery::BackOff { first, longest } => {
                if absence.attempts == 0 && absence.not_before == Time::ZERO {
                    absence.not_before = now + first;
                } else if now - absence.not_before > longest {
                    // It was well for so long.
                    (absence.attempts, absence.not_before) = (0, now + first);
                }
                if now < absence.not_before {
                    return None;
                }
            }
        }
        absence.busy = Some(now);
        absence.attempts += 1;
        Some(absence.attempts)
    }

    /// An attempt to bring it back to OP ended; how long it took, and when there may be another.
    pub fn attempted(
        &mut self,
        position: usize,
        policy: Recovery,
        now: Time<Host>,
    ) -> (Nanos, Option<Nanos>) {
        let absence = &mut self.absences[position];
        let after = now - absence.busy.take().unwrap_or(now);
        let Recovery::BackOff { first, longest } = policy else { return (after, None) };
        let doubled = first.0.saturating_mul(1 << absence.attempts.min(30));
        let pause = Nanos(doubled.min(longest.0));
        absence.not_before = now + pause;
        (after, Some(pause))
    }
}

/// By position, at which place of the processing order who answers now stands; `None`: it does not answer.
///
/// A SubDevice is there if the one above it is, and its port there is open. `Err`: that does not agree with who
/// answers, as while a link is coming up, or where cables were changed. `is_out`: another device was found in the
/// place of this one, so that it is the turn of the next that may hang there.
pub(crate) fn places(
    segment: &Segment,
    everybody: &[Found],
    is_out: impl Fn(usize) -> bool,
) -> Result<Vec<Option<usize>>, ()> {
    let mut places: Vec<Option<usize>> = vec![None; segment.devices.len()];
    let mut next = 0;
    for (position, device) in segment.devices.iter().enumerate() {
        let there = match device.parent {
            None => position == 0,
            Some((above, port)) => is_open(&places, everybody, above, port),
        };
        // Of those that may hang at one port, one does: the first that was not found to be another.
        let shares = |other: &&SubDevice| position > 0 && other.parent == device.parent;
        let (before, behind) = segment.devices.split_at(position);
        let occupied = before.iter().filter(shares).any(|other| places[other.position].is_some());
        let mut next_turn = behind[1..].iter().filter(shares).filter(|other| !other.admitted);
        let out = !device.admitted && is_out(position);
        if !there || occupied || out && next_turn.any(|other| !is_out(other.position)) {
            continue;
        }
        let found = everybody.get(next).ok_or(())?;
        if device.admitted && found.station != device.station {
            return Err(());
        }
        // Somebody who is known stands elsewhere.
        let others = segment.devices.iter().filter(|other| other.admitted);
        if others.clone().any(|o| o.station == found.station && o.position != position) {
            return Err(());
        }
        places[position] = Some(next);
        next += 1;
    }
    if next == everybody.len() { Ok(places) } else { Err(()) }
}

fn is_open(places: &[Option<usize>], everybody: &[Found], above: usize, port: PortNumber) -> bool {
    let place = places.get(above).copied().flatten();
    place.and_then(|at| everybody.get(at)).is_some_and(|found| found.dl_status.open(port))
}

/// Those that are back, and everything that is needed to take them up.
pub(crate) struct Return {
    pub link: Link,
    pub config: Rc<Config>,
    /// The segment as it was planned; who takes part in it as of now.
    pub segment: Segment,
    pub everybody: Vec<Found>,
    pub places: Vec<Option<usize>>,
    /// Positions that are back.
    pub back: Vec<usize>,
    /// Where each one's end is put.
    pub outcomes: Outcomes,
}

/// One SubDevice on its way, until something goes wrong.
struct Traveller {
    place: usize,
    device: SubDevice,
    mailbox: Option<Mailbox>,
    failed: Option<Cause>,
}

/// Takes up SubDevices that are back. What goes wrong at one of them ends its own way only.
pub(crate) async fn readmit(work: Return) {
    let Return { link, config, mut segment, everybody, places, back, outcomes } = work;
    let (link, config) = (&link, &*config);
    let mut all: Vec<Traveller> = Vec::with_capacity(back.len());
    for position in back {
        let Some(place) = places[position] else { continue };
        let device = segment.devices[position].clone();
        all.push(Traveller { place, device, mailbox: None, failed: None });
    }
    each(&mut all, |one| Box::pin(identify(link, config, one, everybody[one.place].station))).await;
    let planned = &segment;
    each(&mut all, |one| Box::pin(prepare(link, config, planned, one))).await;
    if let Err(cause) = set_clocks(link, config, &mut segment, &everybody, &places, &mut all).await
    {
        for one in all.iter_mut().filter(|one| one.failed.is_none() && one.device.dc.has_clock()) {
            one.failed = Some(cause.clone());
        }
    }
    let segment = &segment;
    let outcomes = &outcomes;
    let ends = all.into_iter().map(|mut one| -> Procedure<'_, Result<(), Infallible>> {
        Box::pin(async move {
            if one.failed.is_none() {
                one.failed = finish(link, config, segment, &mut one).await.err();
            }
            let position = one.device.position;
            let outcome = match one.failed {
                Some(cause) => Err(cause),
                None => Ok(Box::new((one.device, one.mailbox))),
            };
            outcomes.borrow_mut().push((position, outcome));
            Ok(())
        })
    });
    let Ok(_) = join(ends.collect()).await;
}

/// The same at all that are still on their way, side by side, each to its own end.
async fn each<'a>(
    all: &'a mut [Traveller],
    procedure: impl Fn(&'a mut Traveller) -> Procedure<'a, Result<(), Cause>>,
) {
    let going = all.iter_mut().filter(|one| one.failed.is_none());
    let procedures: Vec<Procedure<'a, Result<Option<Cause>, Infallible>>> = going
        .map(|one| {
            let procedure = procedure(one);
            Box::pin(async move { Ok(procedure.await.err()) }) as Procedure<'a, _>
        })
        .collect();
    let Ok(_) = join(procedures).await;
}

/// Gives it its address and sees who it is. Another device keeps the address that it had.
async fn identify(
    link: &Link,
    config: &Config,
    one: &mut Traveller,
    before: StationAddress,
) -> Result<(), Cause> {
    let result = async {
        let planned = &one.device;
        let address = register::STATION_ADDRESS.address;
        link.apwr(one.place, address, &planned.station.0.to_bytes()).expect(1).await?;
        let mut found = SubDevice::new(planned.position, planned.station);
        if let Some(wish) = config.devices.get(planned.position) {
            found.name.clone_from(&wish.name);
        }
        scan::take_eeprom(link, found.station).await?;
        let read = sii::read(link, config, &mut found).await;
        let identity = |device: &SubDevice| (device.identity.vendor, device.identity.product);
        let (expected, now) = (identity(planned), identity(&found));
        if now != (0, 0) && now != expected {
            let place = crate::Place { position: found.position, name: found.sii.name.clone() };
            link.fpwr(found.station, address, &before.0.to_bytes()).expect(1).await?;
            return Err(Cause::Identity { place, expected, found: now });
        }
        read?;
        scan::reset_one(link, found.station).await?;
        scan::describe(link, &mut found).await?;
        esm::change(link, &mut found, AlState::Init, config.timeouts.init).await?;
        if found.dc != planned.dc {
            let (place, planned, found) = (planned.place(), planned.dc, found.dc);
            return Err(Cause::Clock { place, planned, found });
        }
        // The rest is as it was planned.
        one.device = SubDevice {
            esc: found.esc,
            identity: found.identity,
            sii: found.sii,
            dl_status: found.dl_status,
            al_status: found.al_status,
            al_code: found.al_code,
            sync: None,
            ..one.device.clone()
        };
        Ok(())
    }
    .await;
    keep(one, result)
}

/// A failure ends the way of one.
fn keep(one: &mut Traveller, result: Result<(), Cause>) -> Result<(), Cause> {
    one.failed = result.clone().err();
    result
}

/// PREOP, objects and mapping, which must be what the process image was made for.
async fn prepare(
    link: &Link,
    config: &Config,
    segment: &Segment,
    one: &mut Traveller,
) -> Result<(), Cause> {
    let result = async {
        let device = &mut one.device;
        bring_up::to_preop(link, config, device).await?;
        one.mailbox = bring_up::mailbox(link, config, device);
        let lengths = |device: &SubDevice| (device.outputs.length, device.inputs.length);
        let planned = (device.outputs.clone(), device.inputs.clone());
        let planned_lengths = lengths(device);
        match &mut one.mailbox {
            Some(mailbox) => objects::read(mailbox, device, wish(config, device)).await?,
            None => objects::from_sii(device),
        }
        mapping::place_process_data(device)?;
        if (&device.outputs, &device.inputs) != (&planned.0, &planned.1) {
            let (planned, found) = (planned_lengths, lengths(device));
            let problem = MappingProblem::Changed { planned, found };
            return Err(Cause::Mapping { place: device.place(), problem });
        }
        still_fits(config, segment, device)?;
        mapping::write(link, device, config.watchdog).await
    }
    .await;
    keep(one, result)
}

/// What it says of itself must fit the plan that all run by: a device with other firmware, or one of which only a
/// description was known, may need longer.
fn still_fits(config: &Config, segment: &Segment, device: &SubDevice) -> Result<(), Cause> {
    let Some(timing) = &segment.timing else { return Ok(()) };
    let mut chosen = device.clone();
    mode::choose(&mut chosen, config, wish(config, device))?;
    if chosen.mode != device.mode {
        let (wish, reason) = (device.mode, "it does not offer what was planned".into());
        return Err(Cause::Mode { place: device.place(), wish, reason });
    }
    let mut segment = segment.clone();
    segment.devices[device.position] = device.clone();
    let again = Config { force: true, shift: timing.sync0, ..config.clone() };
    let planned = mode::plan(&segment, &again)?;
    let line = planned.devices.get(device.position).and_then(|(_, budget)| budget.failure());
    match line.filter(|_| !config.force) {
        Some(line) => Err(Cause::Plan { place: device.place(), line }),
        None => Ok(()),
    }
}

fn wish<'a>(config: &'a Config, device: &SubDevice) -> Option<&'a DeviceConfig> {
    config.devices.get(device.position)
}

/// Delay and offset of those that have a clock.
async fn set_clocks(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    everybody: &[Found],
    places: &[Option<usize>],
    all: &mut [Traveller],
) -> Result<(), Cause> {
    let mut going: Vec<_> = all.iter_mut().filter(|one| one.failed.is_none()).collect();
    for one in &going {
        segment.devices[one.device.position] = one.device.clone();
    }
    for (position, place) in places.iter().enumerate() {
        if let Some(found) = place.and_then(|at| everybody.get(at)) {
            segment.devices[position].dl_status = found.dl_status;
        }
    }
    let joining = going.iter().map(|one| one.device.position).collect();
    let there: Vec<usize> = (0..places.len())
        .filter(|at| {
            segment.devices[*at].admitted || going.iter().any(|o| o.device.position == *at)
        })
        .collect();
    let strangers = everybody.len().saturating_sub(there.len()) as u16;
    clock::join(link, config, segment, Joining { joining, there, strangers }).await?;
    for one in &mut going {
        let set = &segment.devices[one.device.position];
        one.device.delay = set.delay;
        one.device.measured_delay = set.measured_delay;
        one.device.offset = set.offset;
    }
    Ok(())
}

/// From clocks that were set to OP.
async fn finish(
    link: &Link,
    config: &Config,
    segment: &Segment,
    one: &mut Traveller,
) -> Result<(), Cause> {
    let device = &mut one.device;
    let led = segment.reference.filter(|reference| *reference != device.position);
    if let (true, true, Some(reference)) = (device.dc.has_clock(), config.drift_compensation, led) {
        clock::follow(link, config, segment.devices[reference].station, device).await?;
    }
    if let Some(mailbox) = &mut one.mailbox {
        sync::write_types(mailbox, device, config, wish(config, device)).await?;
    }
    program_sync(link, config, segment, device).await?;
    esm::change(link, device, AlState::SafeOp, config.timeouts.safeop).await?;
    if let Some(mailbox) = &mut one.mailbox {
        sync::verify_types(mailbox, device, wish(config, device)).await?;
    }
    wait_for_inputs(link, config, device).await?;
    wait_for_sync(link, config, segment, device).await?;
    esm::change(link, device, AlState::Op, config.timeouts.op).await
}

/// SYNC on the grid that all have.
async fn program_sync(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let phase = segment.timing.as_ref().and_then(|timing| timing.sync0);
    let (true, Some(phase), Some(reference)) = (device.mode.uses_dc(), phase, segment.reference)
    else {
        return Ok(());
    };
    let now = sync::reference_now(link, &segment.devices[reference]).await?;
    let grid = sync::grid(segment, config.cycle);
    let acting = grid.start(now, config.timeouts.sync_lead, phase);
    sync::program(link, device, acting).await
}

/// Sees that pulses come, one cycle behind the first.
async fn wait_for_sync(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let (Some(setting), Some(reference)) = (device.sync, segment.reference) else { return Ok(()) };
    let now = sync::reference_now(link, &segment.devices[reference]).await?;
    link.sleep(Nanos((setting.start - now + config.cycle).0.max(0))).await;
    sync::verify(link, device).await
}

/// Waits until inputs come, and for some cycles in which the outputs of the present ones have gone out.
///
/// They are read by a datagram of its own, as its logical bytes are shared with nobody: the working counter of the
/// cycle can't tell who is still missing.
async fn wait_for_inputs(link: &Link, config: &Config, device: &SubDevice) -> Result<(), Cause> {
    let end = link.now() + config.timeouts.safeop;
    let length = usize::from(device.inputs.length);
    let mut right = 0;
    while right < bring_up::COMPLETE_CYCLES {
        if length > 0 {
            let address = Address::Logical(device.inputs.logical);
            let read =
                link.exchange(Command::Lrd, address, vec![0; length], Travel::default()).reply();
            let found = read.await?.wkc;
            right = if found == 1 { right + 1 } else { 0 };
            if link.now() >= end {
                let cycles = ((config.timeouts.safeop.0) / config.cycle.0.max(1)) as u64;
                return Err(Cause::ProcessData { cycles, expected: 1, found });
            }
        } else {
            right += 1;
        }
        link.sleep(config.cycle).await;
    }
    Ok(())
}

/// Brings a SubDevice that left OP, but is in SAFEOP and synchronized, back: error acknowledged, SYNC seen to run,
/// OP.
pub(crate) async fn recover(
    link: Link,
    config: Rc<Config>,
    segment: Segment,
    position: usize,
) -> Result<SubDevice, Cause> {
    let mut device = segment.devices[position].clone();
    let (status, code) = esm::read_status(&link, device.station).await?;
    (device.al_status, device.al_code) = (status, code);
    if status.error() {
        esm::acknowledge(&link, &mut device, AlState::SafeOp, config.timeouts.safeop).await?;
    }
    if sync::verify(&link, &mut device).await.is_err() {
        program_sync(&link, &config, &segment, &mut device).await?;
        wait_for_sync(&link, &config, &segment, &mut device).await?;
    }
    wait_for_inputs(&link, &config, &device).await?;
    esm::change(&link, &mut device, AlState::Op, config.timeouts.op).await?;
    Ok(device)
}

#[cfg(test)]
mod tests {
    use isocat_wire::dl::DlStatus;

    use super::*;

    /// A fork with a branch of two at port 1 and a branch of one at port 2.
    fn fork() -> Segment {
        let device = |(position, parent): (usize, Option<(usize, PortNumber)>)| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            device.parent = parent;
            device
        };
        let above =
            [None, Some((0, PortNumber::P1)), Some((1, PortNumber::P1)), Some((0, PortNumber::P2))];
        Segment {
            devices: above.into_iter().enumerate().map(device).collect(),
            ..Segment::default()
        }
    }

    /// Somebody with an address, and ports at which frames go on.
    fn found(station: u16, ports: &[PortNumber]) -> Found {
        let open = |status: DlStatus, port: &PortNumber| status.with_port(*port, true, false, true);
        let dl_status = ports.iter().fold(DlStatus::default(), open);
        Found { station: StationAddress(station), dl_status }
    }

    fn stand(segment: &Segment, everybody: &[Found]) -> Result<Vec<Option<usize>>, ()> {
        places(segment, everybody, |_| false)
    }

    /// Two groups for one port, a pair and one alone.
    #[test]
    fn whose_turn_it_is_at_a_port_that_several_may_hang_at() {
        use PortNumber::{P0, P1, P2};
        let mut segment = fork();
        let mut other = SubDevice::new(4, StationAddress(0x1005));
        other.parent = Some((0, P2));
        segment.devices.push(other);
        for device in &mut segment.devices[3..] {
            device.admitted = false;
        }
        let pair = [found(0x1002, &[P0, P1]), found(0x1003, &[P0])];
        let mut all = vec![found(0x1001, &[P0, P1, P2])];
        all.extend(pair);
        all.push(found(0, &[P0]));
        let line = [Some(0), Some(1), Some(2)];
        let stands = |out: &[usize]| {
            let places = places(&segment, &all, |position| out.contains(&position));
            places.map(|places| (places[..3] == line, places[3], places[4]))
        };
        assert_eq!(stands(&[]), Ok((true, Some(3), None)));
        assert_eq!(stands(&[3]), Ok((true, None, Some(3))));
        assert_eq!(stands(&[3, 4]), Ok((true, Some(3), None)), "a stranger, whoever it is");
    }

    #[test]
    fn who_stands_where_follows_from_open_ports() {
        use PortNumber::{P0, P1, P2};
        let mut segment = fork();
        segment.devices[1].admitted = false;
        segment.devices[2].admitted = false;
        let fork = found(0x1001, &[P0, P1, P2]);
        let right = found(0x1004, &[P0]);
        // Both are back; the first of them alone; nobody.
        let all = [fork, found(0, &[P0, P1]), found(0x1003, &[P0]), right];
        assert_eq!(stand(&segment, &all), Ok(vec![Some(0), Some(1), Some(2), Some(3)]));
        let one = [fork, found(0, &[P0]), right];
        assert_eq!(stand(&segment, &one), Ok(vec![Some(0), Some(1), None, Some(2)]));
        let none = [found(0x1001, &[P0, P2]), right];
        assert_eq!(stand(&segment, &none), Ok(vec![Some(0), None, None, Some(1)]));
        // A port is open and nobody follows yet; one more than the tree has; one that is known, elsewhere.
        assert_eq!(stand(&segment, &[fork, right]), Err(()));
        let more = [fork, found(0, &[P0]), right, found(0, &[P0])];
        assert_eq!(stand(&segment, &more), Err(()));
        assert_eq!(stand(&segment, &[fork, right, found(0, &[P0])]), Err(()));
    }

    #[test]
    fn attempts_follow_the_policy() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let mut keeper = Keeper::new(1);
        assert_eq!(keeper.attempt(0, Recovery::Never, ms(1)), None);
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(1)), Some(1));
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(2)), None, "one is under way");
        assert_eq!(keeper.attempted(0, Recovery::Once, ms(5)), (Nanos::millis(4), None));
        assert_eq!(keeper.attempt(0, Recovery::Once, ms(100_000)), None);

        let policy = Recovery::BackOff { first: Nanos::millis(10), longest: Nanos::millis(30) };
        let mut keeper = Keeper::new(1);
        assert_eq!(keeper.attempt(0, policy, ms(100)), None, "the first pause begins");
        assert_eq!(keeper.attempt(0, policy, ms(110)), Some(1));
        assert_eq!(keeper.attempted(0, policy, ms(111)).1, Some(Nanos::millis(20)));
        assert_eq!(keeper.attempt(0, policy, ms(130)), None);
        assert_eq!(keeper.attempt(0, policy, ms(131)), Some(2));
        assert_eq!(keeper.attempted(0, policy, ms(131)).1, Some(Nanos::millis(30)), "no longer");
        assert_eq!(keeper.attempt(0, policy, ms(161)), Some(3));
        assert_eq!(keeper.attempted(0, policy, ms(161)).1, Some(Nanos::millis(30)));
        // Well for longer than the longest pause: it begins anew.
        assert_eq!(keeper.attempt(0, policy, ms(300)), None);
        assert_eq!(keeper.attempt(0, policy, ms(310)), Some(1));
    }

    #[test]
    fn another_device_is_not_asked_again_until_it_is_gone() {
        let ms = |ms: u64| Time::new(1_000_000 * ms);
        let (mut keeper, mut segment) = (Keeper::new(4), fork());
        segment.devices[3].admitted = false;
        let places = [Some(0), Some(1), Some(2), Some(3)];
        let policy = Readmission { pause: Nanos::millis(10) };
        let place = crate::Place { position: 3, name: Default::default() };
        let other = Cause::Identity { place, expected: (1, 2), found: (1, 3) };
        assert_eq!(keeper.wanted(&places, &segment, ms(1)), [3]);
        keeper.begin(3, ms(1));
        assert_eq!(keeper.wanted(&places, &segment, ms(1)), []);
        assert_eq!(keeper.failed(3, &other, policy, ms(2)), None);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_000)), []);
        keeper.is_absent(3);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_000)), [3]);
        keeper.begin(3, ms(1_000));
        assert_eq!(keeper.failed(3, &Cause::Empty, policy, ms(1_001)), Some(policy.pause));
        assert_eq!(keeper.wanted(&places, &segment, ms(1_010)), []);
        assert_eq!(keeper.wanted(&places, &segment, ms(1_011)), [3]);
        assert_eq!(keeper.admitted(3, ms(1_012)), Nanos::ZERO);
    }
}
