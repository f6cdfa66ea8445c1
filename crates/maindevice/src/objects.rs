//! Reads a device's object dictionary: PDO assignment and mapping, and the sync objects.

use alloc::string::String;
use alloc::vec::Vec;

use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, SM_COMMUNICATION_TYPE,
    name, sub,
};
use isocat_wire::coe::info::EntryDescription;
use isocat_wire::sii::sm_type::{self, INPUTS, OUTPUTS};
use isocat_wire::sii::{PdoEntryRecord, SmRecord};
use isocat_wire::{AbortCode, ObjectAddress};

use crate::coe;
use crate::config::DeviceConfig;
use crate::error::{Cause, MappingProblem, SdoError};
use crate::mailbox::Mailbox;
use crate::segment::{
    Guarded, Pdo, PdoEntry, ProcessData, SiiPdo, SubDevice, SyncEntry, SyncObject,
};
use crate::service::{self, Service};

mod alike;

pub(crate) use alike::{Template, read_all};

/// CoE details bit of the SII: the device supports SDO information.
const SDO_INFORMATION: u8 = 1 << 1;

/// Writes the configured objects in PREOP, then reads assignment, mapping and sync objects. With a
/// template of its kind, sync objects are uploaded as a whole.
pub(crate) async fn read(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    config: Option<&DeviceConfig>,
    template: Option<&Template>,
) -> Result<(), Cause> {
    // Devices of its kind hold whole objects as they describe them.
    mailbox.whole_lists = template.is_some();
    for startup in config.map(|config| &config.startup[..]).unwrap_or(&[]) {
        coe::download(mailbox, startup.object, &startup.data, startup.complete)
            .await
            .map_err(|error| sdo(device, startup.object, error))?;
    }
    device.sm_types = match sm_types(mailbox, device).await {
        Ok(types) => types,
        Err(cause) => {
            device.do_without(Service::SyncManagerTypes, cause)?;
            Vec::new()
        }
    };
    let outputs = config.and_then(|config| config.outputs.as_deref());
    process_data(mailbox, device, OUTPUTS, outputs).await?;
    let inputs = config.and_then(|config| config.inputs.as_deref());
    process_data(mailbox, device, INPUTS, inputs).await?;
    if let Some(template) = template
        && alike::read_as(mailbox, device, template).await?
    {
        return Ok(());
    }
    device.output_sync = sync_object(mailbox, device, OUTPUT_PARAMETER).await?;
    device.input_sync = sync_object(mailbox, device, INPUT_PARAMETER).await?;
    Ok(())
}

/// Reads the same without writing anything, continues after errors, and returns them. A substitute
/// of the bring-up counts as an error here.
pub(crate) async fn look(mailbox: &mut Mailbox, device: &mut SubDevice) -> Vec<Cause> {
    let mut problems = Vec::new();
    let mut failed = |cause| problems.push(cause);
    device.sm_types = sm_types(mailbox, device).await.unwrap_or_else(|cause| {
        failed(cause);
        Vec::new()
    });
    for kind in [OUTPUTS, INPUTS] {
        if let Err(cause) = process_data(mailbox, device, kind, None).await {
            failed(cause);
        }
    }
    for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
        let object = sync_object(mailbox, device, index).await.unwrap_or_else(|cause| {
            failed(cause);
            None
        });
        match index {
            OUTPUT_PARAMETER => device.output_sync = object,
            _ => device.input_sync = object,
        }
    }
    problems.extend(device.take_substitutes());
    problems
}

/// Takes assignment and mapping from the SII, for a device without CoE.
pub(crate) fn from_sii(device: &mut SubDevice) {
    spread_by_sii(&mut device.outputs, &device.sii.rx_pdos, &device.sii.sync_managers, OUTPUTS);
    spread_by_sii(&mut device.inputs, &device.sii.tx_pdos, &device.sii.sync_managers, INPUTS);
}

