//! The rules, as data.

use super::case::{Case, Done};

mod access;
mod counters;
mod modes;
mod objects;
mod recovery;
mod states;
mod times;

/// A requirement on a SubDevice.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// Its permanent name: group and number.
    pub id: &'static str,
    /// The requirement in one sentence.
    pub what: &'static str,
    /// Where the requirement is written: object, register, section.
    pub source: &'static str,
    /// The SubDevices that it applies to.
    pub applies: &'static str,
    /// How it is tried.
    pub check: Check,
}

/// How a rule is tried.
#[derive(Clone, Copy, Debug)]
pub enum Check {
    /// The check runs once.
    Once(fn(&mut Case<'_, '_>) -> Done),
    /// The check runs in each mode that the SubDevice announces.
    EachMode(fn(&mut Case<'_, '_>) -> Done),
}

/// All rules, in the order in which they are tried.
pub fn all() -> impl Iterator<Item = &'static Rule> {
    [
        objects::RULES,
        access::RULES,
        modes::RULES,
        states::RULES,
        counters::RULES,
        times::RULES,
        recovery::RULES,
    ]
    .into_iter()
    .flatten()
}
