//! Every form of input finds its meaning, and the likeliest comes first.

use super::*;

fn kinds(what: &str) -> Vec<&'static str> {
    explain(what).unwrap().iter().map(|meaning| meaning.kind).collect()
}

#[test]
fn numbers_that_are_several_things() {
    assert_eq!(kinds("0x001A"), ["AL status code"]);
    assert_eq!(kinds("0x0030"), ["AL status code", "AssignActivate"]);
    assert_eq!(kinds("0x0300"), ["AssignActivate", "register"]);
    assert_eq!(kinds("0x0310"), ["AssignActivate", "register"]);
    assert_eq!(kinds("0x0730"), ["AssignActivate"]);
    assert_eq!(kinds("0x0130"), ["register"]);
    assert_eq!(kinds("0x0990"), ["register"]);
    assert_eq!(kinds("0x1C32"), ["object"]);
    assert_eq!(kinds("0x0427"), ["value of 0x1C32:04 and 0x1C33:04"]);
    assert_eq!(kinds("0xC007"), ["AL status code", "value of 0x1C32:04 and 0x1C33:04"]);
    assert_eq!(kinds("0x06090030"), ["SDO abort code"]);
    assert_eq!(kinds("06090030"), ["SDO abort code"]);
    assert_eq!(kinds("26"), ["AL status code"]);
    assert_eq!(kinds("0x7008"), ["SoE error code"]);
    assert_eq!(kinds("0x0009"), ["register"], "SoE has it, too, and it is less often meant");
}

#[test]
fn a_kind_of_a_rule_names_the_rule_its_doors_and_its_evidence() {
    let found = explain("sync0-apart").unwrap();
    assert!(found[0].name.starts_with("of the rule `in-phase`: SYNC0 of SubDevices"), "{found:?}");
    assert!(found[0].name.contains("diagnose and record with --segment"), "{found:?}");
    assert!(found[0].read[0].starts_with("the phase of SYNC0"), "{found:?}");
}

#[test]
fn a_kind_says_which_one_is_meant() {
    for (what, kind, found) in [
        ("AL 0x0030", "AL status code", "0x0030"),
        ("al=0x0030", "AL status code", "0x0030"),
        ("register 0x0300", "register", "0x0300"),
        ("aa 0x0330", "AssignActivate", "0x0330"),
        ("AssignActivate 0x0500", "AssignActivate", "0x0500"),
        ("SI4 0x0427", "value of 0x1C32:04 and 0x1C33:04", "0x0427"),
        ("abort 0x08000022", "SDO abort code", "0x08000022"),
        ("SoE 0x1001", "SoE error code", "0x1001"),
        ("soe 9", "SoE error code", "0x0009"),
        ("object 0x1C33:06", "object", "0x1C33:06"),
        ("dc-sync0", "mode", "dc-sync0"),
        ("DC-Sync0", "mode", "dc-sync0"),
    ] {
        let meanings = explain(what).unwrap_or_else(|unknown| panic!("{unknown}"));
        assert_eq!(meanings.len(), 1, "{what}");
        assert_eq!((meanings[0].kind, meanings[0].what.as_str()), (kind, found), "{what}");
    }
}

#[test]
fn values_are_taken_apart() {
    let value = |what: &str| explain(what).unwrap().remove(0).value;
    let supported = value("0x1C32:04=0x0427");
    assert_eq!(supported, value("SI4 0x0427"));
    assert_eq!(supported.last().unwrap(), "modes: free-run, sm, dc-sync0");
    assert_eq!(supported.len(), 6, "bits 0, 1, 2, 5, 10: {supported:?}");
    assert_eq!(value("0x1C33:01=0x22"), ["0x22 (SM-synchronous with SM2)"]);
    assert_eq!(value("0x1C32:02=1000000"), ["1 ms"]);
    assert_eq!(value("0x1C32:0B=5"), ["5 (0x5)"]);
    let difference = "the local clock is 253 ns ahead of the time received (behind it on chips whose register text \
                      has bit 31 the other way round)";
    assert_eq!(value("0x092C=0x000000FD"), [difference]);
    assert!(value("0x092C=0x80000005")[0].contains("5 ns behind"));
    assert_eq!(value("0x0130=0x14"), ["SAFEOP+ERR"]);
    let word = value("0x0980=0x0730");
    assert_eq!(word, value("AssignActivate 0x0730"));
    assert_eq!(word.last().unwrap(), "modes: dc-shift-sync1, dc-sync1, dc-subordinated");
    assert_eq!(value("aa 0x0300").last().unwrap(), "modes: dc-sync0");
    assert_eq!(value("aa 0x0500").last().unwrap(), "modes: dc-sync1");
    assert_eq!(value("aa 0").last().unwrap(), "modes: sm, free-run");
}

