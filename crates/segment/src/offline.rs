//! The segment according to its devices' profiles and its cables: the same as a scan and the
//! objects would show.

use isocat_esc::chip::{Chip, DcUnits};
use isocat_maindevice::segment::{
    DcCapability, EscInformation, Guarded, Identity, OperationMode, Pdo, PdoEntry, ProcessData,
    Sii, SiiPdo, SyncEntry, SyncObject,
};
use isocat_maindevice::written::Bits;
use isocat_maindevice::{Segment, SubDevice};
use isocat_sim::{Cable, Direction};
use isocat_subdevice::description::{Description, ProcessDataArea};
use isocat_sync::object::{INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER};
use isocat_sync::way::{Cabled, Way, propagation};
use isocat_wire::StationAddress;
use isocat_wire::coe::info::{EntryDescription, ObjectDescription};
use isocat_wire::register::features;
use isocat_wire::sii::{self, PdoEntryRecord, SmRecord, category};
use isocat_wire::time::{Nanos, Picos};

use crate::profile::Profile;
use crate::segment_file;

/// The segment of these devices in this order, as far as it can be known without a wire.
pub fn segment(described: &[segment_file::SubDevice]) -> Segment {
    let mut devices: Vec<SubDevice> =
        described.iter().enumerate().map(|(i, device)| subdevice(i, device)).collect();
    let reference = devices.iter().position(|device| device.dc.has_clock());
    let ways = ways(described);
    let base = reference.map_or(Picos::ZERO, |at| ways[at].delay);
    for (device, way) in devices.iter_mut().zip(&ways) {
        // Half a nanosecond and more is rounded up, as in the mean of many latches.
        let ps = (way.delay - base).0;
        device.delay = Some(Nanos((ps + 500).div_euclid(1_000)));
    }
    Segment { devices, reference, ..Segment::default() }
}

/// One of these devices, as far as it can be known without a wire.
pub fn known(described: &[segment_file::SubDevice], position: usize) -> SubDevice {
    segment(described).devices.swap_remove(position)
}

/// In a ring, the time of a frame from each port of the MainDevice to the device there: the cable
/// and the device's PHY.
pub fn ends(devices: &[segment_file::SubDevice], ring: segment_file::Ring) -> [Picos; 2] {
    let phy = |device: usize, port| devices[device].profile.esc().port_delay(port);
    let first = &devices[0];
    let out =
        first.cable.0 * first.cable_delay.0 / 1_000 + Picos::from(first.cable_asymmetry).0 / 2;
    let closing = Cable::of_length(ring.cable.0 as u64).delay(Direction::Back);
    [phy(0, first.place.port) + Picos(out), phy(ring.device, ring.port) + closing]
}

/// The propagation delays that follow from cables and chips.
pub fn ways(devices: &[segment_file::SubDevice]) -> Vec<Way> {
    fn chip(device: &segment_file::SubDevice) -> &Chip {
        device.profile.esc()
    }
    let cabled: Vec<Cabled> = devices
        .iter()
        .map(|device| {
            let own = chip(device).port_delay(device.place.port);
            let above = device.place.upstream;
            let phys =
                own + above.map_or(Picos::ZERO, |(at, port)| chip(&devices[at]).port_delay(port));
            // mm times ps per metre.
            let mean = device.cable.0 * device.cable_delay.0 / 1_000;
            let more = Picos::from(device.cable_asymmetry).0;
            Cabled {
                parent: above,
                entry: device.place.port,
                out: phys + Picos(mean + more / 2),
                back: phys + Picos(mean + more / 2 - more),
                processing: chip(device).processing_delay,
                forwarding: chip(device).forwarding_delay,
            }
        })
        .collect();
    let mut ways = vec![Way::default(); cabled.len()];
    propagation(&cabled, &mut ways);
    ways
}

