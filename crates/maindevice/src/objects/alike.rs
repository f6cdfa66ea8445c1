//! Devices of one kind: what their sync objects consist of is learned from two of them.
//!
//! A kind is the devices of one vendor, product and revision with equal CoE details. The first two
//! are asked for everything: each description, each entry by itself, and the whole object at once.
//! If both describe their objects alike, and the whole object held what the single entries held,
//! the others take over the descriptions and upload each object at once. Values always come from
//! the device itself. One in [`ONE_IN`] of these devices is asked for everything all the same. So
//! is a device whose whole object is refused, has another length, or states other times than the
//! first.

use alloc::boxed::Box;
use alloc::vec::Vec;

use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::ObjectAddress;

use crate::bring_up::{self, Work};
use crate::coe;
use crate::config::DeviceConfig;
use crate::error::{Cause, SdoError};
use crate::left_out::{self, Failures};
use crate::link::Procedure;
use crate::mailbox::Mailbox;
use crate::mapping;
use crate::segment::{SubDevice, SyncEntry, SyncObject};

/// CoE details bit of the SII: the device supports complete access.
const COMPLETE_ACCESS: u8 = 1 << 5;
/// Of this number of devices of a kind, one is asked for everything.
const ONE_IN: usize = 16;
/// Devices of a kind that are asked for everything first.
const WITNESSES: usize = 2;
/// Entries that are equal in all devices of a kind.
const CONSTANT: [u8; 5] = [
    sub::SUPPORTED_TYPES,
    sub::MINIMUM_CYCLE_TIME,
    sub::CALC_AND_COPY_TIME,
    sub::MINIMUM_DELAY_TIME,
    sub::DELAY_TIME,
];

/// What the sync objects of a kind consist of: outputs, inputs. `None`: it has no such object.
pub(crate) type Template = [Option<Layout>; 2];

/// The sync object of a witness, and how the whole of it is uploaded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Layout {
    object: SyncObject,
    /// By entry; `None`: it is uploaded by itself.
    places: Vec<Option<Place>>,
    /// Bytes of the whole object.
    len: usize,
}

/// Where an entry is in the whole object, in bits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Place {
    first: usize,
    bits: usize,
}

/// Reads the objects of all SubDevices that take part.
pub(crate) async fn read_all(work: &mut Work) -> Result<Failures, Cause> {
    let Work { segment, mailboxes, config, .. } = work;
    let config = &**config;
    let kinds = if config.share_objects { kinds(&segment.devices) } else { Vec::new() };
    let mut followers = alloc::vec![None; segment.devices.len()];
    for (number, kind) in kinds.iter().enumerate() {
        let others = kind.iter().enumerate().skip(WITNESSES);
        let shares = others.filter(|(place, _)| place % ONE_IN != 0);
        shares.for_each(|(_, position)| followers[*position] = Some(number));
    }
    // Filled by position: a procedure has its own place.
    let mut learned: Vec<Option<Template>> = alloc::vec![None; segment.devices.len()];
    let is_witness = |position: usize| {
        let witnesses = |kind: &Vec<usize>| kind[..WITNESSES].contains(&position);
        kinds.iter().any(|kind| kind.len() > WITNESSES && witnesses(kind))
    };
    let (mut positions, mut all) = (Vec::new(), Vec::new());
    for ((device, mailbox), learned) in
        segment.devices.iter_mut().zip(&mut *mailboxes).zip(&mut learned)
    {
        if !device.admitted || followers[device.position].is_some() {
            continue;
        }
        positions.push(device.position);
        let (wish, witness) = (config.devices.get(device.position), is_witness(device.position));
        let read: Procedure<'_, Result<(), Cause>> = Box::pin(async move {
            let mut mailbox = mailbox.as_mut();
            of_device(mailbox.as_deref_mut(), device, wish, None).await?;
            if let Some(mailbox) = mailbox.filter(|_| witness) {
                *learned = layouts(mailbox, device).await?;
            }
            Ok(())
        });
        all.push(read);
    }
    let mut failures = left_out::each_of(config, positions, all).await?;

    let templates: Vec<Option<Template>> =
        kinds.iter().map(|kind| agreed(&learned, kind)).collect();
    let (mut positions, mut all) = (Vec::new(), Vec::new());
    for (device, mailbox) in segment.devices.iter_mut().zip(mailboxes) {
        let Some(kind) = followers[device.position].filter(|_| device.admitted) else { continue };
        positions.push(device.position);
        let (wish, template) = (config.devices.get(device.position), templates[kind].as_ref());
        let read: Procedure<'_, Result<(), Cause>> =
            Box::pin(of_device(mailbox.as_mut(), device, wish, template));
        all.push(read);
    }
    failures.extend(left_out::each_of(config, positions, all).await?);
    Ok(failures)
}

