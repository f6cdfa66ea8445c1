//! Typed values as their names, in both directions: a status is written by one program and read by another.

/// A moment of the cycle.
pub mod moment {
    use isocat_sync::Moment;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(moment: &Moment, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(moment.name())
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Moment, D::Error> {
        let name = String::deserialize(from)?;
        Moment::of_name(&name).ok_or_else(|| D::Error::custom(format!("\"{name}\" is no moment")))
    }
}
