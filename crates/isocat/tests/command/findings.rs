//! Findings have kinds: what looks at them goes by these, and sentences are for people alone.
//!
//! `UPDATE_FINDINGS=1` writes the tables of `docs/findings.md`.

use std::path::Path;

use isocat::diagnosis::{Diagnosis, diagnose};
use isocat::html::run::{self, Run};
use isocat::recording::{Recorded, Recording};
use isocat::report::{NoteKind, words};
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_maindevice::Segment;
use isocat_maindevice::kind::Description;
use isocat_rules::book::Rule;
use isocat_sim::host::Stall;
use isocat_sim::{Judged, Kind};

/// A run with all that looks at it.
struct Ran {
    report: Report,
    recorded: Recorded,
    segment: Segment,
    limit: Nanos,
}

impl Ran {
    fn of(scenario: &Scenario) -> Self {
        let limit = scenario.sync0_limit;
        let spans = run::spans(scenario.devices.len());
        let recording = Recording::new(scenario.duration, limit, spans);
        let outcome = scenario.run().execute(Some(recording), &mut |_| {});
        let report = Report::new(scenario, &outcome);
        let segment = outcome.world.main().segment().clone();
        let recorded = outcome.world.into_tap().expect("the tap").finish();
        Self { report, recorded, segment, limit }
    }

    fn diagnoses(&self, report: &Report) -> Vec<Diagnosis> {
        diagnose(report, &self.recorded, &self.segment, self.limit)
    }

    fn page(&self, report: &Report) -> String {
        let Self { recorded, segment, limit, .. } = self;
        let command = "isocat run test.toml";
        Run { report, recorded, segment, limit: *limit, command }.page().render()
    }

    fn kinds(&self) -> Vec<&'static str> {
        self.report.findings.iter().map(|finding| finding.kind.name()).collect()
    }

    /// The diagnosis of the segment for a finding of this kind, with the sentence of the finding.
    fn of_segment(&self, kind: &str) -> Diagnosis {
        let finding = self.report.findings.iter().find(|finding| finding.kind.name() == kind);
        let what = &finding.unwrap_or_else(|| panic!("{kind}: {:?}", self.kinds())).what;
        let all = self.diagnoses(&self.report);
        let mut of_it = all.into_iter().filter(|one| one.position.is_none() && one.what == *what);
        of_it.next().unwrap_or_else(|| panic!("{kind} has no diagnosis"))
    }
}

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("test.toml", text).expect("it is right"))
}

const TWO: &str = r#"
cycle = "1ms"
hop_jitter = false
for = "500ms"
[[subdevice]]
device = "model_every_mode"
name = "conveyor"
[[subdevice]]
device = "model_every_mode"
name = "gripper"
"#;

/// Copies later than it states.
fn late() -> Ran {
    let text = TWO.replacen("for = ", "shift = \"200us\"\nfor = ", 1);
    Ran::of(&scenario(&(text + "copy_time = \"182us\"\n")))
}

/// A clock that is not led.
fn unled() -> Ran {
    let text = TWO.to_owned() + "clock = \"40ppm\"\n[host]\ndrift_compensation = false\n";
    Ran::of(&scenario(&text))
}

/// A device that refuses a state on the way up.
fn refused() -> Ran {
    let text = TWO.replace("model_every_mode", "kollmorgen_akd2g");
    Ran::of(&scenario(&(text + "misbehave = [\"refused-state SAFEOP\"]\n")))
}

/// True time at which [`TWO`] begins to be judged.
fn began() -> i64 {
    let sound = Ran::of(&scenario(TWO));
    assert!(sound.report.in_sync, "{}", sound.report.verdict);
    sound.report.segment.true_time.time_to_synchronization_ns.expect("it came up")
}

/// The MainDevice's machine does nothing for a while.
fn stalled(length: Nanos) -> Ran {
    let mut scenario = scenario(TWO);
    scenario.host.stall = Some(Stall { at: Nanos(began()) + Nanos::millis(100), length });
    Ran::of(&scenario)
}

