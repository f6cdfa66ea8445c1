//! Reads frames from captures of any tool, and pairs requests with answers.
//!
//! The way of the data: [`reading`] takes the packets of a pcapng or pcap file one after the other,
//! and [`link`] turns them into Ethernet frames, whatever link they were captured on. [`pairing`]
//! finds the answer to each request, and tells how the tap saw the segment. All of it streams:
//! memory is bounded, however long the capture is. [`annotating`] copies captures with comments at
//! their packets; [`probe`] knows what hardware probes add to packets.
#![forbid(unsafe_code)]

pub mod annotating;
pub mod link;
pub mod pairing;
pub mod probe;
pub mod reading;
