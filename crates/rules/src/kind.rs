//! Kinds of findings, declared once: a stable name, its meaning, and its figures.
//!
//! A program that reads a finding uses its kind and its figures; the sentence next to them is for
//! people and may change. [`kinds!`](crate::kinds) declares an enum of kinds. The names, the
//! figures and the table in the documentation come from this declaration.

use alloc::string::{String, ToString};

use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatus, AlStatusCode, ObjectAddress};

/// One figure of a finding.
#[derive(Clone, PartialEq, Debug)]
pub enum Figure {
    /// A count, a code or a time in whole ns.
    Integer(i64),
    /// A time in ns with decimals for the ps.
    Real(f64),
    /// Yes or no.
    Flag(bool),
    /// A name: a state, an object, an interface.
    Text(String),
    /// Unknown or not applicable.
    Absent,
}

/// A type of figures.
pub trait Figured {
    /// Suffix of the name of such a figure: `_ns` for times.
    const UNIT: &'static str = "";
    /// The figure.
    fn figure(&self) -> Figure;
}

/// A kind, as the documentation describes it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Description {
    /// The name.
    pub name: &'static str,
    /// What it means.
    pub means: &'static str,
    /// Its figures.
    pub figures: &'static [FigureDescription],
}

/// A figure of a kind, as the documentation describes it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FigureDescription {
    /// The name, without its unit.
    pub name: &'static str,
    /// The unit that is the suffix of the name.
    pub unit: &'static str,
    /// Its meaning.
    pub means: &'static str,
}

/// Declares an enum of kinds.
///
/// Each variant has a name in kebab case and its figures as fields. The enum gets `name`, `figures`
/// and `DESCRIPTIONS`.
#[macro_export]
macro_rules! kinds {
    (
        $(#[$outer:meta])*
        $vis:vis enum $kinds:ident {
            $(
                $(#[doc = $means:literal])+
                $kind:ident = $name:literal $({
                    $( $(#[doc = $tells:literal])+ $figure:ident: $type:ty ),+ $(,)?
                })?
            ),+ $(,)?
        }
    ) => {
        $(#[$outer])*
        $vis enum $kinds {
            $(
                $(#[doc = $means])+
                $kind $({ $( $(#[doc = $tells])+ $figure: $type ),+ })?
            ),+
        }

        impl $kinds {
            /// Each kind with its figures, in the order of the declaration.
            pub const DESCRIPTIONS: &'static [$crate::kind::Description] = &[
                $($crate::kind::Description {
                    name: $name,
                    means: concat!($($means),+),
                    figures: &[$($($crate::kind::FigureDescription {
                        name: stringify!($figure),
                        unit: <$type as $crate::kind::Figured>::UNIT,
                        means: concat!($($tells),+),
                    }),+)?],
                }),+
            ];

            /// The name of the kind. It stays the same even if the sentence changes.
            pub const fn name(&self) -> &'static str {
                match self {
                    $(Self::$kind { .. } => $name),+
                }
            }

            /// The figures by name, including the unit.
            pub fn figures(&self) -> $crate::kind::Figures {
                #[allow(unused_mut, reason = "an enum may have kinds without figures only")]
                let mut figures = $crate::kind::Figures::default();
                match self {
                    $(Self::$kind $({ $($figure),+ })? => {
                        $($(figures.push(stringify!($figure), $figure);)+)?
                    })+
                }
                figures
            }
        }
    };
}

/// The figures of a finding, in the order of their declaration.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Figures(alloc::vec::Vec<(String, Figure)>);

impl Figures {
    /// Appends a figure.
    pub fn push<T: Figured>(&mut self, name: &str, figure: &T) {
        self.0.push((alloc::format!("{name}{}", T::UNIT), figure.figure()));
    }

    /// Each figure with its name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Figure)> {
        self.0.iter().map(|(name, figure)| (name.as_str(), figure))
    }
}

macro_rules! integers {
    ($($type:ty),+) => {
        $(impl Figured for $type {
            fn figure(&self) -> Figure {
                Figure::Integer(i64::try_from(*self).unwrap_or(i64::MAX))
            }
        })+
    };
}

integers!(u8, u16, u32, u64, usize, i64);

impl Figured for bool {
    fn figure(&self) -> Figure {
        Figure::Flag(*self)
    }
}

impl Figured for String {
    fn figure(&self) -> Figure {
        Figure::Text(self.clone())
    }
}

impl Figured for Nanos {
    const UNIT: &'static str = "_ns";
    fn figure(&self) -> Figure {
        Figure::Integer(self.0)
    }
}

impl Figured for Picos {
    const UNIT: &'static str = "_ns";
    fn figure(&self) -> Figure {
        Figure::Real(self.0 as f64 / 1000.0)
    }
}

impl Figured for AlStatusCode {
    fn figure(&self) -> Figure {
        Figure::Integer(self.0.into())
    }
}

impl Figured for AlState {
    fn figure(&self) -> Figure {
        Figure::Text(self.name().to_string())
    }
}

impl Figured for AlStatus {
    fn figure(&self) -> Figure {
        Figure::Text(self.to_string())
    }
}

impl Figured for ObjectAddress {
    fn figure(&self) -> Figure {
        Figure::Text(self.to_string())
    }
}

impl<T: Figured> Figured for Option<T> {
    const UNIT: &'static str = T::UNIT;
    fn figure(&self) -> Figure {
        self.as_ref().map_or(Figure::Absent, T::figure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    kinds! {
        /// Of a test.
        #[derive(Clone, Debug)]
        enum Kind {
            /// Nothing
            /// is known.
            Bare = "bare",
            /// A time.
            Late = "came-late" {
                /// By how much.
                by: Nanos,
                /// At most.
                limit: Option<Picos>,
            },
        }
    }

    #[test]
    fn names_and_figures_come_from_the_declaration() {
        let late = Kind::Late { by: Nanos(-3), limit: Some(Picos(1_500)) };
        assert_eq!((Kind::Bare.name(), late.name()), ("bare", "came-late"));
        let figures = late.figures();
        let expected = [("by_ns", &Figure::Integer(-3)), ("limit_ns", &Figure::Real(1.5))];
        assert_eq!(figures.iter().collect::<alloc::vec::Vec<_>>(), expected);
        assert_eq!(Kind::Bare.figures(), Figures::default());
        let [bare, late] = Kind::DESCRIPTIONS else { panic!("two kinds") };
        assert_eq!((bare.means, bare.figures.len()), (" Nothing is known.", 0));
        assert_eq!((late.figures[1].name, late.figures[1].unit), ("limit", "_ns"));
    }

    #[test]
    fn a_number_beyond_the_range_saturates() {
        assert_eq!(u64::MAX.figure(), Figure::Integer(i64::MAX));
        assert_eq!(None::<u16>.figure(), Figure::Absent);
    }
}