/// The same, as if frames of that time had been lost: no file of a segment says that wires fail.
fn without_frames() -> Ran {
    let mut ran = stalled(Nanos::millis(5));
    for finding in &mut ran.report.findings {
        if let Kind::Judged(Judged::CyclesSkipped { cycles }) = finding.kind {
            finding.kind = Judged::FramesLost { frames: cycles }.into();
            finding.what = words::what(&finding.kind, words::Family::Virtual);
        }
    }
    ran
}

#[test]
fn no_diagnosis_page_or_text_goes_by_a_sentence() {
    let all = [
        late(),
        unled(),
        refused(),
        stalled(Nanos::millis(5)),
        stalled(Nanos::millis(250)),
        without_frames(),
    ];
    for ran in all {
        assert!(!ran.report.in_sync && !ran.report.findings.is_empty(), "{}", ran.report.verdict);
        let mut mutated = ran.report.clone();
        let mut words = vec![(ran.report.verdict.clone(), "Plain nonsense (v).".to_owned())];
        mutated.verdict = words[0].1.clone();
        let Report { findings, visits, .. } = &mut mutated;
        for finding in findings.iter_mut().chain(visits) {
            // What is said of two SubDevices is one sentence.
            let known = words.iter().find(|(what, _)| *what == finding.what);
            let nonsense = match known {
                Some((_, nonsense)) => nonsense.clone(),
                None => format!("nonsense ({})", words.len()),
            };
            words.push((std::mem::replace(&mut finding.what, nonsense.clone()), nonsense));
        }
        // A sentence may be part of another one.
        words[1..].sort_by_key(|(what, _)| std::cmp::Reverse(what.len()));
        let nonsense =
            |text: String| words.iter().fold(text, |text, (what, other)| text.replace(what, other));
        let expected: Vec<Diagnosis> = ran
            .diagnoses(&ran.report)
            .into_iter()
            .map(|one| Diagnosis {
                what: nonsense(one.what),
                causes: one.causes.into_iter().map(nonsense).collect(),
                ..one
            })
            .collect();
        assert_eq!(ran.diagnoses(&mutated), expected, "{:?}", ran.kinds());
        assert_eq!(ran.page(&mutated), nonsense(ran.page(&ran.report)), "{:?}", ran.kinds());
        let hints = |report: &Report| {
            let text = report.text();
            text.lines().filter(|line| line.contains("isocat explain")).map(str::to_owned).collect()
        };
        let (before, after): (Vec<String>, Vec<String>) = (hints(&ran.report), hints(&mutated));
        assert_eq!(before, after, "{:?}", ran.kinds());
    }
}

#[test]
fn a_refused_state_points_to_what_its_code_means() {
    let ran = refused();
    assert_eq!(ran.kinds(), ["failed"]);
    assert!(ran.report.text().contains("isocat explain 0x0001"), "{}", ran.report.text());
    let json = serde_json::to_value(&ran.report).expect("JSON");
    let figures = &json["findings"][0]["figures"];
    assert_eq!((&figures["cause"], &figures["code"]), (&"state-refused".into(), &1.into()));
}

#[test]
fn skipped_cycles_have_a_remedy() {
    let ran = stalled(Nanos::millis(5));
    let told = ran.of_segment("cycles-skipped");
    assert!(told.causes[0].contains("came later than a whole cycle"), "{told:?}");
    assert!(told.remedies[0].contains("--preflight"), "{told:?}");
    assert_eq!(told.remedies.len(), 2);
    let json = serde_json::to_value(&ran.report).expect("JSON");
    let finding = json["findings"].as_array().expect("findings").iter();
    let mut finding = finding.filter(|finding| finding["kind"] == "cycles-skipped");
    let cycles = finding.next().expect("it was found")["figures"]["cycles"].as_u64();
    assert!((4..=6).contains(&cycles.expect("a number")), "{cycles:?}");
}

#[test]
fn lost_frames_have_a_remedy() {
    let told = without_frames().of_segment("frames-lost");
    assert!(told.causes[0].contains("Frames were lost on the wire"), "{told:?}");
    assert!(told.remedies[0].contains("isocat scan counts errors"), "{told:?}");
}

