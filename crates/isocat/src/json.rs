//! Reports as JSON: in lines for readers, without blanks for pages and for events.

use serde::Serialize;

/// A document in lines.
pub fn lines(document: &impl Serialize) -> String {
    serde_json::to_string_pretty(document).expect("a document has no map keys that JSON lacks")
}

/// A document without blanks, in one line. It is made of the lines, so that the compiler makes the
/// code of each report once: a second serializer would be a second copy of all of it.
pub fn compact(document: &impl Serialize) -> String {
    let lines = lines(document);
    let mut compact = String::with_capacity(lines.len());
    let (mut in_text, mut escaped) = (false, false);
    for letter in lines.chars() {
        if in_text || !matches!(letter, ' ' | '\n') {
            compact.push(letter);
        }
        match letter {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => in_text = !in_text,
            _ => {}
        }
    }
    compact
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    #[test]
    fn both_forms_are_those_of_the_library() {
        let document = json!({
            "empty": [], "none": {}, "list": [1, [-2.5, null], { "in": { "it": [true] } }],
            "a text": "a \"quoted one\" \\, \u{7}\n and ü", "last, \\\"": {}, "\\": " ",
        });
        assert_eq!(super::lines(&document), serde_json::to_string_pretty(&document).unwrap());
        assert_eq!(super::compact(&document), serde_json::to_string(&document).unwrap());
    }
}
