//! Response times of devices: an EEPROM read, and the changes between INIT and PREOP.

use isocat_wire::AlControl;
use isocat_wire::al::{AlState, AlStatus};
use isocat_wire::eeprom::{EepromStatus, read_command};
use isocat_wire::register::{self, Value};
use isocat_wire::sii::word;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use super::bus::{Bus, Trouble, number};
use super::found::Found;
use super::hops::Spread;

/// Response times of a device, by the host's clock from the request's departure to the answer's
/// arrival.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Response {
    /// One read of the EEPROM (4 or 8 bytes), ns; `None` if it failed.
    pub eeprom: Option<Times>,
    /// INIT to PREOP; `None` if it was not tried.
    pub to_preop: Option<StateChange>,
    /// PREOP to INIT.
    pub to_init: Option<StateChange>,
    /// The state at the end, if it could not be restored.
    pub state_left: Option<AlStatus>,
}

/// Times of several tries, ns.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Times {
    /// Their spread.
    pub spread: Spread,
    /// Number of tries.
    pub count: usize,
    /// Longest time between two polls: a time may be too long by this much.
    pub grain: f64,
}

/// A change of state.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum StateChange {
    /// The state was reached after this time.
    After(Times),
    /// The state was refused, with this status and code of register 0x0134.
    Refused(AlStatus, u16),
    /// The state was not reached within this time.
    TooLate(Nanos),
}

/// Measures all devices, one after the other.
pub(super) fn measure(bus: &mut Bus<'_>, found: &[Found]) -> Result<Vec<Response>, Trouble> {
    found.iter().map(|device| one(bus, device)).collect()
}

/// Measures one device. Its original state is restored even after a request to stop.
fn one(bus: &mut Bus<'_>, device: &Found) -> Result<Response, Trouble> {
    let at = device.position;
    let owner = bus.read(at, register::EEPROM_CONFIGURATION)?;
    let managers = bus.try_read_each(&[at], register::SM_0.address, 16)?.remove(0);
    let mut response = Response::default();
    let result = measure_one(bus, device, &mut response);
    let heard = std::mem::replace(&mut bus.putting_back, true);
    let back = put_back(bus, device, owner, managers.as_deref(), &mut response);
    bus.putting_back = heard;
    match (result, back) {
        (Ok(()), Ok(())) => Ok(response),
        (Err(trouble), Ok(())) => Err(trouble),
        (result, Err(why)) => {
            let first = Box::new(result.err().unwrap_or_else(|| why.clone()));
            Err(Trouble::NotPutBack { position: at, why: Box::new(why), first })
        }
    }
}

fn measure_one(bus: &mut Bus<'_>, device: &Found, response: &mut Response) -> Result<(), Trouble> {
    let at = device.position;
    for owner in [2, 0] {
        bus.write(at, register::EEPROM_CONFIGURATION.address, &[owner])?;
    }
    let mut tries = Vec::with_capacity(EEPROM_READS);
    let mut mailboxes = [0; 4];
    for _ in 0..EEPROM_READS {
        match eeprom(bus, at, word::RECEIVE_MAILBOX)? {
            Some((took, words)) => {
                mailboxes[..2].copy_from_slice(&words);
                tries.push(took);
            }
            None => break,
        }
    }
    response.eeprom = times(&tries);
    let Some((_, send)) = eeprom(bus, at, word::SEND_MAILBOX)? else { return Ok(()) };
    mailboxes[2..].copy_from_slice(&send);
    if device.status.error() {
        return Ok(());
    }
    bus.write(at, register::EEPROM_CONFIGURATION.address, &[1])?;
    let init = change(bus, device, AlState::Init)?;
    if !matches!(init, StateChange::After(_)) {
        return Ok(());
    }
    if mailboxes[1] > 0 && mailboxes[3] > 0 {
        let manager = |start, length, control| SyncManager::new(start, length, control, true);
        let out = manager(mailboxes[0], mailboxes[1], SyncManager::MAILBOX_OUT);
        let inp = manager(mailboxes[2], mailboxes[3], SyncManager::MAILBOX_IN);
        bus.write(at, register::sync_manager(0).address, &out.to_bytes())?;
        bus.write(at, register::sync_manager(1).address, &inp.to_bytes())?;
    }
    let up = change(bus, device, AlState::PreOp)?;
    response.to_preop = Some(up);
    if matches!(up, StateChange::After(_)) {
        response.to_init = Some(change(bus, device, AlState::Init)?);
    }
    Ok(())
}

