//! What a rule looked at: expected and found.

use schemars::JsonSchema;
use serde::Serialize;

/// Something that was looked at.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Evidence {
    /// Where: object, register, situation.
    pub place: String,
    /// What had to be there.
    pub expected: String,
    /// What was.
    pub found: String,
    /// Whether that is right.
    pub right: bool,
}