/// Takes the PDOs of one direction from the SII. If they are in several SyncManagers of that
/// direction, each SyncManager has a part of the process image, in the order of their numbers.
fn spread_by_sii(data: &mut ProcessData, pdos: &[SiiPdo], records: &[SmRecord], kind: u8) {
    data.further.clear();
    data.window = false;
    data.pdos = assigned_by_sii(pdos, records);
    let record = |sm: u8| records.get(usize::from(sm));
    let is_window = |sm: u8| record(sm).is_some_and(SmRecord::is_window);
    let of_kind = |sm: u8| record(sm).is_some_and(|record| record.kind == kind);
    let mut named: Vec<u8> = pdos.iter().map(|pdo| pdo.record.sm).collect();
    named.retain(|sm| *sm != NO_SYNC_MANAGER && (kind == INPUTS || !is_window(*sm)));
    named.sort_by_cached_key(|sm| u64::from(*sm));
    named.dedup();
    let windows = named.iter().any(|sm| is_window(*sm));
    if named.len() < 2 && !windows || !named.iter().all(|sm| is_window(*sm) || of_kind(*sm)) {
        return;
    }
    data.pdos.clear();
    for (place, sm) in named.into_iter().enumerate() {
        let of_sm = pdos.iter().filter(|pdo| pdo.record.sm == sm).map(pdo_of_sii);
        let first = data.pdos.len();
        data.pdos.extend(of_sm);
        let assigned = &data.pdos[first..];
        let bits: u32 = assigned.iter().map(Pdo::bits).sum();
        let part = Guarded {
            sync_manager: sm,
            start: records[usize::from(sm)].start,
            length: u16::try_from(bits.div_ceil(8)).unwrap_or(u16::MAX),
            pdos: assigned.len(),
            window: is_window(sm),
        };
        match place {
            0 => (data.sync_manager, data.window) = (Some(sm), part.window),
            _ => data.further.push(part),
        }
    }
}

/// The PDOs that a SyncManager has by default, without those in windows.
fn assigned_by_sii(pdos: &[SiiPdo], records: &[SmRecord]) -> Vec<Pdo> {
    let assigned = |pdo: &&SiiPdo| match pdo.record.sm {
        NO_SYNC_MANAGER => false,
        sm => !records.get(usize::from(sm)).is_some_and(SmRecord::is_window),
    };
    pdos.iter().filter(assigned).map(pdo_of_sii).collect()
}

fn pdo_of_sii(pdo: &SiiPdo) -> Pdo {
    let entry =
        |entry: &PdoEntryRecord| PdoEntry { index: entry.index, sub: entry.sub, bits: entry.bits };
    Pdo { index: pdo.record.index, entries: pdo.entries.iter().map(entry).collect() }
}

/// Reads object 0x1C00; empty if the device has none, so that the SII decides.
async fn sm_types(mailbox: &mut Mailbox, device: &SubDevice) -> Result<Vec<u8>, Cause> {
    if let Some(types) = list::<1>(mailbox, SM_COMMUNICATION_TYPE).await {
        let most = usize::from(MOST_SYNC_MANAGERS);
        return Ok(types.into_iter().take(most).map(|[kind]| kind).collect());
    }
    let count = match number(mailbox, device, SM_COMMUNICATION_TYPE, 0).await? {
        Some(count) => count as u8,
        None => return Ok(Vec::new()),
    };
    let mut types = Vec::new();
    for sub in 1..=count.min(MOST_SYNC_MANAGERS) {
        let kind = number(mailbox, device, SM_COMMUNICATION_TYPE, sub).await?;
        types.push(kind.map_or(sm_type::UNUSED, |kind| kind as u8));
    }
    Ok(types)
}

