//! Real wires: the command and the library on veth pairs, in network namespaces of their own, in
//! real time.
#![cfg(target_os = "linux")]

mod alone;
mod calibrate;
mod eni_interface;
mod full_disk;
mod interface;
mod serve;
mod service;
mod watch;
