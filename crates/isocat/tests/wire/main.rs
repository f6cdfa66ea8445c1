//! Real wires: the command and the library on veth pairs, in network namespaces of their own.

#[cfg(target_os = "linux")]
mod alone;
mod application;
mod calibrate;
mod eni_interface;
mod interface;
mod serve;
mod watch;
