//! From the PDO assignment to SyncManagers, FMMUs and the process image.
//!
//! Outputs and inputs of a SubDevice overlap in the image: both begin at the same logical byte, and
//! the longer one decides what it takes. With LRW its outputs travel out and its inputs come back
//! in the same bytes of the frame, which makes the shortest frame. Mappings are byte-wise;
//! SubDevices never share a byte.

use alloc::vec::Vec;

use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, Value, features};
use isocat_wire::sii::{SmRecord, sm_type};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use crate::config::WatchdogRegisters;
use crate::cycle::MOST_CHUNK;
use crate::error::{Cause, MappingProblem};
use crate::link::Link;
use crate::objects;
use crate::segment::{Chunk, Guarded, ProcessData, ProcessImage, SubDevice};

/// Lays out the process image: the logical address of each SubDevice, and which SubDevices share a
/// datagram. Those with the same cycle share one; shorter cycles come first.
pub(crate) fn lay_out(devices: &mut [SubDevice]) -> Result<ProcessImage, Cause> {
    let mut image = ProcessImage {
        chunks: Vec::new(),
        read_write: !devices.iter().any(|device| device.esc.has(features::NO_LRW)),
    };
    for device in &mut *devices {
        let (outputs, inputs) = (device.outputs.length, device.inputs.length);
        let length = outputs.max(inputs);
        if usize::from(length) > MOST_CHUNK {
            let problem = MappingProblem::TooLong { length: length.into(), most: MOST_CHUNK };
            return Err(Cause::Mapping { place: device.place(), problem });
        }
        // The open chunk of a group is its last one.
        let open = image.chunks.iter().rposition(|chunk| chunk.every == device.every);
        let fits =
            |at: &usize| usize::from(image.chunks[*at].length) + usize::from(length) <= MOST_CHUNK;
        let at = match open.filter(fits) {
            Some(at) => at,
            None if length == 0 => {
                (device.outputs.logical, device.inputs.logical) = (0, 0);
                continue;
            }
            None => {
                image.chunks.push(Chunk {
                    every: device.every,
                    first: device.position,
                    end: device.position,
                    ..Chunk::default()
                });
                image.chunks.len() - 1
            }
        };
        let chunk = &mut image.chunks[at];
        // Counted from the chunk's first byte until all chunks are known.
        let logical = u32::from(chunk.length);
        (device.outputs.logical, device.inputs.logical) = (logical, logical);
        chunk.length += length;
        chunk.end = device.position + 1;
        chunk.writers += u16::from(outputs > 0);
        chunk.readers += u16::from(inputs > 0);
    }
    image.chunks.sort_by_cached_key(|chunk| u64::from(chunk.every));
    let mut logical = 0;
    for chunk in &mut image.chunks {
        chunk.logical = logical;
        logical += u32::from(chunk.length);
        for device in devices.iter_mut().filter(|device| chunk.holds(device)) {
            device.outputs.logical += chunk.logical;
            device.inputs.logical += chunk.logical;
        }
    }
    Ok(image)
}

/// The same for a SubDevice that is not asked: without CoE, the SII has its PDOs.
pub(crate) fn place_as_known(device: &mut SubDevice) -> Result<(), Cause> {
    if !device.has_coe() {
        objects::from_sii(device);
    }
    place_process_data(device)
}

