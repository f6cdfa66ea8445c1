//! What a rule looked at: expected and found.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// One thing that was looked at.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Evidence {
    /// Where: object, register or situation.
    pub place: String,
    /// The expected value.
    pub expected: String,
    /// The value that was found.
    pub found: String,
    /// Whether the found value is right.
    pub right: bool,
}