async fn of_device(
    mailbox: Option<&mut Mailbox>,
    device: &mut SubDevice,
    wish: Option<&DeviceConfig>,
    template: Option<&Template>,
) -> Result<(), Cause> {
    bring_up::read_objects(mailbox, device, wish, template).await?;
    mapping::place_process_data(device)
}

/// Positions of the devices of each kind, ascending; only kinds that support complete access.
fn kinds(devices: &[SubDevice]) -> Vec<Vec<usize>> {
    let mut kinds: Vec<Vec<usize>> = Vec::new();
    for device in devices.iter().filter(|device| device.admitted && device.has_coe()) {
        let whole = device.sii.coe_details & COMPLETE_ACCESS != 0;
        if !whole || device.identity.product == 0 {
            continue;
        }
        let of = |device: &SubDevice| {
            let identity = device.identity;
            (identity.vendor, identity.product, identity.revision, device.sii.coe_details)
        };
        match kinds.iter_mut().find(|kind| of(&devices[kind[0]]) == of(device)) {
            Some(kind) => kind.push(device.position),
            None => kinds.push(Vec::from([device.position])),
        }
    }
    kinds.retain(|kind| kind.len() > WITNESSES);
    kinds
}

/// What the witnesses of a kind agree about; `None`: the others are asked for everything.
fn agreed(learned: &[Option<Template>], kind: &[usize]) -> Option<Template> {
    let first = learned[kind[0]].as_ref()?;
    let second = learned[kind[1]].as_ref()?;
    let shape = |template: &Template| template.clone().map(|layout| layout.map(Layout::shape));
    (shape(first) == shape(second)).then(|| first.clone())
}

impl Layout {
    /// The object without the values that differ between devices of a kind.
    fn shape(mut self) -> Self {
        self.object.values = Default::default();
        for entry in &mut self.object.entries {
            if !CONSTANT.contains(&entry.sub) && entry.value.is_ok() {
                entry.value = Ok(Vec::new());
            }
        }
        self
    }
}

/// Uploads the whole sync objects of a device whose entries were read; `None` if these do not tell
/// where each entry is, or hold something else.
async fn layouts(mailbox: &mut Mailbox, device: &SubDevice) -> Result<Option<Template>, Cause> {
    if !device.substitutes.is_empty() {
        return Ok(None);
    }
    let mut all = [None, None];
    for (place, (index, object)) in objects(device).into_iter().enumerate() {
        let Some(object) = object else { continue };
        let Some(places) = places(object) else { return Ok(None) };
        let Some(bytes) = whole(mailbox, device, index).await? else { return Ok(None) };
        let layout = Layout { object: object.clone(), places, len: bytes.len() };
        let holds = |(entry, place): (&SyncEntry, &Option<Place>)| match (&entry.value, place) {
            (Ok(value), Some(place)) => part(&bytes, *place).as_ref() == Some(value),
            _ => true,
        };
        if !object.entries.iter().zip(&layout.places).all(holds) {
            return Ok(None);
        }
        all[place] = Some(layout);
    }
    Ok(Some(all))
}

fn objects(device: &SubDevice) -> [(u16, Option<&SyncObject>); 2] {
    [(OUTPUT_PARAMETER, device.output_sync.as_ref()), (INPUT_PARAMETER, device.input_sync.as_ref())]
}

