//! The process data of SM2 and SM3 on their way between the ESC and the application.

use isocat_esc::Pdi;

/// Most bytes of process data in one direction. The stack keeps one image of each direction, since a
/// buffer of the ESC is fetched or filled as a whole.
pub const MAX_PROCESS_DATA: usize = 256;

/// Where a buffer lies and how long it is; of length 0 if nothing is transmitted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Buffer {
    /// First byte.
    pub start: u16,
    /// Bytes, at most [`MAX_PROCESS_DATA`].
    pub length: u16,
}

impl Buffer {
    /// Whether anything is transmitted.
    pub const fn is_used(&self) -> bool {
        self.length > 0
    }
}

/// The two images.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProcessData {
    outputs: Buffer,
    inputs: Buffer,
    output_image: [u8; MAX_PROCESS_DATA],
    input_image: [u8; MAX_PROCESS_DATA],
}

impl ProcessData {
    /// No process data.
    pub const fn new() -> Self {
        Self {
            outputs: Buffer { start: 0, length: 0 },
            inputs: Buffer { start: 0, length: 0 },
            output_image: [0; MAX_PROCESS_DATA],
            input_image: [0; MAX_PROCESS_DATA],
        }
    }

    /// Takes the buffers that SM2 and SM3 guard; their lengths were checked against the maximum.
    pub fn start(&mut self, outputs: Buffer, inputs: Buffer) {
        *self = Self { outputs, inputs, ..Self::new() };
    }

    /// Nothing is exchanged any more.
    pub fn stop(&mut self) {
        self.outputs = Buffer::default();
        self.inputs = Buffer::default();
    }

    /// Fetches the outputs. One access of the whole buffer opens and closes it.
    pub fn fetch_outputs(&mut self, pdi: &mut impl Pdi) {
        let length = usize::from(self.outputs.length);
        pdi.read(self.outputs.start, &mut self.output_image[..length]);
    }

    /// Acknowledges outputs that nobody will use.
    pub fn drop_outputs(&self, pdi: &mut impl Pdi) {
        let mut dropped = [0; MAX_PROCESS_DATA];
        pdi.read(self.outputs.start, &mut dropped[..usize::from(self.outputs.length)]);
    }

    /// Hands the inputs over. One access of the whole buffer opens and closes it.
    pub fn store_inputs(&self, pdi: &mut impl Pdi) {
        pdi.write(self.inputs.start, &self.input_image[..usize::from(self.inputs.length)]);
    }

    /// Bytes of outputs and inputs.
    pub fn lengths(&self) -> (u32, u32) {
        (u32::from(self.outputs.length), u32::from(self.inputs.length))
    }

    /// The outputs fetched last.
    pub fn outputs(&self) -> &[u8] {
        &self.output_image[..usize::from(self.outputs.length)]
    }

    /// A bit of the outputs fetched last; `None` beyond their end.
    pub fn output_bit(&self, at: u16) -> Option<bool> {
        self.outputs().get(usize::from(at / 8)).map(|byte| byte >> (at % 8) & 1 != 0)
    }

    /// The inputs to be handed over.
    pub fn inputs_mut(&mut self) -> &mut [u8] {
        &mut self.input_image[..usize::from(self.inputs.length)]
    }
}
