//! The state of a segment before the calibration, and how it is restored.

use isocat_wire::al::AlState;
use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, Value, features};
use isocat_wire::{AlStatus, PortNumber};

use super::bus::{Bus, Operating, Trouble, number};

/// Kind of a port, register 0x0007.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PortKind {
    /// Copper with a PHY.
    Mii,
    /// The contacts between terminals.
    Ebus,
    /// Absent, or not configured.
    Other,
}

impl PortKind {
    /// The kind by its two bits.
    fn of(bits: u8) -> Self {
        match bits & 0b11 {
            0b11 => Self::Mii,
            0b10 => Self::Ebus,
            _ => Self::Other,
        }
    }
}

/// One device as it was found.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub position: usize,
    /// Register 0x0000.
    pub kind: u8,
    /// Kinds of its ports, by number.
    pub ports: [PortKind; 4],
    /// Open ports, by number.
    pub open: [bool; 4],
    /// Whether it has receive times, register 0x0900.
    pub has_times: bool,
    /// Its clock, if it has one.
    pub clock: Option<ClockRegisters>,
    /// State without the error bit.
    pub status: AlStatus,
    /// Bit 0 of 0x0141: the ESC answers AL requests by itself.
    pub emulated: bool,
}

/// The registers of a clock that a calibration writes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ClockRegisters {
    /// Register 0x0920.
    pub offset: u64,
    /// Register 0x0928.
    pub delay: u32,
    /// Register 0x0930.
    pub start: u16,
    /// Registers 0x0934 and 0x0935.
    pub depths: [u8; 2],
    /// Whether its counter has 64 bits, so that 0x0920 has 8 bytes.
    pub wide: bool,
}

/// Reads all devices; nothing is written. A device in operation is an error.
pub(super) fn look(bus: &mut Bus<'_>) -> Result<Vec<Found>, Trouble> {
    let count = bus.count()?;
    if count == 0 {
        return Err(Trouble::Empty);
    }
    let all: Vec<usize> = (0..count).collect();
    let information = bus.read_each(&all, register::TYPE.address, 10)?;
    let ports = bus.read_each(&all, register::DL_STATUS.address, 2)?;
    let states = bus.read_each(&all, register::AL_STATUS.address, 2)?;
    let configurations = bus.read_each(&all, register::ESC_CONFIGURATION.address, 1)?;
    let times = bus.try_read_each(&all, register::RECEIVE_TIME_0.address, 16)?;
    let clocks = bus.try_read_each(&all, register::SYSTEM_TIME_OFFSET.address, 12)?;
    let mut devices = Vec::with_capacity(count);
    for position in all {
        let features = register::FEATURES.load(&information[position]);
        let has_dc = features & features::DC != 0;
        let status = DlStatus::from_bytes([ports[position][0], ports[position][1]]);
        let clock = clocks[position].as_ref().filter(|_| has_dc);
        let wide = features & features::DC_64_BIT != 0;
        devices.push(Found {
            position,
            kind: information[position][0],
            ports: PortNumber::ALL
                .map(|port| PortKind::of(information[position][7] >> (2 * port.index()))),
            open: PortNumber::ALL.map(|port| status.open(port)),
            has_times: has_dc && times[position].is_some(),
            clock: clock.map(|bytes| read_clock(bus, position, wide, bytes)).transpose()?,
            status: AlStatus::from_bytes([states[position][0], states[position][1]]),
            emulated: configurations[position][0] & 1 != 0,
        });
    }
    for device in &devices {
        check(bus, device)?;
    }
    Ok(devices)
}

fn read_clock(
    bus: &mut Bus<'_>,
    position: usize,
    wide: bool,
    bytes: &[u8],
) -> Result<ClockRegisters, Trouble> {
    let filters = bus.read_each(&[position], register::SPEED_COUNTER_START.address, 6)?;
    let filters = &filters[0];
    Ok(ClockRegisters {
        offset: number(&bytes[..8]),
        delay: number(&bytes[8..12]) as u32,
        start: number(&filters[..2]) as u16,
        depths: [filters[4], filters[5]],
        wide,
    })
}

/// Refuses a segment in operation: every SubDevice must be in INIT or PREOP.
fn check(bus: &mut Bus<'_>, device: &Found) -> Result<(), Trouble> {
    let position = device.position;
    if !matches!(device.status.state(), Ok(AlState::Init | AlState::PreOp)) {
        return Err(Trouble::InOperation { position, what: Operating::State(device.status) });
    }
    if device.clock.is_some() {
        let read = bus.try_read_each(&[position], register::SYNC_ACTIVATION.address, 1)?;
        if read[0].as_ref().is_some_and(|bytes| bytes[0] & 1 != 0) {
            return Err(Trouble::InOperation { position, what: Operating::Sync });
        }
    }
    Ok(())
}

/// Restores the clocks' registers, each device independently. Returns the devices that failed.
///
/// The write to 0x0930 comes last, as it clears what the filters took in meanwhile.
pub(super) fn put_back(bus: &mut Bus<'_>, devices: &[Found]) -> Vec<(usize, Trouble)> {
    bus.putting_back = true;
    let mut failed = Vec::new();
    for device in devices {
        let Some(clock) = &device.clock else { continue };
        if let Err(trouble) = put_back_clock(bus, device.position, clock) {
            failed.push((device.position, trouble));
        }
    }
    failed
}

fn put_back_clock(
    bus: &mut Bus<'_>,
    position: usize,
    clock: &ClockRegisters,
) -> Result<(), Trouble> {
    bus.write(position, register::SYSTEM_TIME_OFFSET.address, &clock.offset_bytes(clock.offset))?;
    bus.write(position, register::SYSTEM_TIME_DELAY.address, &clock.delay.to_le_bytes())?;
    bus.write(position, register::TIME_FILTER_DEPTH.address, &clock.depths)?;
    bus.write(position, register::SPEED_COUNTER_START.address, &clock.start.to_le_bytes())
}

impl ClockRegisters {
    /// Register 0x0920 in the width of this clock.
    pub fn offset_bytes(&self, offset: u64) -> Vec<u8> {
        offset.to_le_bytes()[..if self.wide { 8 } else { 4 }].to_vec()
    }
}
