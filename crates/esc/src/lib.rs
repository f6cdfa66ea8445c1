//! An EtherCAT SubDevice Controller in software, exact to its 10 ns tick.
//!
//! A frame enters by [`Esc::process`]: the EPU answers its datagrams in place. Reads and writes
//! reach memory through the register rules of each side (`access`), through FMMUs if they are
//! logical, and through SyncManagers if they lie in process RAM. Writes to registers wait in a
//! shadow (`memory`) until the frame has ended well. Then (`frame_end`) the units apply them: AL
//! (`al`), data link (`dl`), EEPROM, MII management (`mii`), LEDs, watchdogs, DC.
//!
//! Between frames the ESC has events of its own: the end of a frame, SYNC0 and SYNC1, latch inputs,
//! watchdogs, EEPROM. Nothing runs tick by tick. [`Esc::next_event`] tells when an event is due,
//! and [`Esc::step`] handles it. The local CPU accesses the ESC through [`Pdi`], which [`Esc::pdi`]
//! returns.
//!
//! An ESC takes memory for as many registers and SyncManagers as any chip has. With the feature
//! `alloc` it takes as much as its own chip and its frames need, from the heap.
//!
//! Times are [`Time<Device>`](isocat_wire::time::Device), as the device's own oscillator counts
//! them, rounded down to ticks wherever the ESC samples.
//!
//! ```
//! use isocat_esc::{ET1100, Esc};
//! use isocat_wire::{Command, Time, datagram::Address, frame::FrameWriter, register};
//!
//! let mut esc = Esc::new(&ET1100, vec![0; 128], vec![0; 8192]);
//! let mut buffer = [0; 60];
//! let mut frame = FrameWriter::new(&mut buffer, [0x10; 6]);
//! let data = frame.push(Command::Brd, 0, Address::Broadcast(0x0000), &[0]).unwrap();
//! frame.finish();
//! esc.process(&mut buffer, Time::new(1_000), Time::new(6_760), true);
//! assert_eq!(buffer[data], 0x11); // an ET1100
//! assert_eq!(buffer[data + 1..data + 3], [1, 0]); // working counter
//! ```
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "alloc")]
extern crate alloc;
#[cfg(test)]
extern crate std;

mod access;
mod al;
pub mod chip;
mod cyclic;
mod dc;
mod dl;
mod eeprom;
mod esc;
mod fmmu;
mod frame_end;
mod led;
mod memory;
mod mii;
pub mod pdi;
mod process;
mod reach;
mod regular;
mod room;
pub mod rx_fifo;
mod sync_manager;
#[cfg(test)]
mod tests;
mod watchdog;

pub use chip::{
    Chip, ET1100, ET1100_MII, ET1200, IP_CORE_32, IP_CORE_32_EMULATED, LAN9252, XMC4800,
};
pub use cyclic::CyclicFrame;
pub use dc::drift_law::{DriftLaw, UnknownDriftLaw};
pub use dc::latch::LatchInput;
pub use esc::{Esc, EscEvent, PortError};
pub use pdi::{Buffers, EscPdi, Pdi, PdiExt};
pub use process::{Passing, Processed};
pub use reach::Reach;
pub use regular::Usual;
pub use rx_fifo::{Receiver, RxFifo};
