//! The rules, as data.

use super::case::{Case, Done};

mod access;
mod counters;
mod modes;
mod objects;
mod recovery;
mod states;
mod times;

/// Something that a SubDevice has to do.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    /// Name that stays: group and number.
    pub id: &'static str,
    /// One sentence.
    pub what: &'static str,
    /// Where it is written: object, register, section.
    pub source: &'static str,
    /// Whom it concerns.
    pub applies: &'static str,
    /// How it is tried.
    pub check: Check,
}

/// How a rule is tried.
#[derive(Clone, Copy, Debug)]
pub enum Check {
    /// Once.
    Once(fn(&mut Case<'_, '_>) -> Done),
    /// In each mode that the SubDevice announces.
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