/// Where the entries are by their descriptions: sub-index 0 takes 16 bits, all others follow each
/// other. Entries behind a gap have no place, since the length of gaps is not asked for. `None`
/// without descriptions.
fn places(object: &SyncObject) -> Option<Vec<Option<Place>>> {
    let (mut next, mut expected) = (16, Some(0));
    let place = |entry: &SyncEntry| {
        let (description, _) = entry.description.as_ref()?;
        let bits = usize::from(description.bits);
        expected = expected.filter(|sub| *sub == entry.sub).and_then(|sub: u8| sub.checked_add(1));
        let first = if entry.sub == 0 { 0 } else { next };
        next += if entry.sub == 0 { 0 } else { bits };
        Some(expected.map(|_| Place { first, bits }))
    };
    object.entries.iter().map(place).collect()
}

/// The bytes of an entry in the whole object; `None` if it is not whole bytes in it.
fn part(whole: &[u8], Place { first, bits }: Place) -> Option<Vec<u8>> {
    if first % 8 != 0 || bits % 8 != 0 {
        return None;
    }
    whole.get(first / 8..(first + bits) / 8).map(<[u8]>::to_vec)
}

/// Uploads a whole object; `None`: the device refuses it.
async fn whole(
    mailbox: &mut Mailbox,
    device: &SubDevice,
    index: u16,
) -> Result<Option<Vec<u8>>, Cause> {
    let object = ObjectAddress::new(index, 0);
    match coe::upload(mailbox, object, true).await {
        Ok(bytes) => Ok(Some(bytes)),
        Err(SdoError::Mailbox(error)) => Err(super::sdo(device, object, SdoError::Mailbox(error))),
        Err(_) => Ok(None),
    }
}

/// Reads both sync objects as the kind has them; `false` if this device has them otherwise.
pub(super) async fn read_as(
    mailbox: &mut Mailbox,
    device: &mut SubDevice,
    template: &Template,
) -> Result<bool, Cause> {
    let mut all = [None, None];
    for (place, layout) in template.iter().enumerate() {
        let Some(layout) = layout else { continue };
        let index = [OUTPUT_PARAMETER, INPUT_PARAMETER][place];
        let Some(bytes) = whole(mailbox, device, index).await? else { return Ok(false) };
        if bytes.len() != layout.len {
            return Ok(false);
        }
        let description = layout.object.description.clone();
        let mut object = SyncObject { description, ..SyncObject::default() };
        for (entry, place) in layout.object.entries.iter().zip(&layout.places) {
            let mut own = entry.clone();
            own.value = match place.filter(|_| entry.value.is_ok()) {
                Some(place) => match part(&bytes, place) {
                    Some(value) => Ok(value),
                    None => return Ok(false),
                },
                None => match coe::upload(mailbox, ObjectAddress::new(index, own.sub), false).await
                {
                    Ok(value) => Ok(value),
                    Err(SdoError::Abort(code)) => Err(code),
                    Err(_) => return Ok(false),
                },
            };
            if CONSTANT.contains(&own.sub) && own.value != entry.value {
                return Ok(false);
            }
            if let Some(number) = own.number() {
                object.values.set(own.sub, number);
            }
            object.entries.push(own);
        }
        all[place] = Some(object);
    }
    [device.output_sync, device.input_sync] = all;
    Ok(true)
}

#[cfg(test)]
mod tests {
    use alloc::string::String;
    use alloc::vec;

    use isocat_wire::coe::AbortCode;
    use isocat_wire::coe::info::{Access, EntryDescription};

    use super::*;
    use crate::segment::{Identity, station_of};

    /// An entry of a sync object, with a description of `bits`; the access does not matter here.
    fn entry(sub: u8, bits: u16, value: &[u8]) -> SyncEntry {
        let access = Access(0x07);
        let (index, value_info, data_type) = (OUTPUT_PARAMETER, 0, 6);
        let description = EntryDescription { index, sub, value_info, data_type, bits, access };
        SyncEntry {
            sub,
            description: Some((description, String::new())),
            value: Ok(value.to_vec()),
        }
    }