/// Reads the PDOs of a direction, after writing the configured assignment of its first SyncManager.
/// Further SyncManagers of the direction have assignments of their own, which are taken as they
/// are; those without PDOs stay off.
async fn process_data(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    kind: u8,
    wanted: Option<&[u16]>,
) -> Result<(), Cause> {
    let data = if kind == OUTPUTS { &mut device.outputs } else { &mut device.inputs };
    (data.pdos, data.further) = (Vec::new(), Vec::new());
    let (first, behind) = sync_managers(device, kind);
    let index = if kind == OUTPUTS { OUTPUT_ASSIGNMENT } else { INPUT_ASSIGNMENT };
    let is_first = |sm: u8| !behind.contains(&sm);
    let mut all = pdos(mailbox, device, index, kind, is_first, wanted).await?;
    let mut further = Vec::new();
    for sync_manager in behind.iter().copied() {
        let index = FIRST_ASSIGNMENT + u16::from(sync_manager);
        let is_own = |sm: u8| sm == sync_manager;
        let own = pdos(mailbox, device, index, kind, is_own, None).await?;
        let bits: u32 = own.iter().map(Pdo::bits).sum();
        if bits > 0 {
            further.push(Guarded {
                sync_manager,
                start: device.sii.sync_managers[usize::from(sync_manager)].start,
                length: u16::try_from(bits.div_ceil(8)).unwrap_or(u16::MAX),
                pdos: own.len(),
                window: false,
            });
            all.extend(own);
        }
    }
    let data = if kind == OUTPUTS { &mut device.outputs } else { &mut device.inputs };
    if !further.is_empty() {
        data.sync_manager = first;
    }
    (data.pdos, data.further) = (all, further);
    Ok(())
}

/// The first SyncManager of a direction by 0x1C00, and those behind it that can be used: the SII
/// says where they are, and their assignment is not that of the other direction.
fn sync_managers(device: &SubDevice, kind: u8) -> (Option<u8>, Vec<u8>) {
    let of_kind = (0..).zip(&device.sm_types).filter(|(_, found)| **found == kind);
    let mut numbers = of_kind.map(|(number, _): (u8, _)| number);
    let first = numbers.next();
    let usable = |number: &u8| {
        let record = device.sii.sync_managers.get(usize::from(*number));
        let index = FIRST_ASSIGNMENT + u16::from(*number);
        record.is_some_and(|record| !record.is_window())
            && ![OUTPUT_ASSIGNMENT, INPUT_ASSIGNMENT].contains(&index)
    };
    (first, numbers.filter(usable).collect())
}

/// Reads the PDOs of an assignment with their mappings, after writing the configured one. Missing
/// information is taken from the SII, if the SII has it: the PDOs of the SyncManagers that `is_own`
/// names.
async fn pdos(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    index: u16,
    kind: u8,
    is_own: impl Fn(u8) -> bool + Send + Sync,
    wanted: Option<&[u16]>,
) -> Result<Vec<Pdo>, Cause> {
    let of_sii = |device: &SubDevice| {
        let all = if kind == OUTPUTS { &device.sii.rx_pdos } else { &device.sii.tx_pdos };
        let own = |pdo: &&SiiPdo| pdo.record.sm == NO_SYNC_MANAGER || is_own(pdo.record.sm);
        all.iter().filter(own).cloned().collect::<Vec<_>>()
    };
    let mut assigned = match assignment(mailbox, device, index).await {
        Ok(assigned) => assigned,
        // A SII without any PDO has no information about this direction either. An abort may mean
        // that there is no object.
        Err(cause) if device.sii.rx_pdos.is_empty() && device.sii.tx_pdos.is_empty() => {
            if !is_abort(&cause) {
                return Err(cause);
            }
            None
        }
        Err(cause) => {
            device.do_without(Service::Assignment, cause)?;
            let by_sii = assigned_by_sii(&of_sii(device), &device.sii.sync_managers);
            let indices = by_sii.iter().map(|pdo| pdo.index);
            // The assignment of the SII need not be written to an object that does not answer.
            if wanted.is_none_or(|wanted| indices.eq(wanted.iter().copied())) {
                return Ok(by_sii);
            }
            None
        }
    };
    if let Some(wanted) = wanted.filter(|wanted| assigned.as_deref() != Some(wanted)) {
        match assign(mailbox, index, wanted).await {
            Ok(()) => assigned = Some(wanted.to_vec()),
            Err((_, SdoError::Abort(AbortCode::READ_ONLY))) => {
                let problem = MappingProblem::Fixed { index };
                return Err(Cause::Mapping { place: device.place(), problem });
            }
            Err((object, error)) => return Err(sdo(device, object, error)),
        }
    }
    let Some(assigned) = assigned else {
        return Ok(assigned_by_sii(&of_sii(device), &device.sii.sync_managers));
    };
    let mut pdos = Vec::new();
    // An assignment may contain 0 for an empty place.
    for pdo in assigned.into_iter().filter(|pdo| *pdo != 0) {
        let cause = match mapping(mailbox, device, pdo).await {
            Ok(pdo) => {
                pdos.push(pdo);
                continue;
            }
            Err(cause) => cause,
        };
        let known = of_sii(device).into_iter().find(|known| known.record.index == pdo);
        let Some(known) = known else { return Err(cause) };
        device.do_without(Service::Mapping, cause)?;
        pdos.push(pdo_of_sii(&known));
    }
    Ok(pdos)
}

