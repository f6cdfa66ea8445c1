//! One mutation: what is done to the datagrams of a class between the program and the segment.

use std::fmt;

use isocat_wire::datagram::{HEADER_LEN, Layout, Layouts};
use serde::{Deserialize, Serialize};

use super::class::{Class, HEADERS, SDO_VALUE, Shown, payload};

/// What happens to a datagram. The program is told what it would be told if it had been taken as it
/// was sent, as far as nothing but the segment could tell otherwise.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub enum Change {
    /// Nobody takes it, and it comes back with its usual working counter.
    LeftOut,
    /// It comes once more, behind its frame.
    Twice,
    /// It comes behind the next frame instead.
    Later,
    /// Its register, or its logical address, is another one.
    Address(i16),
    /// Its SubDevice is another one.
    Neighbour(i16),
    /// The number in it is greater or less.
    Value(i8),
    /// All that it writes is 0.
    Zero,
    /// This bit of what it writes is another one.
    Bit(u16),
}

/// A mutation of a program's frames.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub struct Mutant {
    pub class: Class,
    pub change: Change,
    /// How many of its datagrams go untouched before.
    pub after: u64,
    /// Each one after that; otherwise one alone.
    pub always: bool,
    /// The working counter that datagrams of this class come back with.
    pub wkc: u16,
}

impl Mutant {
    /// All mutants of a class that showed itself so in a good run.
    pub fn all_of(class: Class, shown: Shown) -> impl Iterator<Item = Self> {
        let of = move |(after, always)| {
            changes(class).map(move |change| Self { class, change, after, always, wkc: shown.wkc })
        };
        // What is sent once is changed each time, too.
        let times = match shown.count {
            0 | 1 => 1,
            2 => 2,
            _ => 3,
        };
        let all = [(0, false), (0, true), (shown.count / 2, false)];
        all.into_iter().take(times).flat_map(of)
    }

    /// The positions that it concerns, if its datagrams are for the SubDevice at `position`.
    pub fn positions(&self, position: Option<usize>) -> Vec<usize> {
        let Some(position) = position else { return Vec::new() };
        let other = match self.change {
            Change::Neighbour(by) => position.checked_add_signed(by.into()),
            _ => None,
        };
        std::iter::once(position).chain(other).collect()
    }
}

fn changes(class: Class) -> impl Iterator<Item = Change> {
    use Change::*;
    let always = [LeftOut, Twice, Later].into_iter();
    // A mailbox is one memory, and process data are the application's.
    let addresses = [Address(1), Address(-1)].into_iter().filter(move |_| !class.is_mailbox());
    let neighbours = [Neighbour(1), Neighbour(-1)].into_iter().filter(move |_| class.is_of_one());
    let values = [Value(1), Value(-1), Zero].into_iter();
    let values = values.filter(move |_| class.writes_registers());
    let bits = (0..8 * class.written_bytes()).map(Bit);
    always.chain(addresses).chain(neighbours).chain(values).chain(bits)
}

impl fmt::Display for Mutant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let how = match self.change {
            Change::LeftOut => "left out".to_owned(),
            Change::Twice => "twice".to_owned(),
            Change::Later => "behind the next frame".to_owned(),
            Change::Address(by) => format!("address {by:+}"),
            Change::Neighbour(by) => format!("to SubDevice {by:+}"),
            Change::Value(by) => format!("value {by:+}"),
            Change::Zero => "value 0".to_owned(),
            Change::Bit(bit) => format!("bit {bit} turned over"),
        };
        let times = match (self.always, self.after) {
            (true, _) => "each time",
            (false, 0) => "the first time",
            (false, _) => "in the middle",
        };
        write!(f, "{}: {how}, {times}", self.class)
    }
}

/// Does a mutation to the frames of a program.
#[derive(Debug)]
pub struct Mutation {
    mutant: Mutant,
    /// Datagrams of its class so far.
    met: u64,
    /// Frames that are sent behind the present one.
    behind: Vec<Vec<u8>>,
    /// Frames that are sent behind the next one.
    later: Vec<Vec<u8>>,
    undo: Vec<Undo>,
}

/// How to give a datagram back as the program sent it.
#[derive(Debug)]
struct Undo {
    layout: Layout,
    header: [u8; HEADER_LEN],
    /// What was added to its address.
    moved: u32,
    /// The data as they were sent, where nothing is read.
    data: Option<Vec<u8>>,
    /// The working counter to tell; `None`: what came.
    wkc: Option<u16>,
}

impl Mutation {
    pub fn new(mutant: Mutant) -> Self {
        Self { mutant, met: 0, behind: Vec::new(), later: Vec::new(), undo: Vec::new() }
    }

    /// Changes a frame on its way out. Returns the frames that are sent behind it.
    pub fn out(&mut self, frame: &mut [u8], in_operation: bool) -> Vec<Vec<u8>> {
        let mut behind = std::mem::take(&mut self.later);
        self.undo.clear();
        let found: Vec<Layout> = match payload(frame) {
            Some(bytes) => self.found(bytes, in_operation),
            None => Vec::new(),
        };
        for layout in found {
            let number = self.met;
            self.met += 1;
            let is_meant = match self.mutant.always {
                true => number >= self.mutant.after,
                false => number == self.mutant.after,
            };
            if is_meant {
                self.change(frame, layout);
            }
        }
        behind.append(&mut self.behind);
        behind
    }

