//! Turns the report into comments on the packets of the captures.

use isocat_captures::annotating::Comments;

use super::text::switched;
use super::{DeviceReport, DiagnoseReport, FrameRef, StateReport, WeightKind};
use crate::words;

impl DiagnoseReport {
    /// Comments for a copy of the captures, by capture: findings, the frames that belong to them,
    /// states of devices, switches of SYNC units and the number of SubDevices that frames pass.
    /// Frame numbers in the text count over all captures, as in the copy, where the captures follow
    /// one another.
    pub fn comments(&self) -> Vec<Comments> {
        let mut all = vec![Comments::new(); self.captures.len()];
        let mut say = |at: FrameRef, what: String| {
            if let Some(comments) = all.get_mut(at.capture) {
                comments.entry(at.frame).or_default().push(format!("isocat: {what}"));
            }
        };
        for finding in &self.findings {
            let weight = match finding.weight {
                WeightKind::Fault => "FAULT",
                WeightKind::Warning => "warning",
                WeightKind::Note => "note",
            };
            say(finding.frame, format!("{weight} {}: {}", finding.kind, finding.what));
            let remedy = finding.remedies.first().filter(|_| finding.weight == WeightKind::Fault);
            if let Some(remedy) = remedy {
                say(finding.frame, format!("what to do: {remedy}"));
            }
            for other in &finding.evidence {
                let number = self.number_in_copy(finding.frame);
                say(*other, format!("belongs to {} of frame {number}", finding.kind));
            }
        }
        for device in &self.devices {
            for state in &device.states {
                say(state.frame, state_of(device, state));
            }
            for sync in &device.sync {
                say(sync.frame, format!("{}: {}", device.title(), switched(sync)));
            }
        }
        for reach in &self.reach {
            let many = words::subdevices(reach.subdevices);
            say(reach.frame, format!("frames pass {many} from here on"));
        }
        all
    }

    /// The number of a frame in a copy that joins all captures.
    pub(crate) fn number_in_copy(&self, at: FrameRef) -> usize {
        let before = self.captures.iter().take(at.capture).map(|capture| capture.packets);
        before.sum::<usize>() + at.frame
    }
}

fn state_of(device: &DeviceReport, state: &StateReport) -> String {
    let code = state.code.filter(|code| *code != 0);
    let code = code.map_or(String::new(), |code| format!(", AL status code {code:#06x}"));
    let asked = state.asked.as_ref().filter(|asked| **asked != state.status);
    let asked = asked.map_or(String::new(), |asked| format!(", was asked for {asked}"));
    format!("{} is in {}{code}{asked}", device.title(), state.status)
}
