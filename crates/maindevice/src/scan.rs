//! The scan: reset, count, addresses, and the ESC information.

use alloc::boxed::Box;
use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::al::{AlControl, AlState};
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::dc::SyncActivation;
use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, Value, features};
use isocat_wire::time::Nanos;

use crate::config::Config;
use crate::error::{AccessError, AccessProblem, Cause};
use crate::esm;
use crate::hot_connect;
use crate::link::{Link, Procedure, join};
use crate::ring;
use crate::segment::{DcCapability, EscInformation, Segment, SubDevice, station_of};
use crate::topology::{self, Ports};

/// Finds all SubDevices and brings them from any state into INIT, without settings of an earlier
/// run.
pub(crate) async fn scan(link: &Link, config: &Config, segment: &mut Segment) -> Result<(), Cause> {
    find(link, config, segment).await?;
    address(link, segment).await?;
    ring::close(link, segment).await?;
    let init = config.timeouts.init;
    join(
        segment
            .devices
            .iter_mut()
            .map(|device| -> Procedure<_> {
                Box::pin(async move {
                    describe(link, device).await?;
                    esm::to_init(link, device, init).await
                })
            })
            .collect(),
    )
    .await?;
    tree(segment)?;
    complete(link, config, segment).await
}

/// With hot-connect SubDevices: gives each SubDevice found its position, and inserts the absent
/// ones.
pub(crate) async fn complete(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
) -> Result<(), Cause> {
    if hot_connect::is_short(config, segment) {
        hot_connect::seat(link, config, segment).await?;
        hot_connect::fill(config, segment);
    }
    hot_connect::check_reference(config, segment)
}

/// Counts the SubDevices; nothing is written to them.
pub(crate) async fn find(link: &Link, config: &Config, segment: &mut Segment) -> Result<(), Cause> {
    let count = count(link).await?;
    if link.board(|board| board.ring.is_some()) {
        // The copy from the other end is back by then.
        link.sleep(Nanos::millis(1)).await;
    }
    ring::check(link)?;
    if count == 0 {
        return Err(Cause::Empty);
    }
    if !config.devices.is_empty() && !hot_connect::allows(config, count.into()) {
        return Err(Cause::Count { expected: config.devices.len(), found: count.into() });
    }
    if config.devices.is_empty() && count > DOUBTFUL {
        check_ends(link, count).await?;
    }
    link.with(|shared| shared.port.expect_way(count));
    for position in 0..usize::from(count) {
        let mut device = SubDevice::new(position, station_of(position));
        if let Some(config) = config.devices.get(position) {
            device.name.clone_from(&config.name);
        }
        segment.devices.push(device);
    }
    Ok(())
}

/// Checks that there is a last SubDevice and none behind it. It is used if a single working counter
/// announces many and none are configured, since each of them costs memory and frames.
async fn check_ends(link: &Link, count: u16) -> Result<(), Cause> {
    let (last, behind) = (usize::from(count) - 1, usize::from(count));
    for (position, expected) in [(last, 1), (behind, 0)] {
        // Behind 65 535 SubDevices, the position is that of the first one again.
        if position <= usize::from(u16::MAX) {
            link.aprd(position, register::TYPE.address, 1).expect(expected).await?;
        }
    }
    Ok(())
}

/// Resets the settings of an earlier run, and gives station addresses.
pub(crate) async fn address(link: &Link, segment: &Segment) -> Result<(), Cause> {
    reset(link, segment.devices.len() as u16).await?;
    let address = register::STATION_ADDRESS.address;
    let writes: Vec<_> = segment
        .devices
        .iter()
        .map(|device| link.apwr(device.position, address, &device.station.0.to_bytes()))
        .collect();
    for write in writes {
        write.expect(1).await?;
    }
    Ok(())
}

/// Finds the parents, as far as open ports show them, and the reference clock.
pub(crate) fn tree(segment: &mut Segment) -> Result<(), Cause> {
    segment.reference = segment.devices.iter().position(|device| device.dc.has_clock());
    let ports: Vec<_> = segment
        .devices
        .iter()
        .map(|device| Ports { status: device.dl_status, entry: device.entry, times: None })
        .collect();
    topology::check_count(&ports)?;
    // Where cables are swapped they make no tree yet; receive times will tell.
    let parents = topology::parents(&ports).unwrap_or_default();
    for (device, parent) in segment.devices.iter_mut().zip(parents) {
        device.parent = parent;
    }
    Ok(())
}

/// Counts the SubDevices. A link that has just come up, or a host that is busy, may lose the first
/// frames, so they are repeated for a while.
async fn count(link: &Link) -> Result<u16, Cause> {
    let begin = link.now();
    loop {
        let exchange = link.brd(register::TYPE.address, 1);
        let address = Address::Broadcast(register::TYPE.address);
        if let Ok(reply) = exchange.reply().await {
            // ESCs counted its position up and none answered: that is no loop-back.
            if reply.wkc == 0 && reply.passed > 0 {
                let problem = AccessProblem::WorkingCounter { expected: reply.passed, found: 0 };
                return Err(AccessError { command: Command::Brd, address, problem }.into());
            }
            return Ok(reply.wkc);
        }
        let after = link.now() - begin;
        if after < FIRST_ANSWER {
            continue;
        }
        let counts = link.board(|board| board.statistics);
        if counts.frames_echoed > 0 {
            return Err(Cause::Empty);
        }
        let foreign = counts.foreign_source.map(|source| (source, counts.frames_foreign));
        return Err(Cause::Silent { sent: counts.frames_sent, after, foreign });
    }
}

/// Up to this number of SubDevices the working counter is believed without a check: they cost
/// little.
const DOUBTFUL: u16 = 512;

