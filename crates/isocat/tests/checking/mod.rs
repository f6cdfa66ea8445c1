//! What must hold of arbitrary bytes at each door of the command: they are taken or refused with a place, and nothing
//! panics. The fuzz targets in `fuzz/` share these checks.

use isocat_captures::reading::Reading;
use isocat_descriptions::FileError;
use isocat_descriptions::eni::Eni;
use isocat_descriptions::esi::EsiFile;
use isocat_descriptions::limits;
use isocat_diagnose::{Diagnosis, Names};
use isocat_segment::SegmentFile;
use isocat_segment::profile::Profile;
use isocat_serve::Order;

/// A maker's description.
pub fn esi(bytes: &[u8]) {
    match EsiFile::from_bytes("x.xml", bytes) {
        Ok(file) => {
            for device in file.devices.iter().take(4) {
                // Made into a device, or not for a reason that has a place.
                if let Err(refused) = Profile::from_esi(&file, device, None) {
                    placed(&refused.error);
                }
            }
            file.refused.iter().for_each(placed);
        }
        Err(error) => placed(&error),
    }
}

/// A network description.
pub fn eni(bytes: &[u8]) {
    match Eni::from_bytes("x.xml", bytes) {
        Ok(eni) => assert!(!eni.json().is_empty()),
        Err(error) => placed(&error),
    }
}

/// A segment file.
pub fn segment(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match SegmentFile::parse("x.toml", text) {
        Ok(file) => assert!(!file.subdevices.is_empty()),
        Err(error) => placed(&error),
    }
}

/// A device profile.
pub fn profile(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Err(error) = Profile::from_toml("x.toml", text) {
        placed(&error);
    }
}

/// A capture.
pub fn capture(bytes: &[u8]) {
    if let Ok(reading) = Reading::of(bytes) {
        let held: usize = reading.frames.iter().map(|frame| frame.bytes.len()).sum();
        assert!(held <= bytes.len(), "{held} bytes of frames out of {} bytes", bytes.len());
        assert!(reading.frames.len() <= reading.tally.packets);
        let mut diagnosis = Diagnosis::new();
        diagnosis.read("x.pcapng", bytes).expect("what was read once is read again");
        if let Ok(report) = diagnosis.report(&Names::default()) {
            assert!(!report.text().is_empty());
            let packets: usize = report.captures.iter().map(|capture| capture.packets).sum();
            assert!(report.findings.iter().all(|one| (1..=packets).contains(&one.frame.frame)));
        }
    }
}

/// A request over the control socket.
pub fn control(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let names = ["axis 1".to_owned(), "axis 2".to_owned()];
    match Order::parse(text, &names) {
        // What is told of it names it.
        Ok(fault) => assert!(!fault.to_string().is_empty()),
        Err(words) => assert!(!words.is_empty()),
    }
}

/// An error has a place, and does not repeat a whole file.
fn placed(error: &FileError) {
    assert!(error.line > 0 && error.column > 0, "{error:?}");
    assert!(error.message.chars().count() <= limits::MESSAGE + 1, "{} bytes", error.message.len());
}