/// Finds which SyncManager guards the outputs or inputs, and where: by object 0x1C00, otherwise by
/// the SII.
pub(crate) fn place_process_data(device: &mut SubDevice) -> Result<(), Cause> {
    for kind in [sm_type::OUTPUTS, sm_type::INPUTS] {
        let data = if kind == sm_type::OUTPUTS { &device.outputs } else { &device.inputs };
        // Where several share the direction, or it begins with a window, the first one is known
        // with its PDOs.
        let known = data.window || !data.further.is_empty();
        let shared = data.sync_manager.filter(|_| known).map(usize::from);
        let number = shared
            .or_else(|| device.sm_types.iter().position(|found| *found == kind))
            .or_else(|| {
                let guards = |record: &SmRecord| record.kind == kind && !record.is_window();
                device.sii.sync_managers.iter().position(guards)
            });
        let start = number
            .and_then(|number| device.sii.sync_managers.get(number))
            .map(|record| record.start);
        let place = device.place();
        let data = if kind == sm_type::OUTPUTS { &mut device.outputs } else { &mut device.inputs };
        // Each SyncManager has whole bytes.
        let elsewhere: usize = data.further.iter().map(|guarded| guarded.pdos).sum();
        let first = data.pdos.len().saturating_sub(elsewhere);
        let bits: u32 = data.pdos[..first].iter().map(|pdo| pdo.bits()).sum();
        let further: u32 = data.further.iter().map(|guarded| u32::from(guarded.length)).sum();
        let length = bits.div_ceil(8) + further;
        let Ok(length) = u16::try_from(length) else {
            let problem = MappingProblem::TooLong { length, most: MOST_CHUNK };
            return Err(Cause::Mapping { place, problem });
        };
        data.length = length;
        match (number, start) {
            (Some(number), Some(start)) => {
                data.sync_manager = Some(number as u8);
                data.start = start;
            }
            _ if length > 0 => {
                let problem = MappingProblem::NoSyncManager;
                return Err(Cause::Mapping { place, problem });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Whether its ESC has an FMMU for each part of the process data.
pub(crate) fn enough_fmmus(device: &SubDevice) -> Result<(), Cause> {
    let (needed, found) = (device.fmmus_needed() as u8, device.esc.fmmus);
    match needed <= found {
        true => Ok(()),
        false => {
            let problem = MappingProblem::NoFmmu { needed, found };
            Err(Cause::Mapping { place: device.place(), problem })
        }
    }
}

/// Writes the SyncManagers of the process data and the FMMUs.
pub(crate) async fn write(
    link: &Link,
    device: &SubDevice,
    watchdog: WatchdogRegisters,
) -> Result<(), Cause> {
    enough_fmmus(device)?;
    let writes: Vec<_> = writes(device, watchdog)
        .iter()
        .map(|(address, data)| link.fpwr(device.station, *address, data))
        .collect();
    for write in writes {
        write.expect(1).await?;
    }
    Ok(())
}

/// The registers of the process data: address and bytes, in order.
pub(crate) fn writes(device: &SubDevice, watchdog: WatchdogRegisters) -> Vec<(u16, Vec<u8>)> {
    let directions = [(&device.outputs, Fmmu::WRITE), (&device.inputs, Fmmu::READ)];
    let mut writes = Vec::new();
    let mut next_fmmu = 0;
    for (data, kind) in directions {
        for guarded in data.guarded().filter(|guarded| !guarded.window) {
            let manager = sync_manager(device, guarded, kind);
            let address = register::sync_manager(usize::from(guarded.sync_manager)).address;
            writes.push((address, manager.to_bytes().to_vec()));
        }
        for Span { logical, start, length } in spans(data) {
            let fmmu = Fmmu::bytes(logical, length, start, kind);
            writes.push((register::fmmu(next_fmmu).address, fmmu.to_bytes().to_vec()));
            next_fmmu += 1;
        }
    }
    let WatchdogRegisters { divider, pdi, process_data } = watchdog;
    let registers = [
        (register::WATCHDOG_DIVIDER, divider),
        (register::WATCHDOG_TIME_PDI, pdi),
        (register::WATCHDOG_TIME_PROCESS_DATA, process_data.filter(|_| device.outputs.length > 0)),
    ];
    for (register, value) in registers {
        writes.extend(value.map(|value| (register.address, value.to_le_bytes().to_vec())));
    }
    writes
}

/// How long outputs stay valid without new ones; `None` if the SyncManager does not trigger the
/// watchdog, or it is off.
pub(crate) fn watchdog(device: &SubDevice, registers: WatchdogRegisters) -> Option<Nanos> {
    let mut guarded = device.outputs.guarded().filter(|guarded| guarded.length > 0);
    let triggers = guarded.any(|guarded| {
        let manager = sync_manager(device, guarded, Fmmu::WRITE);
        manager.control & SyncManager::CONTROL_WATCHDOG != 0
    });
    registers.time().filter(|_| triggers)
}

/// The settings of a SyncManager: control by the SII, length by the mapping, off without process
/// data.
fn sync_manager(device: &SubDevice, guarded: Guarded, kind: u8) -> SyncManager {
    let Guarded { sync_manager, start, length, .. } = guarded;
    let record: Option<&SmRecord> = device.sii.sync_managers.get(usize::from(sync_manager));
    let usual = if kind == Fmmu::WRITE { SyncManager::OUTPUTS } else { SyncManager::INPUTS };
    let control = record.map_or(usual, |record| record.control);
    SyncManager::new(start, length, control, length > 0)
}

/// A part of a direction that one FMMU maps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Span {
    logical: u32,
    start: u16,
    length: u16,
}

impl SubDevice {
    /// Number of FMMUs that its process data needs.
    pub fn fmmus_needed(&self) -> usize {
        spans(&self.outputs).len() + spans(&self.inputs).len()
    }
}

/// What the FMMUs of a direction map: one span for each SyncManager or window, and one for all that
/// lie behind each other without a gap, as the bytes of digital outputs do. Descriptions count
/// FMMUs in the same way.
fn spans(data: &ProcessData) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    let mut logical = data.logical;
    for Guarded { start, length, .. } in data.guarded().filter(|guarded| guarded.length > 0) {
        match spans.last_mut() {
            Some(last) if last.start.checked_add(last.length) == Some(start) => {
                last.length += length;
            }
            _ => spans.push(Span { logical, start, length }),
        }
        logical += u32::from(length);
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::StationAddress;
    use isocat_wire::sii::{PdoEntryRecord, PdoRecord};

    use crate::segment::{EscInformation, SiiPdo};

    fn device(position: usize, outputs: u16, inputs: u16) -> SubDevice {
        let mut device = SubDevice::new(position, StationAddress(0x1001));
        (device.outputs.length, device.inputs.length) = (outputs, inputs);
        device
    }

    #[test]
    fn outputs_and_inputs_overlap() {
        let mut devices = [device(0, 7, 11), device(1, 0, 0), device(2, 4, 0)];
        let image = lay_out(&mut devices).unwrap();
        assert_eq!(devices.each_ref().map(|d| d.outputs.logical), [0, 11, 11]);
        let chunk =
            Chunk { every: 1, logical: 0, length: 15, first: 0, end: 3, writers: 2, readers: 1 };
        assert_eq!(image.chunks, [chunk]);
    }

    /// Groups may alternate in the segment: each has its bytes in one piece.
    #[test]
    fn groups_do_not_share_a_chunk() {
        let most = MOST_CHUNK as u16;
        let of = |position, every, length| SubDevice { every, ..device(position, length, length) };
        let mut devices = [
            of(0, 5, 4),
            of(1, 1, 8),
            of(2, 2, most),
            of(3, 1, 6),
            of(4, 5, 2),
            of(5, 2, 1),
            of(6, 5, 0),
            of(7, 3, 0),
        ];
        let image = lay_out(&mut devices).unwrap();
        let seen: Vec<_> =
            image.chunks.iter().map(|c| (c.every, c.logical, c.length, c.first, c.end)).collect();
        let most = u32::from(most);
        let expected = [
            (1, 0, 14, 1, 4),
            (2, 14, most as u16, 2, 3),
            (2, 14 + most, 1, 5, 6),
            (5, 15 + most, 6, 0, 7),
        ];
        assert_eq!(seen, expected);
        let logical = devices.each_ref().map(|device| device.inputs.logical);
        assert_eq!(logical[..6], [15 + most, 0, 14, 8, 19 + most, 14 + most]);
        let holders = |device: &SubDevice| image.chunks.iter().position(|c| c.holds(device));
        assert_eq!(devices.each_ref().map(holders)[..6].to_vec(), [3, 0, 1, 0, 3, 2].map(Some));
    }

    /// A chunk that is full to the last byte, and one byte more.
    #[test]
    fn no_subdevice_is_cut() {
        let most = MOST_CHUNK as u16;
        let mut devices = [device(0, most - 10, 0), device(1, 10, 10)];
        assert_eq!(lay_out(&mut devices).unwrap().chunks.len(), 1);
        let mut devices = [device(0, most - 10, 0), device(1, 11, 0)];
        let image = lay_out(&mut devices).unwrap();
        assert_eq!(image.chunks.len(), 2);
        assert_eq!((image.chunks[1].logical, image.chunks[1].first), (u32::from(most) - 10, 1));
        let mut devices = [device(0, most + 1, 0)];
        assert!(matches!(lay_out(&mut devices), Err(Cause::Mapping { .. })));
    }

    /// The first SyncManager has the bytes that the further ones leave.
    fn spread(length: u16, start: u16, further: &[(u8, u16, u16)]) -> ProcessData {
        let further = further.iter().map(|&(sync_manager, start, length)| Guarded {
            sync_manager,
            start,
            length,
            pdos: 0,
            window: false,
        });
        let further = further.collect();
        ProcessData {
            sync_manager: Some(0),
            start,
            length,
            logical: 100,
            further,
            ..Default::default()
        }
    }

    /// One byte between them makes two windows, and so does an area at a lower address.
    #[test]
    fn one_fmmu_maps_what_lies_behind_each_other() {
        let of = |data: &ProcessData| -> Vec<_> {
            spans(data).iter().map(|s| (s.logical, s.start, s.length)).collect()
        };
        assert_eq!(of(&spread(2, 0x0F00, &[(1, 0x0F01, 1)])), [(100, 0x0F00, 2)]);
        assert_eq!(of(&spread(2, 0x0F00, &[(1, 0x0F02, 1)])), [(100, 0x0F00, 1), (101, 0x0F02, 1)]);
        assert_eq!(of(&spread(6, 0x1200, &[(1, 0x1000, 3)])), [(100, 0x1200, 3), (103, 0x1000, 3)]);
        // A SyncManager that is off has no window and does not divide one.
        assert_eq!(of(&spread(2, 0x0F00, &[(1, 0x1000, 0), (2, 0x0F01, 1)])), [(100, 0x0F00, 2)]);
        assert_eq!(of(&ProcessData::default()), []);
    }

    /// By the SII: a window in front of a SyncManager, one behind, and each of the two alone.
    #[test]
    fn a_window_has_its_fmmu_and_no_sync_manager() {
        let record = |start: u16, enable, kind| {
            let [low, high] = start.to_le_bytes();
            SmRecord::parse(&[low, high, 0, 0, 0x20, 0, enable, kind])
        };
        let pdo = |sm, bits| SiiPdo {
            word: 0,
            record: PdoRecord {
                index: 0x1A00 + u16::from(sm),
                entries: 1,
                sm,
                sync_unit: 0,
                name: 0,
                flags: 0,
            },
            entries: alloc::vec![PdoEntryRecord { bits, ..PdoEntryRecord::parse(&[0; 8]) }],
        };
        let records = [
            record(0x0990, SmRecord::VIRTUAL, sm_type::INPUTS),
            record(0x1000, SmRecord::ENABLED, sm_type::INPUTS),
            // The type of a window need not be told.
            record(0x0910, SmRecord::VIRTUAL, sm_type::UNUSED),
            record(0x0981, SmRecord::VIRTUAL, sm_type::OUTPUTS),
        ];
        let of = |inputs: &[(u8, u8)]| {
            let mut device = device(0, 0, 0);
            device.sii.sync_managers = records.to_vec();
            device.sii.tx_pdos = inputs.iter().map(|(sm, bits)| pdo(*sm, *bits)).collect();
            // A window of outputs is left out, and there is no other SyncManager for it.
            device.sii.rx_pdos = alloc::vec![pdo(3, 8)];
            place_as_known(&mut device).unwrap();
            assert_eq!(device.outputs, ProcessData::default());
            device
        };
        type Fmmus = Vec<(u16, u16)>;
        let written = |device: &SubDevice| -> (Vec<u16>, Fmmus) {
            let writes = writes(device, WatchdogRegisters::default());
            let managers = writes.iter().filter(|(at, _)| *at >= 0x0800);
            let fmmus = writes.iter().filter(|(at, _)| *at < 0x0800);
            let word = |data: &[u8], at: usize| u16::from_le_bytes([data[at], data[at + 1]]);
            (
                managers.map(|(at, _)| *at).collect(),
                fmmus.map(|(_, data)| (word(data, 8), word(data, 4))).collect(),
            )
        };
        // Whole bytes for each, in the order of their numbers.
        let all = of(&[(2, 64), (0, 33), (1, 1)]);
        let expected = (alloc::vec![0x0808], alloc::vec![(0x0990, 5), (0x1000, 1), (0x0910, 8)]);
        assert_eq!((written(&all), all.inputs.length), (expected, 14));
        assert_eq!(all.inputs.exchanged(), Some((5, 1)));
        let alone = of(&[(2, 32)]);
        assert_eq!(written(&alone), (Vec::new(), alloc::vec![(0x0910, 4)]));
        assert_eq!((alone.inputs.sync_manager, alone.inputs.window), (Some(2), true));
        assert_eq!(alone.inputs.exchanged(), None);
        let without = of(&[(1, 1)]);
        assert_eq!(written(&without), (alloc::vec![0x0808], alloc::vec![(0x1000, 1)]));
        assert_eq!((without.inputs.window, without.inputs.exchanged()), (false, Some((0, 1))));

        let with_fmmus =
            |fmmus| SubDevice { esc: EscInformation { fmmus, ..all.esc }, ..all.clone() };
        assert!(enough_fmmus(&with_fmmus(3)).is_ok());
        let problem = MappingProblem::NoFmmu { needed: 3, found: 2 };
        let place = all.place();
        assert_eq!(enough_fmmus(&with_fmmus(2)), Err(Cause::Mapping { place, problem }));
    }

    #[test]
    fn each_sync_manager_is_written_and_any_of_them_feeds_the_watchdog() {
        let mut device = device(0, 0, 0);
        device.outputs = spread(6, 0x1000, &[(1, 0x1200, 2)]);
        let control = |first, second| {
            [first, second].map(|control| SmRecord::parse(&[0, 0, 0, 0, control, 0, 1, 0])).to_vec()
        };
        for (first, second, triggers) in
            [(0x64, 0x24, true), (0x24, 0x64, true), (0x24, 0x24, false)]
        {
            device.sii.sync_managers = control(first, second);
            assert_eq!(watchdog(&device, WatchdogRegisters::default()).is_some(), triggers);
            let written: Vec<_> = writes(&device, WatchdogRegisters::default());
            let sm = |start: u16, length: u8, control| {
                let [low, high] = start.to_le_bytes();
                [low, high, length, 0, control, 0, 1, 0].to_vec()
            };
            assert_eq!(written[0], (0x0800, sm(0x1000, 4, first)));
            assert_eq!(written[1], (0x0808, sm(0x1200, 2, second)));
            assert_eq!(
                written[2..].iter().map(|(at, _)| *at).collect::<Vec<_>>(),
                [0x0600, 0x0610]
            );
        }
    }
}
