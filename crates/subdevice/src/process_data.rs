//! The process data between the ESC and the application. Each direction is one image for the
//! application; in the ESC it is in one or several buffers, one for each SyncManager of the
//! direction.

use core::ops::Range;

use isocat_esc::Pdi;

/// Most bytes of process data in one direction: the capacity of one datagram. The stack keeps one
/// image of each direction, since a buffer of the ESC is read or written as a whole. The images are
/// as long as the areas of the description, and are in the value store of the caller.
pub const MAX_PROCESS_DATA: usize = 1486;

/// Most SyncManagers of one direction.
pub const MAX_AREAS: usize = 8;

/// The place and the length of a buffer; length 0 if there is no process data.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Buffer {
    /// First byte.
    pub start: u16,
    /// Bytes, at most [`MAX_PROCESS_DATA`].
    pub length: u16,
}

impl Buffer {
    /// Whether there is process data.
    pub const fn is_used(&self) -> bool {
        self.length > 0
    }
}

/// The buffers of one direction, in the order of its image.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Buffers {
    all: [Buffer; MAX_AREAS],
    /// Number of buffers in use.
    used: u8,
    /// Bytes of the image, at most [`MAX_PROCESS_DATA`].
    length: u16,
}

impl Buffers {
    /// No buffers.
    pub const NONE: Self =
        Self { all: [Buffer { start: 0, length: 0 }; MAX_AREAS], used: 0, length: 0 };

    /// These buffers.
    #[cfg(test)]
    pub fn of(all: &[Buffer]) -> Self {
        let mut buffers = Self::NONE;
        for (area, buffer) in all.iter().enumerate() {
            buffers.set(area, *buffer);
        }
        buffers
    }

    /// The buffer of the area with this number, in the order of the description.
    pub fn set(&mut self, area: usize, buffer: Buffer) {
        if let Some(place) = self.all.get_mut(area) {
            *place = buffer;
        }
        let used = self.all.iter().rposition(Buffer::is_used).map_or(0, |last| last + 1);
        let length: usize = self.all.iter().map(|buffer| usize::from(buffer.length)).sum();
        self.used = used as u8;
        self.length = length.min(MAX_PROCESS_DATA) as u16;
    }

    /// Bytes of each buffer.
    pub fn lengths(&self) -> [u32; MAX_AREAS] {
        self.all.map(|buffer| u32::from(buffer.length))
    }

    /// Whether there is process data.
    pub fn is_used(&self) -> bool {
        self.used > 0
    }

    /// Bytes of the image, at most [`MAX_PROCESS_DATA`].
    #[inline]
    fn length(&self) -> usize {
        usize::from(self.length)
    }

    /// The start address of the only buffer, if there is one only.
    #[inline]
    fn single(&self) -> Option<u16> {
        (self.used == 1).then(|| self.all[0].start)
    }

    /// For each used buffer: its start address, and its bytes in an image of `image` bytes.
    fn places(&self, image: usize) -> impl Iterator<Item = (u16, Range<usize>)> + '_ {
        let mut at = 0;
        let used = self.all.iter().take(usize::from(self.used));
        used.filter(|buffer| buffer.is_used()).map(move |buffer| {
            let from = at;
            at = (from + usize::from(buffer.length)).min(image);
            (buffer.start, from..at)
        })
    }
}

/// The places of the process data. The images belong to the caller and come after the values of the
/// dictionary.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProcessData {
    outputs: Buffers,
    inputs: Buffers,
}

impl ProcessData {
    /// No process data.
    pub const fn new() -> Self {
        Self { outputs: Buffers::NONE, inputs: Buffers::NONE }
    }

    /// Takes the buffers that the SyncManagers guard; their lengths were checked against the
    /// maximum. The images start with zeros.
    pub fn start(&mut self, outputs: Buffers, inputs: Buffers, images: Images<'_>) {
        *self = Self { outputs, inputs };
        images.outputs.fill(0);
        images.inputs.fill(0);
    }

    /// Ends the exchange.
    pub fn stop(&mut self) {
        *self = Self::new();
    }

    /// Reads the outputs, and returns them. One access to a whole buffer opens and closes it.
    #[inline]
    pub fn fetch_outputs<'a>(&self, image: &'a mut [u8], pdi: &mut impl Pdi) -> &'a [u8] {
        let length = self.outputs.length().min(image.len());
        match self.outputs.single() {
            Some(start) => pdi.read(start, &mut image[..length]),
            None => self.fetch_parts(image, pdi),
        }
        &image[..length]
    }

    #[inline(never)]
    fn fetch_parts(&self, image: &mut [u8], pdi: &mut impl Pdi) {
        for (start, bytes) in self.outputs.places(image.len()) {
            pdi.read(start, &mut image[bytes]);
        }
    }

    /// Acknowledges outputs that will not be used: the first byte opens a buffer, the last one
    /// closes it.
    pub fn drop_outputs(&self, pdi: &mut impl Pdi) {
        for (start, bytes) in self.outputs.places(MAX_PROCESS_DATA) {
            let last = bytes.len().saturating_sub(1) as u16;
            pdi.read(start, &mut [0]);
            if last > 0 {
                pdi.read(start.wrapping_add(last), &mut [0]);
            }
        }
    }

    /// Writes the [inputs](Self::inputs). One access to a whole buffer opens and closes it.
    #[inline]
    pub fn store_inputs(&self, inputs: &[u8], pdi: &mut impl Pdi) {
        match self.inputs.single() {
            Some(start) => pdi.write(start, inputs),
            None => self.store_parts(inputs, pdi),
        }
    }

    #[inline(never)]
    fn store_parts(&self, inputs: &[u8], pdi: &mut impl Pdi) {
        for (start, bytes) in self.inputs.places(inputs.len()) {
            pdi.write(start, &inputs[bytes]);
        }
    }

    /// Bytes of each buffer of outputs and inputs.
    pub fn lengths(&self) -> ([u32; MAX_AREAS], [u32; MAX_AREAS]) {
        (self.outputs.lengths(), self.inputs.lengths())
    }

    /// The outputs that were fetched last.
    #[inline]
    pub fn outputs<'a>(&self, image: &'a [u8]) -> &'a [u8] {
        &image[..self.outputs.length().min(image.len())]
    }

    /// A bit of the outputs that were fetched last; `None` beyond their end.
    pub fn output_bit(&self, image: &[u8], at: u16) -> Option<bool> {
        self.outputs(image).get(usize::from(at / 8)).map(|byte| byte >> (at % 8) & 1 != 0)
    }

    /// The inputs to be written.
    #[inline]
    pub fn inputs<'a>(&self, image: &'a mut [u8]) -> &'a mut [u8] {
        let length = self.inputs.length().min(image.len());
        &mut image[..length]
    }
}

/// The images of both directions.
pub(crate) struct Images<'a> {
    pub outputs: &'a mut [u8],
    pub inputs: &'a mut [u8],
}
