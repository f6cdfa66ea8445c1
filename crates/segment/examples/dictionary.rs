//! The object dictionary of each device of a segment file, as JSON: the answers of its virtual
//! SubDevice after power-on.
//!
//! `cargo run -p isocat-segment --example dictionary SEGMENT.toml`. `tests/interop/esi_compare.py`
//! compares it with another reading of the descriptions.

use isocat_segment::SegmentFile;
use serde_json::{Value, json};

fn main() {
    let path = std::env::args().nth(1).expect("a segment file");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let segment = SegmentFile::parse(&path, &text).unwrap_or_else(|error| panic!("{error}"));
    let devices: Vec<Value> = segment
        .subdevices
        .iter()
        .map(|device| {
            let description = &device.profile.description;
            let objects = description.objects.iter();
            let objects: Vec<Value> = objects
                .map(|object| {
                    let entries = object.entries.iter();
                    let entries: Vec<Value> = entries
                        .map(|entry| {
                            let value = description.power_on(entry);
                            let value: String = value.iter().map(|b| format!("{b:02x}")).collect();
                            json!([entry.sub, entry.bits, value])
                        })
                        .collect();
                    json!({ "index": object.index, "entries": entries })
                })
                .collect();
            let left_out = device.profile.assumptions.iter();
            let left_out: Vec<String> = left_out.map(|one| format!("{one:?}")).collect();
            json!({ "objects": objects, "assumptions": left_out })
        })
        .collect();
    println!("{}", Value::from(devices));
}
