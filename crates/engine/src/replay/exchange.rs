//! The exchanges of a whole capture, and what was left out.

use isocat_captures::pairing::{Pairing, Tally};
use isocat_captures::reading::Frame;

/// A frame that was sent, and its answer.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Exchange {
    /// Number of the request in the file.
    pub request_number: usize,
    /// Number of the answer, and the answer; `None` if it is not in the file.
    pub answer: Option<(usize, Vec<u8>)>,
    /// Time of the request, ns from the first frame of the file.
    pub at: u64,
    /// The request.
    pub request: Vec<u8>,
}

/// The content of a capture.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Exchanges {
    /// The exchanges in the order of the requests; answers without a request are only counted.
    pub list: Vec<Exchange>,
    /// What was left out.
    pub tally: Tally,
}

impl Exchanges {
    /// Pairs the frames of a capture.
    pub fn of(frames: &[Frame]) -> Self {
        let mut pairing = Pairing::new();
        for frame in frames {
            pairing.push(frame.clone());
        }
        pairing.end();
        let mut list = Vec::new();
        let mut first = None;
        while let Some(exchange) = pairing.exchange() {
            let Some(request) = exchange.request else { continue };
            let begin = *first.get_or_insert(request.at);
            let at = request.at.saturating_sub(begin).as_nanos();
            list.push(Exchange {
                request_number: request.number,
                answer: exchange.answer.map(|answer| (answer.number, answer.bytes)),
                at: u64::try_from(at).unwrap_or(u64::MAX),
                request: request.bytes,
            });
        }
        Self { list, tally: pairing.tally() }
    }

    /// Requests whose answer is not in the file.
    pub fn unanswered(&self) -> usize {
        self.tally.unanswered
    }
}
