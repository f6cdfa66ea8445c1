//! Values with the frame in which each was seen.

use std::collections::BTreeMap;

use isocat_wire::register::{PROCESS_RAM, Register, Value};

/// A value, and the frame that shows it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Known<T> {
    pub value: T,
    /// Number of the frame, from 1; of a value of several bytes, the latest frame.
    pub frame: usize,
}

impl<T> Known<T> {
    pub fn map<U>(self, f: impl FnOnce(T) -> U) -> Known<U> {
        Known { value: f(self.value), frame: self.frame }
    }
}

/// The registers of one device, byte by byte, as far as the capture shows them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Image {
    written: BTreeMap<u16, Known<u8>>,
    read: BTreeMap<u16, Known<u8>>,
}

impl Image {
    /// Notes what a frame wrote from `address` on and the device took.
    pub fn write(&mut self, address: u16, data: &[u8], frame: usize) {
        store(&mut self.written, address, data, frame);
    }

    /// Notes what a frame read from `address` on.
    pub fn note(&mut self, address: u16, data: &[u8], frame: usize) {
        store(&mut self.read, address, data, frame);
    }

    /// What was last written to all bytes of a register.
    pub fn written<T: Value>(&self, register: Register<T>) -> Option<Known<T>> {
        gather(register, |address| self.written.get(&address).copied())
    }

    /// What was last read of all bytes of a register.
    pub fn read<T: Value>(&self, register: Register<T>) -> Option<Known<T>> {
        gather(register, |address| self.read.get(&address).copied())
    }

    /// What was last seen of a register that keeps what is written to it.
    pub fn latest<T: Value>(&self, register: Register<T>) -> Option<Known<T>> {
        gather(register, |address| self.newest(address))
    }

    /// The same, with 0 for bytes that were not seen. `None`: none was.
    pub fn latest_or_zero<T: Value>(&self, register: Register<T>) -> Option<Known<T>> {
        let unseen = Known { value: 0, frame: 0 };
        let known = gather(register, |address| self.newest(address).or(Some(unseen)));
        known.filter(|known| known.frame > 0)
    }

    fn newest(&self, address: u16) -> Option<Known<u8>> {
        let both = [self.written.get(&address), self.read.get(&address)];
        both.into_iter().flatten().max_by_key(|known| known.frame).copied()
    }

    /// Bytes from `address` on as they were last written.
    pub fn written_bytes<const N: usize>(&self, address: u16) -> Option<Known<[u8; N]>> {
        let mut all = Known { value: [0; N], frame: 0 };
        for (place, address) in all.value.iter_mut().zip(address..) {
            let known = self.written.get(&address)?;
            *place = known.value;
            all.frame = all.frame.max(known.frame);
        }
        Some(all)
    }
}

fn gather<T: Value>(
    register: Register<T>,
    byte: impl Fn(u16) -> Option<Known<u8>>,
) -> Option<Known<T>> {
    let mut bytes = T::Bytes::default();
    let mut frame = 0;
    for (place, address) in bytes.as_mut().iter_mut().zip(register.address..) {
        let known = byte(address)?;
        *place = known.value;
        frame = frame.max(known.frame);
    }
    Some(Known { value: register.decode(&bytes), frame })
}

fn store(cells: &mut BTreeMap<u16, Known<u8>>, address: u16, data: &[u8], frame: usize) {
    for (value, address) in data.iter().zip(usize::from(address)..usize::from(PROCESS_RAM)) {
        cells.insert(address as u16, Known { value: *value, frame });
    }
}

/// The first events of a kind in full, and the number of all: memory stays bounded.
#[derive(Clone, Debug)]
pub(crate) struct Log<T> {
    /// The first ones.
    pub kept: Vec<T>,
    /// All of them.
    pub count: u64,
    most: usize,
}

impl<T> Log<T> {
    /// Keeps at most `most` events.
    pub fn new(most: usize) -> Self {
        Self { kept: Vec::new(), count: 0, most }
    }

    pub fn push(&mut self, event: T) {
        self.count += 1;
        if self.kept.len() < self.most {
            self.kept.push(event);
        }
    }

    /// The number of events that were not kept.
    pub fn left_off(&self) -> u64 {
        self.count - self.kept.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::register;

    #[test]
    fn a_register_is_known_when_all_its_bytes_are() {
        let mut image = Image::default();
        image.write(0x09A0, &[1, 2], 3);
        assert_eq!(image.written(register::SYNC0_CYCLE), None);
        let half = Some(Known { value: 0x0201, frame: 3 });
        assert_eq!(image.latest_or_zero(register::SYNC0_CYCLE), half);
        assert_eq!(image.latest_or_zero(register::SYNC1_CYCLE), None);
        image.note(0x09A2, &[3, 4], 7);
        assert_eq!(image.written(register::SYNC0_CYCLE), None);
        let all = Known { value: 0x0403_0201, frame: 7 };
        assert_eq!(image.latest(register::SYNC0_CYCLE), Some(all));
        image.note(0x09A0, &[9], 8);
        assert_eq!(image.latest(register::SYNC0_CYCLE).map(|k| k.value), Some(0x0403_0209));
        // What lies in the process RAM is no register.
        image.write(0x0FFF, &[1, 2], 9);
        assert_eq!((image.written.len(), image.written.contains_key(&0x1000)), (3, false));
    }

    #[test]
    fn a_log_is_bounded() {
        let mut log = Log::new(2);
        (0..5).for_each(|event| log.push(event));
        assert_eq!((log.kept, log.count), (vec![0, 1], 5));
    }
}
