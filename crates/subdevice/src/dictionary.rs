//! The values of the object dictionary, and what else is in the store that the caller gives.

use isocat_wire::ObjectAddress;

use crate::description::{Description, Entry, LIST_HEAD, Object, Parameter};
use crate::misbehaviour::Misbehaviours;
use crate::objects::MAX_TRANSFER;
use crate::process_data::Images;

/// The dictionary: the description, and the store of the caller. It holds the present values, then
/// the images of the process data, then the room of the mailbox.
pub(crate) struct Dictionary<S> {
    description: Description,
    store: S,
    /// First byte of the values of parameters in the store.
    parameters: usize,
    /// First byte of the images of the process data in the store: outputs, then inputs.
    images: usize,
    /// Bytes of the image of the outputs.
    outputs: usize,
    /// Bytes of the image of the inputs.
    inputs: usize,
}

/// The present values, with the description of the device.
pub(crate) struct Values<'a> {
    description: &'a Description,
    store: &'a mut [u8],
    /// First byte of the values of parameters.
    parameters: usize,
}

/// The memory of a mailbox; only devices with a mailbox have it.
pub(crate) struct Room<'a> {
    /// The last two messages sent.
    pub messages: [&'a mut [u8]; 2],
    /// The data of a transfer that needs several messages.
    pub transfer: &'a mut [u8; MAX_TRANSFER],
}

impl<S: AsRef<[u8]> + AsMut<[u8]>> Dictionary<S> {
    /// A dictionary with the values after power-on.
    pub fn new(description: &Description, store: S) -> Self {
        assert!(
            store.as_ref().len() >= description.store_len(),
            "the value store must have {} bytes, it has {}",
            description.store_len(),
            store.as_ref().len()
        );
        assert!(
            description.objects.is_sorted_by_key(|object| object.index),
            "objects must stand in ascending order: they are searched by halves"
        );
        let mut dictionary = Self {
            description: description.clone(),
            store,
            parameters: description.objects_len(),
            images: description.values_len(),
            outputs: description.output_bytes(),
            inputs: description.input_bytes(),
        };
        for object in description.objects {
            assert!(
                object.entries.is_sorted_by_key(|entry| entry.sub),
                "entries of 0x{:04X} must stand in ascending order",
                object.index
            );
        }
        let speaks = description.parameters();
        assert!(
            speaks.is_sorted_by_key(|one| (one.drive, one.idn)),
            "parameters must stand in ascending order: they are searched by halves"
        );
        dictionary.store.as_mut()[dictionary.images..].fill(0);
        dictionary.reset();
        dictionary
    }

    /// Gives all entries their values after power-on, and zeroes the images.
    pub fn reset(&mut self) {
        self.values().reset();
        let images = self.images_mut();
        images.outputs.fill(0);
        images.inputs.fill(0);
    }

    /// The values.
    pub fn values(&mut self) -> Values<'_> {
        let store = &mut self.store.as_mut()[..self.images];
        Values { description: &self.description, store, parameters: self.parameters }
    }

    /// The values, and the room of the mailbox; `None` without a mailbox.
    pub fn values_and_room(&mut self) -> Option<(Values<'_>, Room<'_>)> {
        let len = usize::from(self.description.mailbox?.send.length);
        let (values, rest) = self.store.as_mut().split_at_mut(self.images);
        let rest = rest.get_mut(self.outputs + self.inputs..)?;
        let (messages, rest) = rest.split_at_mut_checked(2 * len)?;
        let (one, other) = messages.split_at_mut(len);
        let room = Room { messages: [one, other], transfer: rest.first_chunk_mut()? };
        let (description, parameters) = (&self.description, self.parameters);
        Some((Values { description, store: values, parameters }, room))
    }

    /// The misbehaviours of the device.
    pub fn misbehaviour_mut(&mut self) -> &mut Misbehaviours {
        &mut self.description.behaviour.misbehaviour
    }

    /// The images of the process data.
    pub fn images_mut(&mut self) -> Images<'_> {
        let both = &mut self.store.as_mut()[self.images..][..self.outputs + self.inputs];
        let (outputs, inputs) = both.split_at_mut(self.outputs);
        Images { outputs, inputs }
    }

    /// One of the images only.
    #[inline]
    pub fn outputs_mut(&mut self) -> &mut [u8] {
        &mut self.store.as_mut()[self.images..self.images + self.outputs]
    }

    /// The other one.
    #[inline]
    pub fn inputs_mut(&mut self) -> &mut [u8] {
        let from = self.images + self.outputs;
        &mut self.store.as_mut()[from..from + self.inputs]
    }

    /// The image of the outputs.
    pub fn output_image(&self) -> &[u8] {
        &self.store.as_ref()[self.images..][..self.outputs]
    }

    /// The first byte of an entry; `None` if the device does not have it.
    pub fn byte(&self, address: ObjectAddress) -> Option<u8> {
        let start = usize::from(self.description.entry(address)?.store);
        self.store.as_ref()[..self.images].get(start).copied()
    }

    /// The fixed properties of the device.
    pub fn description(&self) -> &Description {
        &self.description
    }
}

