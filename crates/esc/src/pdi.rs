//! The door of an ESC to its local CPU.

/// The ESC as the local CPU sees it: the software ESC, or a driver of a chip.
///
/// An access has the side effects that the chip gives it: reading AL control releases it for the next
/// request, reading the first byte of a SyncManager's buffer opens it, reading or writing its last
/// byte closes it. Whole buffers are therefore best accessed with one call.
///
/// A driver whose bus can fail keeps the fault and hands it out by a method of its own; towards the
/// stack a failed read gives zeros, which no state of an ESC looks like.
pub trait Pdi {
    /// Reads `data.len()` bytes from `address` on.
    fn read(&mut self, address: u16, data: &mut [u8]);

    /// Writes `data` from `address` on. Bytes that the PDI may not write stay as they are.
    fn write(&mut self, address: u16, data: &[u8]);

    /// The AL event request (0x0220), without any side effect; see
    /// [`isocat_wire::register::al_event`].
    fn events(&mut self) -> u32 {
        let mut bytes = [0; 4];
        self.read(isocat_wire::register::AL_EVENT_REQUEST.address, &mut bytes);
        u32::from_le_bytes(bytes)
    }
}

/// Typed access on top of [`Pdi`].
pub trait PdiExt: Pdi {
    /// Reads a register.
    fn load<T: isocat_wire::register::Value>(&mut self, register: isocat_wire::Register<T>) -> T {
        let mut bytes = T::Bytes::default();
        self.read(register.address, bytes.as_mut());
        T::from_bytes(bytes)
    }

    /// Writes a register.
    fn store<T: isocat_wire::register::Value>(
        &mut self,
        register: isocat_wire::Register<T>,
        value: T,
    ) {
        self.write(register.address, value.to_bytes().as_ref());
    }
}

impl<P: Pdi + ?Sized> PdiExt for P {}
