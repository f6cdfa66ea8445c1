//! The memory of a simulated ESC, which is small for a device that uses little of it.

use std::sync::Arc;

/// Process RAM that grows with its use, or an EEPROM image that devices of a kind share until one
/// of them writes to it.
#[derive(Clone, Debug)]
pub struct Storage(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Own(Vec<u8>),
    Shared(Arc<[u8]>),
}

impl Storage {
    /// An empty memory.
    pub const fn empty() -> Self {
        Self(Kind::Own(Vec::new()))
    }

    /// A shared image.
    pub const fn shared(image: Arc<[u8]>) -> Self {
        Self(Kind::Shared(image))
    }

    /// Extends it to at least `len` bytes, with zeros.
    pub fn grow(&mut self, len: usize) {
        let own = self.own();
        own.reserve_exact(len.saturating_sub(own.len()));
        own.resize(len.max(own.len()), 0);
    }

    #[inline(always)]
    fn own(&mut self) -> &mut Vec<u8> {
        if let Kind::Shared(_) = &self.0 {
            self.copy();
        }
        match &mut self.0 {
            Kind::Own(bytes) => bytes,
            Kind::Shared(_) => unreachable!("it was just made our own"),
        }
    }

    #[cold]
    fn copy(&mut self) {
        if let Kind::Shared(image) = &self.0 {
            self.0 = Kind::Own(image.to_vec());
        }
    }
}

impl AsRef<[u8]> for Storage {
    #[inline]
    fn as_ref(&self) -> &[u8] {
        match &self.0 {
            Kind::Own(bytes) => bytes,
            Kind::Shared(image) => image,
        }
    }
}

impl AsMut<[u8]> for Storage {
    #[inline(always)]
    fn as_mut(&mut self) -> &mut [u8] {
        self.own()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_shared_until_it_is_written() {
        let image: Arc<[u8]> = Arc::from([1, 2, 3]);
        let (mut one, other) = (Storage::shared(image.clone()), Storage::shared(image.clone()));
        assert_eq!(one.as_ref().as_ptr(), other.as_ref().as_ptr());
        one.as_mut()[0] = 9;
        assert_eq!((one.as_ref(), other.as_ref()), (&[9, 2, 3][..], &[1, 2, 3][..]));
    }

    #[test]
    fn it_grows_and_keeps_what_it_holds() {
        let mut ram = Storage::empty();
        ram.grow(2);
        ram.as_mut()[1] = 7;
        ram.grow(4);
        ram.grow(1);
        assert_eq!(ram.as_ref(), [0, 7, 0, 0]);
    }
}
