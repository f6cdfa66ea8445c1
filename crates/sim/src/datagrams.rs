//! The datagrams of the present frame. In regular operation frame after frame has the same ones, so
//! they are kept, and only what differs is read again.

use isocat_esc::{CyclicFrame, Usual};
use isocat_wire::Command;
use isocat_wire::datagram::{HEADER_LEN, Layout, Layouts};
use isocat_wire::frame;

use crate::wiring::MainPort;

/// A datagram of the present frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Item {
    pub layout: Layout,
    /// Its header as sent.
    header: [u8; HEADER_LEN],
    pub command: Command,
    /// Its kind, if it is a usual one.
    pub usual: Option<Usual>,
    pub irq: u16,
    pub wkc: u16,
}

impl Item {
    /// The address on arrival at a place, incremented by all places before.
    pub fn address_at(&self, place: usize) -> u32 {
        let address = self.layout.header.address;
        if self.command.increments_position() {
            address & 0xFFFF_0000 | u32::from((address as u16).wrapping_add(place as u16))
        } else {
            address
        }
    }

    /// Whether all SubDevices process it.
    pub fn concerns_all(&self) -> bool {
        use Command::*;
        matches!(self.command, Brd | Bwr | Brw | Armw | Frmw)
    }
}

/// The datagrams of the present frame, and of cyclic frames before it.
#[derive(Debug)]
pub(crate) struct Datagrams {
    /// The first one is of the last frame that was not cyclic; the others are kept.
    lists: Vec<List>,
    present: usize,
    /// How many are kept, and where the last one is.
    kept: usize,
    last: usize,
    /// The number of the last cyclic frame with new datagrams.
    number: u64,
}

/// The datagrams of a frame.
#[derive(Default, Debug)]
pub(crate) struct List {
    from: Option<MainPort>,
    pub items: Vec<Item>,
    /// The offset of its payload. `None` for frames that each ESC must process as a whole: those in
    /// another form than EtherCAT on Ethernet, and those with a truncated chain of datagrams.
    pub offset: Option<usize>,
    /// The frame, if it is a cyclic one.
    pub cyclic: Option<CyclicFrame>,
}

impl Datagrams {
    /// No datagrams.
    pub fn new() -> Self {
        let mut lists = Vec::new();
        lists.resize_with(1 + MOST_KEPT, List::default);
        Self { lists, present: 0, kept: 0, last: 0, number: 0 }
    }

    /// Where those of the present frame are, if they are kept; they stay there until others of
    /// [`MOST_KEPT`] frames have been read.
    pub fn place(&self) -> Option<usize> {
        Some(self.present).filter(|place| *place > 0)
    }

    /// Those that are kept at a [place](Self::place).
    pub fn at(&mut self, place: usize) -> &mut List {
        &mut self.lists[place]
    }

    /// Those of the present frame.
    pub fn present(&self) -> &List {
        &self.lists[self.present]
    }

    /// Those of the present frame.
    pub fn present_mut(&mut self) -> &mut List {
        &mut self.lists[self.present]
    }

    /// Reads the datagrams of a frame from this port. Unknown commands and NOP pass unchanged and
    /// are left out.
    pub fn read(&mut self, from: MainPort, bytes: &[u8]) {
        let offset = frame::payload_offset(bytes).ok();
        // As a rule the frames of a cycle come in the same order again.
        for step in 0..self.kept {
            let number = 1 + (self.present + step) % self.kept;
            let list = &mut self.lists[number];
            if list.from == Some(from) && list.offset == offset && list.read_again(bytes) {
                self.present = number;
                return;
            }
        }
        self.read_new(from, offset, bytes);
    }

    #[inline(never)]
    fn read_new(&mut self, from: MainPort, offset: Option<usize>, bytes: &[u8]) {
        self.present = 0;
        let list = &mut self.lists[0];
        list.from = Some(from);
        if list.read(bytes, offset) {
            self.number += 1;
            list.cyclic = list.cyclic.take().map(|frame| frame.numbered(self.number));
            self.last = 1 + self.last % MOST_KEPT;
            self.kept = self.kept.max(self.last);
            self.present = self.last;
            self.lists.swap(0, self.last);
        }
    }

