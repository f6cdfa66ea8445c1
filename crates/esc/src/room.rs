//! Memory whose length depends on the chip or on its use.

/// Up to `MOST` values. With the feature `alloc` it takes the memory of the values that it has;
/// without the feature, always that of `MOST`.
pub(crate) struct Room<T, const MOST: usize>(Values<T, MOST>);

#[cfg(feature = "alloc")]
type Values<T, const MOST: usize> = alloc::vec::Vec<T>;
#[cfg(not(feature = "alloc"))]
type Values<T, const MOST: usize> = [T; MOST];

impl<T: Copy, const MOST: usize> Room<T, MOST> {
    /// At least `len` values.
    #[cfg(feature = "alloc")]
    pub fn new(len: usize, value: T) -> Self {
        Self(alloc::vec![value; len.min(MOST)])
    }

    /// At least `len` values.
    #[cfg(not(feature = "alloc"))]
    pub const fn new(_len: usize, value: T) -> Self {
        Self([value; MOST])
    }

    /// Has at least `len` values from now on; new ones are `value`.
    #[cfg(feature = "alloc")]
    pub fn grow(&mut self, len: usize, value: T) {
        if self.0.len() < len.min(MOST) {
            self.0.resize(len.min(MOST), value);
        }
    }

    /// Has at least `len` values from now on; new ones are `value`.
    #[cfg(not(feature = "alloc"))]
    pub const fn grow(&mut self, _len: usize, _value: T) {}
}

impl<T, const MOST: usize> core::ops::Deref for Room<T, MOST> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T, const MOST: usize> core::ops::DerefMut for Room<T, MOST> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}