#[test]
fn codes_of_makers_are_said_to_be_theirs() {
    let meanings = explain("AL 0xC007").unwrap();
    assert_eq!(meanings[0].name, "the maker's own");
    assert!(meanings[0].value[0].contains("0x8000 to 0xFFFF"));
    let text = text(&meanings);
    assert!(text.contains("manual") && text.contains("no maker's code is known here"), "{text}");
}

#[test]
fn what_is_not_known_names_what_is_near() {
    let hint = |what: &str| {
        let unknown = explain(what).unwrap_err();
        assert!(unknown.hint.contains("understood: ") || unknown.hint.contains("expected one of"));
        unknown.to_string()
    };
    assert!(hint("0x0038").contains("0x0037 (DC: invalid SYNC1 cycle time)"));
    assert!(hint("0x1C34").contains("nearest object is 0x1C33 (SM input parameter)"));
    assert!(!hint("0x5000").contains("nearest"));
    assert!(hint("0x06090039").contains("0x06090030"));
    assert!(hint("dc-sync").contains("did you mean \"dc-sync0\""));
    assert!(hint("0x1C32:13").contains("nothing is known of object 0x1C32:13"));
    assert!(hint("0x6060:00").contains("0x6060:00"));
    assert!(hint("0x1C32:04=abc").contains("\"abc\" is no number"));
    assert!(hint("SI4 0x10427").contains("is no SI4"));
    assert!(hint("1C32:").contains("index and a sub-index"));
    assert!(hint("").contains("is not understood"));
    for (kind, example) in [("AL", "AL 0x001A"), ("si4", "SI4 0x0427"), ("reg", "register 0x0990")]
    {
        let words = hint(kind);
        assert!(words.contains(&format!("a number must follow, such as \"{example}\"")), "{words}");
        assert!(!words.contains("did you mean"), "{words}");
        assert!(explain(example).is_ok(), "{example}");
    }
    for object in ["0x6040", "0x6040:00", "0x1018:1", "object 0x6040", "object 6040:00"] {
        let words = hint(object);
        assert!(words.contains("0x1C00, 0x1C12, 0x1C13, 0x1C32, 0x1C33, 0x10F1"), "{words}");
    }
    assert!(hint("0x0038").contains("understood: 0x001A"));
}

/// Every input gets an answer or a reason.
#[test]
fn nothing_that_is_typed_panics() {
    for short in (0..0x1000).chain((0x1000..=0xFFFFu32).step_by(13)) {
        for what in [format!("0x{short:04X}"), format!("SI4 {short:#x}"), format!("aa {short:#x}")]
        {
            if let Ok(meanings) = explain(&what) {
                assert!(!meanings.is_empty() && !text(&meanings).is_empty());
            }
        }
    }
    for sub in 0..=0xFFu32 {
        for index in objects::OBJECTS {
            let _ = explain(&format!("{index:04X}:{sub:02X}=0xFFFFFFFF"));
        }
    }
    for what in [
        "=",
        ":",
        "=:",
        "0x",
        "AL",
        "AL ",
        "AL =",
        "::",
        "0x0300=",
        "é:é",
        "al\u{a0}1",
        "0x1C32:-1",
    ] {
        assert!(explain(what).is_err(), "{what}");
    }
}

