//! Frames out of anybody's captures, and which of them belong together.
//!
//! Data's way: [`reading`] takes the packets of a pcapng or pcap file one after the other, and
//! [`link`] makes Ethernet frames of them, whatever link they were captured on. [`pairing`] finds
//! which frame is the answer to which request, and says how the tap saw the segment. All of it
//! streams: memory is bounded, however long the capture is. [`annotating`] copies captures, with
//! comments at their packets; [`probe`] knows what hardware probes put into packets.
#![forbid(unsafe_code)]

pub mod annotating;
pub mod link;
pub mod pairing;
pub mod probe;
pub mod reading;
