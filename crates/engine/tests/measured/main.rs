//! What is measured of devices: the laws of their drift loops, their times, and where a reading
//! ends.

mod calibrate;
mod calibrate_jitter;
mod dynamic_times;
mod end_reading;
mod rescue;
