//! What devices of one kind of ESC may have different: the law of the drift loop, the sign of its
//! difference.

use std::sync::{Mutex, PoisonError};

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::{Key, Keys, Kind, Need, Word};
use isocat_esc::DriftLaw;
use isocat_esc::chip::Chip;
use isocat_wire::dc::DifferencePolarity;

/// The laws of the drift loop that files can name.
pub(crate) static LAWS: [Word<DriftLaw>; 3] = [
    (
        "hold",
        "The speed follows what a difference grows, the phase by small steps. Agrees with all that is public",
        DriftLaw::HOLD,
    ),
    (
        "block",
        "As hold, but the speed changes once in as many drift frames as the filter is deep",
        DriftLaw::BLOCK,
    ),
    (
        "proportional",
        "A proportional and integral controller. Contradicts the public record, for comparison",
        DriftLaw::PROPORTIONAL,
    ),
];

/// What bit 31 of register 0x092C may mean.
pub(crate) static POLARITIES: [Word<DifferencePolarity>; 2] = [
    (
        "positive-ahead",
        "Bit 31 = 0: the local clock is ahead (older register texts, captured on an ET1100)",
        DifferencePolarity::PositiveAhead,
    ),
    (
        "negative-ahead",
        "Bit 31 = 1: the local clock is ahead (newer register texts)",
        DifferencePolarity::NegativeAhead,
    ),
];

/// Key `drift_phase`, which stands beside `drift_law` in segment files and profiles.
pub(crate) const DRIFT_PHASE: Key = Key {
    name: "drift_phase",
    kind: Kind::Integer { least: 0, most: MOST_PHASE },
    need: Need::Without("10 with hold, 9 with block"),
    means: "Part of the phase that a drift frame corrects, as the exponent n of 1 / 2^n. `isocat calibrate` \
            measures it.",
    goes: "the laws hold and block of the simulated clocks",
    example: "11",
};
/// The model of the clock has 20 fraction bits.
const MOST_PHASE: i64 = 20;

/// The law that `drift_law` and `drift_phase` ask for; `usual` is the one without `drift_law`.
/// `None` without both keys. `drift_phase` is refused for a law without such a part.
pub(crate) fn asked_law(keys: &Keys<'_>, usual: DriftLaw) -> Result<Option<DriftLaw>, FileError> {
    let named = keys.find_choice("drift_law", &LAWS)?;
    let Some(phase) = keys.find::<i64>("drift_phase")? else { return Ok(named) };
    let phase = phase as u8;
    match named.unwrap_or(usual) {
        DriftLaw::Hold { .. } => Ok(Some(DriftLaw::Hold { phase })),
        DriftLaw::Block { .. } => Ok(Some(DriftLaw::Block { phase })),
        DriftLaw::Proportional { .. } => {
            let found = "drift_phase beside the law proportional";
            let expected = "expected the law hold or block, which have such a part";
            Err(keys.error_at("drift_phase", format!("{found}; {expected}")))
        }
    }
}

/// One and the same reference for equal chips, so that no more of them are kept than differ.
pub(crate) fn interned(chip: Chip) -> &'static Chip {
    static KNOWN: Mutex<Vec<&'static Chip>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(same) = known.iter().find(|known| ***known == chip) {
        return same;
    }
    let chip: &'static Chip = Box::leak(Box::new(chip));
    known.push(chip);
    chip
}

/// The same chip with another law of its drift loop.
pub(crate) fn with_law(chip: &'static Chip, law: Option<DriftLaw>) -> &'static Chip {
    match law {
        Some(law) if law != chip.drift_law => interned(Chip { drift_law: law, ..*chip }),
        _ => chip,
    }
}
