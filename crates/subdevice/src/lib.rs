//! EtherCAT SubDevice stack.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod application;
pub mod description;

pub use application::Application;
pub use description::{Description, Entry, Object};
