//! The CoE server: SDO transfers and the description of the dictionary.
//!
//! [`server`] parses requests and keeps the present transfer; [`information`] answers requests
//! about the dictionary.

mod information;
mod server;

pub(crate) use server::{Outcome, Server};
