//! Hardware probes that add to each packet the instant at which the frame passed them.
//!
//! The known header is that of the EtherCAT Switch Link (ESL), as the ET2000 writes it: sixteen
//! bytes before or after the frame. Six bytes identify it (01 01 05 10 00 00, or 11 in place of
//! 10), two hold the port and errors, and eight the instant in ns, lower byte first. Wireshark's
//! dissector `esl` reads the same.

use std::str::FromStr;
use std::time::Duration;

/// A kind of probe.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Probe {
    /// EtherCAT Switch Link: `esl`.
    Esl,
}

impl FromStr for Probe {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "esl" | "et2000" => Ok(Self::Esl),
            other => Err(format!("{other:?} is no known probe; expected esl or et2000")),
        }
    }
}

/// The offset of a probe's clock from the stamps of the file: the clock may begin at any value.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clock {
    /// The probe's instant of its first frame, ns, and the stamp of that packet.
    first: Option<(u64, Duration)>,
}

impl Clock {
    /// Removes the header from a packet; returns when the frame passed the probe. `None`: the
    /// packet has no such header, and is left unchanged.
    pub fn take(
        &mut self,
        Probe::Esl: Probe,
        at: Duration,
        bytes: &mut Vec<u8>,
    ) -> Option<Duration> {
        let behind = bytes.len().checked_sub(HEADER)?;
        let header = [0, behind].into_iter().find(|place| is_header(&bytes[*place..]))?;
        let stamp = bytes.get(header + STAMP..)?.first_chunk().copied()?;
        bytes.drain(header..header + HEADER);
        let now = u64::from_le_bytes(stamp);
        let (then, first) = *self.first.get_or_insert((now, at));
        let since = now.wrapping_sub(then).cast_signed();
        let distance = Duration::from_nanos(since.unsigned_abs());
        Some(match since {
            0.. => first.saturating_add(distance),
            _ => first.saturating_sub(distance),
        })
    }
}

fn is_header(bytes: &[u8]) -> bool {
    matches!(bytes, [0x01, 0x01, 0x05, 0x10 | 0x11, 0, 0, ..])
}

/// Length of the header, bytes.
const HEADER: usize = 16;
/// Offset of the instant in the header.
const STAMP: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;

    fn header(kind: u8, stamp: u64) -> Vec<u8> {
        let mut header = vec![1, 1, 5, kind, 0, 0, 0x80, 0x20];
        header.extend(stamp.to_le_bytes());
        header
    }

    #[test]
    fn headers_before_and_behind_the_frame() {
        let mut clock = Clock::default();
        let at = Duration::from_secs(100);
        let frame = vec![7; 60];
        for (kind, stamp, before, expected) in [
            (0x10, 5_000, true, at),
            // From here on the stamps of the file do not count.
            (0x11, 6_010, false, at + Duration::from_nanos(1_010)),
            (0x10, 4_999, true, at - Duration::from_nanos(1)),
        ] {
            let header = header(kind, stamp);
            let mut bytes = match before {
                true => [&header[..], &frame].concat(),
                false => [&frame[..], &header].concat(),
            };
            let late = at + Duration::from_millis(9);
            let stamped = if stamp == 5_000 { at } else { late };
            assert_eq!(clock.take(Probe::Esl, stamped, &mut bytes), Some(expected));
            assert_eq!(bytes, frame);
        }
    }

    #[test]
    fn what_has_no_header_stays_as_it_is() {
        let mut clock = Clock::default();
        for bytes in [vec![], header(0x10, 1)[..15].to_vec(), header(0x12, 1), vec![0; 60]] {
            let mut same = bytes.clone();
            assert_eq!(clock.take(Probe::Esl, Duration::ZERO, &mut same), None);
            assert_eq!(same, bytes);
        }
    }

    #[test]
    fn names() {
        assert_eq!(("esl".parse(), "et2000".parse()), (Ok(Probe::Esl), Ok(Probe::Esl)));
        assert!("profishark".parse::<Probe>().is_err_and(|error| error.contains("expected esl")));
    }
}
