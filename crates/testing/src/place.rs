//! How a test names a device.

use isocat_descriptions::document::name_hint;

/// The name of a device, or its position from 0.
pub trait Place {
    /// The position of the device among devices with these names.
    ///
    /// # Errors
    ///
    /// If there is no such device, with the reason.
    fn find(&self, names: &[&str]) -> Result<usize, String>;
}

impl Place for &str {
    fn find(&self, names: &[&str]) -> Result<usize, String> {
        let found = names.iter().position(|name| name == self);
        found.ok_or_else(|| {
            format!("no device \"{self}\"; {}", name_hint(self, names.iter().copied()))
        })
    }
}

impl Place for usize {
    fn find(&self, names: &[&str]) -> Result<usize, String> {
        let count = names.len();
        let too_far = || format!("no device {self}; expected 0 to {}", count.saturating_sub(1));
        (*self < count).then_some(*self).ok_or_else(too_far)
    }
}

/// The position of a device.
///
/// # Panics
///
/// If there is no such device.
#[track_caller]
pub(crate) fn position(names: &[&str], place: impl Place) -> usize {
    match place.find(names) {
        Ok(position) => position,
        // This is not in a closure, so that the panic has the caller's line.
        Err(error) => panic!("{error}"),
    }
}
