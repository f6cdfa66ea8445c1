//! The stack as a MainDevice sees it, over a small stand-in for an ESC.

mod bench;
mod coe;
mod device;
mod esm;
mod mailbox;
mod random;
mod simple;
mod sync;
mod with_esc;
