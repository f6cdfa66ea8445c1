//! The rules as data, and the judgement by all of them.

use alloc::vec::Vec;

use crate::breach::Breach;
use crate::claims::Claims;
use crate::evidence::Evidence;
use crate::rules;

/// One rule.
pub struct Rule {
    /// Its name in documents.
    pub name: &'static str,
    /// What it claims, as a sentence.
    pub claims: &'static str,
    /// The evidence that it needs, in words.
    pub needs: &'static str,
    /// The kind of what it finds.
    pub finds: &'static str,
    /// Checks the claims against the evidence.
    check: fn(&Claims, &Evidence, &mut Findings<'_>),
}

/// What a rule found; `device` is `None` for the segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Breached {
    /// Position of the SubDevice.
    pub device: Option<usize>,
    /// The breach.
    pub breach: Breach,
}

/// A claim that could not be checked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Unchecked {
    /// Position of the SubDevice; `None`: the claim is about the segment.
    pub device: Option<usize>,
    /// Name of the rule.
    pub rule: &'static str,
    /// The evidence that is missing.
    pub needs: &'static str,
}

/// The judgement by all rules.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Ruling {
    /// Breaches, by the order of the rules.
    pub breached: Vec<Breached>,
    /// Number of claims that were checked.
    pub checked: usize,
    /// Claims that were not.
    pub unchecked: Vec<Unchecked>,
}

/// Where a rule puts what it finds.
pub(crate) struct Findings<'a> {
    rule: &'static Rule,
    ruling: &'a mut Ruling,
}

impl Findings<'_> {
    /// The claim is kept.
    pub(crate) fn kept(&mut self) {
        self.ruling.checked += 1;
    }

    /// The claim is broken.
    pub(crate) fn broken(&mut self, device: Option<usize>, breach: Breach) {
        debug_assert_eq!(breach.name(), self.rule.finds, "of another rule");
        self.ruling.checked += 1;
        self.ruling.breached.push(Breached { device, breach });
    }

    /// The evidence for the claim is missing.
    pub(crate) fn unknown(&mut self, device: Option<usize>) {
        let (rule, needs) = (self.rule.name, self.rule.needs);
        self.ruling.unchecked.push(Unchecked { device, rule, needs });
    }
}

/// All rules, in the order in which they are judged: what explains the others comes first.
pub const RULES: &[Rule] = &[
    Rule {
        name: "operates",
        claims: "each SubDevice that is not optional is in OP",
        needs: "its AL status",
        finds: "not-operated",
        check: rules::state::operates,
    },
    Rule {
        name: "mode",
        claims: "a SubDevice runs in the mode that was asked for",
        needs: "its mode",
        finds: "other-mode",
        check: rules::sync::mode,
    },
    Rule {
        name: "starts",
        claims: "the next pulse of a SYNC0 that is switched on is to come",
        needs: "0x0990 and the SubDevice's clock",
        finds: "start-passed",
        check: rules::sync::starts,
    },
    Rule {
        name: "clock-kept",
        claims: "offset and delay of a clock stay as they are while SYNC0 runs",
        needs: "0x0920 and 0x0928 in operation",
        finds: "clock-set",
        check: rules::sync::clock_kept,
    },
    Rule {
        name: "sync0-cycle",
        claims: "SYNC0 has the cycle that was asked for",
        needs: "0x09A0",
        finds: "other-sync0-cycle",
        check: rules::sync::sync0_cycle,
    },
    Rule {
        name: "shift",
        claims: "SYNC0 comes at the time after the frame that was asked for",
        needs: "the distance from frames to SYNC0",
        finds: "other-shift",
        check: rules::sync::shift,
    },
    Rule {
        name: "in-phase",
        claims: "SYNC0 of SubDevices with the same cycle and shift comes at one instant",
        needs: "the phase of SYNC0, by a clock that is known to follow the reference",
        finds: "sync0-apart",
        check: rules::sync::in_phase,
    },
    Rule {
        name: "cycle",
        claims: "frames follow each other at the bus cycle",
        needs: "the times of frames",
        finds: "other-cycle",
        check: rules::frames::cycle,
    },
    Rule {
        name: "steady",
        claims: "frames stay where they are in the cycle of the reference clock",
        needs: "the phases of enough frames",
        finds: "frames-slide",
        check: rules::frames::steady,
    },
    Rule {
        name: "one-talker",
        claims: "one MainDevice sends",
        needs: "the senders of frames",
        finds: "several-talkers",
        check: rules::frames::one_talker,
    },
    Rule {
        name: "taken",
        claims: "the program takes its answers always before it sends the next frame, or always after",
        needs: "the sockets of the program",
        finds: "answers-untaken",
        check: rules::frames::taken,
    },
    Rule {
        name: "time",
        claims: "the reference time reaches the clocks often enough",
        needs: "the times of drift datagrams",
        finds: "time-not-distributed",
        check: rules::frames::time,
    },
    Rule {
        name: "process-data",
        claims: "a SubDevice that was described with process data has some",
        needs: "the lengths of its process data",
        finds: "no-process-data",
        check: rules::data::present,
    },
    Rule {
        name: "carried",
        claims: "outputs come to each SubDevice that has some, and inputs of it are fetched",
        needs: "the frames with its process data",
        finds: "not-carried",
        check: rules::data::carried,
    },
    Rule {
        name: "each-cycle",
        claims: "process data come to a SubDevice, and are fetched, in each of its cycles",
        needs: "the number of frames with its process data",
        finds: "carried-seldom",
        check: rules::data::each_cycle,
    },
    Rule {
        name: "interpolation",
        claims: "a drive interpolates its set points over the time from one to the next",
        needs: "0x60C2, as it was written",
        finds: "other-interpolation",
        check: rules::data::interpolation,
    },
    Rule {
        name: "own-address",
        claims: "no two SubDevices take the same logical bits",
        needs: "their FMMUs",
        finds: "shared-address",
        check: rules::data::own_address,
    },
    Rule {
        name: "guarded",
        claims: "outputs are guarded by the process data watchdog",
        needs: "the watchdog's registers",
        finds: "watchdog-off",
        check: rules::data::guarded,
    },
    Rule {
        name: "watchdog",
        claims: "the process data watchdog has the time that was asked for",
        needs: "the watchdog's registers",
        finds: "other-watchdog",
        check: rules::data::watchdog,
    },
];

/// Holds the evidence against the claims, by all rules.
pub fn judge(claims: &Claims, evidence: &Evidence) -> Ruling {
    let mut ruling = Ruling::default();
    for rule in RULES {
        (rule.check)(claims, evidence, &mut Findings { rule, ruling: &mut ruling });
    }
    ruling
}