    fn object(entries: &[SyncEntry]) -> SyncObject {
        SyncObject { entries: entries.to_vec(), ..SyncObject::default() }
    }

    fn template(entries: &[SyncEntry]) -> Option<Template> {
        let object = object(entries);
        let places = places(&object).unwrap();
        Some([Some(Layout { object, places, len: 8 }), None])
    }

    fn device(position: usize, revision: u32, coe_details: u8) -> SubDevice {
        let mut device = SubDevice::new(position, station_of(position));
        device.admitted = true;
        device.identity = Identity { vendor: 7, product: 1, revision, serial: position as u32 };
        let header = &mut device.sii.header;
        header.protocols = isocat_wire::sii::Header::COE;
        (header.receive.length, header.send.length) = (128, 128);
        device.sii.coe_details = coe_details;
        device
    }

    /// Three devices make a kind, two do not: no third one would share what they tell. The serial
    /// number does not matter, the revision does.
    #[test]
    fn kinds_are_equal_devices_with_complete_access() {
        let all = COMPLETE_ACCESS;
        let mut devices: Vec<_> = (0..3).map(|position| device(position, 1, all)).collect();
        devices.extend([device(3, 2, all), device(4, 2, all), device(5, 1, 0), device(6, 1, all)]);
        assert_eq!(kinds(&devices), [[0, 1, 2, 6]]);
        devices[1].admitted = false;
        assert_eq!(kinds(&devices), [[0, 2, 6]]);
        devices[2].identity.product = 0;
        assert!(kinds(&devices).is_empty());
    }

    /// Sub-index 0 takes 16 bits of the whole object. Behind a gap nothing has a place.
    #[test]
    fn places_end_at_a_gap() {
        let entries = [entry(0, 8, &[9]), entry(1, 16, &[2, 0]), entry(2, 32, &[0; 4])];
        let place = |first, bits| Some(Place { first, bits });
        assert_eq!(
            places(&object(&entries)),
            Some(vec![place(0, 8), place(16, 16), place(32, 32)])
        );
        let gap = [entry(0, 8, &[9]), entry(1, 16, &[2, 0]), entry(4, 16, &[1, 0])];
        assert_eq!(places(&object(&gap)), Some(vec![place(0, 8), place(16, 16), None]));
        let mut unknown = entries;
        unknown[1].description = None;
        assert_eq!(places(&object(&unknown)), None);
    }

    #[test]
    fn parts_are_whole_bytes_within_the_object() {
        let bytes = [1, 2, 3, 4];
        let part = |first, bits| super::part(&bytes, Place { first, bits });
        assert_eq!([part(0, 8), part(16, 16)], [Some(vec![1]), Some(vec![3, 4])]);
        assert_eq!([part(4, 8), part(0, 4), part(24, 16)], [None, None, None]);
    }

    /// Witnesses may differ in what belongs to a device, such as a counter or the cycle, but not in
    /// times that the firmware states, in what is readable, or in how entries are described.
    #[test]
    fn witnesses_agree_about_what_a_kind_shares() {
        let least = |value: &[u8]| entry(sub::MINIMUM_CYCLE_TIME, 32, value);
        let cycle = |value: &[u8]| entry(sub::CYCLE_TIME, 32, value);
        let first = template(&[cycle(&[1, 0, 0, 0]), least(&[5, 0, 0, 0])]);
        let agrees = |second: Option<Template>| agreed(&[first.clone(), second], &[0, 1]) == first;
        assert!(agrees(first.clone()));
        assert!(agrees(template(&[cycle(&[2, 0, 0, 0]), least(&[5, 0, 0, 0])])));
        assert!(!agrees(template(&[cycle(&[1, 0, 0, 0]), least(&[6, 0, 0, 0])])));
        assert!(!agrees(template(&[entry(sub::CYCLE_TIME, 16, &[1, 0]), least(&[5, 0, 0, 0])])));
        let mut refused = cycle(&[]);
        refused.value = Err(AbortCode::NO_OBJECT);
        assert!(!agrees(template(&[refused, least(&[5, 0, 0, 0])])));
        assert!(!agrees(None));
    }
}
