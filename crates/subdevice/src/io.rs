//! An I/O application: it returns its outputs as inputs.

use crate::application::Application;

/// Up to 256 bytes of outputs wired to inputs.
pub type Io = IoOf<256>;

/// Up to `BYTES` bytes of outputs wired to inputs, up to the shorter length; further inputs are 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct IoOf<const BYTES: usize> {
    mapped: [u8; BYTES],
    outputs: [u8; BYTES],
    inputs: [u8; BYTES],
    /// Most bytes that ever arrived: the rest is 0 everywhere.
    used: usize,
}

impl<const BYTES: usize> IoOf<BYTES> {
    /// An application with all outputs 0.
    pub const fn new() -> Self {
        let zeros = [0; BYTES];
        Self { mapped: zeros, outputs: zeros, inputs: zeros, used: 0 }
    }

    /// How many bytes move at once: a few of them all, since a constant length needs no call.
    const fn moved(used: usize) -> usize {
        if BYTES <= 64 { BYTES } else { used }
    }

    /// The bytes at the output terminals.
    pub fn outputs(&self) -> &[u8; BYTES] {
        &self.outputs
    }
}

impl<const BYTES: usize> Default for IoOf<BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const BYTES: usize> Application for IoOf<BYTES> {
    fn map_outputs(&mut self, outputs: &[u8]) {
        let len = outputs.len().min(self.mapped.len());
        self.mapped[..len].copy_from_slice(&outputs[..len]);
        self.used = self.used.max(len);
    }

    fn outputs_valid(&mut self) {
        let used = Self::moved(self.used);
        self.outputs[..used].copy_from_slice(&self.mapped[..used]);
    }

    fn latch_inputs(&mut self) {
        let used = Self::moved(self.used);
        self.inputs[..used].copy_from_slice(&self.outputs[..used]);
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        let len = inputs.len().min(self.inputs.len());
        inputs[..len].copy_from_slice(&self.inputs[..len]);
    }

    fn power_off(&mut self) {
        *self = Self::new();
    }

    fn safe_outputs(&mut self) {
        self.mapped = [0; BYTES];
        self.outputs = [0; BYTES];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_come_back_only_after_they_acted_and_were_latched() {
        let mut io = Io::new();
        let mut inputs = [0xFF; 3];
        io.map_outputs(&[1, 2]);
        io.latch_inputs();
        io.map_inputs(&mut inputs);
        assert_eq!(inputs, [0, 0, 0], "mapped, but not valid");
        io.outputs_valid();
        io.map_inputs(&mut inputs);
        assert_eq!(inputs, [0, 0, 0], "valid, but not latched");
        io.latch_inputs();
        io.map_inputs(&mut inputs);
        assert_eq!(inputs, [1, 2, 0]);
        io.safe_outputs();
        assert_eq!(io.outputs()[..2], [0, 0]);
    }
}