/// Reads the indices in an assignment; `None` if there is no such object, so that the SII has
/// the fixed assignment.
async fn assignment(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    index: u16,
) -> Result<Option<Vec<u16>>, Cause> {
    if let Some(assigned) = list(mailbox, index).await {
        return Ok(Some(assigned.into_iter().map(u16::from_le_bytes).collect()));
    }
    let object = ObjectAddress::new(index, 0);
    let count = match coe::upload(mailbox, object, false).await.and_then(|bytes| number_of(&bytes))
    {
        Ok(count) => count,
        Err(SdoError::Abort(AbortCode::NO_OBJECT)) => return Ok(None),
        Err(error) => return Err(sdo(device, object, error)),
    };
    let mut assigned = Vec::new();
    for sub in 1..=count.min(254) as u8 {
        let object = ObjectAddress::new(index, sub);
        assigned.push(required(mailbox, device, object).await? as u16);
    }
    Ok(Some(assigned))
}

/// Writes an assignment.
async fn assign(
    mailbox: &mut Mailbox,
    index: u16,
    pdos: &[u16],
) -> Result<(), (ObjectAddress, SdoError)> {
    for (object, data) in assignment_writes(index, pdos) {
        let written = coe::download(mailbox, object, &data, false).await;
        written.map_err(|error| (object, error))?;
    }
    Ok(())
}

/// The writes of an assignment: count 0, the entries, the count.
pub(crate) fn assignment_writes(index: u16, pdos: &[u16]) -> Vec<(ObjectAddress, Vec<u8>)> {
    let count = |count: usize| (ObjectAddress::new(index, 0), alloc::vec![count as u8]);
    let entry =
        |(sub, pdo): (u8, &u16)| (ObjectAddress::new(index, sub), pdo.to_le_bytes().to_vec());
    let entries = (1..=u8::MAX).zip(pdos).map(entry);
    core::iter::once(count(0)).chain(entries).chain([count(pdos.len())]).collect()
}

/// Reads one PDO's entries.
async fn mapping(mailbox: &mut Mailbox, device: &SubDevice, index: u16) -> Result<Pdo, Cause> {
    let entry = |value: u32| PdoEntry {
        index: (value >> 16) as u16,
        sub: (value >> 8) as u8,
        bits: value as u8,
    };
    if let Some(values) = list(mailbox, index).await {
        let entries = values.into_iter().map(|value| entry(u32::from_le_bytes(value))).collect();
        return Ok(Pdo { index, entries });
    }
    let count = required(mailbox, device, ObjectAddress::new(index, 0)).await?;
    let mut entries = Vec::new();
    for sub in 1..=count.min(254) as u8 {
        entries.push(entry(required(mailbox, device, ObjectAddress::new(index, sub)).await?));
    }
    Ok(Pdo { index, entries })
}

/// Uploads a list of equal elements as a whole object. `None` if that is not wanted, if the device
/// refuses it, or if its length is not that of as many elements as it counts.
async fn list<const N: usize>(mailbox: &mut Mailbox, index: u16) -> Option<Vec<[u8; N]>> {
    if !mailbox.whole_lists {
        return None;
    }
    // An error comes again when the list is read element by element.
    let bytes = coe::upload(mailbox, ObjectAddress::new(index, 0), true).await.ok()?;
    let (head, elements) = bytes.split_first_chunk::<2>()?;
    let (elements, rest) = elements.as_chunks::<N>();
    let fits = rest.is_empty() && elements.len() == usize::from(head[0]);
    fits.then(|| elements.to_vec())
}

