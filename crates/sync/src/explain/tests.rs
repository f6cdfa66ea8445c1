//! Every code that can occur has its explanation, and each explanation has the parts that help.

use isocat_wire::soe::ErrorCode;
use isocat_wire::{AbortCode, AlStatusCode, ObjectAddress};
use std::format;

use super::*;
use crate::SyncMode;
use crate::object::{INPUT_PARAMETER, OUTPUT_PARAMETER};
use crate::table::SUBS;

/// Checks that the meaning is a sentence, and that there is advice.
fn complete(entry: &Entry, what: &str) {
    assert!(entry.means.ends_with(['.', ')']), "{what}: {}", entry.means);
    assert!(!entry.read.is_empty() && !entry.change.is_empty(), "{what}");
    for line in entry.causes.iter().chain(entry.read).chain(entry.change) {
        assert!(!line.is_empty() && !line.ends_with('.') && !line.contains("  "), "{what}: {line}");
    }
}

#[test]
fn every_al_status_code_is_explained() {
    assert!(al_codes::CODES.windows(2).all(|pair| pair[0].0 < pair[1].0), "ascending");
    for code in AlStatusCode::ALL {
        let entry = al_codes::explain(*code).unwrap_or_else(|| panic!("{code}"));
        complete(entry, &format!("{code}"));
        assert!(!entry.causes.is_empty(), "{code}");
    }
    assert_eq!(al_codes::CODES.len(), AlStatusCode::ALL.len(), "codes without a name");
}

#[test]
fn codes_of_makers_are_said_to_be_theirs() {
    assert_eq!(al_codes::explain(AlStatusCode(0x7FFF)), None);
    for code in [0x8000, 0xC007, 0xFFFF] {
        assert_eq!(al_codes::explain(AlStatusCode(code)), Some(&al_codes::VENDOR));
    }
    complete(&al_codes::VENDOR, "vendor");
    assert_eq!(al_codes::explain(AlStatusCode(0x0005)), None);
}

#[test]
fn every_soe_code_is_explained() {
    for code in ErrorCode::ALL {
        let entry = soe_codes::explain(*code).unwrap_or_else(|| panic!("{code}"));
        assert!(!entry.means.is_empty() && !entry.causes.is_empty(), "{code}");
        assert!(!entry.read.is_empty() && !entry.change.is_empty(), "{code}");
    }
    for unknown in [0, 0x1000, 0x7001, 0x700D, 0x800D] {
        assert_eq!(soe_codes::explain(ErrorCode(unknown)), None);
    }
}

#[test]
fn every_abort_code_is_explained() {
    assert!(aborts::CODES.windows(2).all(|pair| pair[0].0 < pair[1].0), "ascending");
    for code in AbortCode::ALL {
        let entry = aborts::explain(*code).unwrap_or_else(|| panic!("{code}"));
        complete(entry, &format!("{code}"));
        assert!(!entry.causes.is_empty(), "{code}");
    }
    assert_eq!(aborts::CODES.len(), AbortCode::ALL.len(), "codes without a name");
    assert_eq!(aborts::explain(AbortCode(0x0601_0007)), None);
}

#[test]
fn every_sub_index_of_the_tables_is_explained() {
    for index in [OUTPUT_PARAMETER, INPUT_PARAMETER] {
        for sub in SUBS {
            let (name, entry) = objects::sub_index(ObjectAddress::new(index, sub)).unwrap();
            assert!(!name.is_empty());
            complete(entry, &format!("{index:#06x}:{sub:02X}"));
        }
        assert_eq!(objects::sub_index(ObjectAddress::new(index, 0x13)), None);
    }
    for index in objects::OBJECTS {
        complete(objects::object(index).unwrap().1, &format!("{index:#06x}"));
    }
    let limit = objects::sub_index(ObjectAddress::new(0x10F1, 2)).unwrap();
    assert_eq!(limit.0, "sync error counter limit");
    let reserved = objects::sub_index(ObjectAddress::new(INPUT_PARAMETER, 0x11)).unwrap();
    assert_eq!(reserved.0, "reserved");
}

#[test]
fn registers_by_any_of_their_addresses() {
    let ascending = registers::REGISTERS.windows(2);
    assert!(ascending.clone().all(|pair| pair[0].address + pair[0].length <= pair[1].address));
    for register in &registers::REGISTERS {
        complete(&register.entry, register.name);
        let last = register.address + register.length - 1;
        for address in [register.address, last] {
            assert_eq!(registers::explain(address).map(|found| found.name), Some(register.name));
        }
    }
    assert_eq!(registers::explain(0x0917).unwrap().name, "system time");
    assert_eq!(registers::explain(0x0007), None);
    assert_eq!(registers::explain(0x09D0), None);
    assert_eq!(registers::explain(0), None);
}

#[test]
fn words_and_modes() {
    for word in assign_activate::KNOWN {
        complete(assign_activate::explain(isocat_wire::dc::AssignActivate(word)), "word");
    }
    for mode in SyncMode::ALL {
        complete(modes::explain(mode), mode.name());
    }
    let bits = |word| {
        let found = assign_activate::bits(isocat_wire::dc::AssignActivate(word));
        found.map(|(bit, _)| bit).collect::<std::vec::Vec<_>>()
    };
    assert_eq!(bits(0x0730), [4, 5, 8, 9, 10]);
    assert_eq!(bits(0), []);
}

#[test]
fn every_symptom_is_explained_and_has_names_of_its_own() {
    let mut names = std::vec::Vec::new();
    for symptom in symptoms::SYMPTOMS.iter().chain(&terms::TERMS) {
        complete(&symptom.entry, symptom.name);
        assert!(!symptom.entry.causes.is_empty(), "{}", symptom.name);
        for name in symptom.aliases.iter().chain([&symptom.name]) {
            let found = symptoms::find(name).or_else(|| terms::find(name));
            assert_eq!(found, Some(symptom), "{name}");
            names.push(*name);
        }
    }
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count, "a name stands for one symptom");
    assert_eq!(symptoms::find("Lost-Sync!"), symptoms::find("lost sync"));
    assert_eq!(symptoms::find("lost"), None);
    assert_eq!(symptoms::find(""), None);
}