#[test]
fn wrong_working_counters_have_a_remedy() {
    // So long that watchdogs end: SubDevices leave OP and take no outputs.
    let told = stalled(Nanos::millis(250)).of_segment("working-counter");
    assert!(told.causes[0].contains("did not take or give its process data"), "{told:?}");
    assert!(told.remedies[0].contains("the first one with a finding"), "{told:?}");
}

#[test]
fn pulses_without_outputs_name_the_frames_that_did_not_come() {
    // Frames that were lost can be looked at; those that a host did not send can't.
    for (ran, kind, remedy) in [
        (stalled(Nanos::millis(5)), "cycles-skipped", "--preflight"),
        (without_frames(), "frames-lost", "--capture"),
    ] {
        let all = ran.diagnoses(&ran.report);
        let one = all.iter().find(|one| one.position == Some(1)).expect("it missed outputs");
        let lost = ran.report.findings.iter().find(|finding| finding.kind.name() == kind);
        let lost = &lost.expect("it was found").what;
        assert!(one.causes[0].contains(lost) && one.causes[0].contains("did not come"), "{one:?}");
        assert!(one.remedies[0].contains(remedy), "{one:?}");
    }
}

#[test]
fn a_clock_is_diagnosed_by_the_limit_of_the_judges() {
    let mut scenario =
        scenario(&(TWO.to_owned() + "clock = \"40ppm\"\n[host]\ndrift_compensation = false\n"));
    let about_the_clock = |ran: &Ran| {
        let all = ran.diagnoses(&ran.report);
        all.iter().flat_map(|one| &one.causes).any(|cause| cause.contains("runs away"))
    };
    assert!(about_the_clock(&Ran::of(&scenario)));
    // 40 us each second: within this limit.
    scenario.sync0_limit = Nanos::millis(1);
    let ran = Ran::of(&scenario);
    let off = |finding: &isocat::report::Finding| {
        matches!(finding.kind, Kind::Judged(Judged::Sync0OffGrid { .. }))
    };
    assert!(!ran.report.findings.iter().any(off), "{:?}", ran.kinds());
    assert!(!about_the_clock(&ran));
}

/// A table of kinds as docs/findings.md shows it.
fn table<'a>(kinds: impl Iterator<Item = &'a Description>) -> String {
    let mut text = "| kind | what it means | figures |\n|---|---|---|\n".to_owned();
    for kind in kinds {
        let figures: Vec<String> = kind
            .figures
            .iter()
            .map(|figure| {
                let means = figure.means.trim().trim_end_matches('.');
                format!("`{}{}`: {means}", figure.name, figure.unit)
            })
            .collect();
        text += &format!("| `{}` | {} | {} |\n", kind.name, kind.means.trim(), figures.join("; "));
    }
    text
}

/// The table of the rules as docs/rules.md shows it.
fn rules() -> String {
    let mut text =
        "| rule | what it claims | the evidence that it needs | its kind |\n|---|---|---|---|\n"
            .to_owned();
    for Rule { name, claims, needs, finds, .. } in isocat_rules::book::RULES {
        text += &format!("| `{name}` | {claims} | {needs} | `{finds}` |\n");
    }
    text
}

#[test]
fn all_kinds_and_rules_are_documented() {
    for (page, name, table) in [
        ("findings", "findings", table(Kind::descriptions())),
        ("findings", "notes", table(NoteKind::DESCRIPTIONS.iter())),
        ("rules", "rules", rules()),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../docs/{page}.md"));
        let mut text = std::fs::read_to_string(&path).expect("the page is there");
        let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->\n"));
        let from = text.find(&begin).expect("the mark") + begin.len();
        let to = text.find(&end).expect("its end");
        if std::env::var_os("UPDATE_FINDINGS").is_some() {
            text.replace_range(from..to, &table);
            std::fs::write(&path, &text).expect("docs/ is writable");
            continue;
        }
        assert_eq!(&text[from..to], table, "{name}: run with UPDATE_FINDINGS=1");
    }
}