/// Register 0x0100 bit 0: EtherCAT frames are processed and their source address is marked, other
/// frames are destroyed.
const DL_CONTROL_MARKS: u8 = 1;

/// How long to wait for the first frame that comes back.
const FIRST_ANSWER: Nanos = Nanos(1_000_000_000);

/// Resets the settings of an earlier run by broadcasts. SYNC comes first: further pulses would take
/// a device out of INIT.
///
/// Registers that not every ESC has may have a working counter below the number of SubDevices, but
/// never above it. AL control has 0 if the firmware has not yet read an earlier request, and is
/// then repeated for each SubDevice.
async fn reset(link: &Link, count: u16) -> Result<(), Cause> {
    let init = AlControl::request_and_acknowledge(AlState::Init);
    let zeros = [0; 256];
    let all: [(u16, &[u8], bool); 10] = [
        (register::SYNC_ACTIVATION.address, &SyncActivation(0).to_bytes(), false),
        (register::AL_CONTROL.address, &init.to_bytes(), false),
        // As after power-on, for an earlier run may have cleared it: the first ESC marks the source
        // address of what it has processed. Loop control of all ports: automatic; the alias is not
        // used.
        (register::DL_CONTROL.address, &[DL_CONTROL_MARKS, 0], true),
        (register::DL_CONTROL.address + 3, &zeros[..1], true),
        (register::RX_ERRORS.address, &zeros[..8], true),
        (register::FMMU_0.address, &zeros, false),
        (register::SM_0.address, &zeros[..128], false),
        (register::STATION_ADDRESS.address, &zeros[..2], true),
        // The EEPROM back from a PDI that may hold it, then to ECAT.
        (register::EEPROM_CONFIGURATION.address, &[2], true),
        (register::EEPROM_CONFIGURATION.address, &zeros[..1], true),
    ];
    for (address, data, everywhere) in all {
        // One after the other: registers take effect at the end of their frame.
        let exchange = link.bwr(address, data);
        if everywhere {
            exchange.expect(count).await?;
            if address == register::DL_CONTROL.address {
                link.with(|shared| shared.port.expect_marks());
            }
            continue;
        }
        let found = exchange.reply().await?.wkc;
        if found > count {
            return Err(Cause::Access(AccessError {
                command: Command::Bwr,
                address: Address::Broadcast(address),
                problem: AccessProblem::WorkingCounter { expected: count, found },
            }));
        }
    }
    Ok(())
}

/// Takes the EEPROM of one SubDevice from a PDI that may hold it, for ECAT.
pub(crate) async fn take_eeprom(link: &Link, station: StationAddress) -> Result<(), AccessError> {
    for value in [2, 0] {
        link.write(station, register::EEPROM_CONFIGURATION, value).await?;
    }
    Ok(())
}

/// Resets the settings of an earlier run at one SubDevice, SYNC first. Registers that it does not
/// have return a working counter of 0.
pub(crate) async fn reset_one(link: &Link, station: StationAddress) -> Result<(), AccessError> {
    let zeros = [0; 256];
    let all: [(u16, &[u8]); 6] = [
        (register::SYNC_ACTIVATION.address, &zeros[..1]),
        (register::DL_CONTROL.address, &[DL_CONTROL_MARKS, 0]),
        (register::DL_CONTROL.address + 3, &zeros[..1]),
        (register::RX_ERRORS.address, &zeros[..8]),
        (register::FMMU_0.address, &zeros),
        (register::SM_0.address, &zeros[..128]),
    ];
    for (address, data) in all {
        let found = link.fpwr(station, address, data).reply().await?.wkc;
        if found > 1 {
            return Err(AccessError {
                command: Command::Fpwr,
                address: Address::Station(station, address),
                problem: AccessProblem::WorkingCounter { expected: 1, found },
            });
        }
    }
    Ok(())
}

/// Reads the ESC information.
pub(crate) async fn describe(link: &Link, device: &mut SubDevice) -> Result<(), Cause> {
    let station = device.station;
    let information = link.fprd(station, register::TYPE.address, 10);
    let configuration = link.fprd(station, register::ESC_CONFIGURATION.address, 1);
    let status = link.fprd(station, register::DL_STATUS.address, 2);
    let times = link.fprd(station, register::RECEIVE_TIME_0.address, 16);
    let clock = link.fprd(station, register::SYSTEM_TIME.address, 8);
    let bytes = information.expect(1).await?.data;
    device.esc = EscInformation {
        kind: register::TYPE.load(&bytes),
        revision: register::REVISION.load(&bytes),
        build: register::BUILD.load(&bytes),
        fmmus: register::FMMU_COUNT.load(&bytes),
        sync_managers: register::SM_COUNT.load(&bytes),
        ram: register::RAM_SIZE.load(&bytes),
        ports: register::PORT_DESCRIPTOR.load(&bytes),
        features: register::FEATURES.load(&bytes),
        configuration: configuration.expect(1).await?.data[0],
    };
    let status = status.expect(1).await?.data;
    device.dl_status = DlStatus::from_bytes([status[0], status[1]]);
    device.entry = topology::likely_entry(device.dl_status);
    // Feature bit 2 only promises receive times; the clock is there if its register answers.
    let times = times.reply().await?.wkc == 1;
    let clock = clock.reply().await?.wkc == 1;
    device.dc = match (device.esc.has(features::DC) && times, clock) {
        (false, _) => DcCapability::None,
        (true, false) => DcCapability::ReceiveTimes,
        (true, true) if device.esc.has(features::DC_64_BIT) => DcCapability::Clock64,
        (true, true) => DcCapability::Clock32,
    };
    Ok(())
}
