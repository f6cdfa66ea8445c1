//! The captures, which were read one after the other, and the capture that a frame belongs to.

use isocat_captures::reading;

use crate::report::{CaptureReport, FrameRef};

/// All captures so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Files {
    list: Vec<File>,
}

#[derive(Clone, Debug)]
struct File {
    name: String,
    /// Packets of all files before it.
    before: usize,
    tally: reading::Tally,
}

impl Files {
    /// Begins the next file.
    pub fn begin(&mut self, name: &str) {
        let before = self.list.last().map_or(0, |last| last.before + last.tally.packets);
        let tally = reading::Tally::default();
        self.list.push(File { name: name.to_owned(), before, tally });
    }

    /// Counts one more packet of the present file.
    pub fn packet(&mut self) {
        if let Some(last) = self.list.last_mut() {
            last.tally.packets += 1;
        }
    }

    /// Ends the present file.
    pub fn end(&mut self, tally: reading::Tally) {
        if let Some(last) = self.list.last_mut() {
            last.tally = tally;
        }
    }

    /// The number over all files of frame `frame` of the present file.
    pub fn number(&self, frame: usize) -> usize {
        self.list.last().map_or(0, |last| last.before) + frame
    }

    /// The place of the frame with this number over all files.
    pub fn place(&self, number: usize) -> FrameRef {
        let capture = self.list.partition_point(|file| file.before < number).saturating_sub(1);
        let before = self.list.get(capture).map_or(0, |file| file.before);
        FrameRef { capture, frame: number.saturating_sub(before) }
    }

    pub fn reports(&self) -> Vec<CaptureReport> {
        let files = self.list.iter().map(|file| CaptureReport {
            name: file.name.clone(),
            packets: file.tally.packets,
            cut: file.tally.cut,
            other_links: file.tally.other_links,
            other_link: file.tally.other_link,
            ended: file.tally.ended.clone(),
        });
        files.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_numbered_through_and_found_again() {
        let mut files = Files::default();
        for (name, packets) in [("a", 10), ("b", 0), ("c", 3)] {
            files.begin(name);
            let tally = reading::Tally { packets, ..reading::Tally::default() };
            files.end(tally);
        }
        assert_eq!(files.place(1), FrameRef { capture: 0, frame: 1 });
        assert_eq!(files.place(10), FrameRef { capture: 0, frame: 10 });
        assert_eq!(files.place(11), FrameRef { capture: 2, frame: 1 });
        assert_eq!(files.number(2), 12);
    }
}