    /// Called when SubDevices may be at other places.
    pub fn forget(&mut self) {
        (self.present, self.kept, self.last) = (0, 0, 0);
    }
}

impl List {
    /// Reads a frame. Returns whether it is cyclic and these are all of its datagrams.
    fn read(&mut self, bytes: &[u8], offset: Option<usize>) -> bool {
        self.items.clear();
        let whole = offset.map(|offset| self.read_payload(&bytes[offset..]));
        self.offset = offset.filter(|_| whole != Some(None));
        let datagrams = self.items.iter().map(|item| (item.command, item.layout));
        self.cyclic = self.offset.and_then(|_| CyclicFrame::of(datagrams));
        self.cyclic.is_some() && whole == Some(Some(true))
    }

    /// Returns whether these are all datagrams; `None`: the chain is truncated.
    fn read_payload(&mut self, payload: &[u8]) -> Option<bool> {
        let mut layouts = Layouts::new();
        let mut whole = true;
        while let Some(layout) = layouts.next(payload) {
            let layout = layout.ok()?;
            match layout.header.command() {
                Err(_) | Ok(Command::Nop) => whole = false,
                Ok(command) => {
                    let wkc =
                        u16::from_le_bytes([payload[layout.wkc()], payload[layout.wkc() + 1]]);
                    let (header, irq) = (layout.header.emit(), layout.header.irq);
                    let len = usize::from(layout.header.len);
                    let usual = Usual::of(command, layout.header.address, len);
                    self.items.push(Item { layout, header, command, usual, irq, wkc });
                }
            }
        }
        Some(whole)
    }

    /// Adds what the frame counted where SubDevices took it at once to what the others did.
    pub fn add_counts(&mut self, payload: &mut [u8]) {
        let Self { items, cyclic, .. } = self;
        for (number, count) in cyclic.iter_mut().flat_map(|frame| frame.finish(payload)) {
            if let Some(item) = items.get_mut(number) {
                item.wkc = item.wkc.wrapping_add(count);
            }
        }
    }

    /// Writes the values that were counted separately into the frame, behind this number of places.
    pub fn write_counts(&self, payload: &mut [u8], places: usize) {
        for item in &self.items {
            let (at, wkc) = (item.layout.start, item.layout.wkc());
            let address = item.address_at(places);
            payload[at + 2..at + 6].copy_from_slice(&address.to_le_bytes());
            payload[at + 8..at + 10].copy_from_slice(&item.irq.to_le_bytes());
            payload[wkc..wkc + 2].copy_from_slice(&item.wkc.to_le_bytes());
        }
    }

    /// Reads a frame that has the same datagrams. `false`: it has others.
    fn read_again(&mut self, bytes: &[u8]) -> bool {
        let Some(payload) = self.offset.and_then(|offset| bytes.get(offset..)) else {
            return false;
        };
        // Nothing is taken before all of it fits: another frame may still be on its way with this
        // list.
        let fits = self.items.iter().all(|item| {
            let place = item.layout.start..item.layout.wkc() + 2;
            let sent = payload.get(place).and_then(|bytes| bytes.first_chunk::<HEADER_LEN>());
            // The index and the IRQ field may be others.
            let [command_before, _, places_before @ .., _, _] = item.header;
            sent.is_some_and(|[command, _, places @ .., _, _]| {
                *command == command_before && *places == places_before
            })
        });
        for item in self.items.iter_mut().filter(|_| fits) {
            let word = |at: usize| u16::from_le_bytes([payload[at], payload[at + 1]]);
            (item.irq, item.wkc) = (word(item.layout.start + 8), word(item.layout.wkc()));
        }
        fits
    }
}

/// As many as the frames of a cycle of ten thousand SubDevices.
const MOST_KEPT: usize = 128;