impl Values<'_> {
    fn reset(&mut self) {
        for entry in self.description.objects.iter().flat_map(|object| object.entries) {
            let default = self.description.power_on(entry);
            let start = usize::from(entry.store);
            let value = &mut self.store[start..start + entry.len()];
            let given = default.len().min(value.len());
            value[..given].copy_from_slice(&default[..given]);
            value[given..].fill(0);
        }
        for parameter in self.description.parameters() {
            let value = self.parameter_mut(parameter);
            let given = parameter.default.len().min(value.len());
            value[..given].copy_from_slice(&parameter.default[..given]);
            value[given..].fill(0);
        }
    }

    /// The bytes of an entry.
    pub fn bytes_mut(&mut self, entry: &Entry) -> &mut [u8] {
        let start = usize::from(entry.store);
        &mut self.store[start..start + entry.len()]
    }

    /// All bytes of a parameter.
    pub fn parameter_mut(&mut self, parameter: &Parameter) -> &mut [u8] {
        let start = self.parameters + usize::from(parameter.store);
        &mut self.store[start..start + usize::from(parameter.len)]
    }

    /// The bytes of a parameter; of a list, only those in use.
    pub fn parameter(&self, parameter: &Parameter) -> &[u8] {
        let start = self.parameters + usize::from(parameter.store);
        let bytes = &self.store[start..start + usize::from(parameter.len)];
        match *bytes {
            [l0, l1, _, _, ..] if parameter.attribute.is_list() => {
                let used = LIST_HEAD + usize::from(u16::from_le_bytes([l0, l1]));
                &bytes[..used.min(bytes.len())]
            }
            _ => bytes,
        }
    }

    /// Sets a number, if the device has the entry; excess bytes are dropped.
    pub fn set(&mut self, index: u16, sub: u8, value: u32) {
        if let Some(entry) = self.value_entry(index, sub) {
            let bytes = value.to_le_bytes();
            let target = self.bytes_mut(entry);
            let len = target.len().min(bytes.len());
            target[..len].copy_from_slice(&bytes[..len]);
        }
    }

    /// The bytes of an entry.
    pub fn bytes(&self, entry: &Entry) -> &[u8] {
        let start = usize::from(entry.store);
        &self.store[start..start + entry.len()]
    }

    /// The number in an entry of up to four bytes (the low four of a longer one); `None` if the
    /// device does not have the entry.
    pub fn value(&self, index: u16, sub: u8) -> Option<u32> {
        let bytes = self.bytes(self.value_entry(index, sub)?);
        let mut value = [0; 4];
        let len = bytes.len().min(value.len());
        value[..len].copy_from_slice(&bytes[..len]);
        Some(u32::from_le_bytes(value))
    }

    /// The object with this index.
    pub fn object(&self, index: u16) -> Option<&'static Object> {
        self.description.object(index)
    }

    /// The fixed properties of the device.
    pub const fn description(&self) -> &Description {
        self.description
    }

    fn value_entry(&self, index: u16, sub: u8) -> Option<&'static Entry> {
        let entry = self.description.entry(ObjectAddress::new(index, sub))?;
        (!entry.is_gap()).then_some(entry)
    }
}
