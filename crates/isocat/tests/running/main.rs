//! Segments that are brought up and run, each judged in true time or on the wire.

mod acknowledge;
mod allocations;
mod application;
mod bad_wire;
mod changes;
mod clock_of_32_bits;
mod conformance;
mod delays;
mod direction;
mod field;
mod groups;
mod hot_connect;
mod main_job;
mod many_devices;
mod modes;
mod objects_over_the_wire;
mod optional;
mod oversampling;
mod plant;
mod quality;
mod reads;
mod ring;
mod serve_traps;
mod several_sync_managers;
mod simple_devices;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod supervised;
mod topology;
mod watch;
mod way_back;
mod which_cycle;
mod windows;
