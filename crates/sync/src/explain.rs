//! What codes, objects, registers, modes and symptoms mean to somebody who looks for a fault: in plain words, with the
//! usual causes in order of likelihood, what to read next and what to change.
//!
//! Constant tables, one file for each kind; [`al_codes`], [`aborts`] and [`soe_codes`] have an entry for every code that the
//! project's own SubDevice or MainDevice can emit.

pub mod aborts;
pub mod al_codes;
pub mod assign_activate;
pub mod modes;
pub mod objects;
pub mod registers;
pub mod soe_codes;
pub mod symptoms;

/// What is known of one thing. Lists are in the order in which they are worth trying.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Entry {
    /// What it means, in sentences.
    pub means: &'static str,
    /// The usual causes, likeliest first; empty where nothing is wrong.
    pub causes: &'static [&'static str],
    /// What to read next.
    pub read: &'static [&'static str],
    /// What to change.
    pub change: &'static [&'static str],
}

const fn entry(
    means: &'static str,
    causes: &'static [&'static str],
    read: &'static [&'static str],
    change: &'static [&'static str],
) -> Entry {
    Entry { means, causes, read, change }
}

#[cfg(test)]
mod tests;