fn subdevice(position: usize, file: &segment_file::SubDevice) -> SubDevice {
    let profile = &file.profile;
    let chip = profile.esc();
    let station = StationAddress(FIRST_STATION.wrapping_add(position as u16));
    let header = sii::Header::parse(&profile.sii).unwrap_or_default();
    let description = &profile.description;
    let mut device = SubDevice::new(position, station);
    device.name.clone_from(&file.name);
    device.esc = EscInformation {
        kind: chip.kind,
        revision: chip.revision,
        build: chip.build,
        fmmus: chip.fmmu_count,
        sync_managers: chip.sm_count,
        ram: chip.ram_kib,
        ports: chip.port_descriptor,
        features: chip.features,
        configuration: header.configuration[1],
    };
    device.identity = Identity {
        vendor: header.vendor_id,
        product: header.product_code,
        revision: header.revision,
        serial: header.serial,
    };
    device.dc = clock(chip, header.configuration[1]);
    device.parent = file.place.upstream;
    device.entry = file.place.port;
    device.sii = Sii {
        header,
        name: profile.name.clone(),
        operation_modes: profile
            .op_modes
            .iter()
            .map(|mode| OperationMode {
                cycle_time_0: 0,
                shift_time_0: 0,
                shift_time_1: 0,
                sync1_factor: mode.sync1_factor,
                assign_activate: mode.assign_activate,
                sync0_factor: mode.sync0_factor,
            })
            .collect(),
        ..Sii::default()
    };
    let used = [category::SYNC_MANAGER, category::RX_PDO, category::TX_PDO];
    let mut at = usize::from(sii::word::CATEGORIES);
    for found in sii::categories(&profile.sii).flatten() {
        if used.contains(&found.kind) {
            device.sii.take(found.kind, at + 2, found.data);
        }
        at += 2 + found.data.len() / 2;
    }
    let outputs = &profile.assignment.outputs;
    let inputs = &profile.assignment.inputs;
    if device.has_coe() {
        device.outputs.pdos = pdos(profile, OUTPUT_ASSIGNMENT, outputs);
        device.inputs.pdos = pdos(profile, INPUT_ASSIGNMENT, inputs);
        let Description { outputs, inputs, further_outputs, further_inputs, .. } = description;
        further(&mut device.outputs, profile, *outputs, further_outputs);
        further(&mut device.inputs, profile, *inputs, further_inputs);
        device.output_sync = sync_object(description, OUTPUT_PARAMETER);
        device.input_sync = sync_object(description, INPUT_PARAMETER);
    }
    device
}

/// Which system time the device has: it depends on the feature bits, and on the units that the
/// EEPROM switches on.
fn clock(chip: &Chip, configuration: u8) -> DcCapability {
    let has = chip.has(features::DC)
        && match chip.dc_units {
            DcUnits::Always => true,
            DcUnits::ByEeprom => configuration & (DC_SYNC | DC_LATCH) != 0,
        };
    match (has, chip.counts_64_bit()) {
        (true, true) => DcCapability::Clock64,
        (true, false) => DcCapability::Clock32,
        (false, _) if chip.has(features::DC) => DcCapability::ReceiveTimes,
        (false, _) => DcCapability::None,
    }
}

/// The PDOs of a device's outputs and inputs, as they will be assigned; for a device without CoE
/// those of its SII.
pub(crate) fn process_data(file: &segment_file::SubDevice) -> [Vec<Pdo>; 2] {
    let device = subdevice(0, file);
    if device.has_coe() {
        return [whole_bytes(&device.outputs), whole_bytes(&device.inputs)];
    }
    let records = &device.sii.sync_managers;
    let is_window = |sm: u8| records.get(usize::from(sm)).is_some_and(SmRecord::is_window);
    let assigned = |pdo: &&SiiPdo| pdo.record.sm != NO_SYNC_MANAGER && !is_window(pdo.record.sm);
    let entry =
        |entry: &PdoEntryRecord| PdoEntry { index: entry.index, sub: entry.sub, bits: entry.bits };
    let pdo = |pdo: &SiiPdo| Pdo {
        index: pdo.record.index,
        entries: pdo.entries.iter().map(entry).collect(),
    };
    [device.sii.rx_pdos, device.sii.tx_pdos]
        .map(|pdos| pdos.iter().filter(assigned).map(pdo).collect())
}

/// The PDOs of a direction as they lie in the process image: with padding behind those of each
/// SyncManager but the last, since the next one begins with a whole byte.
fn whole_bytes(data: &ProcessData) -> Vec<Pdo> {
    let mut at = 0;
    let further = data.further.iter().map(|guarded| guarded.pdos);
    let first = data.pdos.len() - further.clone().sum::<usize>();
    let mut all: Vec<Pdo> = Vec::new();
    for count in std::iter::once(first).chain(further) {
        let bits: u32 = all.iter().map(Pdo::bits).sum();
        let padding = (bits.next_multiple_of(8) - bits) as u8;
        if padding > 0 {
            all.push(Pdo { index: 0, entries: vec![PdoEntry { index: 0, sub: 0, bits: padding }] });
        }
        all.extend_from_slice(&data.pdos[at..at + count]);
        at += count;
    }
    all
}