    fn found(&self, bytes: &[u8], in_operation: bool) -> Vec<Layout> {
        let mut layouts = Layouts::new();
        let all = std::iter::from_fn(|| layouts.next(bytes)?.ok());
        let is_meant = |layout: &Layout| {
            let data = &bytes[layout.data()..layout.wkc()];
            Class::of(&layout.header, data, in_operation) == self.mutant.class
        };
        all.filter(is_meant).collect()
    }

    fn change(&mut self, frame: &mut [u8], layout: Layout) {
        let bytes = &mut frame[HEADERS..];
        let data = bytes[layout.data()..layout.wkc()].to_vec();
        let header = layout.header.emit();
        let reads_nothing = self.mutant.class.writes_registers();
        let mut undo = Undo { layout, header, moved: 0, data: None, wkc: None };
        match self.mutant.change {
            Change::Twice => {
                let alone = alone(frame, layout);
                return self.behind.push(alone);
            }
            Change::LeftOut | Change::Later => {
                bytes[layout.start] = NOP;
                undo.wkc = Some(self.mutant.wkc);
                if self.mutant.change == Change::Later {
                    bytes[layout.start] = layout.header.command;
                    let alone = alone(frame, layout);
                    self.later.push(alone);
                    frame[HEADERS + layout.start] = NOP;
                }
            }
            Change::Address(by) => {
                let logical = layout.header.command().is_ok_and(|command| command.is_logical());
                let by = i32::from(by).cast_unsigned();
                undo.moved = if logical { by } else { by << 16 };
            }
            // Positions count down.
            Change::Neighbour(by) => {
                let by = if layout.header.command == APWR { -by } else { by };
                let adp = layout.header.adp().wrapping_add_signed(by);
                let address = layout.header.address & 0xFFFF_0000 | u32::from(adp);
                undo.moved = address.wrapping_sub(layout.header.address);
            }
            Change::Value(by) => {
                add(value(&mut bytes[layout.data()..layout.wkc()], &self.mutant), by)
            }
            Change::Zero => value(&mut bytes[layout.data()..layout.wkc()], &self.mutant).fill(0),
            Change::Bit(bit) => {
                let from = if self.mutant.class.object != 0 { SDO_VALUE } else { 0 };
                bytes[layout.data() + from + usize::from(bit / 8)] ^= 1 << (bit % 8);
            }
        }
        if undo.moved != 0 {
            let address = layout.header.address.wrapping_add(undo.moved);
            frame[HEADERS + layout.start + 2..][..4].copy_from_slice(&address.to_le_bytes());
        }
        undo.data = reads_nothing.then_some(data);
        self.undo.push(undo);
    }

    /// Changes the frame back on its way to the program.
    pub fn back(&mut self, frame: &mut [u8]) {
        for undo in self.undo.drain(..) {
            let Some(bytes) = frame.get_mut(HEADERS..) else { continue };
            let Layout { start, .. } = undo.layout;
            let Some(header) = bytes.get_mut(start..start + HEADER_LEN) else { continue };
            header[0] = undo.header[0];
            let address = u32::from_le_bytes([header[2], header[3], header[4], header[5]]);
            let address = address.wrapping_sub(undo.moved);
            header[2..6].copy_from_slice(&address.to_le_bytes());
            if let Some(data) = undo.data {
                bytes[undo.layout.data()..undo.layout.wkc()].copy_from_slice(&data);
            }
            if let Some(wkc) = undo.wkc {
                let at = undo.layout.wkc();
                bytes[at..at + 2].copy_from_slice(&wkc.to_le_bytes());
            }
        }
    }
}

/// The part of a datagram that is its number: that of an SDO, or the first eight bytes.
fn value<'a>(data: &'a mut [u8], mutant: &Mutant) -> &'a mut [u8] {
    let from = if mutant.class.object != 0 { SDO_VALUE.min(data.len()) } else { 0 };
    let most = if mutant.class.object != 0 { 4 } else { 8 };
    let to = data.len().min(from + most);
    &mut data[from..to]
}

/// Adds to a little-endian number.
fn add(number: &mut [u8], by: i8) {
    let mut bytes = [0; 8];
    bytes[..number.len()].copy_from_slice(number);
    let sum = u64::from_le_bytes(bytes).wrapping_add_signed(by.into());
    number.copy_from_slice(&sum.to_le_bytes()[..number.len()]);
}

/// A frame with a datagram of another one alone.
fn alone(frame: &[u8], layout: Layout) -> Vec<u8> {
    let mut bytes = frame[..HEADERS].to_vec();
    let datagram = &frame[HEADERS + layout.start..HEADERS + layout.end()];
    let length = u16::try_from(datagram.len()).unwrap_or(0) & 0x07FF | 0x1000;
    bytes[14..16].copy_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(datagram);
    // No datagram follows.
    bytes[HEADERS + 7] &= 0x7F;
    bytes.resize(bytes.len().max(60), 0);
    bytes
}

const NOP: u8 = 0;
const APWR: u8 = isocat_wire::Command::Apwr as u8;
