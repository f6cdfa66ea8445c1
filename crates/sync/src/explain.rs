//! The meaning of codes, objects, registers, modes, symptoms and terms for an engineer who looks
//! for a fault: in plain words, with the usual causes in order of likelihood, what to read next and
//! what to change.
//!
//! These are constant tables, one file for each kind. [`al_codes`], [`aborts`] and [`soe_codes`]
//! have an entry for every code that the project's own SubDevice or MainDevice can send.

pub mod aborts;
pub mod al_codes;
pub mod assign_activate;
pub mod modes;
pub mod objects;
pub mod registers;
pub mod soe_codes;
pub mod symptoms;
pub mod terms;

/// The explanation of one code, object, register, mode or symptom. Each list begins with the item
/// that is most worth trying.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Entry {
    /// What it means, in sentences.
    pub means: &'static str,
    /// The usual causes, likeliest first; empty if there is no fault.
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
