//! The messages of Perfetto's trace format (protobuf) that are written, with the field numbers of
//! its published schema.
//!
//! [`packet`] is all that writes: a dozen fields of five messages need no library. The tests of the
//! command read traces back with one (`crates/isocat/tests/recordings/trace/schema.rs`).

/// `perfetto.protos.TracePacket`: one event or one description of a track.
#[derive(Default)]
pub struct TracePacket {
    /// In ns.
    pub timestamp: Option<u64>,
    pub trusted_packet_sequence_id: Option<u32>,
    pub track_event: Option<TrackEvent>,
    pub track_descriptor: Option<TrackDescriptor>,
}

/// `perfetto.protos.TrackDescriptor`.
#[derive(Default)]
pub struct TrackDescriptor {
    pub uuid: Option<u64>,
    pub name: Option<String>,
    pub process: Option<ProcessDescriptor>,
    pub parent_uuid: Option<u64>,
    pub counter: Option<CounterDescriptor>,
    /// Order of its children; see [`EXPLICIT`].
    pub child_ordering: Option<i32>,
    pub sibling_order_rank: Option<i32>,
}

/// `TrackDescriptor.ChildTracksOrdering.EXPLICIT`: children are sorted by their ranks.
pub const EXPLICIT: i32 = 3;

/// `perfetto.protos.ProcessDescriptor`.
pub struct ProcessDescriptor {
    pub pid: i32,
    pub process_name: String,
}

/// `perfetto.protos.CounterDescriptor`.
pub struct CounterDescriptor {
    pub unit_name: String,
}

/// `perfetto.protos.TrackEvent`.
#[derive(Default)]
pub struct TrackEvent {
    pub r#type: Option<Type>,
    pub track_uuid: Option<u64>,
    pub name: Option<String>,
    pub counter_value: Option<i64>,
    pub double_counter_value: Option<f64>,
}

/// `perfetto.protos.TrackEvent.Type`.
#[derive(Clone, Copy)]
#[repr(u8)]
pub enum Type {
    SliceBegin = 1,
    SliceEnd = 2,
    Instant = 3,
    Counter = 4,
}

/// Appends a `perfetto.protos.Trace` with this one packet; fields are ordered by their numbers.
pub fn packet(packet: &TracePacket, output: &mut Vec<u8>) {
    message(1, output, |output| {
        number(8, packet.timestamp, output);
        number(10, packet.trusted_packet_sequence_id.map(u64::from), output);
        if let Some(event) = &packet.track_event {
            message(11, output, |output| event.fields(output));
        }
        if let Some(descriptor) = &packet.track_descriptor {
            message(60, output, |output| descriptor.fields(output));
        }
    });
}

impl TrackDescriptor {
    fn fields(&self, output: &mut Vec<u8>) {
        number(1, self.uuid, output);
        text(2, self.name.as_deref(), output);
        if let Some(process) = &self.process {
            message(3, output, |output| {
                number(1, Some(signed(process.pid.into())), output);
                text(6, Some(&process.process_name), output);
            });
        }
        number(5, self.parent_uuid, output);
        if let Some(counter) = &self.counter {
            message(8, output, |output| text(6, Some(&counter.unit_name), output));
        }
        number(11, self.child_ordering.map(|order| signed(order.into())), output);
        number(12, self.sibling_order_rank.map(|rank| signed(rank.into())), output);
    }
}

impl TrackEvent {
    fn fields(&self, output: &mut Vec<u8>) {
        number(9, self.r#type.map(|kind| kind as u64), output);
        number(11, self.track_uuid, output);
        text(23, self.name.as_deref(), output);
        number(30, self.counter_value.map(signed), output);
        if let Some(value) = self.double_counter_value {
            tag(44, EIGHT_BYTES, output);
            output.extend(value.to_le_bytes());
        }
    }
}

/// How the value of a field is written, the lower three bits of its tag.
const VARINT: u64 = 0;
const EIGHT_BYTES: u64 = 1;
const WITH_LENGTH: u64 = 2;

fn tag(field: u64, form: u64, output: &mut Vec<u8>) {
    varint(field << 3 | form, output);
}

fn number(field: u64, value: Option<u64>, output: &mut Vec<u8>) {
    if let Some(value) = value {
        tag(field, VARINT, output);
        varint(value, output);
    }
}

fn text(field: u64, value: Option<&str>, output: &mut Vec<u8>) {
    if let Some(value) = value {
        tag(field, WITH_LENGTH, output);
        varint(value.len() as u64, output);
        output.extend_from_slice(value.as_bytes());
    }
}

/// A message in another one. Its length stands before it and is known behind it, so the bytes of
/// the length are written there and moved to the front.
fn message(field: u64, output: &mut Vec<u8>, fields: impl FnOnce(&mut Vec<u8>)) {
    tag(field, WITH_LENGTH, output);
    let begin = output.len();
    fields(output);
    let length = output.len() - begin;
    varint(length as u64, output);
    let bytes_of_length = output.len() - begin - length;
    output[begin..].rotate_right(bytes_of_length);
}

/// Negative numbers take all 64 bits.
fn signed(value: i64) -> u64 {
    value as u64
}

/// Seven bits a byte, the lowest first; the eighth bit says that more follow.
fn varint(mut value: u64, output: &mut Vec<u8>) {
    while value >= 0x80 {
        output.push(value as u8 | 0x80);
        value >>= 7;
    }
    output.push(value as u8);
}
