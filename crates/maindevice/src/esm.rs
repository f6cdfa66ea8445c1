//! State changes: request, acknowledge, poll, and the AL status code of a refusal.

use isocat_wire::al::{AlControl, AlState, AlStatus, AlStatusCode};
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;
use isocat_wire::{Command, StationAddress};

use crate::error::{AccessError, AccessProblem, Cause, SiiProblem};
use crate::event::Event;
use crate::link::Link;
use crate::segment::SubDevice;

/// Takes a SubDevice to a state within `patience`.
///
/// The request is repeated while its working counter is 0: AL control is locked until the firmware
/// has read the previous request. A request of INIT acknowledges errors; for other states an error
/// is a refusal.
pub(crate) async fn change(
    link: &Link,
    device: &mut SubDevice,
    state: AlState,
    patience: Nanos,
) -> Result<(), Cause> {
    let end = link.now() + patience;
    let control = request(device, state);
    while !write_control(link, device.station, control).await? {
        if link.now() >= end {
            return Err(timeout(device, state, patience));
        }
        link.sleep(POLL_FIRST).await;
    }
    let mut interval = POLL_FIRST;
    loop {
        let (status, code) = read_status(link, device.station).await?;
        let changed = status != device.al_status;
        (device.al_status, device.al_code) = (status, code);
        let error = status.error() && !(device.esc.device_emulation() && code == NO_ERROR);
        let reached = status.state() == Ok(state) && !error;
        let refused = error && state != AlState::Init;
        if changed && (reached || refused) {
            let cycle = link.board(|board| board.cycle);
            let position = device.position;
            link.report(Event::StateChanged { position, status, code, cycle });
        }
        if reached {
            return Ok(());
        }
        if refused {
            return Err(Cause::Refused { place: device.place(), requested: state, status, code });
        }
        if link.now() >= end {
            return Err(timeout(device, state, patience));
        }
        link.sleep(interval).await;
        interval = Nanos((interval.0 * 2).min(POLL_LAST.0));
    }
}

/// Takes a SubDevice to INIT. Without its configuration an ESC has no PDI, so nobody behind it
/// reads a request: then the EEPROM is the cause.
pub(crate) async fn to_init(
    link: &Link,
    device: &mut SubDevice,
    patience: Nanos,
) -> Result<(), Cause> {
    let result = change(link, device, AlState::Init, patience).await;
    if !matches!(result, Err(Cause::StateTimeout { .. })) {
        return result;
    }
    let status = link.try_read(device.station, register::EEPROM_STATUS).await?;
    match status.filter(|status| status.0 & EepromStatus::NOT_LOADED != 0) {
        Some(EepromStatus(status)) => {
            let problem = SiiProblem::NotLoaded(status);
            Err(Cause::Sii { place: device.place(), problem })
        }
        None => result,
    }
}

/// Acknowledges the error of a SubDevice, which stays in its state.
pub(crate) async fn acknowledge(
    link: &Link,
    device: &mut SubDevice,
    state: AlState,
    patience: Nanos,
) -> Result<(), Cause> {
    let end = link.now() + patience;
    let control = AlControl::request_and_acknowledge(state);
    while !write_control(link, device.station, control).await? {
        if link.now() >= end {
            return Err(timeout(device, state, patience));
        }
        link.sleep(POLL_FIRST).await;
    }
    loop {
        let (status, code) = read_status(link, device.station).await?;
        (device.al_status, device.al_code) = (status, code);
        if status.state() == Ok(state) && !status.error() {
            return Ok(());
        }
        // The error bit stays set until the firmware has read the request.
        if link.now() >= end {
            return Err(timeout(device, state, patience));
        }
        link.sleep(POLL_FIRST).await;
    }
}

/// Reads AL status and AL status code, registers 0x0130 to 0x0135, in one access, so that both are
/// of the same time.
pub(crate) async fn read_status(
    link: &Link,
    station: StationAddress,
) -> Result<(AlStatus, AlStatusCode), AccessError> {
    let address = register::AL_STATUS.address;
    let reply = link.fprd(station, address, STATUS_LEN).expect(1).await?;
    Ok(status_of(&reply.data))
}

/// AL status and its code in the six bytes from 0x0130 on.
pub(crate) fn status_of(bytes: &[u8]) -> (AlStatus, AlStatusCode) {
    (AlStatus::from_bytes([bytes[0], bytes[1]]), AlStatusCode::from_bytes([bytes[4], bytes[5]]))
}

/// Bytes from AL status to the end of the AL status code.
pub(crate) const STATUS_LEN: usize = 6;

/// Devices without firmware mirror AL control including the acknowledge bit, so the bit is not set
/// for them.
fn request(device: &SubDevice, state: AlState) -> AlControl {
    if state == AlState::Init && !device.esc.device_emulation() {
        AlControl::request_and_acknowledge(state)
    } else {
        AlControl::request(state)
    }
}

/// Writes AL control; returns `false` if it is locked.
async fn write_control(
    link: &Link,
    station: StationAddress,
    control: AlControl,
) -> Result<bool, AccessError> {
    let exchange = link.fpwr(station, register::AL_CONTROL.address, &control.to_bytes());
    match exchange.reply().await?.wkc {
        0 => Ok(false),
        1 => Ok(true),
        found => Err(AccessError {
            command: Command::Fpwr,
            address: isocat_wire::datagram::Address::Station(station, register::AL_CONTROL.address),
            problem: AccessProblem::WorkingCounter { expected: 1, found },
        }),
    }
}

fn timeout(device: &SubDevice, requested: AlState, after: Nanos) -> Cause {
    Cause::StateTimeout {
        place: device.place(),
        requested,
        status: device.al_status,
        code: device.al_code,
        after,
    }
}

/// First interval of polling: fast firmware answers within it.
const POLL_FIRST: Nanos = Nanos(200_000);
/// Longest interval of polling, which a long change may take in addition.
const POLL_LAST: Nanos = Nanos(10_000_000);
const NO_ERROR: AlStatusCode = AlStatusCode::NO_ERROR;
