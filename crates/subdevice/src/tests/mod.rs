//! The stack as a MainDevice sees it, over a small stand-in for an ESC.

mod bench;
mod coe;
mod counters;
mod device;
mod emulated;
mod esm;
mod mailbox;
mod random;
mod services;
mod several;
mod simple;
mod soe;
mod sync;
mod sync1;
mod with_esc;
