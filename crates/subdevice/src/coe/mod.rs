//! The CoE server: SDO transfers and the description of the dictionary.
//!
//! [`server`] takes a request apart and holds the transfer that is under way, [`information`] answers
//! what the dictionary consists of.

mod information;
mod server;

pub(crate) use server::{Outcome, Server};
