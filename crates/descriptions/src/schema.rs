//! JSON schemas of the documents that isocat writes.

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::{Value, json};

/// The schema of a document, draft 2020-12. Its `$id` follows from the form of the document:
/// `urn:isocat:run-report:8` for `isocat-run-report/8`, so that a program that keeps schemas of
/// several versions can tell them apart.
pub fn of<T: JsonSchema>(format: &str) -> Value {
    let mut schema =
        SchemaSettings::draft2020_12().for_serialize().into_generator().into_root_schema_for::<T>();
    schema.insert("$id".to_owned(), json!(id(format)));
    schema.to_value()
}

/// The name of a form as a URN.
fn id(format: &str) -> String {
    let name = format.strip_prefix("isocat-").unwrap_or(format);
    format!("urn:isocat:{}", name.replace('/', ":"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_id_names_document_and_version() {
        assert_eq!(id("isocat-run-report/8"), "urn:isocat:run-report:8");
        let schema = of::<u32>("isocat-run-report/8");
        assert_eq!(schema["$id"], "urn:isocat:run-report:8");
        assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    }
}
