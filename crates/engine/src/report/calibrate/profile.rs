//! The determined properties of chips, as keys of a device profile and as a file for `--chips`.

use super::{CalibrationReport, Device};

/// Why there is no fragment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NoFragment {
    /// No device has this position, or its law and sign were not determined.
    NotTold(usize),
    /// Several clocks were determined, and they differ.
    Differ(Vec<usize>),
    /// Law and sign were not determined for any clock.
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
    /// The section `[esc]` of a device profile, without its other keys: that of the clock at
    /// `position`, or of all clocks if they are equal.
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
        let text = format!(
            "# Measured by isocat calibrate on {}, position {}, ESC type 0x{:02X}.\n\
             # These keys belong into the section [esc] of a device profile.\n",
            self.place.replace(char::is_control, " "),
            first.position,
            first.esc_type
        );
        Ok(text + &misfit(first) + "[esc]\n" + keys)
    }

    /// The determined properties of each chip, for `--chips` of `plan`, `run` and `serve`.
    pub fn chips(&self) -> String {
        let mut text = format!(
            "# Measured by isocat calibrate on {}. Take it beside a segment file of the same devices:\n\
             # isocat run my.toml --chips THIS_FILE\n",
            self.place.replace(char::is_control, " ")
        );
        for device in &self.devices {
            text += &format!("\n# ESC type 0x{:02X}\n", device.esc_type);
            let loops = keys(device);
            if loops.is_some() {
                text += &misfit(device);
            } else if device.law.is_some() {
                text += "# Law and sign of 0x092C were not told: those of the profile stay.\n";
            }
            text += &format!("[[chip]]\nposition = {}\n", device.position);
            text += &loops.unwrap_or_default();
            text += &times(device);
        }
        text
    }
}

/// The fit of the law, as a comment.
fn misfit(device: &Device) -> String {
    let Some(fit) = device.law.as_ref().and_then(|law| law.fits.first()) else {
        return String::new();
    };
    let measured = fit.measured.as_ref().map_or_else(String::new, |measured| {
        let name = if fit.name == "proportional" { "gain" } else { "phase" };
        format!(", {name} {:.3} +- {:.3}", measured.value, measured.error)
    });
    format!("# Misfit {:.2} standard deviations{measured}.\n", fit.misfit)
}

/// The measured properties of EEPROM and ports.
fn times(device: &Device) -> String {
    let mut text = String::new();
    if let Some(read) = &device.eeprom_read {
        // A look may come late and never early.
        let (micros, late) = (read.least / 1e3, read.error / 1e3);
        let most = micros.clamp(0.0, 50_000.0).round();
        text += &format!("eeprom_read = \"{most}us\"  # up to {late:.0} us less\n");
    }
    if let Some(figure) = device.jitter.as_ref().and_then(|jitter| jitter.deviation.as_ref()) {
        // A saw tooth is as high as the root of 12 standard deviations.
        let height = |deviation: f64| (deviation * 12f64.sqrt()).round();
        let (value, error) = (height(figure.value).clamp(0.0, 1_000.0), height(figure.error));
        text += &format!("port_jitter = \"{value}ns\"  # +- {error} ns\n");
    }
    text
}

/// The keys of one clock; `None` if one of them was not determined.
fn keys(device: &Device) -> Option<String> {
    let law = device.law.as_ref()?;
    let mut text = format!("drift_law = \"{}\"\n", law.name?);
    if let Some(phase) = law.phase {
        text += &format!("drift_phase = {phase}\n");
    }
    if let Some(gain) = law.gain {
        text += &format!("drift_gain = {gain}\n");
    }
    Some(text + &format!("difference_polarity = \"{}\"\n", device.difference_polarity?))
}
