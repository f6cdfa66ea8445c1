//! What must hold of arbitrary bytes at each door of the command: they are taken or refused with a
//! place, and nothing panics. The fuzz targets in `fuzz/` share these checks.

use isocat_captures::annotating::Annotated;
use isocat_captures::reading::Reading;
use isocat_descriptions::FileError;
use isocat_descriptions::eni::Eni;
use isocat_descriptions::esi::{EsiFile, ModuleAt};
use isocat_descriptions::limits;
use isocat_descriptions::sii::SiiFile;
use isocat_diagnose::{Around, DiagnoseReport, Diagnosis, Names};
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
                // The same with its slots full.
                let Some(slots) = &device.slots else { continue };
                let full = slots.places().filter_map(|place| {
                    let module = file.modules.iter().find(|module| place.slot.takes(module))?;
                    Some(ModuleAt { place: place.number, module })
                });
                let fitted = file.fitted(device, &full.collect::<Vec<_>>());
                if let Err(refused) = Profile::from_esi(&file, &fitted, None) {
                    placed(&refused.error);
                }
            }
            file.refused.iter().for_each(placed);
        }
        Err(error) => placed(&error),
    }
}

/// The content of an EEPROM.
pub fn sii(bytes: &[u8]) {
    let file = match SiiFile::from_bytes("x.bin", bytes) {
        Ok(file) => file,
        // A binary file has no lines; the word stands in the message.
        Err(error) => return assert!(error.to_string().starts_with("x.bin")),
    };
    assert!(!file.text().is_empty() && file.used <= file.image.len());
    let as_esi = EsiFile::of_sii(&file);
    for device in &as_esi.devices {
        let modes = device.op_modes().len().min(4);
        for mode in (0..modes).map(Some).chain([None]) {
            if let Ok(profile) = Profile::from_esi(&as_esi, device, mode) {
                assert_eq!(profile.with_sii(&file.image).sii.len() % 2, 0);
            }
        }
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
        if let Ok(mut report) = diagnosis.report(&Names::default()) {
            if let Some(mut around) = Around::new(&report) {
                around.read("x.pcapng", bytes).expect("what was read once is read again");
                around.end(&mut report);
            }
            annotated(bytes, &reading, &report);
            assert!(!report.text().is_empty());
            let packets: usize = report.captures.iter().map(|capture| capture.packets).sum();
            assert!(report.findings.iter().all(|one| (1..=packets).contains(&one.frame.frame)));
        }
    }
}

/// A copy with comments has the frames of the original. It may have more: a block that only looks
/// wrong inside is copied as it is.
fn annotated(bytes: &[u8], reading: &Reading, report: &DiagnoseReport) {
    let mut copy = Annotated::new(Vec::new());
    let copied = copy.add(bytes, &report.comments()[0]).expect("what was read once is read again");
    assert!(copied.packets >= reading.tally.packets, "{copied:?}");
    let copy = copy.finish().expect("memory takes it");
    let again = Reading::of(&copy).expect("a capture");
    assert!(again.frames.len() >= reading.frames.len(), "{} frames", again.frames.len());
    for (one, other) in again.frames.iter().zip(&reading.frames) {
        assert_eq!((one.number, &one.bytes), (other.number, &other.bytes));
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