#[test]
fn text_keeps_within_a_hundred_columns() {
    for what in ["0x001A", "0x0300", "0x1C32:0B", "0x092C", "dc-subordinated", "0xC007"] {
        let text = text(&explain(what).unwrap());
        for line in text.lines() {
            assert!(line.chars().count() <= 100 && line == line.trim_end(), "{line:?}");
        }
    }
}

#[test]
fn keys_in_each_of_their_places() {
    let found = |what: &str| {
        let meanings = explain(what).unwrap_or_else(|unknown| panic!("{unknown}")).into_iter();
        meanings.map(|meaning| (meaning.kind, meaning.what)).collect::<Vec<_>>()
    };
    let (file, profile) = ("key of a segment file", "key of a profile");
    assert_eq!(found("input_shift"), [(file, "subdevice.input_shift".into())]);
    assert_eq!(found("cycle"), [(file, "cycle".into()), (file, "subdevice.cycle".into())]);
    assert_eq!(found("subdevice.cycle"), [(file, "subdevice.cycle".into())]);
    assert_eq!(found("sync_unit"), [(profile, "esc.sync_unit".into())]);
    // This word is a kind, too.
    assert!(explain("object").is_err());
    let both = [(profile, "object".into()), (profile, "startup.object".into())];
    assert_eq!(found("key object"), both);
    let text = text(&explain("input_shift").unwrap());
    assert!(text.contains("goes to: DeviceConfig::shift_inputs; object 0x1C33:03"), "{text}");
    for place in isocat_segment::keys::all() {
        let meanings = explain(&format!("key {}", place.path())).unwrap();
        assert!(
            meanings.iter().any(|meaning| meaning.means == place.key.means),
            "{}",
            place.path()
        );
        for line in self::text(&meanings).lines() {
            assert!(line.chars().count() <= 100 && line == line.trim_end(), "{line:?}");
        }
    }
    let hint = |what: &str| explain(what).unwrap_err().to_string();
    assert!(hint("input_shfit").contains("did you mean \"input_shift\""));
    assert!(hint("key inptu_shift").contains("did you mean \"input_shift\""));
}

#[test]
fn numbers_behind_the_words_of_their_kind() {
    for (text, kind, what) in [
        ("AL status code 0x001A", "AL status code", "0x001A"),
        ("AL status code: 001b", "AL status code", "0x001B"),
        ("SDO abort code 0x06090011", "SDO abort code", "0x06090011"),
    ] {
        let meanings = explain(text).unwrap_or_else(|unknown| panic!("{unknown}"));
        let first = &meanings[0];
        assert_eq!((first.kind, &*first.what, first.found), (kind, what, Found::Asked), "{text}");
    }
    let unknown = explain("unit: 3 of nothing").expect_err("no line");
    assert_eq!(unknown.reason, "is not understood");
}

#[test]
fn symptoms_are_explained_by_any_of_their_names() {
    let kinds = |what: &str| -> Vec<_> {
        let meanings = explain(what).unwrap_or_else(|unknown| panic!("{unknown}"));
        meanings.into_iter().map(|meaning| (meaning.kind, meaning.what)).collect()
    };
    for what in ["lost sync", "Out of sync", "SYNC lost"] {
        assert_eq!(kinds(what), [("symptom", "lost sync".into())], "{what}");
    }
    assert_eq!(kinds("wkc"), [("symptom", "working counter".into())]);
    // The key of segment files follows it.
    let jitter = kinds("jitter");
    assert_eq!(jitter[0], ("symptom", "jitter".into()));
    assert!(jitter.len() > 1 && jitter[1..].iter().all(|(kind, _)| kind.starts_with("key of")));
    let near = explain("lost synk").expect_err("it is misspelt");
    assert!(near.hint.contains("did you mean \"lost sync\"?"), "{}", near.hint);
}

#[test]
fn objects_of_external_synchronization_are_explained() {
    for (what, name) in [
        ("0x10F4", "external synchronization status"),
        ("0x10F4:12", "external time stamp"),
        ("0x10F5:01", "sync master"),
    ] {
        let meanings = explain(what).unwrap_or_else(|unknown| panic!("{unknown}"));
        assert_eq!(meanings[0].name, name);
    }
    assert!(explain("0x10F4:02").is_err());
}