/// Reads 0x1C32 or 0x1C33 entry by entry: all entries that the device's description lists. Without
/// SDO information, it tries all sub-indices of ETG.1020.
async fn sync_object(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    index: u16,
) -> Result<Option<SyncObject>, Cause> {
    let mut object = SyncObject::default();
    let offered = device.sii.coe_details & SDO_INFORMATION != 0;
    if offered && !device.does_without(Service::SdoInformation) {
        match coe::object_description(mailbox, index).await {
            Ok(description) => object.description = Some(description),
            Err(SdoError::Abort(AbortCode::NO_OBJECT)) => return Ok(None),
            Err(error) if is_refusal(&error) => {}
            Err(error) => {
                let cause = sdo(device, ObjectAddress::new(index, 0), error);
                device.do_without(Service::SdoInformation, cause)?;
            }
        }
    }
    let described = object.description.as_ref().map(|(description, _)| description.max_sub);
    let mut describes = described.is_some();
    let highest = described.map_or(HIGHEST_KNOWN, |max| max.max(HIGHEST_KNOWN));
    for sub in 0..=highest {
        let address = ObjectAddress::new(index, sub);
        let mut description = None;
        if describes {
            match describe_entry(mailbox, device, address).await {
                Ok(None) => continue,
                Ok(found) => description = found,
                Err(cause) => {
                    device.do_without(Service::SdoInformation, cause)?;
                    describes = false;
                }
            }
        }
        if !describes && sub != 0 && name(sub).is_none() {
            continue;
        }
        let value = match coe::upload(mailbox, address, false).await {
            Ok(value) => Ok(value),
            Err(SdoError::Abort(AbortCode::NO_OBJECT)) if sub == 0 => return Ok(None),
            Err(SdoError::Abort(code)) => Err(code),
            Err(error) => {
                let cause = sdo(device, address, error);
                let silent = service::is_silence(&cause);
                device.do_without(Service::SyncEntry, cause)?;
                // The remaining entries would each cost the same timeout.
                if silent {
                    break;
                }
                continue;
            }
        };
        if description.is_none() && value.is_err() {
            continue;
        }
        let entry = SyncEntry { sub, description, value };
        if let Some(number) = entry.number() {
            object.values.set(sub, number);
        }
        object.entries.push(entry);
    }
    // No entry was answered, so the object counts as missing.
    let missing = object.entries.is_empty() && device.does_without(Service::SyncEntry);
    Ok((!missing).then_some(object))
}

/// Reads the error counters of the sync objects again, as evidence when a device refuses OP. A
/// counter that cannot be read keeps its last value, since the refusal is the error to report.
pub(crate) async fn refresh_counters(mailbox: &mut Mailbox, device: &mut SubDevice) {
    for (index, object) in
        [(OUTPUT_PARAMETER, &mut device.output_sync), (INPUT_PARAMETER, &mut device.input_sync)]
    {
        let Some(object) = object else { continue };
        for entry in object.entries.iter_mut().filter(|entry| COUNTERS.contains(&entry.sub)) {
            let address = ObjectAddress::new(index, entry.sub);
            let Ok(value) = coe::upload(mailbox, address, false).await else { continue };
            entry.value = Ok(value);
            if let Some(number) = entry.number() {
                object.values.set(entry.sub, number);
            }
        }
    }
}

/// Reads the description of an entry; `None` if it does not exist or is a gap.
async fn describe_entry(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    object: ObjectAddress,
) -> Result<Option<(EntryDescription, String)>, Cause> {
    match coe::entry_description(mailbox, object).await {
        Ok((description, _)) if description.bits == 0 || description.data_type == 0 => Ok(None),
        Ok(found) => Ok(Some(found)),
        Err(error) if is_refusal(&error) => Ok(None),
        Err(error) => Err(sdo(device, object, error)),
    }
}

