//! Faults as text: one line each, in the same form in segment files, over the control socket, and
//! elsewhere.
//!
//! A line is a word of [`WORDS`] and its arguments, then `for` and a time if it is to end: `pull
//! axis 2 for 500ms`, `loss 0.5% burst 3 back`, `misbehave 3 missed-copy 7 for 2s`. A SubDevice is
//! named by its name or its position.

use std::fmt;
use std::sync::Arc;

use isocat_descriptions::document::name_hint;
use isocat_sim::Fault;
use isocat_wire::time::Nanos;

use crate::profile::Profile;

mod arguments;
mod words;

pub use words::{WORDS, Word};

use arguments::Arguments;

/// A requested fault, and its duration.
#[derive(Clone, Debug)]
pub struct Order {
    /// The fault. A replacement SubDevice is spare 0 until the caller numbers it.
    pub fault: Fault,
    /// Duration; `None`: until another fault ends it.
    pub lasts: Option<Nanos>,
    /// The replacement device.
    pub spare: Option<Arc<Profile>>,
}

impl Order {
    /// Reads a line; `names` are those of the SubDevices, by position.
    pub fn parse(text: &str, names: &[String]) -> Result<Self, String> {
        let mut arguments = Arguments::of(text, names);
        let verb = arguments.next().unwrap_or_default();
        let Some(word) = WORDS.iter().find(|word| word.name == verb) else {
            let all = WORDS.iter().map(|word| word.name);
            return Err(format!("unknown fault \"{verb}\"; {}", name_hint(verb, all)));
        };
        let order = (word.read)(&mut arguments).map_err(|wrong| wrong.of(word))?;
        let lasts = arguments.lasts().map_err(|wrong| wrong.of(word))?;
        if let Some(rest) = arguments.next() {
            let why = match rest {
                "burst" => ": it goes with a share, and a number of frames is one burst",
                _ => "",
            };
            return Err(Wrong(format!("\"{rest}\" is too much{why}")).of(word));
        }
        let order = Self { lasts: lasts.or(order.lasts), ..order };
        match (&order.lasts, order.fault.can_end()) {
            (Some(_), false) => Err(format!("{verb} does not last; expected no \"for\"")),
            (None, _) if order.fault == Fault::Stall => {
                Err("stall needs its time, such as \"stall 20ms\"".to_owned())
            }
            _ => Ok(order),
        }
    }
}

impl From<Fault> for Order {
    fn from(fault: Fault) -> Self {
        Self { fault, lasts: None, spare: None }
    }
}

/// The fault in words: `SubDevice 2 is off, for 500 ms`.
impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.fault.fmt(f)?;
        match self.lasts {
            Some(lasts) => write!(f, ", for {lasts}"),
            None => Ok(()),
        }
    }
}

/// Error in the arguments of a word.
#[derive(Debug)]
pub struct Wrong(String);

impl Wrong {
    fn of(self, word: &Word) -> String {
        let form = format!("{} {}", word.name, word.form);
        format!("{}; expected \"{}\"", self.0, form.trim_end())
    }
}

#[cfg(test)]
mod tests;
