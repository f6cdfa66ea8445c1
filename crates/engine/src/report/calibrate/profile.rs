//! What was told of a chip, as keys of a device profile.

use super::{CalibrationReport, Device};

/// Why there is no fragment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NoFragment {
    /// No device has this position, or its law and sign were not told.
    NotTold(usize),
    /// Several clocks were told, and they differ.
    Differ(Vec<usize>),
    /// Of no clock were law and sign told.
    None,
}

impl std::fmt::Display for NoFragment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotTold(position) => {
                write!(f, "position {position}: no clock whose law and sign of 0x092C were told")
            }
            Self::Differ(positions) => write!(
                f,
                "the clocks of positions {positions:?} differ; expected --device to say whose profile it is"
            ),
            Self::None => f.write_str("of no clock were law and sign of 0x092C told"),
        }
    }
}

impl CalibrationReport {
    /// The section `[esc]` of a device profile, without its other keys: of the clock at `position`,
    /// or of all clocks if they are alike.
    pub fn profile(&self, position: Option<usize>) -> Result<String, NoFragment> {
        let wanted = |device: &&Device| position.is_none_or(|position| device.position == position);
        let told: Vec<(&Device, String)> = self
            .devices
            .iter()
            .filter(wanted)
            .filter_map(|device| Some((device, keys(device)?)))
            .collect();
        let Some((first, keys)) = told.first() else {
            return Err(position.map_or(NoFragment::None, NoFragment::NotTold));
        };
        if told.iter().any(|(_, other)| other != keys) {
            return Err(NoFragment::Differ(
                told.iter().map(|(device, _)| device.position).collect(),
            ));
        }
        let mut text = format!(
            "# Measured by isocat calibrate on {}, position {}, ESC type 0x{:02X}.\n\
             # These keys belong into the section [esc] of a device profile.\n",
            self.place.replace(char::is_control, " "),
            first.position,
            first.esc_type
        );
        let law = first.law.as_ref().and_then(|law| law.fits.first());
        if let Some(fit) = law {
            text += &format!("# Misfit {:.2} standard deviations", fit.misfit);
            if let Some(phase) = &fit.phase {
                text += &format!(", phase {:.3} +- {:.3}", phase.value, phase.error);
            }
            text += ".\n";
        }
        Ok(text + "[esc]\n" + keys)
    }
}

/// The keys of one clock; `None` if something of it was not told.
fn keys(device: &Device) -> Option<String> {
    let law = device.law.as_ref()?;
    let mut text = format!("drift_law = \"{}\"\n", law.name?);
    if let Some(phase) = law.phase {
        text += &format!("drift_phase = {phase}\n");
    }
    Some(text + &format!("difference_polarity = \"{}\"\n", device.difference_polarity?))
}