/// Restores the original state, SyncManagers and EEPROM owner.
fn put_back(
    bus: &mut Bus<'_>,
    device: &Found,
    owner: u8,
    managers: Option<&[u8]>,
    response: &mut Response,
) -> Result<(), Trouble> {
    let at = device.position;
    // A device that shows an error keeps it: its states were not tried.
    if device.status.error() {
        return bus.write(at, register::EEPROM_CONFIGURATION.address, &[owner & 1]);
    }
    let now = bus.read(at, register::AL_STATUS)?;
    if now.state() != Ok(AlState::Init) || now.error() {
        change(bus, device, AlState::Init)?;
    }
    if let Some(managers) = managers {
        // An active SyncManager accepts no other settings.
        for number in 0..2 {
            bus.write(at, register::sm_activate(number).address, &[0])?;
        }
        bus.write(at, register::SM_0.address, managers)?;
    }
    if device.status.state() == Ok(AlState::PreOp) {
        change(bus, device, AlState::PreOp)?;
    }
    bus.write(at, register::EEPROM_CONFIGURATION.address, &[owner & 1])?;
    let now = bus.read(at, register::AL_STATUS)?;
    response.state_left = (now.state() != device.status.state()).then_some(now);
    Ok(())
}

/// Two words that were read, the time the read took, and the amount by which that time may be too
/// long.
type Read = ((Nanos, Nanos), [u16; 2]);

fn eeprom(bus: &mut Bus<'_>, at: usize, word: u16) -> Result<Option<Read>, Trouble> {
    let begin = bus.now();
    bus.write(at, register::EEPROM_STATUS.address, &read_command(u32::from(word)))?;
    let mut before = bus.now();
    let mut grain = Nanos::ZERO;
    while bus.now() - begin < EEPROM_PATIENCE {
        let bytes = bus.read_each(&[at], register::EEPROM_STATUS.address, 14)?.remove(0);
        let now = bus.now();
        grain = grain.max(now - before);
        before = now;
        let status = EepromStatus(number(&bytes[..2]) as u16);
        if !status.busy() {
            let words = [number(&bytes[6..8]) as u16, number(&bytes[8..10]) as u16];
            return Ok((!status.failed()).then_some(((now - begin, grain), words)));
        }
    }
    Ok(None)
}

/// Asks for a state and waits for it.
fn change(bus: &mut Bus<'_>, device: &Found, state: AlState) -> Result<StateChange, Trouble> {
    let at = device.position;
    let control = match state == AlState::Init && !device.emulated {
        true => AlControl::request_and_acknowledge(state),
        false => AlControl::request(state),
    };
    let begin = bus.now();
    while !offer(bus, at, &control.to_bytes())? {
        if bus.now() - begin > STATE_PATIENCE {
            return Ok(StateChange::TooLate(STATE_PATIENCE));
        }
        bus.wait(STATE_PACE)?;
    }
    let mut before = bus.now();
    let mut grain = Nanos::ZERO;
    loop {
        let bytes = bus.read_each(&[at], register::AL_STATUS.address, 6)?.remove(0);
        let now = bus.now();
        grain = grain.max(now - before);
        before = now;
        let status = AlStatus::from_bytes([bytes[0], bytes[1]]);
        let code = number(&bytes[4..6]) as u16;
        let error = status.error() && !(device.emulated && code == 0);
        if status.state() == Ok(state) && !error {
            let took = times(&[(now - begin, grain)]);
            return Ok(took.map_or(StateChange::TooLate(STATE_PATIENCE), StateChange::After));
        }
        if error && state != AlState::Init {
            return Ok(StateChange::Refused(status, code));
        }
        if now - begin > STATE_PATIENCE {
            return Ok(StateChange::TooLate(STATE_PATIENCE));
        }
        bus.wait(STATE_PACE)?;
    }
}

/// Writes AL control. Returns whether the write was accepted: the register is locked until the
/// device has read the previous request.
fn offer(bus: &mut Bus<'_>, at: usize, control: &[u8]) -> Result<bool, Trouble> {
    let ask = super::bus::write(at, register::AL_CONTROL.address, control.to_vec());
    Ok(bus.ask(&[ask])?[0].wkc == 1)
}

fn times(tries: &[(Nanos, Nanos)]) -> Option<Times> {
    let each: Vec<f64> = tries.iter().map(|(took, _)| took.0 as f64).collect();
    let grain = tries.iter().map(|(_, grain)| grain.0).max()? as f64;
    Some(Times { spread: Spread::of(&each), count: each.len(), grain })
}

const EEPROM_READS: usize = 8;
const EEPROM_PATIENCE: Nanos = Nanos::millis(50);
/// The same limit as a MainDevice has for PREOP.
const STATE_PATIENCE: Nanos = Nanos::millis(3_000);
/// Time from one poll of the state to the next.
const STATE_PACE: Nanos = Nanos::micros(100);
