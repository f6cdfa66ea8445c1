//! Segment files and profiles: every key, what is written of devices, and that clocks lock in
//! what they describe.

mod clocks_lock;
mod keys;
mod written_profiles;