/// The bits of an object in these PDOs, with a sign.
pub(crate) fn bits_of(pdos: &[Pdo], index: u16, sub: u8) -> Option<Bits> {
    let mut at = 0;
    for entry in pdos.iter().flat_map(|pdo| &pdo.entries) {
        if (entry.index, entry.sub) == (index, sub) {
            return Some(Bits { at, len: entry.bits, signed: true });
        }
        at += u32::from(entry.bits);
    }
    None
}

/// Adds the SyncManagers behind the first one of a direction, each with the PDOs of its own
/// assignment.
fn further(
    data: &mut ProcessData,
    profile: &Profile,
    first: ProcessDataArea,
    behind: &[ProcessDataArea],
) {
    for area in behind {
        let own = pdos(profile, FIRST_ASSIGNMENT + u16::from(area.sync_manager), &[]);
        let bits: u32 = own.iter().map(Pdo::bits).sum();
        data.sync_manager = Some(first.sync_manager);
        data.further.push(Guarded {
            sync_manager: area.sync_manager,
            start: area.start,
            length: u16::try_from(bits.div_ceil(8)).unwrap_or(u16::MAX),
            pdos: own.len(),
            window: false,
        });
        data.pdos.extend(own);
    }
}

/// The PDOs that will be assigned, with their mapping; those of power-on if none are requested.
fn pdos(profile: &Profile, assignment: u16, wanted: &[u16]) -> Vec<Pdo> {
    let assigned = match wanted {
        [] => list(profile, assignment).into_iter().map(|pdo| pdo as u16).collect(),
        wanted => wanted.to_vec(),
    };
    let entry = |value: u32| PdoEntry {
        index: (value >> 16) as u16,
        sub: (value >> 8) as u8,
        bits: value as u8,
    };
    let pdo = |index| Pdo { index, entries: list(profile, index).into_iter().map(entry).collect() };
    assigned.into_iter().filter(|pdo| *pdo != 0).map(pdo).collect()
}

/// The values of a list object, in the number that its sub-index 0 states.
pub fn list(profile: &Profile, index: u16) -> Vec<u32> {
    let value = |sub| profile.value(isocat_wire::ObjectAddress::new(index, sub));
    let count = value(0).unwrap_or(0).min(254) as u8;
    (1..=count).filter_map(|sub| Some(value(sub)? as u32)).collect()
}

fn sync_object(description: &Description, index: u16) -> Option<SyncObject> {
    let found = description.object(index)?;
    let head = ObjectDescription {
        index,
        data_type: found.data_type.0,
        max_sub: found.max_sub(),
        code: found.code,
    };
    let mut object =
        SyncObject { description: Some((head, found.name.into())), ..SyncObject::default() };
    for entry in found.entries.iter().filter(|entry| !entry.is_gap() && !entry.is_empty()) {
        let head = EntryDescription {
            index,
            sub: entry.sub,
            value_info: 0,
            data_type: entry.data_type.0,
            bits: entry.bits,
            access: entry.access,
        };
        let mut value = description.power_on(entry).to_vec();
        value.resize(entry.len(), 0);
        let entry = SyncEntry {
            sub: entry.sub,
            description: Some((head, entry.name.into())),
            value: Ok(value),
        };
        if let Some(number) = entry.number() {
            object.values.set(entry.sub, number);
        }
        object.entries.push(entry);
    }
    Some(object)
}

/// Assignment object of SM0; that of SM n is n behind it.
const FIRST_ASSIGNMENT: u16 = 0x1C10;
/// In the SII: a PDO without a SyncManager by default.
const NO_SYNC_MANAGER: u8 = 0xFF;
/// First station address of a scan.
const FIRST_STATION: u16 = 0x1001;
/// Register 0x0141: SYNC-out unit on.
const DC_SYNC: u8 = 1 << 2;
/// Register 0x0141: latch-in unit on.
const DC_LATCH: u8 = 1 << 3;