/// Reads a value of up to 4 bytes; `None` if the device does not have it.
pub(crate) async fn number(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    index: u16,
    sub: u8,
) -> Result<Option<u32>, Cause> {
    let object = ObjectAddress::new(index, sub);
    match coe::upload(mailbox, object, false).await {
        Ok(bytes) => Ok(Some(number_of(&bytes).map_err(|error| sdo(device, object, error))?)),
        Err(SdoError::Abort(_)) => Ok(None),
        Err(error) => Err(sdo(device, object, error)),
    }
}

/// Reads a required value of up to 4 bytes.
async fn required(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    object: ObjectAddress,
) -> Result<u32, Cause> {
    let value = coe::upload(mailbox, object, false).await.and_then(|bytes| number_of(&bytes));
    value.map_err(|error| sdo(device, object, error))
}

fn number_of(bytes: &[u8]) -> Result<u32, SdoError> {
    if bytes.is_empty() || bytes.len() > 4 {
        return Err(SdoError::Length { expected: 4, found: bytes.len() });
    }
    Ok(bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte)))
}

fn is_abort(cause: &Cause) -> bool {
    matches!(cause, Cause::Sdo { error: SdoError::Abort(_), .. })
}

/// Whether the device answered with a refusal.
fn is_refusal(error: &SdoError) -> bool {
    use crate::error::MailboxError::Error;
    matches!(error, SdoError::Abort(_) | SdoError::Mailbox(Error(_)))
}

pub(crate) fn sdo(device: &SubDevice, object: ObjectAddress, error: SdoError) -> Cause {
    Cause::Sdo { place: device.place(), object, error }
}

/// The error counters of the sync objects, and the sync error flag.
const COUNTERS: [u8; 4] =
    [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT, sub::SYNC_ERROR];
/// Assignment object of SM0; that of SM n is n behind it.
const FIRST_ASSIGNMENT: u16 = 0x1C10;
/// SyncManager number of a PDO that is not assigned by default.
const NO_SYNC_MANAGER: u8 = 0xFF;
/// Most SyncManagers of an ESC.
const MOST_SYNC_MANAGERS: u8 = 16;
/// Highest sub-index of the sync objects in ETG.1020. Some devices state a lower one but have it.
const HIGHEST_KNOWN: u8 = 0x20;

#[cfg(test)]
mod tests {
    use alloc::vec;

    use isocat_wire::StationAddress;

    use super::*;

    /// SyncManagers of a kind by 0x1C00, in an SII of `records` records, one of which is a window.
    #[test]
    fn sync_managers_of_a_direction() {
        let plain = SmRecord { start: 0, length: 0, control: 0, status: 0, enable: 0, kind: 0 };
        let found = |types: &[u8], records: usize| {
            let mut device = SubDevice::new(0, StationAddress(0x1001));
            device.sm_types = types.to_vec();
            device.sii.sync_managers = vec![plain; records];
            if let Some(record) = device.sii.sync_managers.get_mut(5) {
                record.enable = SmRecord::VIRTUAL;
            }
            (sync_managers(&device, OUTPUTS), sync_managers(&device, INPUTS))
        };
        let usual = [1, 2, 3, 4];
        assert_eq!(found(&usual, 4), ((Some(2), vec![]), (Some(3), vec![])));
        let several = [1, 2, 3, 4, 3, 4, 4];
        // SM5 is a window, and SM6 is in no record of the shorter SII.
        assert_eq!(found(&several, 7), ((Some(2), vec![4]), (Some(3), vec![6])));
        assert_eq!(found(&several, 6), ((Some(2), vec![4]), (Some(3), vec![])));
        // 0x1C13 is the assignment of the inputs, whatever SM3 is.
        assert_eq!(found(&[1, 2, 3, 3, 4], 5), ((Some(2), vec![]), (Some(4), vec![])));
        assert_eq!(found(&[], 4), ((None, vec![]), (None, vec![])));
    }
}
